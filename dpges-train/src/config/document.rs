//! The keys as documents: TOML with comments, and tables in Markdown.

use std::fmt::Write as _;

use toml::Value;

use super::sources::PRESETS;
use super::{Config, Key, SECTIONS};

/// Width of comments, in characters.
const WIDTH: usize = 100;

const TOML_INTRODUCTION: &str = "Every key with its value and its meaning, as `dpges config` prints it. A file of your \
                                 own names only the keys that it changes: dpges train DATASET --config mine.toml";

impl Config {
    /// Every key with its value and, as comments, what it means and which values it takes; TOML that
    /// [`Config::resolve`] reads back.
    pub fn to_documented_toml(&self) -> String {
        let mut text = comment("# ", TOML_INTRODUCTION);
        let values = self.to_table();
        for section in SECTIONS {
            _ = write!(text, "\n{}[{}]\n", comment("# ", &section.about()), section.name);
            for key in section.keys {
                text += &format!("\n{}", comment("# ", &key.about()));
                for choice in key.choices {
                    text += &comment("#   ", &choice.documented(""));
                }
                let value = &values[section.name][key.short_name()];
                _ = writeln!(text, "{} = {}{}", key.short_name(), written(value), key.notes());
            }
        }
        text
    }
}

impl Key {
    fn short_name(&self) -> &str {
        self.name.split_once('.').map_or(self.name, |(_, name)| name)
    }

    /// Unit, range and ablations.
    fn notes(&self) -> String {
        let unit = (!self.unit.is_empty()).then(|| self.unit.to_owned());
        let range = self.range.map(|range| range());
        let ablations = self.ablations.iter().map(|ablation| format!("ablation {}: {}", ablation.name, ablation.value));
        let notes: Vec<String> = unit.into_iter().chain(range).chain(ablations).collect();
        if notes.is_empty() { String::new() } else { format!("  # {}", notes.join("; ")) }
    }
}

/// A table of the presets other than `default`, then one of the keys of each section, in Markdown.
pub fn markdown() -> String {
    let mut text = "## Presets\n\n| preset | for |\n|---|---|\n".to_owned();
    for (name, toml) in &PRESETS[1..] {
        let lines = toml.lines().map_while(|line| line.strip_prefix('#')).map(str::trim);
        _ = writeln!(text, "| `{name}` | {} |", lines.collect::<Vec<_>>().join(" "));
    }
    let defaults = Config::default().to_table();
    for section in SECTIONS {
        _ = write!(text, "\n## `[{}]`\n\n{}\n\n", section.name, section.about());
        text += "| key | meaning | default | unit | allowed | ablation |\n|---|---|---|---|---|---|\n";
        for key in section.keys {
            let default = written(&defaults[section.name][key.short_name()]);
            let choices = key.choices.iter().map(|choice| choice.documented("`"));
            let choices = choices.collect::<Vec<_>>().join("<br>");
            let allowed = if choices.is_empty() { key.allowed() } else { choices };
            let ablations = key.ablations.iter().map(|ablation| format!("`{}`: {}", ablation.name, ablation.value));
            let ablations = ablations.collect::<Vec<_>>().join("<br>");
            let (Key { name, unit, .. }, meaning) = (key, key.about());
            _ = writeln!(text, "| `{name}` | {meaning} | `{default}` | {unit} | {allowed} | {ablations} |");
        }
    }
    text
}

/// A value as people write it: small numbers with an exponent.
fn written(value: &Value) -> String {
    match value {
        Value::Float(number) if *number != 0.0 && number.abs() < 1e-3 => format!("{number:e}"),
        value => value.to_string(),
    }
}

/// Lines of at most [`WIDTH`] characters, each after `prefix`.
fn comment(prefix: &str, text: &str) -> String {
    let mut lines: Vec<String> = Vec::new();
    for word in text.split_whitespace() {
        match lines.last_mut() {
            Some(line) if line.chars().count() + word.chars().count() < WIDTH => *line += &format!(" {word}"),
            _ => lines.push(format!("{prefix}{word}")),
        }
    }
    lines.join("\n") + "\n"
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::keys;

    #[test]
    fn documented_toml_is_the_configuration() {
        let mut config = Config::default();
        (config.train.steps, config.optimizer.poses) = (77, 2.5e-9);
        let text = config.to_documented_toml();
        assert_eq!(toml::from_str::<Config>(&text).unwrap(), config);
        assert!(text.lines().filter(|line| line.starts_with('#')).all(|line| line.chars().count() <= WIDTH), "{text}");
        assert!(text.contains("\nposes = 2.5e-9  # radians, extents; at least 0\n"), "{text}");
    }

    #[test]
    fn choices_and_ablations_are_values_of_their_keys() {
        let resolves = |key: &Key, value: &str| Config::with(&[&format!("{}={value}", key.name)]).unwrap();
        for key in keys() {
            for choice in key.choices {
                let example = match choice.name {
                    "N" => "2",
                    "sbN" => "sb2",
                    "shN" => "sh2",
                    "NMB" => "2MB",
                    "NGB" => "2GB",
                    "Npx" => "2px",
                    "Npx/MP" => "2px/MP",
                    "x, y, z, -x, -y, -z" => "-y",
                    "a,b,c" => "0,-1,0.2",
                    "r,g,b" => "0,0.5,1",
                    // of pictures of `dpges render` alone
                    "transparent" => continue,
                    name => name,
                };
                resolves(key, example);
            }
            for ablation in key.ablations {
                resolves(key, ablation.value);
            }
        }
    }

    #[test]
    fn help_says_what_a_key_means_and_allows() {
        assert_eq!(
            crate::config::key("train.steps").help(),
            "Length of the run, all stages together. Each step renders one view \
             [key: train.steps; unit: steps; allowed: at least 1]"
        );
    }
}
