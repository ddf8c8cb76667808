//! Dialogs of the system that name a file.

use std::path::PathBuf;
use std::time::{Duration, Instant};

use super::pending::Pending;

/// Nobody closes a dialog sooner than this: one that is gone by then was never there.
const LEAST_TIME: Duration = Duration::from_millis(400);

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Purpose {
    OpenScene,
    OpenRun,
    SaveScreenshot,
    SavePath,
    LoadPath,
    SaveScene,
}

#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Answer {
    File(Purpose, PathBuf),
    Cancelled,
    NoDialogs,
}

/// One dialog at a time, beside the window.
#[derive(Default)]
pub struct Dialogs {
    open: Option<Pending<Answer>>,
}

impl Dialogs {
    pub fn is_open(&self) -> bool {
        self.open.is_some()
    }

    /// Asks for a file; calls `wake` when there is an answer. Call it on the thread of the window.
    pub fn ask(&mut self, purpose: Purpose, file_name: &str, wake: impl Fn() + Send + 'static) {
        let dialog = rfd::AsyncFileDialog::new();
        let question: std::pin::Pin<Box<dyn Future<Output = Option<rfd::FileHandle>> + Send>> = match purpose {
            Purpose::OpenScene => {
                Box::pin(dialog.add_filter("scenes", &["safetensors", "ply", "spz", "sog", "glb", "gltf"]).pick_file())
            }
            Purpose::OpenRun => Box::pin(dialog.pick_folder()),
            Purpose::LoadPath => Box::pin(dialog.add_filter("camera paths", &["json"]).pick_file()),
            Purpose::SaveScene => {
                Box::pin(dialog.add_filter("scenes", &["safetensors"]).set_file_name(file_name).save_file())
            }
            Purpose::SavePath | Purpose::SaveScreenshot => Box::pin(dialog.set_file_name(file_name).save_file()),
        };
        let wait = move || {
            let since = Instant::now();
            let file = pollster::block_on(question).map(|file| file.path().to_owned());
            answer(purpose, file, since.elapsed())
        };
        self.open = Some(Pending::start(wait, wake));
    }

    pub fn poll(&mut self) -> Option<Answer> {
        let answer = self.open.as_ref()?.poll(|| Answer::NoDialogs)?;
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
