//! Speed, size and time against quality: one scene drawn in many ways, and trained in many ways.

pub mod bench;
mod combine;
pub mod knob;
pub mod subject;
pub mod sweep;
pub mod trained;

use dpges_core::scene::ColourModel;
use dpges_train::config::{Config, HARD_RIM, Method};
use dpges_train::dataset::Dataset;
use dpges_train::eval::simplify::detail_of;
use dpges_train::run::budget;

use super::store::Shape;
use super::variant::Variant;

pub static SHAPE: Shape = Shape { name: "trade", title: "Speed and accuracy", line: "label", frontier_alone: true };

/// The configuration itself, then every value of every knob of training that changes it and `is_wanted`.
pub fn variants(config: &Config, dataset: &Dataset, is_wanted: &dyn Fn(&str) -> bool) -> Vec<Variant> {
    let mut all = vec![Variant::new("trained-again", "", vec![])];
    let mut add = |label, knob, settings| {
        if is_wanted(knob) {
            all.push(Variant::new(label, knob, settings));
        }
    };
    let primitives = budget(config, dataset);
    for (label, parts) in [("budget-half", 2), ("budget-quarter", 4)] {
        add(label, "budget", vec![format!("refine.budget={}", (primitives / parts).max(1))]);
    }
    let model = config.model.colour;
    for (label, detail) in [("detail-1", 1), ("detail-0", 0)] {
        let less = match model {
            ColourModel::SphericalBeta { .. } => ColourModel::SphericalBeta { lobes: detail },
            ColourModel::SphericalHarmonics { .. } | ColourModel::HarmonicsAndOpacity { .. } => {
                ColourModel::SphericalHarmonics { degree: detail }
            }
        };
        if detail < detail_of(model) {
            add(label, "detail", vec![format!("model.colour={less}")]);
        }
    }
    let other = match model {
        ColourModel::SphericalBeta { .. } => ("colour-sh3", "model.colour=sh3"),
        ColourModel::SphericalHarmonics { .. } | ColourModel::HarmonicsAndOpacity { .. } => {
            ("colour-sb2", "model.colour=sb2")
        }
    };
    // its opacities depend on the direction as its colours do, by harmonics
    if config.train.method != Method::SortFree {
        add(other.0, "colour", vec![other.1.to_owned()]);
    }
    if config.train.method == Method::Dpges {
        for (label, layers) in [("layers-1", 1), ("layers-2", 2), ("layers-3", 3), ("layers-4", 4)] {
            // rims fade into what a second layer shows: without one they have to be hard
            let modulation = config.model.modulation.max(if layers == 1 { HARD_RIM } else { 0.0 });
            if layers != config.model.layers {
                let settings = [format!("model.layers={layers}"), format!("model.modulation={modulation}")];
                add(label, "layers", settings.into());
            }
        }
        add("method-mcmc", "method", vec!["train.method=mcmc".to_owned()]);
    }
    let longest = dataset.longest_side();
    if longest > 1 {
        add("resolution-half", "resolution", vec![format!("data.max_resolution={}", longest / 2)]);
    }
    for (label, parts) in [("steps-half", 2), ("steps-quarter", 4)] {
        add(label, "steps", vec![format!("train.steps={}", (config.train.steps / parts).max(1))]);
    }
    add("steps-double", "steps", vec![format!("train.steps={}", 2 * config.train.steps)]);
    all
}

#[cfg(test)]
mod tests {
    use std::collections::HashSet;

    use dpges_train::dataset::{BuiltinOptions, builtin};

    use super::knob::KNOBS;
    use super::*;

    fn dataset() -> Dataset {
        let (width, height, train_views, test_views, points) = (20, 12, 2, 1, 10);
        builtin(&BuiltinOptions { width, height, train_views, test_views, points, ..Default::default() })
    }

    #[test]
    fn every_variant_is_another_configuration_but_the_first() {
        for set in [vec![], vec!["model.colour=sh3".to_owned()], vec!["train.method=mcmc".to_owned()]] {
            let resolve = |more: &[String]| Config::resolve(None, None, &[&set[..], more].concat()).unwrap();
            let base = resolve(&[]);
            let all = variants(&base, &dataset(), &|_| true);
            assert_eq!(resolve(&all[0].settings), base);
            assert!(all.iter().map(|variant| variant.label).collect::<HashSet<_>>().len() == all.len());
            for variant in &all[1..] {
                assert!(KNOBS.contains(&variant.about.as_str()), "{variant:?}");
                assert_ne!(resolve(&variant.settings), base, "{variant:?}");
            }
        }
    }

    #[test]
    fn values_are_parts_of_the_configured_ones() {
        let set = ["refine.budget=1000", "train.steps=8", "model.layers=2"].map(str::to_owned);
        let config = Config::resolve(None, None, &set).unwrap();
        let all = variants(&config, &dataset(), &|_| true);
        let settings = |label: &str| all.iter().find(|v| v.label == label).map(|v| v.settings[0].as_str());
        for (label, expected) in [
            ("budget-quarter", "refine.budget=250"),
            ("detail-0", "model.colour=sb0"),
            ("resolution-half", "data.max_resolution=10"),
            ("steps-half", "train.steps=4"),
            ("steps-double", "train.steps=16"),
            ("layers-1", "model.layers=1"),
            ("method-mcmc", "train.method=mcmc"),
        ] {
            assert_eq!(settings(label), Some(expected));
        }
        assert_eq!(settings("layers-2"), None);
        let wanted = variants(&config, &dataset(), &|knob| knob == "steps");
        assert_eq!(
            wanted.iter().map(|variant| variant.label).collect::<Vec<_>>()[..2],
            ["trained-again", "steps-half"]
        );
        let hard = all.iter().find(|v| v.label == "layers-1").map(|v| v.settings[1].as_str());
        assert_eq!(hard, Some("model.modulation=255"));
    }
}
