//! Work on threads of its own, so that the window goes on.

use std::sync::mpsc::{Receiver, TryRecvError, channel};

/// A result that is on its way.
pub struct Pending<T>(Receiver<T>);

impl<T: Send + 'static> Pending<T> {
    /// Calls `wake` when `work` is done.
    pub fn start(work: impl FnOnce() -> T + Send + 'static, wake: impl FnOnce() + Send + 'static) -> Self {
        let (sender, receiver) = channel();
        std::thread::spawn(move || {
            // nobody listens if something else was asked for since, or the window is closed
            let _ = sender.send(work());
            wake();
        });
        Self(receiver)
    }

    /// The result, once it is there: `otherwise` if the work has panicked.
    pub fn poll(&self, otherwise: impl FnOnce() -> T) -> Option<T> {
        match self.0.try_recv() {
            Ok(result) => Some(result),
            Err(TryRecvError::Empty) => None,
            Err(TryRecvError::Disconnected) => Some(otherwise()),
        }
    }
}
