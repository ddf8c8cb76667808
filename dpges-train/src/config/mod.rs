//! One struct is the truth about a training run: its fields are the keys of the TOML files and of
//! `--set`, its [`Default`] is their default. `configs/default.toml` documents every key.
//!
//! [`layers`] puts presets, files and options on top of each other, [`range`] says what values make
//! sense, [`schedule`] turns the keys of `[refine]` into the steps of a run.

pub mod budget;
pub mod layers;
pub mod range;
pub mod schedule;
pub mod stages;

use std::fmt;
use std::str::FromStr;

use dpges_core::ops::adam::AdamStep;
use dpges_core::scene::{ColourModel, Footprint, MarginLookup};
use serde::{Deserialize, Serialize};

use crate::dataset::LoadOptions;

pub use budget::Budget;
use budget::primitives_for;
pub use layers::ConfigError;
pub use schedule::{Due, Schedule};
pub use stages::{
    DiscsConfig, GaussianStage, Method, Relocation, RelocationConfig, StageKind, StagePlan, StagesConfig,
};

#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Config {
    pub data: DataConfig,
    pub train: TrainConfig,
    pub model: ModelConfig,
    pub init: InitConfig,
    pub stages: StagesConfig,
    pub discs: DiscsConfig,
    pub relocation: RelocationConfig,
    pub optimizer: OptimizerConfig,
    pub refine: RefineConfig,
}

/// How a dataset is read.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct DataConfig {
    /// Colour behind everything; pictures with alpha are composited on it.
    pub background: Background,
    /// 1 reads the folder `images`; 2, 4, 8 read `images_2`, `images_4`, `images_8` as shipped.
    pub image_scale: u32,
    /// px; pictures whose longer side exceeds it are made smaller; 0 is no limit.
    pub max_resolution: usize,
    /// Every n-th view by name is held out, where the dataset has no split of its own; 0 holds out none.
    pub test_every: usize,
    /// Every n-th training view is left out of training for decisions on the way (`train.stop`, `refine.budget`);
    /// 0 leaves out every 8th if there is such a decision, none otherwise.
    pub validation_every: usize,
    /// World units; nothing nearer to a camera exists; 0 takes what suits the kind of dataset.
    pub near: f64,
}

/// Length of a run, its losses, what it writes.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct TrainConfig {
    /// What is trained.
    pub method: Method,
    /// One view per step, all stages together.
    pub steps: usize,
    /// When the run ends.
    pub stop: Stop,
    /// Evaluations without a better validation PSNR after which [`Stop::Validation`] ends the run.
    pub patience: usize,
    pub seed: u64,
    /// On GPUs: sums in a fixed order, so that two runs give the same bits. CPUs always add so.
    pub deterministic: bool,
    /// λ1: weight of the L1 loss of the surfels alone (DP-GES).
    pub lambda_surfel: f64,
    /// λ2: weight of the scale loss; DP-GES uses 5e-5 for unbounded and 1e-5 for bounded scenes.
    pub lambda_scale: f64,
    /// λ3: weight of the transmittance loss (DP-GES).
    pub lambda_transmittance: f64,
    /// Share of D-SSIM in the picture loss (3DGS).
    pub lambda_dssim: f64,
    /// λ4, λ5, λ6: weights of depth, normals, and normals of the depth of the surfels against those of the discs
    /// that they come from (DP-GES, geometry regularisation: 0.1, 0.05, 0.05); 0 for novel views.
    pub lambda_depth: f64,
    pub lambda_normal: f64,
    pub lambda_depth_normal: f64,
    /// No gradient from Gaussians to surfels through the transmittance: the ablation of DP-GES.
    pub detach_transmittance: bool,
    /// Surfels keep their places, rotations and scales, and none is pruned; their colours learn (GES, joint stage).
    pub freeze_surfels: bool,
    /// Steps between evaluations of the held-out views; 0 evaluates only at the end.
    pub evaluate_every: usize,
    /// Steps between checkpoints; 0 writes only the last.
    pub checkpoint_every: usize,
    /// Held-out views written as pictures at each evaluation.
    pub picture_views: usize,
}

/// What a scene is made of.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct ModelConfig {
    /// `sbN`: N spherical Beta lobes; `shN`: spherical harmonics of degree N.
    pub colour: ColourModel,
    /// K: surfels peeled per pixel.
    pub layers: usize,
    /// w: opacity of a surfel is min(1, w G).
    pub modulation: f64,
    /// How the opacity of a Gaussian is made from the number that is trained, in the joint stage.
    pub opacity: Opacity,
    pub footprint: Footprint,
    pub margin: Margin,
    /// Part of the scene: it is rendered as it was trained.
    pub margin_lookup: MarginLookup,
}

