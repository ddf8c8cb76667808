//! Pictures in memory: kept as long as there is room, and read in the background ahead of their need.

use std::sync::Arc;
use std::sync::atomic::{AtomicUsize, Ordering};

use moka::policy::EvictionPolicy;
use moka::sync::Cache;
use rayon::{ThreadPool, ThreadPoolBuilder};

use crate::Picture;

/// Pictures from files that are kept in any case: the one in use and the next.
const LEAST_CACHED: usize = 2;

/// A cache of the values that were asked for last, up to `most_bytes`.
///
/// Its bound holds after [`Cache::run_pending_tasks`]: before, it may hold up to 64 values more.
pub fn least_recently_used<T: Send + Sync + 'static>(
    most_bytes: usize,
    size_bytes: impl Fn(&T) -> usize + Send + Sync + 'static,
) -> Cache<usize, Arc<T>> {
    Cache::builder()
        .max_capacity(most_bytes as u64)
        .weigher(move |_, value: &Arc<T>| u32::try_from(size_bytes(value)).unwrap_or(u32::MAX))
        .eviction_policy(EvictionPolicy::lru())
        .build()
}

/// Threads that read photographs.
///
/// # Panics
/// If the system grants no thread.
pub(crate) fn reading_threads(count: usize) -> ThreadPool {
    let threads = ThreadPoolBuilder::new().num_threads(count).thread_name(|_| "photographs".to_owned());
    // whoever needs what was being read tries again, and panics there
    threads.panic_handler(|_| {}).build().expect("the system grants threads")
}

/// The pictures that were read from files, and threads that read ahead.
pub(crate) struct ImageCache {
    /// They fit into memory.
    pub kept: Cache<usize, Arc<Picture>>,
    /// Photographs beyond the budget that were read recently.
    pub cached: Cache<usize, Arc<Picture>>,
    pub most_cached_bytes: usize,
    threads: ThreadPool,
    /// Calls of [`prefetch`](Self::prefetch).
    requests: Arc<AtomicUsize>,
}

impl ImageCache {
    /// Keeps all pictures that stay and up to `most_cached_bytes` of the others, and two of up to `largest_bytes` in any case.
    pub fn new(most_cached_bytes: usize, largest_bytes: usize, threads: ThreadPool) -> Arc<Self> {
        let most_cached_bytes = most_cached_bytes.max(LEAST_CACHED * largest_bytes);
        Arc::new(Self {
            kept: Cache::builder().build(),
            cached: least_recently_used(most_cached_bytes, Picture::size_bytes),
            most_cached_bytes,
            threads,
            requests: Arc::default(),
        })
    }

    /// Does `work` in the background, the first first, instead of what was asked for before and has not begun.
    pub fn prefetch(&self, work: impl IntoIterator<Item = impl FnOnce() + Send + 'static>) {
        let request = self.requests.fetch_add(1, Ordering::SeqCst) + 1;
        for work in work {
            let requests = Arc::clone(&self.requests);
            self.threads.spawn(move || {
                if requests.load(Ordering::SeqCst) == request {
                    work();
                }
            });
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Mutex;
    use std::sync::mpsc::channel;

    use super::*;

    #[test]
    fn what_was_asked_for_longest_ago_leaves_first() {
        let cache = least_recently_used(30, |_: &usize| 10);
        let made = |keys: &[usize]| -> Vec<usize> {
            let mut made = Vec::new();
            for &key in keys {
                cache.get_with(key, || {
                    made.push(key);
                    Arc::new(key)
                });
                cache.run_pending_tasks();
            }
            made
        };
        assert_eq!(made(&[1, 2, 3, 1, 2, 3]), [1, 2, 3]);
        assert_eq!(made(&[1, 4, 1, 3, 2]), [4, 2]);
    }

    #[test]
    fn what_is_asked_for_is_done_in_order_until_something_else_is() {
        let (done, results) = channel();
        let (let_go, gate) = channel::<()>();
        let gate = Arc::new(Mutex::new(gate));
        let work = |item: usize| {
            let (done, gate) = (done.clone(), Arc::clone(&gate));
            move || {
                done.send(item).unwrap();
                gate.lock().unwrap().recv().unwrap();
            }
        };
        let cache = ImageCache::new(0, 1, reading_threads(1));
        cache.prefetch([1, 2, 3].map(work));
        assert_eq!(results.recv(), Ok(1));
        // 1 has begun, 2 and 3 are forgotten
        cache.prefetch([4, 5].map(work));
        (0..3).for_each(|_| let_go.send(()).unwrap());
        assert_eq!((results.recv(), results.recv()), (Ok(4), Ok(5)));
    }
}
