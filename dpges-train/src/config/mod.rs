//! The configuration of a run. `keys.rs` declares every key once: its meaning, default, unit, range and ablations.

pub mod budget;
pub mod choices;
pub mod declare;
mod differences;
pub mod document;
pub mod duration;
pub mod error;
pub mod keys;
mod loading;
pub mod memory;
pub mod pixels;
pub mod range;
pub mod sources;
pub mod stages;

pub use budget::Budget;
use budget::{MEGABYTE, primitives_for};
pub use choices::{
    Alpha, Background, DepthMaps, Environment, Exposure, GaussianStage, InitMethod, JointOpacity, Margin, Method,
    NewGaussians, Poses, Stop, SurfelStart, Upwards,
};
pub use declare::{Ablation, Key, Section};
pub use differences::differences;
use dpges_core::scene::ColourModel;
pub use dpges_core::scene::OpacityActivation;
pub use error::ConfigError;
pub use keys::{
    Config, DataConfig, DensityConfig, DiscsConfig, InitConfig, ModelConfig, OptimizerConfig, RefineConfig,
    RelocationConfig, SECTIONS, StagesConfig, StudentsConfig, TrainConfig, WeightedSumConfig,
};
pub use memory::Memory;
pub use pixels::PixelCount;
pub use stages::{Blended, Density, Relocation, StageKind, StagePlan};

/// Modulation at which rims of surfels are as hard as those of GES.
pub const HARD_RIM: f64 = 255.0;
/// Smallest budget by the size of the views, in primitives: even a small picture shows a whole scene.
pub const SMALLEST_BUDGET_BY_PIXELS: usize = 16_384;
/// Share of surfels for which a budget in megabytes is converted into primitives. Surfels and Gaussians differ by 4 %.
const SURFEL_SHARE: f64 = 0.1;
/// Every how many-th training view is kept for validation by default.
const DEFAULT_VALIDATION_EVERY: usize = 8;

/// Most primitives of an automatic budget over those of the budget `pixels`, with which it begins.
pub const AUTOMATIC_GROWTH: usize = 4;

/// All keys, in the order in which they are documented.
pub fn keys() -> impl Iterator<Item = &'static Key> {
    SECTIONS.iter().flat_map(|section| section.keys)
}

/// The key called `name`, such as `train.steps`.
///
/// # Panics
/// If there is none.
pub fn key(name: &str) -> &'static Key {
    keys().find(|key| key.name == name).unwrap_or_else(|| panic!("no key `{name}` is declared"))
}

/// The budget `pixels` of training views of `pixels` px.
pub fn primitives_by_pixels(pixels: usize) -> usize {
    (pixels / 2).max(SMALLEST_BUDGET_BY_PIXELS)
}

impl Config {
    /// Largest number of surfels and Gaussians together for training views of `pixels` px. An automatic budget is
    /// limited to [`AUTOMATIC_GROWTH`] times the budget `pixels`.
    pub fn most_primitives(&self, pixels: usize) -> usize {
        let by_pixels = primitives_by_pixels(pixels);
        match self.refine.budget {
            Budget::Pixels => by_pixels,
            Budget::Auto => AUTOMATIC_GROWTH * by_pixels,
            Budget::Primitives(count) => count,
            Budget::Megabytes(size) => primitives_for(MEGABYTE * size, self.scene_model(), SURFEL_SHARE).max(1),
        }
    }

    /// The colour model of the scenes of a run, which may have more than `model.colour` asks for.
    pub fn scene_model(&self) -> ColourModel {
        self.train.method.alone().map_or(self.model.colour, |blended| blended.colour_model(self.model.colour))
    }

    /// Every how many-th training view is kept for validation; 0: none. An automatic budget alone keeps none: the scene would
    /// lose more by their absence than it gains by their decisions.
    pub fn validation_every(&self) -> usize {
        match self.data.validation_every {
            0 if self.train.stop == Stop::Validation => DEFAULT_VALIDATION_EVERY,
            every => every,
        }
    }
}

impl TrainConfig {
    /// Whether a loss compares surfels with discs.
    pub fn has_geometry_losses(&self) -> bool {
        self.lambda_disc_depth > 0.0 || self.lambda_disc_normal > 0.0 || self.lambda_disc_depth_normal > 0.0
    }
}
