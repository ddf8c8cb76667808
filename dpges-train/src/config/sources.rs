//! Where values come from: defaults, those of a kind of dataset, a preset, a file, `key=value`. Each names only what it
//! changes, and later ones win.

use std::path::Path;

use serde::Deserialize;
use toml::{Table, Value};

use super::{Config, ConfigError, DataConfig, Key, SECTIONS, keys};

/// Configurations that come with the program: name and TOML, which begins with a comment on what it is for.
pub const PRESETS: [(&str, &str); 12] = [
    ("default", include_str!("../../configs/default.toml")),
    ("quick", include_str!("../../configs/quick.toml")),
    ("cpu", include_str!("../../configs/cpu.toml")),
    ("fast", include_str!("../../configs/fast.toml")),
    ("balanced", "# The defaults, between `fast` and `quality`."),
    ("recommended", include_str!("../../configs/recommended.toml")),
    ("quality", include_str!("../../configs/quality.toml")),
    ("mipnerf360", include_str!("../../configs/mipnerf360.toml")),
    ("tanks-and-temples", include_str!("../../configs/tanks-and-temples.toml")),
    ("deep-blending", include_str!("../../configs/deep-blending.toml")),
    ("nerf-synthetic", include_str!("../../configs/nerf-synthetic.toml")),
    ("ges", include_str!("../../configs/ges.toml")),
];

impl Config {
    /// Defaults, then `preset`, then `file`, then each `key=value` of `set` in order (`train.steps=1000`); later ones
    /// win. The result is validated.
    ///
    /// # Errors
    /// Any [`ConfigError`]; it names the key, and the preset, file or option it came from.
    pub fn resolve(preset: Option<&str>, file: Option<&Path>, set: &[String]) -> Result<Self, ConfigError> {
        Self::resolve_for(&[], preset, file, set)
    }

    /// Defaults, then each `key=value` of `set`.
    pub fn with(set: &[&str]) -> Result<Self, ConfigError> {
        Self::resolve(None, None, &set.iter().map(|&text| text.to_owned()).collect::<Vec<_>>())
    }

    /// Like [`resolve`](Self::resolve), with each `key=value` of `of_dataset` above the defaults and below the preset.
    /// [What the method brings with it](super::Method::settings) comes between the two.
    ///
    /// # Errors
    /// Any [`ConfigError`].
    pub fn resolve_for(
        of_dataset: &[&str],
        preset: Option<&str>,
        file: Option<&Path>,
        set: &[String],
    ) -> Result<Self, ConfigError> {
        let over = |below: &[&str]| {
            let mut config = Self::default();
            for text in below {
                config.assign_text(text)?;
            }
            if let Some(name) = preset {
                config.assign_table(parse(preset_text(name)?, name)?, &format!("preset `{name}`"))?;
            }
            if let Some(path) = file {
                let (table, origin) = read(path)?;
                config.assign_table(table, &origin)?;
            }
            for text in set {
                config.assign_text(text)?;
            }
            config.validate()?;
            Ok::<Self, ConfigError>(config)
        };
        let config = over(of_dataset)?;
        let config = match config.train.method.settings() {
            [] => config,
            of_method => over(&[of_dataset, of_method].concat())?,
        };
        config.check_colours()?;
        Ok(config)
    }

    /// The section `[data]` of `file`, the configuration of a run, with each `key=value` of `set` on top. Other sections
    /// of the file are ignored.
    ///
    /// # Errors
    /// Any [`ConfigError`].
    pub fn resolve_data(file: Option<&Path>, set: &[String]) -> Result<DataConfig, ConfigError> {
        let mut config = Self::default();
        if let Some(path) = file {
            let (mut table, origin) = read(path)?;
            config.assign_table(table.remove_entry("data").into_iter().collect(), &origin)?;
        }
        for text in set {
            config.assign_text(text)?;
        }
        config.validate()?;
        Ok(config.data)
    }

    /// Every key with its value, as TOML that [`Config::resolve`] reads back.
    pub fn to_toml(&self) -> String {
        toml::to_string(self).expect("tables of numbers, strings and arrays, seeds within i64 once validated")
    }

    /// Every key with its value.
    pub(super) fn to_table(&self) -> Table {
        Table::try_from(self).expect("tables of numbers, strings and arrays, seeds within i64")
    }

    fn assign_table(&mut self, table: Table, origin: &str) -> Result<(), ConfigError> {
        for (section, value) in table {
            let is_known = SECTIONS.iter().any(|known| known.name == section);
            match value {
                Value::Table(keys) if is_known => {
                    for (key, value) in keys {
                        self.assign(&format!("{section}.{key}"), value, origin)?;
                    }
                }
                value if is_known => {
                    let reason = format!("expected a section [{section}], found {}", kind(&value));
                    return Err(ConfigError::Value { key: section, origin: origin.to_owned(), reason });
                }
                _ => return Err(unknown(&section, origin)),
            }
        }
        Ok(())
    }

