//! The variants of the method, as settings of a configuration.

use std::fmt;

use clap::ValueEnum;
use dpges_train::config::layers::PRESETS;
use toml::{Table, Value};

/// Keys of a preset that say how long a run is, how fast it learns and what it writes on the way, not what the method
/// is; and sections of such keys.
const OF_THE_RUN: [&str; 7] = [
    "train.steps",
    "train.evaluate_every",
    "train.checkpoint_every",
    "stages.position_share",
    "stages.surfel_scale",
    "refine.add_as",
    "optimizer",
];

/// The method, or the method but for one thing (DP-GES, ablation studies).
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum Variant {
    /// The method as configured
    Full,
    /// Two layers are peeled
    #[value(name = "layers-2")]
    Layers2,
    /// Four layers are peeled
    #[value(name = "layers-4")]
    Layers4,
    /// No gradient from Gaussians to surfels
    NoTransmittanceGradient,
    /// Without the loss of the surfels alone
    NoSurfelLoss,
    /// Without the scale loss
    NoScaleLoss,
    /// Without the transmittance loss
    NoTransmittanceLoss,
    /// Spherical harmonics of degree 3 as colours
    Sh,
    /// The predecessor: preset `ges`
    Ges,
    /// Spherical harmonics, and Gaussians from the discs that are no surfels, as in GES; needs stages.surfels
    Base,
    /// Surfels start where the points are
    NoSurfelStage,
    /// Gaussians start where the points are
    NoGaussianStage,
    /// Without splitting Gaussians
    NoSplit,
    /// Margins of a surfel's own scales
    RawMargin,
    /// Transmittance looked up at bare depths
    LiteralLookup,
    /// Surfels end where their opacity, not their kernel, does
    OpacityFootprint,
    /// Opacities of Gaussians below 1
    SigmoidOpacity,
}

/// The variants of the paper's table.
const PAPER: [Variant; 9] = [
    Variant::Full,
    Variant::Layers2,
    Variant::Layers4,
    Variant::NoTransmittanceGradient,
    Variant::NoSurfelLoss,
    Variant::NoScaleLoss,
    Variant::NoTransmittanceLoss,
    Variant::Sh,
    Variant::Ges,
];

impl Variant {
    /// Those of `only` in their order, or where that is empty those of the paper's table.
    pub fn chosen(only: &[Self]) -> Vec<Self> {
        let among = if only.is_empty() { &PAPER } else { only };
        Self::value_variants().iter().copied().filter(|variant| among.contains(variant)).collect()
    }

    /// As `--only` takes it; also the name of its folder.
    pub fn name(self) -> String {
        self.to_possible_value().expect("none is skipped").get_name().to_owned()
    }

    /// `key=value` of every key in which it differs from the method.
    pub fn settings(self) -> Vec<String> {
        let setting = match self {
            Self::Full => return Vec::new(),
            Self::Layers2 => "model.layers=2",
            Self::Layers4 => "model.layers=4",
            Self::NoTransmittanceGradient => "train.detach_transmittance=true",
            Self::NoSurfelLoss => "train.lambda_surfel=0",
            Self::NoScaleLoss => "train.lambda_scale=0",
            Self::NoTransmittanceLoss => "train.lambda_transmittance=0",
            Self::Sh => "model.colour=sh3",
            Self::Ges => return method_of("ges"),
            Self::Base => {
                let settings = ["model.colour=sh3", "stages.gaussians=0", "stages.gaussians_by=rest"];
                return settings.map(str::to_owned).into();
            }
            Self::NoSurfelStage => "stages.surfels=0",
            Self::NoGaussianStage => "stages.gaussians=0",
            Self::NoSplit => "refine.split=false",
            Self::RawMargin => "model.margin=raw",
            Self::LiteralLookup => "model.margin_lookup=literal",
            Self::OpacityFootprint => "model.footprint=opacity",
            Self::SigmoidOpacity => "model.opacity=sigmoid",
        };
        vec![setting.to_owned()]
    }
}

impl fmt::Display for Variant {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(&self.name())
    }
}

