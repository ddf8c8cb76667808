//! In which keys two configurations differ.

use toml::Table;

use super::Config;

/// Says for each key whose value in `found` is not that in `expected`, the configuration of a run, what the two are.
pub fn differences(expected: &Config, found: &Config) -> Vec<String> {
    let table = |config: &Config| config.to_toml().parse::<Table>().unwrap_or_default();
    let (expected, found) = (table(expected), table(found));
    let mut differences = Vec::new();
    for (section, keys) in &expected {
        for (key, value) in keys.as_table().into_iter().flatten() {
            let asked = found.get(section).and_then(|keys| keys.get(key));
            if let Some(asked) = asked.filter(|asked| *asked != value) {
                differences.push(format!("`{section}.{key}` is {value}, not {asked}"));
            }
        }
    }
    differences
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::Budget;

    #[test]
    fn differences_name_the_keys() {
        let mut other = Config::default();
        other.train.steps = 7;
        assert_eq!(differences(&Config::default(), &other), ["`train.steps` is 5000, not 7"]);
        assert!(differences(&other, &other).is_empty());
        let before = other.clone();
        other.refine.budget = Budget::Primitives(9000);
        assert_eq!(differences(&before, &other), ["`refine.budget` is \"pixels\", not 9000"]);
    }
}
