//! Ranks that are threads of one process.

use std::panic::resume_unwind;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::sync::{Arc, Mutex, PoisonError};
use std::thread;

use crate::ranks::Ranks;

/// A rank on a thread of its own.
#[derive(Debug)]
struct Thread {
    rank: usize,
    /// To every rank.
    to: Vec<Sender<Vec<u8>>>,
    /// From every rank.
    from: Vec<Mutex<Receiver<Vec<u8>>>>,
}

impl Ranks for Thread {
    fn rank(&self) -> usize {
        self.rank
    }

    fn count(&self) -> usize {
        self.to.len()
    }

    fn join(&self, sums: &mut [f32]) {
        let of_ranks = (self as &dyn Ranks).gather_numbers(sums);
        sums.fill(0.0);
        for found in of_ranks {
            assert_eq!(found.len(), sums.len(), "rank {} joins sums of another length", self.rank);
            sums.iter_mut().zip(found).for_each(|(sum, own)| *sum += own);
        }
    }

    fn gather(&self, own: &[u8]) -> Vec<Vec<u8>> {
        for to in &self.to {
            // one that is gone is noticed below
            let _ = to.send(own.to_vec());
        }
        let receive = |(rank, from): (usize, &Mutex<Receiver<Vec<u8>>>)| {
            let from = from.lock().unwrap_or_else(PoisonError::into_inner);
            from.recv().unwrap_or_else(|_| panic!("rank {rank} is gone"))
        };
        self.from.iter().enumerate().map(receive).collect()
    }
}

/// The results of `work` on each of `count` ranks.
///
/// # Panics
/// With the message of the first rank that does.
pub fn on_ranks<T: Send>(count: usize, work: impl Fn(Arc<dyn Ranks>) -> T + Sync) -> Vec<T> {
    let mut to: Vec<Vec<Sender<Vec<u8>>>> = (0..count).map(|_| Vec::new()).collect();
    let mut from: Vec<Vec<Mutex<Receiver<Vec<u8>>>>> = (0..count).map(|_| Vec::new()).collect();
    for sender in &mut to {
        for receivers in &mut from {
            let (send, receive) = channel();
            sender.push(send);
            receivers.push(Mutex::new(receive));
        }
    }
    let ranks = to.into_iter().zip(from).enumerate();
    thread::scope(|scope| {
        let work = &work;
        let threads: Vec<_> =
            ranks.map(|(rank, (to, from))| scope.spawn(move || work(Arc::new(Thread { rank, to, from })))).collect();
        let results: Vec<_> = threads.into_iter().map(|thread| thread.join()).collect();
        results.into_iter().map(|result| result.unwrap_or_else(|panic| resume_unwind(panic))).collect()
    })
}
