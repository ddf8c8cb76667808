//! The variants of a study, as settings of a configuration.

use dpges_train::config::sources::preset_text;
use toml::{Table, Value};

/// Keys and sections of a preset that are no part of the method: length of the run, budget, learning rates, environment, output.
const OF_THE_RUN: [&str; 8] = [
    "train.steps",
    "train.evaluate_every",
    "train.checkpoint_every",
    "model.environment",
    "stages.position_share",
    "stages.surfel_scale",
    "stages.surfel_budget",
    "optimizer",
];

/// One way to train.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Variant {
    /// Unique in its study; also the name of its folder.
    pub label: &'static str,
    /// Its difference from others, in words.
    pub about: String,
    /// `key=value` of that.
    pub settings: Vec<String>,
    /// The preset that the settings come from.
    preset: Option<&'static str>,
}

impl Variant {
    pub fn new(label: &'static str, about: impl Into<String>, settings: Vec<String>) -> Self {
        Self { label, about: about.into(), settings, preset: None }
    }

    /// `settings`, and what preset `label` says of the method: a run of any length can have that.
    pub fn of_preset(label: &'static str, about: &str, settings: Vec<String>) -> Self {
        let mut variant = Self { preset: Some(label), ..Self::new(label, about, settings) };
        variant.settings.extend(method_of(label));
        variant
    }

    /// `all` as a table in Markdown with these titles.
    pub fn list(all: &[Self], titles: [&str; 3]) -> String {
        let row = |variant: &Self| {
            let keys = match variant.preset {
                Some(preset) => format!("preset `{preset}`"),
                None => variant.settings.iter().map(|set| format!("`{set}`")).collect::<Vec<_>>().join(", "),
            };
            format!("| `{}` | {} | {keys} |\n", variant.label, variant.about)
        };
        let rows: String = all.iter().map(row).collect();
        format!("| {} |\n|---|---|---|\n{rows}", titles.join(" | "))
    }
}

/// `key=value` of what a preset says of the method.
fn method_of(preset: &str) -> Vec<String> {
    let sections: Table = preset_text(preset).ok().and_then(|text| text.parse().ok()).expect("comes with the program");
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
    use dpges_train::config::Config;

    use super::*;

    #[test]
    fn ges_is_its_preset_but_for_the_length_and_the_rates() {
        let mut preset = Config::resolve(Some("ges"), None, &[]).unwrap();
        let Config { train, model, optimizer, stages, .. } = Config::default();
        preset.train.steps = train.steps;
        preset.train.evaluate_every = train.evaluate_every;
        preset.train.checkpoint_every = train.checkpoint_every;
        preset.model.environment = model.environment;
        preset.optimizer = optimizer;
        preset.stages.position_share = stages.position_share;
        preset.stages.surfel_scale = stages.surfel_scale;
        preset.stages.surfel_budget = stages.surfel_budget;
        assert_eq!(Config::resolve(None, None, &method_of("ges")).unwrap(), preset);
    }
}
