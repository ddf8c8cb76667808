//! How long tests with random cases go on: `DPGES_FUZZ_SECONDS` if set, or else as many cases as `DPGES_FUZZ_CASES` says, or
//! else a few.

use std::time::{Duration, Instant};

/// A whole number in an environment variable; `None` if it is not set.
pub fn number(name: &str) -> Option<u64> {
    let text = std::env::var(name).ok()?;
    Some(text.parse().unwrap_or_else(|_| panic!("{name} is {text}, expected a whole number")))
}

/// 0, 1, … of a test that makes so many `cases` unless the environment says otherwise. There is always a first.
pub fn seeds(cases: u64) -> impl Iterator<Item = u64> {
    let end = number("DPGES_FUZZ_SECONDS").map(|seconds| Instant::now() + Duration::from_secs(seconds));
    let cases = number("DPGES_FUZZ_CASES").unwrap_or(cases);
    (0..).take_while(move |&seed| seed == 0 || end.map_or(seed < cases, |end| Instant::now() < end))
}
