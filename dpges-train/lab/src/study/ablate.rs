//! The method, and the method without one of its parts.

use std::sync::LazyLock;

use dpges_train::config::{Config, keys};

use super::store::Shape;
use super::variant::Variant;

pub static SHAPE: Shape = Shape { name: "ablation", title: "Ablations", line: "variant", frontier_alone: false };

/// The variant that is the method itself.
pub const METHOD: &str = "full";

/// The paper's table (DP-GES, ablation studies), in its order.
const PAPER: [&str; 9] = [
    METHOD,
    "layers-2",
    "layers-4",
    "no-transmittance-gradient",
    "no-surfel-loss",
    "no-scale-loss",
    "no-transmittance-loss",
    "sh",
    "ges",
];

/// All variants: those of the paper's table, then others in the order of their keys.
pub static VARIANTS: LazyLock<Vec<Variant>> = LazyLock::new(|| {
    let mut all = vec![
        Variant::new(METHOD, "The method as configured", vec![]),
        Variant::of_preset("ges", "The predecessor (GES): preset `ges`", vec![]),
        Variant::new(
            "base",
            "Colours as `sh`, and Gaussians from the discs that are no surfels (GES); needs stages.surfels",
            ["model.colour=sh3", "stages.gaussians=0", "stages.gaussians_by=rest"].map(str::to_owned).into(),
        ),
    ];
    all.extend(keys().flat_map(|key| {
        let settings = |value| vec![format!("{}={value}", key.name)];
        key.ablations.iter().map(move |of| Variant::new(of.name, of.effect, settings(of.value)))
    }));
    all.sort_by_key(|variant| PAPER.iter().position(|name| *name == variant.label).unwrap_or(PAPER.len()));
    all
});

/// The variants whose labels are in `only`, in the order of all. If that is empty, those of the paper's table, less those
/// that leave the configuration as it is; the second list has the labels of these.
///
/// # Errors
/// Those of `resolve`, which makes a configuration of `key=value`.
pub fn chosen<E>(
    only: &[String],
    resolve: impl Fn(&[String]) -> Result<Config, E>,
) -> Result<(Vec<Variant>, Vec<&'static str>), E> {
    let named = |variant: &&Variant| only.iter().any(|label| label == variant.label);
    if !only.is_empty() {
        return Ok((VARIANTS.iter().filter(named).cloned().collect(), Vec::new()));
    }
    let method = resolve(&[])?;
    let (mut kept, mut equal) = (Vec::new(), Vec::new());
    for variant in &VARIANTS[..PAPER.len()] {
        if variant.label != METHOD && resolve(&variant.settings)? == method {
            equal.push(variant.label);
        } else {
            kept.push(variant.clone());
        }
    }
    Ok((kept, equal))
}

#[cfg(test)]
mod tests {
    use std::collections::HashSet;

    use dpges_train::config::{ConfigError, GaussianStage};

    use super::*;

    fn variant(label: &str) -> &'static Variant {
        VARIANTS.iter().find(|variant| variant.label == label).unwrap()
    }

    fn config(variant: &Variant) -> Config {
        Config::resolve(None, None, &variant.settings).unwrap()
    }

    #[test]
    fn the_paper_s_variants_come_first_but_for_those_that_change_nothing() {
        let labels: Vec<&str> = VARIANTS.iter().map(|variant| variant.label).collect();
        assert_eq!(labels[..PAPER.len()], PAPER);
        assert_eq!(labels.iter().collect::<HashSet<_>>().len(), labels.len());
        let with = |weight: &'static str, only: &[&str]| {
            let only: Vec<String> = only.iter().map(|label| (*label).to_owned()).collect();
            let set = format!("train.lambda_transmittance={weight}");
            let resolve = |more: &[String]| -> Result<Config, ConfigError> {
                Config::resolve(None, None, &[std::slice::from_ref(&set), more].concat())
            };
            let (kept, equal) = chosen(&only, resolve).unwrap();
            (kept.iter().map(|variant| variant.label).collect::<Vec<_>>(), equal)
        };
        assert_eq!(with("0.08", &[]), (PAPER.to_vec(), vec![]));
        let (kept, equal) = with("0", &[]);
        assert_eq!((kept.len(), equal), (PAPER.len() - 1, vec!["no-transmittance-loss"]));
        assert!(!kept.contains(&"no-transmittance-loss"));
        assert_eq!(with("0", &["no-transmittance-loss", "full"]).0, ["full", "no-transmittance-loss"], "as asked");
    }

    #[test]
    fn every_variant_differs_from_the_method_and_keeps_data_seed_and_steps() {
        let staged = |variant: &Variant| {
            let stages =
                ["stages.surfels=0.2", "stages.gaussians=0.3", "train.lambda_transmittance=0.05"].map(str::to_owned);
            Config::resolve(None, None, &[&stages[..], &variant.settings].concat()).unwrap()
        };
        let full = staged(variant(METHOD));
        assert_eq!(config(variant(METHOD)), Config::default());
        for variant in &VARIANTS[1..] {
            let (found, label) = (staged(variant), variant.label);
            assert_ne!(found, full, "{label}");
            assert_eq!((&found.data, &found.init), (&full.data, &full.init), "{label}");
            let length = |config: &Config| (config.train.steps, config.train.seed, config.train.evaluate_every);
            assert_eq!(length(&found), length(&full), "{label}");
        }
        assert_eq!(config(variant("base")).stages.gaussians_by, GaussianStage::Rest);
    }
}
