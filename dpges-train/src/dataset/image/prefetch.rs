//! Work that is done in the background, ahead of its need.

use std::collections::VecDeque;
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread;

/// Threads that do what was asked for last.
#[derive(Debug)]
pub(super) struct Prefetcher<T>(Arc<Work<T>>);

#[derive(Debug)]
struct Work<T> {
    queue: Mutex<Queue<T>>,
    has_changed: Condvar,
}

#[derive(Debug)]
struct Queue<T> {
    items: VecDeque<T>,
    is_open: bool,
}

impl<T: Send + 'static> Prefetcher<T> {
    /// Up to so many `threads`, each of which does one thing at a time. Where there can be no thread, nothing is done.
    pub fn new(threads: usize, work: impl Fn(T) + Send + Sync + 'static) -> Self {
        let queue = Mutex::new(Queue { items: VecDeque::new(), is_open: true });
        let shared = Arc::new(Work { queue, has_changed: Condvar::new() });
        let work = Arc::new(work);
        for _ in 0..threads {
            let (shared, work) = (Arc::clone(&shared), Arc::clone(&work));
            let works = move || {
                while let Some(item) = shared.next() {
                    work(item);
                }
            };
            if thread::Builder::new().name("photographs".to_owned()).spawn(works).is_err() {
                break;
            }
        }
        Self(shared)
    }

    /// Asks for `items`, the first first, instead of what was asked for before and has not begun.
    pub fn ask(&self, items: VecDeque<T>) {
        let forgotten = std::mem::replace(&mut self.0.lock().items, items);
        self.0.has_changed.notify_all();
        drop(forgotten);
    }
}

impl<T> Work<T> {
    fn lock(&self) -> MutexGuard<'_, Queue<T>> {
        self.queue.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Waits for something to do; `None` at the end.
    fn next(&self) -> Option<T> {
        let idle = |queue: &mut Queue<T>| queue.items.is_empty() && queue.is_open;
        let waited = self.has_changed.wait_while(self.lock(), idle);
        waited.unwrap_or_else(PoisonError::into_inner).items.pop_front()
    }
}

impl<T> Drop for Prefetcher<T> {
    fn drop(&mut self) {
        let mut queue = self.0.lock();
        queue.is_open = false;
        let forgotten = std::mem::take(&mut queue.items);
        drop(queue);
        self.0.has_changed.notify_all();
        drop(forgotten);
    }
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc::channel;

    use super::*;

    #[test]
    fn what_is_asked_for_is_done_in_order_until_something_else_is() {
        let (done, results) = channel();
        let (let_go, gate) = channel::<()>();
        let gate = Mutex::new(gate);
        let prefetcher = Prefetcher::new(1, move |item: usize| {
            done.send(item).unwrap();
            gate.lock().unwrap().recv().unwrap();
        });
        prefetcher.ask([1, 2, 3].into());
        assert_eq!(results.recv(), Ok(1));
        // 1 has begun, 2 and 3 are forgotten
        prefetcher.ask([4, 5].into());
        (0..3).for_each(|_| let_go.send(()).unwrap());
        assert_eq!((results.recv(), results.recv()), (Ok(4), Ok(5)));
    }

    #[test]
    fn threads_end_with_what_they_work_for() {
        let (done, results) = channel();
        let prefetcher = Prefetcher::new(3, move |item: usize| done.send(item).unwrap());
        prefetcher.ask((0..20).collect());
        let mut found: Vec<usize> = results.iter().take(20).collect();
        found.sort_unstable();
        assert_eq!(found, (0..20).collect::<Vec<_>>());
        drop(prefetcher);
        // all threads have dropped their end of the channel
        assert!(results.recv().is_err());
    }
}
