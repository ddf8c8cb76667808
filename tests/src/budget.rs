//! How long tests with random cases go on: `DPGES_FUZZ_SECONDS` if set, or else as many cases as `DPGES_FUZZ_CASES` says, or
//! else a few.

use std::time::{Duration, Instant};

/// A whole number in an environment variable; `None` if it is not set.
pub fn number(name: &str) -> Option<u64> {
    let text = std::env::var(name).ok()?;
    Some(text.parse().unwrap_or_else(|_| panic!("{name} is {text}, expected a whole number")))
}

/// The remaining time or cases of a test.
#[derive(Clone, Copy, Debug)]
pub struct Budget {
    cases: u64,
    end: Option<Instant>,
}

impl Budget {
    /// From now on; `cases` unless the environment says otherwise.
    pub fn start(cases: u64) -> Self {
        Self::new(number("DPGES_FUZZ_SECONDS"), number("DPGES_FUZZ_CASES").unwrap_or(cases))
    }

    /// So many seconds, or else so many cases.
    pub fn new(seconds: Option<u64>, cases: u64) -> Self {
        Self { cases, end: seconds.map(|seconds| Instant::now() + Duration::from_secs(seconds)) }
    }

    /// Whether there is another case after `done` cases. There is always a first.
    pub fn goes_on(self, done: u64) -> bool {
        done == 0 || self.end.map_or(done < self.cases, |end| Instant::now() < end)
    }

    /// 0, 1, …
    pub fn seeds(self) -> impl Iterator<Item = u64> {
        (0..).take_while(move |&done| self.goes_on(done))
    }
}
