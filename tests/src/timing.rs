//! How long tests take, for the summary of those that no flag of `cargo test` times.

use std::sync::Mutex;
use std::time::{Duration, Instant};

/// Tests that the summary names.
const NAMED: usize = 8;

static TAKEN: Mutex<Vec<(Duration, &'static str)>> = Mutex::new(Vec::new());

/// Runs `test`, and keeps how long it took.
pub fn timed<T>(name: &'static str, test: impl FnOnce() -> T) -> T {
    let start = Instant::now();
    let result = test();
    TAKEN.lock().expect("no test fails while it holds this").push((start.elapsed(), name));
    result
}

/// The slowest of the tests that ended well, a line each, slowest first.
pub fn slowest() -> String {
    let mut taken = TAKEN.lock().expect("no test fails while it holds this").clone();
    taken.sort_unstable_by(|a, b| b.cmp(a));
    taken.iter().take(NAMED).map(|(time, name)| format!("{:7.1} s  {name}\n", time.as_secs_f64())).collect()
}
