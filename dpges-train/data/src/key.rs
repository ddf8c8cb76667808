//! Paths below the folder of a dataset, so that those are equal that other programs and systems write differently.

use icu_normalizer::ComposingNormalizerBorrowed;

/// A path with `/` between its parts, its letters as one code point each (NFC) and in lower case: what other programs and
/// systems write differently is equal.
pub fn key(path: &str) -> String {
    let parts: Vec<&str> = path.split(['/', '\\']).filter(|part| !matches!(*part, "" | ".")).collect();
    ComposingNormalizerBorrowed::new_nfc().normalize(&parts.join("/")).to_lowercase()
}

/// Without the extension of its last part.
pub fn stem(key: &str) -> &str {
    match key.rsplit_once('.') {
        Some((stem, extension)) if !stem.is_empty() && !stem.ends_with('/') && !extension.contains('/') => stem,
        _ => key,
    }
}

/// The extension of the last part, empty without one.
pub fn extension(key: &str) -> &str {
    key[stem(key).len()..].trim_start_matches('.')
}

/// The folder that a key lies in, empty at the root; and its last part.
pub fn parent(key: &str) -> (&str, &str) {
    key.rsplit_once('/').unwrap_or(("", key))
}
