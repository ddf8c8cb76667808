//! Errors of configurations.

use std::path::PathBuf;

#[derive(Debug, thiserror::Error)]
pub enum ConfigError {
    #[error("{origin}: key `{key}` is unknown{}", nearest.as_ref().map(|n| format!(", did you mean `{n}`?")).unwrap_or_default())]
    UnknownKey { key: String, origin: String, nearest: Option<String> },
    #[error("{origin}: key `{key}`: {reason}")]
    Value { key: String, origin: String, reason: String },
    #[error("{origin} is not valid TOML: {reason}")]
    Syntax { origin: String, reason: String },
    #[error("`{text}` is not of the form key=value")]
    Set { text: String },
    #[error("preset `{name}` is unknown, there are: {known}")]
    UnknownPreset { name: String, known: String },
    #[error("cannot read {path}: {source}")]
    Io { path: PathBuf, source: std::io::Error },
    #[error("key `{key}` is {found}, expected {expected}")]
    Range { key: &'static str, found: String, expected: String },
}

impl ConfigError {
    /// Whether the configuration makes no sense; a file that cannot be read may.
    pub fn is_usage(&self) -> bool {
        !matches!(self, Self::Io { .. })
    }
}
