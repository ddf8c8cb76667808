//! Values that are made when they are needed, and kept as long as there is room for them.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// The values that were asked for last, up to a number of bytes. Others are made again when they are asked for.
#[derive(Debug)]
pub struct Cache<T> {
    most_bytes: usize,
    /// Values that are kept however large they are.
    least: usize,
    /// The one that was asked for last is at the back.
    entries: Mutex<VecDeque<Entry<T>>>,
}

#[derive(Debug)]
struct Entry<T> {
    key: usize,
    bytes: usize,
    slot: Slot<T>,
}

/// Locked while the value is made; `None` before.
type Slot<T> = Arc<Mutex<Option<Arc<T>>>>;

impl<T> Cache<T> {
    pub fn new(most_bytes: usize, least: usize) -> Self {
        Self { most_bytes, least, entries: Mutex::default() }
    }

    /// The value of `key`, which takes `bytes`. `make` makes it if it is not here; another thread that asks for it
    /// meanwhile waits.
    ///
    /// # Errors
    /// The errors of `make`; whoever asks next tries again.
    pub fn get<E>(&self, key: usize, bytes: usize, make: impl FnOnce() -> Result<T, E>) -> Result<Arc<T>, E> {
        let slot = self.slot(key, bytes);
        let mut value = locked(&slot);
        if let Some(value) = &*value {
            return Ok(Arc::clone(value));
        }
        let made = Arc::new(make()?);
        *value = Some(Arc::clone(&made));
        Ok(made)
    }

    /// Whether the value of `key` is here, or being made.
    pub fn has(&self, key: usize) -> bool {
        locked(&self.entries).iter().any(|entry| entry.key == key)
    }

    fn slot(&self, key: usize, bytes: usize) -> Slot<T> {
        let mut entries = locked(&self.entries);
        let known = entries.iter().position(|entry| entry.key == key).and_then(|at| entries.remove(at));
        let entry = known.unwrap_or_else(|| Entry { key, bytes, slot: Slot::default() });
        let slot = Arc::clone(&entry.slot);
        entries.push_back(entry);
        let mut sum: usize = entries.iter().map(|entry| entry.bytes).sum();
        while sum > self.most_bytes && entries.len() > self.least.max(1) {
            sum -= entries.pop_front().map_or(0, |entry| entry.bytes);
        }
        slot
    }
}

/// A thread that panicked while it made a value has left none.
fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::{AtomicUsize, Ordering};

    use super::*;

    /// Which of `keys`, each of 10 bytes, are made when they are asked for in this order.
    fn made(cache: &Cache<usize>, keys: &[usize]) -> Vec<usize> {
        let mut made = Vec::new();
        for &key in keys {
            let found = cache.get(key, 10, || {
                made.push(key);
                Ok::<_, ()>(100 + key)
            });
            assert_eq!(*found.unwrap(), 100 + key);
        }
        made
    }

    #[test]
    fn what_was_asked_for_longest_ago_leaves_first() {
        let cache = Cache::new(30, 1);
        assert_eq!(made(&cache, &[1, 2, 3, 1, 2, 3]), [1, 2, 3]);
        assert_eq!(made(&cache, &[1, 4, 1, 3, 2]), [4, 2]);
    }

    #[test]
    fn what_is_here_is_known_without_being_asked_for() {
        let cache = Cache::new(20, 1);
        made(&cache, &[1, 2]);
        assert_eq!([1, 2, 3].map(|key| cache.has(key)), [true, true, false]);
        made(&cache, &[3]);
        assert_eq!([1, 2, 3].map(|key| cache.has(key)), [false, true, true]);
    }

    #[test]
    fn the_least_stay_however_large_they_are() {
        let cache = Cache::new(0, 2);
        assert_eq!(made(&cache, &[1, 2, 1, 2, 3, 2, 1]), [1, 2, 3, 1]);
    }

    #[test]
    fn what_failed_is_tried_again() {
        let cache = Cache::<usize>::new(30, 1);
        assert_eq!(cache.get(7, 10, || Err("absent")), Err("absent"));
        assert_eq!(made(&cache, &[7, 7]), [7]);
    }

    #[test]
    fn threads_that_ask_for_the_same_make_it_once() {
        let (cache, count) = (Cache::new(1000, 1), AtomicUsize::new(0));
        let ask = |key: usize| {
            cache.get(key, 10, || {
                count.fetch_add(1, Ordering::SeqCst);
                Ok::<_, ()>(key)
            })
        };
        std::thread::scope(|scope| {
            (0..4).for_each(|_| {
                scope.spawn(|| (0..50).for_each(|key| assert_eq!(*ask(key).unwrap(), key)));
            });
        });
        assert_eq!(count.load(Ordering::SeqCst), 50);
    }
}
