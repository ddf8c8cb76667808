//! Paths below the folder of a dataset, so that those are equal that other programs and systems write differently.

use icu_normalizer::ComposingNormalizerBorrowed;

/// The letter that a name has in place of bytes that are not UTF-8.
pub const UNKNOWN: char = char::REPLACEMENT_CHARACTER;

/// A path with `/` between its parts, its letters as one code point each (NFC) and in lower case: what other programs and
/// systems write differently is equal.
pub fn key(path: &str) -> String {
    let parts: Vec<&str> = path.split(['/', '\\']).filter(|part| !matches!(*part, "" | ".")).collect();
    ComposingNormalizerBorrowed::new_nfc().normalize(&parts.join("/")).to_lowercase()
}

/// Whether two keys are equal, but for runs of unknown letters in either, each of which stands for any letters of its part.
pub fn fits(a: &str, b: &str) -> bool {
    let count = |key: &str| key.split('/').count();
    a == b
        || (count(a) == count(b) && a.split('/').zip(b.split('/')).all(|(a, b)| a == b || is_of(a, b) || is_of(b, a)))
}

/// Whether `text` is `pattern` with letters in place of each run of unknown ones.
fn is_of(pattern: &str, text: &str) -> bool {
    let Some((start, rest)) = pattern.split_once(UNKNOWN) else { return pattern == text };
    let rest = rest.trim_start_matches(UNKNOWN);
    let Some(text) = text.strip_prefix(start) else { return false };
    text.char_indices().skip(1).any(|(at, _)| is_of(rest, &text[at..])) || (rest.is_empty() && !text.is_empty())
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn unknown_letters_stand_for_any_of_their_part() {
        for (a, b, expected) in [
            ("k\u{fffd}che/1", "küche/1", true),
            ("küche/1", "k\u{fffd}\u{fffd}che/1", true),
            ("\u{fffd}/\u{fffd}", "ä/öü", true),
            ("k\u{fffd}che", "kche", false),
            ("k\u{fffd}e", "kü/e", false),
            ("k\u{fffd}che 1", "küche 11", false),
            ("\u{fffd}a\u{fffd}", "aaa", true),
        ] {
            assert_eq!(fits(a, b), expected, "{a} {b}");
        }
    }
}