    /// `text` is `section.key=value`; strings may lack their quotes.
    fn assign_text(&mut self, text: &str) -> Result<(), ConfigError> {
        let Some((name, value)) = text.split_once('=') else {
            return Err(ConfigError::Set { text: text.to_owned() });
        };
        let (name, value, origin) = (name.trim(), value.trim(), format!("`{text}`"));
        let key = find(name, &origin)?;
        let parsed = format!("value = {value}").parse::<Table>().ok().and_then(|mut table| table.remove("value"));
        let string = || Value::String(value.to_owned());
        let value = parsed.filter(|parsed| parsed.is_str() || !(key.takes)(&string())).unwrap_or_else(string);
        self.assign(name, value, &origin)
    }

    fn assign(&mut self, name: &str, value: Value, origin: &str) -> Result<(), ConfigError> {
        let key = find(name, origin)?;
        let wrong = |reason| ConfigError::Value { key: name.to_owned(), origin: origin.to_owned(), reason };
        if !(key.takes)(&value) {
            return Err(wrong(format!("expected {}, found {} ({value})", key.kind, kind(&value))));
        }
        let (section, name) = name.split_once('.').expect("names of keys begin with their section");
        let mut changed = self.to_table();
        changed[section][name] = value;
        *self = Self::deserialize(changed).map_err(|error| wrong(error.message().trim_end().to_owned()))?;
        Ok(())
    }
}

/// The TOML of a preset.
///
/// # Errors
/// [`ConfigError::UnknownPreset`].
pub fn preset_text(name: &str) -> Result<&'static str, ConfigError> {
    let found = PRESETS.iter().find(|(known, _)| *known == name);
    found.map(|(_, text)| *text).ok_or_else(|| {
        let known = PRESETS.map(|(name, _)| name).join(", ");
        ConfigError::UnknownPreset { name: name.to_owned(), known }
    })
}

/// The file and its name in messages.
fn read(path: &Path) -> Result<(Table, String), ConfigError> {
    let text = std::fs::read_to_string(path).map_err(|source| ConfigError::Io { path: path.to_owned(), source })?;
    let origin = path.display().to_string();
    Ok((parse(&text, &origin)?, origin))
}

fn parse(text: &str, origin: &str) -> Result<Table, ConfigError> {
    text.parse()
        .map_err(|error: toml::de::Error| ConfigError::Syntax { origin: origin.to_owned(), reason: error.to_string() })
}

fn find(name: &str, origin: &str) -> Result<&'static Key, ConfigError> {
    keys().find(|key| key.name == name).ok_or_else(|| unknown(name, origin))
}

/// Names the section or key that `name` is most like.
fn unknown(name: &str, origin: &str) -> ConfigError {
    let (key, origin) = (name.to_owned(), origin.to_owned());
    let last = |name: &str| name.rsplit('.').next().unwrap_or(name).to_owned();
    let likeness = |known: &str| {
        let whole = strsim::jaro_winkler(name, known);
        whole.max(strsim::jaro_winkler(&last(name), &last(known)) - 0.01)
    };
    let sections = SECTIONS.iter().map(|section| (likeness(section.name), section.name));
    let keys = keys().map(|key| (likeness(key.name), key.name));
    let nearest = keys.chain(sections).max_by(|a, b| a.0.total_cmp(&b.0)).filter(|(likeness, _)| *likeness > 0.75);
    ConfigError::UnknownKey { key, origin, nearest: nearest.map(|(_, name)| name.to_owned()) }
}

