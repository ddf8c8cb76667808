//! A counting semaphore: only so many do something at the same time.

use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};

/// Up to so many hold a permit at the same time; others wait.
#[derive(Debug)]
pub(super) struct Semaphore {
    free: Mutex<usize>,
    has_changed: Condvar,
}

/// Ends when it is dropped.
pub(super) struct Permit<'a>(&'a Semaphore);

impl Semaphore {
    /// `most` at the same time, at least one.
    pub fn new(most: usize) -> Self {
        Self { free: Mutex::new(most.max(1)), has_changed: Condvar::new() }
    }

    /// Waits for a permit.
    pub fn acquire(&self) -> Permit<'_> {
        let waited = self.has_changed.wait_while(self.free(), |free| *free == 0);
        *waited.unwrap_or_else(PoisonError::into_inner) -= 1;
        Permit(self)
    }

    fn free(&self) -> MutexGuard<'_, usize> {
        self.free.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Drop for Permit<'_> {
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
    fn only_so_many_hold_a_permit_at_the_same_time() {
        for most in [0, 1, 3] {
            let (semaphore, now, done) = (Semaphore::new(most), AtomicUsize::new(0), AtomicUsize::new(0));
            let work = || {
                for _ in 0..50 {
                    let _permit = semaphore.acquire();
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
