//! How long a command may take.

use std::cell::Cell;
use std::time::{Duration, Instant};

/// Ends with the time that was given, if any was.
#[derive(Debug)]
pub struct Limit {
    end: Option<Instant>,
    stopped: Cell<bool>,
}

impl Limit {
    /// From now on.
    pub fn new(length: Option<Duration>) -> Self {
        let end = length.and_then(|length| Instant::now().checked_add(length));
        Self { end, stopped: Cell::new(false) }
    }

    pub fn is_over(&self) -> bool {
        self.end.is_some_and(|end| Instant::now() >= end)
    }

    /// [`is_over`](Self::is_over), remembered if it is.
    pub fn stop_if_over(&self) -> bool {
        if self.is_over() {
            self.stopped.set(true);
        }
        self.has_stopped()
    }

    /// Whether something was stopped because of it.
    pub fn has_stopped(&self) -> bool {
        self.stopped.get()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_limit_that_is_over_stays_over() {
        let none = Limit::new(None);
        assert!(!none.is_over() && !none.stop_if_over() && !none.has_stopped());
        let over = Limit::new(Some(Duration::ZERO));
        assert!(over.is_over() && !over.has_stopped());
        assert!(over.stop_if_over() && over.has_stopped());
    }
}