/// Where surfels and Gaussians come from.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct InitConfig {
    pub method: InitMethod,
    /// Points beyond it are left out at random; each point makes a surfel and a Gaussian.
    pub max_points: usize,
    /// Surfel scale over the root mean square distance to the 3 nearest points.
    pub surfel_scale: f64,
    /// Gaussian scale over the same distance.
    pub gaussian_scale: f64,
    /// No scale exceeds this fraction of the extent E.
    pub max_scale_extent: f64,
    /// No scale exceeds this multiple of the median scale.
    pub max_scale_median: f64,
    /// Linear opacity.
    pub gaussian_opacity: f64,
    /// Gaussians drawn where a scene has neither points nor silhouettes.
    pub random_gaussians: usize,
    /// Voxels along each side of the visual hull.
    pub hull_resolution: usize,
    /// Fraction of the views whose silhouette may miss a voxel of the hull.
    pub hull_tolerance: f64,
}

/// Adam; learning rates per step, of raw parameters.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct OptimizerConfig {
    /// Of positions at the first step, in units of the extent E.
    pub position_start: f64,
    /// Of positions at the last step, in units of the extent E; in between the logarithm is linear.
    pub position_end: f64,
    /// Of surfel positions, as a multiple of the Gaussians' rate.
    pub surfel_position_factor: f64,
    pub quaternions: f64,
    pub log_scales: f64,
    pub opacities: f64,
    pub base: f64,
    pub detail: f64,
    /// What is left at the last step of all rates but the positions'; in between the logarithm is linear.
    pub decay: f64,
    pub beta1: f64,
    pub beta2: f64,
    pub epsilon: f64,
}

/// When and how the set of primitives changes. Keys that end in `_at`, `_every`, `_from` and
/// `_until` are in steps of a run of [`schedule::REFERENCE_STEPS`] and scale with `train.steps`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct RefineConfig {
    /// When margins are computed.
    pub margins_at: Vec<usize>,
    pub surfel_prune_every: usize,
    pub surfel_prune_from: usize,
    /// Inclusive.
    pub surfel_prune_until: usize,
    /// px of a picture of 1 megapixel, in smaller and larger ones in proportion; a surfel that is
    /// nearest at no more pixels than this in every view is removed.
    pub surfel_min_pixels: usize,
    /// A surfel with a scale above this fraction of the extent E is removed.
    pub surfel_max_scale: f64,
    pub gaussian_prune_every: usize,
    /// Exclusive.
    pub gaussian_prune_until: usize,
    /// A Gaussian that contributes less than this colour to every pixel is removed.
    pub gaussian_min_contribution: f64,
    pub add_every: usize,
    pub add_from: usize,
    /// Exclusive.
    pub add_until: usize,
    /// From `add_until` to this, exclusive, Gaussians that draw nothing any more make room for new ones, as they do
    /// with every batch. DP-GES: 0.
    pub replace_until: usize,
    /// Whether Gaussians are also added where no surfel is. DP-GES: false.
    pub add_everywhere: bool,
    /// What new Gaussians look like.
    pub add_as: AddAs,
    /// Surfels and Gaussians together never exceed it, see [`Config::most_primitives`].
    pub budget: Budget,
    /// When an automatic budget drops lobes that do nothing.
    pub drop_lobes_at: Vec<usize>,
    /// Whether Gaussians are split at all.
    pub split: bool,
    pub split_every: usize,
    /// Inclusive.
    pub split_until: usize,
    /// A Gaussian is split when its mean scale exceeds this multiple of the margins around it.
    pub split_factor: f64,
}

impl Default for DataConfig {
    fn default() -> Self {
        Self {
            background: Background::Auto,
            image_scale: 1,
            max_resolution: 1600,
            test_every: 8,
            validation_every: 0,
            near: 0.0,
        }
    }
}

impl Default for TrainConfig {
    fn default() -> Self {
        Self {
            method: Method::Dpges,
            steps: 5000,
            stop: Stop::Steps,
            patience: 5,
            seed: 0,
            deterministic: false,
            lambda_surfel: 0.01,
            lambda_scale: 1e-5,
            lambda_transmittance: 0.08,
            lambda_dssim: 0.2,
            lambda_depth: 0.0,
            lambda_normal: 0.0,
            lambda_depth_normal: 0.0,
            detach_transmittance: false,
            freeze_surfels: false,
            evaluate_every: 1000,
            checkpoint_every: 1000,
            picture_views: 3,
        }
    }
}

impl Default for ModelConfig {
    fn default() -> Self {
        Self {
            colour: ColourModel::SphericalBeta { lobes: 2 },
            layers: 3,
            modulation: 30.0,
            opacity: Opacity::Linear,
            footprint: Footprint::Kernel,
            margin: Margin::Median,
            margin_lookup: MarginLookup::Shifted,
        }
    }
}

