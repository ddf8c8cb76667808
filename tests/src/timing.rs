//! Tests that need something of the machine, and how long they take, for the summary of those that no flag of `cargo test` times.

use std::sync::Mutex;
use std::time::{Duration, Instant};

use libtest_mimic::{Failed, Trial};

/// Tests that the summary names.
const NAMED: usize = 8;

static TAKEN: Mutex<Vec<(Duration, String)>> = Mutex::new(Vec::new());

/// A test with what it `needs`, which keeps how long it took. Without that, for the reason there, it is ignored, and fails if it
/// is `required`.
pub fn trial<T: Clone + Send + 'static>(
    name: &str,
    kind: &str,
    needs: &Result<T, String>,
    required: bool,
    test: impl FnOnce(T) -> Result<(), Failed> + Send + 'static,
) -> Trial {
    let (owned_name, owned_needs) = (name.to_owned(), needs.clone());
    let run = move || {
        let needs = owned_needs?;
        let start = Instant::now();
        let result = test(needs);
        TAKEN.lock().expect("no test fails while it holds this").push((start.elapsed(), owned_name));
        result
    };
    Trial::test(name, run).with_kind(kind).with_ignored_flag(needs.is_err() && !required)
}

/// The slowest of the tests that ended well, a line each, slowest first.
pub fn slowest() -> String {
    let mut taken = TAKEN.lock().expect("no test fails while it holds this").clone();
    taken.sort_unstable_by(|a, b| b.cmp(a));
    taken.iter().take(NAMED).map(|(time, name)| format!("{:7.1} s  {name}\n", time.as_secs_f64())).collect()
}
