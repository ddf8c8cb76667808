//! GPUs that fail at work: reset, unplugged, out of memory.
//!
//! Burn reports a failure by a panic, either on the thread that reads a result or on its own thread for the device. It
//! catches the latter and goes on with whatever the memory holds. So a panic on any thread counts, caught or not.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// The message of the device, or of Burn, when it failed.
#[derive(Clone, Debug, thiserror::Error)]
#[error("{text}")]
pub struct DeviceFailure {
    text: String,
}

/// Keeps the first panic of the process and prints none, as long as it or a clone of it lives.
#[derive(Clone)]
pub struct Watch {
    first: Arc<Mutex<Option<DeviceFailure>>>,
}

impl DeviceFailure {
    /// Shortens the message of an error or a panic to one line: what happened and its root cause, without the causes
    /// between them and without the stack that Burn adds.
    pub fn new(message: &str) -> Self {
        let is_stack = |line: &&str| ["Backtrace", "No backtrace", "0:"].iter().any(|start| line.starts_with(start));
        let lines = message.lines().map(str::trim).filter(|line| !line.is_empty());
        let text = lines.take_while(|line| !is_stack(line)).collect::<Vec<_>>().join(" ");
        let causes: Vec<&str> = text.split("Caused by:").map(str::trim).filter(|cause| !cause.is_empty()).collect();
        let text = match causes.as_slice() {
            [] => text,
            [only] => (*only).to_owned(),
            [first, .., root] => format!("{first}: {root}"),
        };
        Self { text }
    }

    fn is_out_of_memory(&self) -> bool {
        let text = self.text.to_lowercase();
        ["out of memory", "out of device memory", "not enough memory", "allocate"]
            .iter()
            .any(|part| text.contains(part))
    }

    /// Advice for the failure.
    pub fn advice(&self) -> &'static str {
        if self.is_out_of_memory() {
            "the memory of the device is too small: use another device (`--device cpu` has the memory of the machine), \
             or train anew with a smaller --max-resolution or --budget (refine.budget)"
        } else {
            "`--device cpu` goes on without the device; `dpges selftest --device …` checks it, and a newer driver may \
             help"
        }
    }
}

impl Watch {
    /// Watches from now on.
    pub fn start() -> Self {
        let first = Arc::new(Mutex::new(None));
        let watched = Arc::downgrade(&first);
        let previous = std::panic::take_hook();
        std::panic::set_hook(Box::new(move |info| match watched.upgrade() {
            Some(first) => {
                tracing::debug!("{info}");
                let message = info.payload_as_str().unwrap_or("a panic without a message");
                lock(&first).get_or_insert_with(|| DeviceFailure::new(message));
            }
            None => previous(info),
        }));
        Self { first }
    }

    /// The first panic since the start.
    pub fn failure(&self) -> Option<DeviceFailure> {
        lock(&self.first).clone()
    }

    /// Returns what `work` returns.
    ///
    /// # Errors
    /// The first panic since the start, if there was one.
    pub fn catch<T>(&self, work: impl FnOnce() -> T) -> Result<T, DeviceFailure> {
        let result = catch_unwind(AssertUnwindSafe(work));
        match (result, self.failure()) {
            (_, Some(failure)) => Err(failure),
            (Ok(value), None) => Ok(value),
            (Err(_), None) => Err(DeviceFailure::new("a panic that was thrown again")),
        }
    }
}

fn lock(first: &Mutex<Option<DeviceFailure>>) -> MutexGuard<'_, Option<DeviceFailure>> {
    first.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fail(message: &str) -> usize {
        panic!("{message}")
    }

    #[test]
    fn the_first_panic_of_any_thread_is_the_failure() {
        let watch = Watch::start();
        assert_eq!(watch.catch(|| 3).unwrap(), 3);
        // as Burn does: the thread of the device panics, and the work goes on
        let out_of_memory = || std::thread::spawn(|| fail("wgpu error: Out of Memory")).join().is_err();
        let failure = watch.catch(out_of_memory).unwrap_err();
        assert_eq!(failure.to_string(), "wgpu error: Out of Memory");
        let later = watch.catch(|| fail("the device is lost")).unwrap_err();
        assert_eq!(later.to_string(), "wgpu error: Out of Memory", "the cause, not what follows from it");
    }

    #[test]
    fn the_message_is_one_line_and_the_advice_fits() {
        let message =
            "Error while reading data: The device is poisoned\nCaused by:\n  Unknown: lost\nBacktrace:\n 0: main";
        let lost = DeviceFailure::new(message);
        assert_eq!(lost.to_string(), "Error while reading data: The device is poisoned: Unknown: lost");
        let deep =
            "An error happened\nCaused by:\n  Several failures\nskipped `Sum`\nCaused by:\n  can't allocate 64 bytes";
        assert_eq!(DeviceFailure::new(deep).to_string(), "An error happened: can't allocate 64 bytes");
        assert!(lost.advice().contains("selftest") && lost.advice().contains("--device cpu"));
        for message in
            ["out of device memory allocating 64 bytes", "can't allocate buffer of size: 64", "Out of Memory"]
        {
            let advice = DeviceFailure::new(message).advice();
            assert!(advice.contains("--max-resolution") && advice.contains("refine.budget"), "{advice}");
        }
    }
}