impl Default for InitConfig {
    fn default() -> Self {
        Self {
            method: InitMethod::Auto,
            max_points: 50_000,
            surfel_scale: 0.4,
            gaussian_scale: 0.5,
            max_scale_extent: 0.06,
            max_scale_median: 10.0,
            gaussian_opacity: 0.1,
            random_gaussians: 50_000,
            hull_resolution: 96,
            hull_tolerance: 0.02,
        }
    }
}

impl Default for OptimizerConfig {
    fn default() -> Self {
        Self {
            position_start: 1.6e-4,
            position_end: 1.6e-6,
            surfel_position_factor: 1.0,
            quaternions: 2e-3,
            log_scales: 7.5e-3,
            opacities: 1e-2,
            base: 5e-3,
            detail: 5e-3,
            decay: 1.0,
            beta1: 0.9,
            beta2: 0.999,
            epsilon: 1e-15,
        }
    }
}

impl Default for RefineConfig {
    fn default() -> Self {
        Self {
            margins_at: vec![0, 4000],
            surfel_prune_every: 1000,
            surfel_prune_from: 1000,
            surfel_prune_until: 15_000,
            surfel_min_pixels: 16,
            surfel_max_scale: 0.06,
            gaussian_prune_every: 500,
            gaussian_prune_until: 2000,
            gaussian_min_contribution: 0.02,
            add_every: 1000,
            add_from: 3000,
            add_until: 13_000,
            replace_until: 20_000,
            add_everywhere: true,
            add_as: AddAs::Picture,
            budget: Budget::Pixels,
            drop_lobes_at: vec![16_000, 22_000],
            split: true,
            split_every: 2000,
            split_until: 16_000,
            split_factor: 2.0,
        }
    }
}

impl DataConfig {
    pub fn load_options(&self) -> LoadOptions {
        LoadOptions {
            background: match self.background {
                Background::Auto => None,
                Background::Colour(colour) => Some(colour),
            },
            image_scale: (self.image_scale > 1).then_some(self.image_scale),
            max_resolution: (self.max_resolution > 0).then_some(self.max_resolution),
            test_every: self.test_every,
            near: (self.near > 0.0).then_some(self.near),
        }
    }
}

/// Below this a budget by the size of the views does not go: even a small picture shows a whole scene.
pub const SMALLEST_BUDGET_BY_PIXELS: usize = 16_384;
/// Share of surfels that a budget in megabytes is turned into primitives with; they differ by 4 %.
const SURFEL_SHARE: f64 = 0.1;

impl Config {
    /// Most surfels and Gaussians together, for training views of `pixels` px. An automatic budget ends at twice what
    /// suits the size of the views, if nothing ends it before.
    pub fn most_primitives(&self, pixels: usize) -> usize {
        let by_pixels = (pixels / 2).max(SMALLEST_BUDGET_BY_PIXELS);
        match self.refine.budget {
            Budget::Pixels => by_pixels,
            Budget::Auto => 2 * by_pixels,
            Budget::Primitives(count) => count,
            Budget::Megabytes(size) => primitives_for(1e6 * size, self.model.colour, SURFEL_SHARE).max(1),
        }
    }
}

/// Share of the training views that decisions are made by, where nothing else is said.
const AUTOMATIC_VALIDATION: usize = 8;

impl Config {
    /// Every how many-th training view is kept for decisions; 0: none.
    pub fn validation_every(&self) -> usize {
        let decides = self.train.stop == Stop::Validation || self.refine.budget == Budget::Auto;
        match self.data.validation_every {
            0 if decides => AUTOMATIC_VALIDATION,
            every => every,
        }
    }
}

impl TrainConfig {
    /// Whether surfels are held to the depths and normals of discs.
    pub fn has_geometry_losses(&self) -> bool {
        self.lambda_depth > 0.0 || self.lambda_normal > 0.0 || self.lambda_depth_normal > 0.0
    }
}

impl OptimizerConfig {
    /// Adam's constants for the step after `completed` ones; the rate is to be set.
    pub fn adam(&self, completed: usize) -> AdamStep {
        AdamStep {
            learning_rate: 0.0,
            beta_1: self.beta1,
            beta_2: self.beta2,
            epsilon: self.epsilon,
            time: completed as u64 + 1,
        }
    }

    /// Learning rate of the Gaussians' positions in world units at `progress` (0 at the first step,
    /// 1 at the last) in a scene of extent `extent` (world units). 3DGS: linear in the logarithm.
    pub fn position_rate(&self, progress: f64, extent: f64) -> f64 {
        extent * between(self.position_start, self.position_end, progress)
    }