/// `key=value` of what a preset says of the method.
fn method_of(preset: &str) -> Vec<String> {
    let (_, text) = PRESETS.into_iter().find(|(name, _)| *name == preset).expect("comes with the program");
    let sections: Table = text.parse().expect("presets are valid TOML");
    let mut settings = Vec::new();
    for (section, keys) in sections {
        let Value::Table(keys) = keys else { continue };
        let named = keys.into_iter().map(|(key, value)| (format!("{section}.{key}"), value));
        let is_of_the_run = |key: &str| OF_THE_RUN.contains(&key) || OF_THE_RUN.contains(&section.as_str());
        let of_the_method = named.filter(|(key, _)| !is_of_the_run(key));
        settings.extend(of_the_method.map(|(key, value)| format!("{key}={value}")));
    }
    settings
}

#[cfg(test)]
mod tests {
    use dpges_train::config::{Config, GaussianStage, OpacityActivation};

    use super::*;

    fn config(variant: Variant) -> Config {
        Config::resolve(None, None, &variant.settings()).unwrap()
    }

    #[test]
    fn every_variant_has_the_name_of_the_paper() {
        let names: Vec<String> = Variant::chosen(&[]).into_iter().map(Variant::name).collect();
        let expected = [
            "full",
            "layers-2",
            "layers-4",
            "no-transmittance-gradient",
            "no-surfel-loss",
            "no-scale-loss",
            "no-transmittance-loss",
            "sh",
            "ges",
        ];
        assert_eq!(names, expected);
    }

    #[test]
    fn every_variant_differs_from_the_method_and_keeps_data_seed_and_steps() {
        let full = config(Variant::Full);
        assert_eq!(full, Config::default());
        for &variant in &Variant::value_variants()[1..] {
            let found = config(variant);
            let without_stages = matches!(variant, Variant::NoSurfelStage | Variant::NoGaussianStage);
            assert_eq!(found == full, without_stages, "{variant}");
            assert_eq!((&found.data, &found.init), (&full.data, &full.init), "{variant}");
            let length = |config: &Config| (config.train.steps, config.train.seed, config.train.evaluate_every);
            assert_eq!(length(&found), length(&full), "{variant}");
        }
        assert_eq!(config(Variant::Layers2).model.layers, 2);
        assert_eq!(config(Variant::Layers4).model.layers, 4);
        assert!(config(Variant::NoTransmittanceGradient).train.detach_transmittance);
        assert_eq!(config(Variant::NoSurfelLoss).train.lambda_surfel, 0.0);
        assert_eq!(config(Variant::NoScaleLoss).train.lambda_scale, 0.0);
        assert_eq!(config(Variant::NoTransmittanceLoss).train.lambda_transmittance, 0.0);
        assert_eq!(config(Variant::Sh).model.colour.to_string(), "sh3");
        assert_eq!(config(Variant::SigmoidOpacity).model.opacity, OpacityActivation::Sigmoid);
        assert_eq!(config(Variant::Base).stages.gaussians_by, GaussianStage::Rest);
        let staged = |variant: Variant| {
            let stages = ["stages.surfels=0.2", "stages.gaussians=0.3"].map(str::to_owned);
            let stages = Config::resolve(None, None, &[&stages[..], &variant.settings()].concat()).unwrap().stages;
            (stages.surfels, stages.gaussians)
        };
        assert_eq!(staged(Variant::NoSurfelStage), (0.0, 0.3));
        assert_eq!(staged(Variant::NoGaussianStage), (0.2, 0.0));
        assert_eq!(Variant::chosen(&[Variant::Ges, Variant::Full]), [Variant::Full, Variant::Ges]);
    }

    #[test]
    fn ges_is_its_preset_but_for_the_length_and_the_rates() {
        let mut preset = Config::resolve(Some("ges"), None, &[]).unwrap();
        let full = config(Variant::Full).train;
        preset.train.steps = full.steps;
        preset.train.evaluate_every = full.evaluate_every;
        preset.train.checkpoint_every = full.checkpoint_every;
        let Config { optimizer, stages, refine, .. } = config(Variant::Full);
        preset.optimizer = optimizer;
        preset.stages.position_share = stages.position_share;
        preset.stages.surfel_scale = stages.surfel_scale;
        preset.refine.add_as = refine.add_as;
        assert_eq!(config(Variant::Ges), preset);
    }
}
