//! The methods that can be compared, as settings of a configuration.

use std::sync::LazyLock;

use clap::ValueEnum;
use clap::builder::PossibleValue;
use dpges_train::config::key;

use super::super::series::preset::method_of;

/// Presets that are methods of their own, and what they are.
const PRESETS: [(&str, &str); 1] = [(
    "ges",
    "The predecessor (GES), as far as there are keys for it: discs, then frozen opaque surfels with Gaussians.",
)];

/// Everything that `train.method` can be, then [`PRESETS`].
static ALL: LazyLock<Vec<Method>> = LazyLock::new(|| {
    let choices = key("train.method").choices.iter();
    let of_key = choices.map(|choice| Method { name: choice.name, about: choice.about(), preset: None });
    let of_preset = PRESETS.map(|(name, about)| Method { name, about: about.to_owned(), preset: Some(name) });
    of_key.chain(of_preset).collect()
});

/// A method to train.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Method {
    /// As `--methods` takes it; also the name of its folder.
    pub name: &'static str,
    about: String,
    /// `None` for a value of `train.method`.
    preset: Option<&'static str>,
}

impl ValueEnum for Method {
    fn value_variants<'a>() -> &'a [Self] {
        &ALL
    }

    fn to_possible_value(&self) -> Option<PossibleValue> {
        Some(PossibleValue::new(self.name).help(self.about.trim_end_matches('.').to_owned()))
    }
}

impl Method {
    /// `asked` without repetitions; if it is empty, all.
    pub fn chosen(asked: &[Self]) -> Vec<Self> {
        if asked.is_empty() {
            return ALL.clone();
        }
        let mut chosen: Vec<Self> = Vec::new();
        for method in asked {
            if !chosen.contains(method) {
                chosen.push(method.clone());
            }
        }
        chosen
    }

    /// `key=value` of everything that makes a configuration this method. What it does not name is as configured.
    pub fn settings(&self) -> Vec<String> {
        match self.preset {
            Some(preset) => [vec!["train.method=dpges".to_owned()], method_of(preset)].concat(),
            None => vec![format!("train.method={}", self.name)],
        }
    }

    /// All methods as a table in Markdown.
    pub fn list() -> String {
        let row = |method: &Self| {
            let keys = match method.preset {
                Some(preset) => format!("preset `{preset}`"),
                None => method.settings().iter().map(|set| format!("`{set}`")).collect::<Vec<_>>().join(", "),
            };
            format!("| `{}` | {} | {keys} |\n", method.name, method.about)
        };
        let rows: String = ALL.iter().map(row).collect();
        format!("| method | what is trained | keys |\n|---|---|---|\n{rows}")
    }
}

#[cfg(test)]
mod tests {
    use std::collections::HashSet;

    use dpges_train::config::{Config, GaussianStage};

    use super::*;

    fn method(name: &str) -> Method {
        ALL.iter().find(|method| method.name == name).unwrap().clone()
    }

    fn config(method: &Method) -> Config {
        Config::resolve(None, None, &method.settings()).unwrap()
    }

    #[test]
    fn every_method_resolves_and_keeps_data_seed_and_length() {
        let base = Config::default();
        assert_eq!(config(&method("dpges")), base);
        assert!(ALL.iter().map(|method| method.name).collect::<HashSet<_>>().len() == ALL.len() && ALL.len() >= 6);
        for method in ALL.iter() {
            let found = config(method);
            assert_eq!(found.data, base.data, "{method:?}");
            let own = !found.train.method.settings().is_empty();
            assert_eq!(found.init == base.init, !own, "{method:?}");
            let of_run =
                |config: &Config| (config.train.steps, config.train.seed, config.train.stop, config.refine.budget);
            assert_eq!(of_run(&found), of_run(&base), "{method:?}");
            assert_eq!(found == base, method.name == "dpges", "{method:?}");
        }
    }

    #[test]
    fn a_method_is_what_it_is_called_whatever_is_configured() {
        for method in ALL.iter() {
            let configured = ["train.method=mcmc".to_owned()];
            let found = Config::resolve(None, None, &[&configured[..], &method.settings()].concat()).unwrap();
            assert_eq!(found, config(method), "{method:?}");
        }
        let ges = config(&method("ges"));
        assert_eq!((ges.stages.gaussians_by, ges.model.layers), (GaussianStage::Rest, 1));
    }

    #[test]
    fn they_are_compared_in_the_order_in_which_they_are_named() {
        let [ges, dpges] = ["ges", "dpges"].map(method);
        assert_eq!(Method::chosen(&[ges.clone(), dpges.clone(), ges.clone()]), [ges, dpges]);
        let all = Method::chosen(&[]);
        assert!(all[0].name == "dpges" && all.len() == ALL.len());
    }
}
