//! Dialogs of the system that name a file.

use std::path::PathBuf;
use std::sync::mpsc::{Receiver, TryRecvError, channel};
use std::time::{Duration, Instant};

/// Nobody closes a dialog sooner than this: one that is gone by then was never there.
const LEAST_TIME: Duration = Duration::from_millis(400);

/// The purpose of a file.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Purpose {
    OpenScene,
    OpenRun,
    SaveScreenshot,
    SavePath,
    LoadPath,
}

/// How a dialog ended.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Answer {
    File(Purpose, PathBuf),
    Cancelled,
    /// The system has no dialogs.
    NoDialogs,
}

/// One dialog at a time, beside the window.
#[derive(Default)]
pub struct Dialogs {
    open: Option<Receiver<Answer>>,
}

impl Dialogs {
    pub fn is_open(&self) -> bool {
        self.open.is_some()
    }

    /// Asks for a file; calls `wake` when there is an answer. Call it on the thread of the window.
    pub fn ask(&mut self, purpose: Purpose, file_name: &str, wake: impl Fn() + Send + 'static) {
        let dialog = rfd::AsyncFileDialog::new();
        let question: std::pin::Pin<Box<dyn Future<Output = Option<rfd::FileHandle>> + Send>> = match purpose {
            Purpose::OpenScene => Box::pin(dialog.add_filter("scenes", &["safetensors"]).pick_file()),
            Purpose::OpenRun => Box::pin(dialog.pick_folder()),
            Purpose::LoadPath => Box::pin(dialog.add_filter("camera paths", &["json"]).pick_file()),
            Purpose::SavePath => Box::pin(dialog.set_file_name(file_name).save_file()),
            Purpose::SaveScreenshot => Box::pin(dialog.set_file_name(file_name).save_file()),
        };
        let (sender, receiver) = channel();
        std::thread::spawn(move || {
            let since = Instant::now();
            let file = pollster::block_on(question).map(|file| file.path().to_owned());
            // nobody listens if the window is closed
            let _ = sender.send(answer(purpose, file, since.elapsed()));
            wake();
        });
        self.open = Some(receiver);
    }

    pub fn poll(&mut self) -> Option<Answer> {
        let answer = match self.open.as_ref()?.try_recv() {
            Err(TryRecvError::Empty) => return None,
            Err(TryRecvError::Disconnected) => Answer::NoDialogs,
            Ok(answer) => answer,
        };
        self.open = None;
        Some(answer)
    }
}

fn answer(purpose: Purpose, file: Option<PathBuf>, after: Duration) -> Answer {
    match file {
        Some(file) => Answer::File(purpose, file),
        None if after < LEAST_TIME => Answer::NoDialogs,
        None => Answer::Cancelled,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_dialog_that_is_gone_at_once_was_never_there() {
        let (soon, later) = (Duration::from_millis(5), Duration::from_secs(2));
        assert_eq!(answer(Purpose::OpenScene, None, soon), Answer::NoDialogs);
        assert_eq!(answer(Purpose::OpenScene, None, later), Answer::Cancelled);
        let file = PathBuf::from("a.json");
        let named = answer(Purpose::LoadPath, Some(file.clone()), soon);
        assert_eq!(named, Answer::File(Purpose::LoadPath, file));
    }
}