fn kind(value: &Value) -> &'static str {
    match value {
        Value::String(_) => "a string",
        Value::Integer(_) => "a whole number",
        Value::Float(_) => "a number",
        Value::Boolean(_) => "true or false",
        Value::Array(_) => "a list",
        Value::Table(_) => "a section",
        Value::Datetime(_) => "a date",
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::config::stages::{REFERENCE_STEPS, STAGE_STEPS};
    use crate::config::{Background, InitMethod, Margin};
    use dpges_core::scene::Peeling;

    fn message(result: Result<Config, ConfigError>) -> String {
        result.unwrap_err().to_string()
    }

    /// The message about a file `mine.toml` of `text`.
    fn message_about(text: &str) -> String {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("mine.toml");
        std::fs::write(&path, text).unwrap();
        message(Config::resolve(None, Some(&path), &[]))
    }

    #[test]
    fn every_preset_resolves() {
        for (name, _) in PRESETS {
            Config::resolve(Some(name), None, &[]).unwrap();
        }
        let error = message(Config::resolve(Some("faster"), None, &[]));
        assert!(error.contains("`faster`") && error.contains("default, quick, cpu"), "{error}");
    }

    fn preset(name: &str) -> Config {
        Config::resolve(Some(name), None, &[]).unwrap()
    }

    #[test]
    fn presets_of_speed_and_quality_lie_on_both_sides_of_the_defaults() {
        let [fast, balanced, quality] = ["fast", "balanced", "quality"].map(preset);
        assert_eq!(balanced, Config::default());
        assert!(fast.train.steps < balanced.train.steps && balanced.train.steps < quality.train.steps);
        assert!(fast.data.max_resolution.0 < quality.data.max_resolution.0);
    }

    /// The keys that a preset itself names, whatever the defaults are. `expected` is TOML with a section a line.
    fn assert_pins(name: &str, expected: &str) {
        let pinned: Table = preset_text(name).unwrap().parse().unwrap();
        for (section, keys) in expected.parse::<Table>().unwrap() {
            for (key, value) in keys.as_table().unwrap() {
                assert_eq!(pinned[&section].get(key), Some(value), "{name}: {section}.{key}");
            }
        }
    }

    /// The numbers of DP-GES, and of 2DGS, DBS and GES where it takes theirs.
    const RECIPE: &str = "
train = { method = 'dpges', steps = 65000, lambda_dssim = 0.2, lambda_surfel = 0.01, lambda_transmittance = 0.08, \
lambda_opacity = 0.0, lambda_gaussian_scale = 0.0, lambda_sky = 0.0, dropout = 0.0, detach_transmittance = false, freeze_surfels = false }
model = { colour = 'sb2', layers = 3, modulation = 30.0, opacity = 'linear', footprint = 'kernel', \
peeling = 'nearest', margin = 'median', environment = 'none', sampling_limit = 0.0 }
init = { limit_scales = false }
stages = { surfels = 0.30769231, gaussians = 0.30769231, coarse = 0.0, gaussians_by = 'dbs', surfel_opacity = 0.8, surfel_scale = 1.0, \
surfel_budget = 0, gaussian_budget = 0.8, joint_opacity = 'kept', position_share = 0.66666667 }
discs = { lambda_normal = 0.05, lambda_distortion = 0.0 }
density = { gradient_threshold = 2e-4 }
optimizer = { position_start = 1.6e-4, position_end = 1.6e-6, quaternions = 1e-3, log_scales = 5e-3, joint_geometry = 1.0, opacities = 2.5e-4, \
base = 2.5e-3, detail = 2.5e-3, decay = 1.0 }
refine = { margins_at = [0, 4000], surfel_prune_every = 1000, surfel_prune_from = 1000, surfel_prune_until = 15000, \
gaussian_prune_every = 500, gaussian_prune_until = 2000, gaussian_min_contribution = 0.02, add_every = 1000, \
add_from = 3000, add_until = 13000, new_gaussians = 'black', split_every = 2000, split_until = 16000, split_factor = 2.0 }
";

    #[test]
    fn presets_of_benchmarks_are_the_recipe_of_the_paper() {
        for (name, image_scale, background, lambda_scale, pixels) in [
            ("mipnerf360", 4, "black", "5e-5", 16),
            ("tanks-and-temples", 1, "black", "5e-5", 16),
            ("deep-blending", 1, "black", "5e-5", 16),
            ("nerf-synthetic", 1, "white", "1e-5", 4),
        ] {
            assert_pins(name, RECIPE);
            let data = format!("{{ image_scale = {image_scale}, max_resolution = 0, background = '{background}' }}");
            let (train, refine) = (format!("lambda_scale = {lambda_scale}"), format!("surfel_pixels = '{pixels}px'"));
            assert_pins(name, &format!("data = {data}\ntrain = {{ {train} }}\nrefine = {{ {refine} }}"));
            assert_eq!(preset(name).data.test_every, 8, "{name}");
            let stages = preset(name).plan(usize::MAX);
            let lengths: Vec<usize> = stages.iter().map(|stage| stage.steps).collect();
            assert_eq!(lengths, [STAGE_STEPS, STAGE_STEPS, REFERENCE_STEPS], "{name}");
        }
    }

    #[test]
    fn ges_is_the_predecessor() {
        let ges = "
train = { lambda_dssim = 0.2, lambda_surfel = 0.0, lambda_scale = 0.0, lambda_transmittance = 0.0, lambda_sky = 0.0, \
lambda_opacity = 0.0, freeze_surfels = true }
model = { colour = 'sh3', layers = 1, modulation = 255.0, margin = 'raw', opacity = 'linear', footprint = 'kernel', \
peeling = 'nearest', environment = 'none', sampling_limit = 0.0 }
density = { gradient_threshold = 2e-4 }
refine = { surfel_pixels = '16px', gaussian_min_contribution = 0.02, split_until = 0 }
";
        assert_pins("ges", ges);
        let lengths: Vec<usize> = preset("ges").plan(usize::MAX).iter().map(|stage| stage.steps).collect();
        assert_eq!(lengths, [20_000, 30_000]);
    }

    #[test]
    fn a_dataset_is_found_whatever_else_a_run_was_configured_with() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("config.toml");
        std::fs::write(&path, "[data]\nimage_scale = 4\n[optimizer]\nof_another_version = 3\n").unwrap();
        let data = Config::resolve_data(Some(&path), &["data.test_every=5".to_owned()]).unwrap();
        assert_eq!((data.image_scale, data.test_every), (4, 5));
        std::fs::write(&path, "[data]\nimage_scales = 4\n").unwrap();
        assert!(Config::resolve_data(Some(&path), &[]).unwrap_err().to_string().contains("`data.image_scale`"));
        assert_eq!(Config::resolve_data(None, &[]).unwrap(), Config::default().data);
    }

    #[test]
    fn what_a_kind_of_dataset_wants_lies_beneath_presets() {
        let of_dataset = ["train.steps=77", "stages.surfels=0.25"];
        let quick = Config::resolve_for(&of_dataset, Some("quick"), None, &[]).unwrap();
        assert_eq!((quick.train.steps, quick.stages.surfels), (1000, 0.25));
        assert_eq!(Config::resolve_for(&of_dataset, None, None, &[]).unwrap().train.steps, 77);
    }

    #[test]
    fn later_sources_win() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("mine.toml");
        std::fs::write(&path, "[train]\nsteps = 300\nseed = 4\n[data]\nnear = 1\n").unwrap();
        let config = Config::resolve(Some("quick"), Some(&path), &["train.seed=5".to_owned()]).unwrap();
        let quick = Config::resolve(Some("quick"), None, &[]).unwrap();
        assert_eq!((config.train.steps, config.train.seed, config.data.near), (300, 5, 1.0));
        assert_eq!(config.refine, quick.refine);
        assert_ne!(quick.train.steps, 300);
    }

    #[test]
    fn assignments_take_strings_with_and_without_quotes() {
        let config = Config::with(&["model.colour=sh3", "init.method=\"random\"", "data.background=white"]).unwrap();
        assert_eq!(config.model.colour.to_string(), "sh3");
        assert_eq!(config.init.method, InitMethod::Random);
        assert_eq!(config.data.background, Background::Colour([1.0; 3]));
        assert_eq!(Config::with(&["refine.margins_at=[0, 100]"]).unwrap().refine.margins_at, [0, 100]);
        assert!(Config::with(&["train.detach_transmittance = true"]).unwrap().train.detach_transmittance);
        assert_eq!(Config::with(&["model.margin=raw"]).unwrap().model.margin, Margin::Raw);
        assert_eq!(Config::with(&["model.peeling=literal"]).unwrap().model.peeling, Peeling::Literal);
    }

    #[test]
    fn unknown_keys_name_the_nearest() {
        let error = message(Config::with(&["train.step=3"]));
        assert!(error.contains("`train.step`") && error.contains("did you mean `train.steps`"), "{error}");
        assert!(message(Config::with(&["budget=3"])).contains("did you mean `refine.budget`"));
        assert!(!message(Config::with(&["zzz.qqq=3"])).contains("did you mean"));
        assert!(message(Config::with(&["train.steps"])).contains("key=value"));
        let error = message_about("[optimiser]\nbase = 1\n");
        assert!(error.contains("mine.toml") && error.contains("did you mean `optimizer`"), "{error}");
    }

    #[test]
    fn wrong_values_name_the_key_and_what_was_expected() {
        for (set, expected) in [
            ("train.steps=many", "`train.steps`: expected a whole number, found a string"),
            ("train.steps=1.5", "expected a whole number, found a number"),
            ("train.steps=-1", "`train.steps`"),
            ("train.steps=0", "at least 1"),
            ("model.colour=sh9", "sh0 to sh3"),
            ("init.method=magic", "silhouette"),
            ("model.margin=mean", "median"),
            ("model.peeling=bare", "literal"),
            ("refine.margins_at=[-1]", "`refine.margins_at`"),
            ("train.freeze_surfels=1", "expected true or false"),
        ] {
            let error = message(Config::with(&[set]));
            assert!(error.contains(expected), "{expected}: {error}");
        }
        for (text, expected) in [
            ("train = 5\n", "section [train]"),
            ("[refine]\nbudget = [1]\n", "`refine.budget`: expected a whole number or a string, found a list"),
            ("[train\n", "line 1"),
        ] {
            let error = message_about(text);
            assert!(error.contains("mine.toml") && error.contains(expected), "{expected}: {error}");
        }
        assert!(message(Config::resolve(None, Some(Path::new("/nowhere.toml")), &[])).contains("/nowhere.toml"));
    }
}
