//! The variants of the method, as settings of a configuration.

use std::fmt;
use std::sync::LazyLock;

use clap::ValueEnum;
use clap::builder::PossibleValue;
use dpges_train::config::keys;

use super::super::series::preset::method_of;

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

/// Variants that are more or less than one key.
const OTHERS: [Variant; 3] = [
    Variant { name: METHOD, effect: "The method as configured", changes: Changes::Keys(&[]) },
    Variant { name: "ges", effect: "The predecessor (GES): preset `ges`", changes: Changes::Preset("ges") },
    Variant {
        name: "base",
        effect: "Colours as `sh`, and Gaussians from the discs that are no surfels (GES); needs stages.surfels",
        changes: Changes::Keys(&["model.colour=sh3", "stages.gaussians=0", "stages.gaussians_by=rest"]),
    },
];

/// All variants: those of the paper's table, then others in the order of their keys.
static ALL: LazyLock<Vec<Variant>> = LazyLock::new(|| {
    let of_keys = keys().flat_map(|key| {
        key.ablations.iter().map(|ablation| Variant {
            name: ablation.name,
            effect: ablation.effect,
            changes: Changes::Key(key.name, ablation.value),
        })
    });
    let mut all: Vec<Variant> = OTHERS.into_iter().chain(of_keys).collect();
    all.sort_by_key(|variant| PAPER.iter().position(|name| *name == variant.name).unwrap_or(PAPER.len()));
    all
});

/// The method, or the method but for one thing.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Variant {
    /// As `--only` takes it; also the name of its folder.
    pub name: &'static str,
    effect: &'static str,
    changes: Changes,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Changes {
    /// A key and its value.
    Key(&'static str, &'static str),
    /// Any number of `key=value`.
    Keys(&'static [&'static str]),
    /// What a preset says of the method.
    Preset(&'static str),
}

impl ValueEnum for Variant {
    fn value_variants<'a>() -> &'a [Self] {
        &ALL
    }

    fn to_possible_value(&self) -> Option<PossibleValue> {
        Some(PossibleValue::new(self.name).help(self.effect))
    }
}

impl fmt::Display for Variant {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.name)
    }
}

impl Variant {
    /// Those of `only` in the order of all variants; if it is empty, those of the paper's table.
    pub fn chosen(only: &[Self]) -> Vec<Self> {
        let is_chosen = |variant: &&Self| {
            if only.is_empty() { PAPER.contains(&variant.name) } else { only.contains(variant) }
        };
        ALL.iter().filter(is_chosen).copied().collect()
    }

    /// `key=value` of every key in which it differs from the method.
    pub fn settings(self) -> Vec<String> {
        match self.changes {
            Changes::Key(key, value) => vec![format!("{key}={value}")],
            Changes::Keys(settings) => settings.iter().map(|setting| setting.to_string()).collect(),
            Changes::Preset(preset) => method_of(preset),
        }
    }

    /// All variants as a table in Markdown.
    pub fn list() -> String {
        let row = |variant: &Self| {
            let keys = match variant.changes {
                Changes::Preset(preset) => format!("preset `{preset}`"),
                _ => variant.settings().iter().map(|set| format!("`{set}`")).collect::<Vec<_>>().join(", "),
            };
            format!("| `{}` | {} | {keys} |\n", variant.name, variant.effect)
        };
        let rows: String = ALL.iter().map(row).collect();
        format!("| variant | what changes | keys |\n|---|---|---|\n{rows}")
    }
}

#[cfg(test)]
mod tests {
    use std::collections::HashSet;

    use dpges_train::config::{Config, GaussianStage};

    use super::*;

    fn variant(name: &str) -> Variant {
        *ALL.iter().find(|variant| variant.name == name).unwrap()
    }

    fn config(variant: Variant) -> Config {
        Config::resolve(None, None, &variant.settings()).unwrap()
    }

    #[test]
    fn the_paper_s_variants_come_first_and_names_are_unique() {
        assert_eq!(Variant::chosen(&[]).iter().map(|variant| variant.name).collect::<Vec<_>>(), PAPER);
        assert_eq!(ALL[..PAPER.len()], Variant::chosen(&[]));
        assert_eq!(ALL.iter().map(|variant| variant.name).collect::<HashSet<_>>().len(), ALL.len());
        let [full, ges] = ["full", "ges"].map(variant);
        assert_eq!(Variant::chosen(&[ges, full]), [full, ges]);
    }

    #[test]
    fn every_variant_differs_from_the_method_and_keeps_data_seed_and_steps() {
        let staged = |variant: Variant| {
            let stages =
                ["stages.surfels=0.2", "stages.gaussians=0.3", "train.lambda_transmittance=0.05"].map(str::to_owned);
            Config::resolve(None, None, &[&stages[..], &variant.settings()].concat()).unwrap()
        };
        let full = staged(variant("full"));
        assert_eq!(config(variant("full")), Config::default());
        for &variant in &ALL[1..] {
            let found = staged(variant);
            assert_ne!(found, full, "{variant}");
            assert_eq!((&found.data, &found.init), (&full.data, &full.init), "{variant}");
            let length = |config: &Config| (config.train.steps, config.train.seed, config.train.evaluate_every);
            assert_eq!(length(&found), length(&full), "{variant}");
        }
        assert_eq!(config(variant("base")).stages.gaussians_by, GaussianStage::Rest);
    }
}
