//! Methods with equal steps, budgets and seeds.

use std::sync::LazyLock;

use dpges_train::config::key;

use super::store::Shape;
use super::variant::Variant;

pub static SHAPE: Shape =
    Shape { name: "comparison", title: "Comparison of methods", line: "method", frontier_alone: false };

/// Everything that `train.method` can be, then presets that are methods of their own.
pub static METHODS: LazyLock<Vec<Variant>> = LazyLock::new(|| {
    let choices = key("train.method").choices.iter();
    let settings = |name| vec![format!("train.method={name}")];
    let of_key = choices.map(|choice| Variant::new(choice.name, choice.about(), settings(choice.name)));
    let ges = Variant::of_preset(
        "ges",
        "The predecessor (GES), as far as there are keys for it: discs, then frozen opaque surfels with Gaussians.",
        settings("dpges"),
    );
    of_key.chain([ges]).collect()
});

/// The methods that are `asked` for, in that order and without repetitions; if none is, all. Each has a `budget` of so many
/// primitives.
pub fn chosen(asked: &[String], budget: usize) -> Vec<Variant> {
    let mut chosen: Vec<Variant> = Vec::new();
    for method in asked.iter().filter_map(|label| METHODS.iter().find(|method| method.label == label)) {
        if chosen.iter().all(|other| other.label != method.label) {
            chosen.push(method.clone());
        }
    }
    if asked.is_empty() {
        chosen.clone_from(&METHODS);
    }
    chosen.iter_mut().for_each(|method| method.settings.push(format!("refine.budget={budget}")));
    chosen
}

#[cfg(test)]
mod tests {
    use std::collections::HashSet;

    use dpges_train::config::{Budget, Config, GaussianStage};

    use super::*;

    fn config(label: &str, first: &[String]) -> Config {
        let method = METHODS.iter().find(|method| method.label == label).unwrap();
        Config::resolve(None, None, &[first, &method.settings].concat()).unwrap()
    }

    #[test]
    fn every_method_resolves_and_keeps_data_seed_and_length() {
        let base = Config::default();
        assert_eq!(config("dpges", &[]), base);
        let labels: HashSet<&str> = METHODS.iter().map(|method| method.label).collect();
        assert!(labels.len() == METHODS.len() && labels.len() >= 6);
        for label in labels {
            let found = config(label, &[]);
            assert_eq!(found.data, base.data, "{label}");
            let own = !found.train.method.settings().is_empty();
            assert_eq!(found.init == base.init, !own, "{label}");
            let of_run =
                |config: &Config| (config.train.steps, config.train.seed, config.train.stop, config.refine.budget);
            assert_eq!(of_run(&found), of_run(&base), "{label}");
            assert_eq!(found == base, label == "dpges", "{label}");
        }
    }

    #[test]
    fn a_method_is_what_it_is_called_whatever_is_configured() {
        for method in METHODS.iter() {
            let found = config(method.label, &["train.method=mcmc".to_owned()]);
            assert_eq!(found, config(method.label, &[]), "{method:?}");
        }
        let ges = config("ges", &[]);
        assert_eq!((ges.stages.gaussians_by, ges.model.layers), (GaussianStage::Rest, 1));
    }

    #[test]
    fn they_are_compared_in_the_order_in_which_they_are_named_with_the_same_budget() {
        let labels = |asked: &[&str]| -> Vec<&str> {
            let asked: Vec<String> = asked.iter().map(|&label| label.to_owned()).collect();
            chosen(&asked, 7).iter().map(|method| method.label).collect()
        };
        assert_eq!(labels(&["ges", "dpges", "ges"]), ["ges", "dpges"]);
        assert!(labels(&[])[0] == "dpges" && labels(&[]).len() == METHODS.len());
        for method in chosen(&[], 1234) {
            let config = Config::resolve(None, None, &method.settings).unwrap();
            assert_eq!(config.refine.budget, Budget::Primitives(1234), "{}", method.label);
        }
    }
}