    /// Factor on every other rate at `progress`.
    pub fn decay_at(&self, progress: f64) -> f64 {
        between(1.0, self.decay, progress)
    }
}

fn between(start: f64, end: f64, progress: f64) -> f64 {
    start * (end / start).powf(progress.clamp(0.0, 1.0))
}

/// What ends a run.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Stop {
    /// Its length.
    #[default]
    Steps,
    /// Views left out of training, once they no longer improve; the best scene is the result.
    Validation,
}

/// The opacity of a Gaussian, from the number that is trained.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Opacity {
    /// That number, at least 0 (GES, DP-GES).
    #[default]
    Linear,
    /// Its logistic function, below 1 (3DGS).
    Sigmoid,
}

/// What a Gaussian that is added at a pixel looks like.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum AddAs {
    /// As the photograph does there, and no larger than a few pixels: it is of use at once.
    #[default]
    Picture,
    /// Black, and as wide as the distance to its neighbours (GES, DP-GES): it has to learn.
    Black,
}

/// What the depth margin of a surfel is made of.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Margin {
    /// The scales of the surfels around it: the median (DP-GES).
    #[default]
    Median,
    /// Its own scales (GES).
    Raw,
}

/// How surfels and Gaussians are placed at the start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum InitMethod {
    /// The first of the others that the dataset allows.
    #[default]
    Auto,
    /// On the points of structure from motion.
    Sfm,
    /// On the visual hull of pictures with alpha.
    Silhouette,
    /// Gaussians anywhere in sight, no surfels.
    Random,
}

/// `auto`, `black`, `white`, or three numbers from 0 to 1 with commas between.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(try_from = "String", into = "String")]
pub enum Background {
    /// What the kind of dataset is evaluated on: white for Blender's, black otherwise.
    #[default]
    Auto,
    /// Display-referred red, green and blue.
    Colour([f64; 3]),
}

impl fmt::Display for Background {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Auto => write!(f, "auto"),
            Self::Colour([r, g, b]) if [r, g, b] == [&0.0; 3] => write!(f, "black"),
            Self::Colour([r, g, b]) if [r, g, b] == [&1.0; 3] => write!(f, "white"),
            Self::Colour([r, g, b]) => write!(f, "{r},{g},{b}"),
        }
    }
}

impl FromStr for Background {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        match text {
            "auto" => return Ok(Self::Auto),
            "black" => return Ok(Self::Colour([0.0; 3])),
            "white" => return Ok(Self::Colour([1.0; 3])),
            _ => {}
        }
        let parts: Option<Vec<f64>> = text.split(',').map(|part| part.trim().parse().ok()).collect();
        match parts.as_deref() {
            Some(&[r, g, b]) if [r, g, b].iter().all(|c| (0.0..=1.0).contains(c)) => Ok(Self::Colour([r, g, b])),
            _ => Err(format!("background `{text}` is neither auto, black, white nor three numbers from 0 to 1")),
        }
    }
}

impl TryFrom<String> for Background {
    type Error = String;

    fn try_from(text: String) -> Result<Self, String> {
        text.parse()
    }
}

impl From<Background> for String {
    fn from(background: Background) -> Self {
        background.to_string()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rates_start_and_end_where_they_should() {
        let rates = OptimizerConfig { decay: 0.01, ..Default::default() };
        assert_eq!(rates.position_rate(0.0, 2.0), 3.2e-4);
        assert!((rates.position_rate(1.0, 2.0) - 3.2e-6).abs() < 1e-18);
        assert!((rates.position_rate(0.5, 1.0) - 1.6e-5).abs() < 1e-15);
        assert!((rates.decay_at(0.5) - 0.1).abs() < 1e-12);
        assert_eq!(rates.decay_at(0.0), 1.0);
    }

    #[test]
    fn zeros_and_auto_leave_the_choice_to_the_dataset() {
        let options = DataConfig { max_resolution: 0, ..Default::default() }.load_options();
        assert_eq!(options, LoadOptions::default());
        let data =
            DataConfig { background: Background::Colour([1.0; 3]), image_scale: 4, near: 0.5, ..Default::default() };
        let options = data.load_options();
        assert_eq!((options.background, options.image_scale, options.near), (Some([1.0; 3]), Some(4), Some(0.5)));
        assert_eq!(options.max_resolution, Some(1600));
    }

    #[test]
    fn backgrounds_read_what_they_write() {
        for text in ["auto", "black", "white", "0.25,0.5,1"] {
            assert_eq!(text.parse::<Background>().unwrap().to_string(), text);
        }
        for text in ["", "red", "1,1", "1,1,2", "0,0,nan"] {
            assert!(text.parse::<Background>().unwrap_err().contains(text));
        }
    }
}
