//! Turns to do something that only so many may do at the same time.

use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};

/// Up to so many take their turns at the same time; others wait.
#[derive(Debug)]
pub(super) struct Turns {
    free: Mutex<usize>,
    has_changed: Condvar,
}

/// Ends when it is dropped.
pub(super) struct Turn<'a>(&'a Turns);

impl Turns {
    /// `most` at the same time, at least one.
    pub fn new(most: usize) -> Self {
        Self { free: Mutex::new(most.max(1)), has_changed: Condvar::new() }
    }

    /// Waits for a turn.
    pub fn take(&self) -> Turn<'_> {
        let waited = self.has_changed.wait_while(self.free(), |free| *free == 0);
        *waited.unwrap_or_else(PoisonError::into_inner) -= 1;
        Turn(self)
    }

    fn free(&self) -> MutexGuard<'_, usize> {
        self.free.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Drop for Turn<'_> {
    fn drop(&mut self) {
        *self.0.free() += 1;
        self.0.has_changed.notify_one();
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicUsize, Ordering};
    use std::thread;

    use super::*;

    #[test]
    fn only_so_many_have_their_turn_at_the_same_time() {
        for most in [0, 1, 3] {
            let (turns, now, done) = (Turns::new(most), AtomicUsize::new(0), AtomicUsize::new(0));
            let work = || {
                for _ in 0..50 {
                    let _turn = turns.take();
                    assert!(now.fetch_add(1, Ordering::SeqCst) < most.max(1));
                    thread::yield_now();
                    now.fetch_sub(1, Ordering::SeqCst);
                    done.fetch_add(1, Ordering::SeqCst);
                }
            };
            thread::scope(|scope| {
                (0..6).for_each(|_| {
                    scope.spawn(work);
                });
            });
            assert_eq!((now.into_inner(), done.into_inner()), (0, 300));
        }
    }
}
