//! The variants of the method, as settings of a configuration.

use std::fmt;

use clap::ValueEnum;
use dpges_train::config::layers::PRESETS;
use toml::{Table, Value};

/// Keys of a preset that say how long a run is and what it writes on the way, not what the method is.
const OF_THE_RUN: [&str; 3] = ["train.steps", "train.evaluate_every", "train.checkpoint_every"];

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
}

impl Variant {
    pub fn all() -> impl Iterator<Item = Self> {
        Self::value_variants().iter().copied()
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
        let of_the_method = named.filter(|(key, _)| !OF_THE_RUN.contains(&key.as_str()));
        settings.extend(of_the_method.map(|(key, value)| format!("{key}={value}")));
    }
    settings
}

#[cfg(test)]
mod tests {
    use dpges_train::config::Config;

    use super::*;

    fn config(variant: Variant) -> Config {
        Config::resolve(None, None, &variant.settings()).unwrap()
    }

    #[test]
    fn every_variant_has_the_name_of_the_paper() {
        let names: Vec<String> = Variant::all().map(Variant::name).collect();
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
        for variant in Variant::all().skip(1) {
            let found = config(variant);
            assert_ne!(found, full, "{variant}");
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
    }

    #[test]
    fn ges_is_its_preset_but_for_the_length() {
        let mut preset = Config::resolve(Some("ges"), None, &[]).unwrap();
        let full = config(Variant::Full).train;
        preset.train.steps = full.steps;
        preset.train.evaluate_every = full.evaluate_every;
        preset.train.checkpoint_every = full.checkpoint_every;
        assert_eq!(config(Variant::Ges), preset);
    }
}
