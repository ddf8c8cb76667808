//! A scene that is still being trained, between the thread that trains it and the window that shows it.

use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use dpges_core::scene::SceneData;

/// Least time between two scenes that the window asks for.
const PAUSE: Duration = Duration::from_millis(500);
/// Time between two looks at whether a paused training is given up.
const LOOK: Duration = Duration::from_millis(100);

#[derive(Clone, Debug, Default, PartialEq)]
pub struct LiveProgress {
    pub step: usize,
    pub steps: usize,
    /// PSNR of the last training view or of held-out views, dB.
    pub psnr: Option<f64>,
    /// The current or last event, one line.
    pub text: String,
}

/// A request of the window to the training.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
enum Wish {
    #[default]
    Go,
    Pause,
    Stop,
}

#[derive(Default)]
struct State {
    progress: LiveProgress,
    scene: Option<SceneData>,
    wish: Wish,
    /// The result, once the training is over.
    end: Option<Result<String, String>>,
    closes: bool,
    /// Whether no window looks any more.
    left: bool,
    last_wanted: Option<Instant>,
    wake: Option<Box<dyn Fn() + Send>>,
}

#[derive(Default)]
struct Shared {
    state: Mutex<State>,
    changed: Condvar,
}

/// A handle for both sides; clones are the same.
#[derive(Clone, Default)]
pub struct LiveScene(Arc<Shared>);

/// The side that trains.
impl LiveScene {
    pub fn new() -> Self {
        Self::default()
    }

    /// Whether the window has room for a new scene: it has taken the last, and half a second has passed.
    pub fn wants_scene(&self) -> bool {
        let state = self.state();
        let is_due = state.last_wanted.is_none_or(|last| last.elapsed() >= PAUSE);
        !state.left && state.scene.is_none() && is_due
    }

    /// Hands a scene to the window; one that it has not taken yet is replaced.
    pub fn publish(&self, scene: SceneData) {
        self.tell(|state| {
            state.scene = Some(scene);
            state.last_wanted = Some(Instant::now());
        });
    }

    pub fn report(&self, progress: LiveProgress) {
        self.tell(|state| state.progress = progress);
    }

    /// Returns at once unless the window has paused the training, else when it goes on or is to stop, or soon after
    /// `gives_up` says so.
    pub fn wait_while_paused(&self, gives_up: impl Fn() -> bool) {
        let mut state = self.state();
        while state.wish == Wish::Pause && !gives_up() {
            state = self.0.changed.wait_timeout(state, LOOK).unwrap_or_else(PoisonError::into_inner).0;
        }
    }

    /// Whether the training is to save its state and end.
    pub fn should_stop(&self) -> bool {
        self.state().wish == Wish::Stop
    }

    /// Says that the training is over, and how it ended.
    pub fn finish(&self, end: Result<String, String>) {
        self.tell(|state| state.end = Some(end));
    }

    /// Closes the window without a question.
    pub fn close_window(&self) {
        self.tell(|state| state.closes = true);
    }

    fn tell(&self, change: impl FnOnce(&mut State)) {
        let mut state = self.state();
        change(&mut state);
        if let Some(wake) = &state.wake {
            wake();
        }
    }
}

/// The side of the window.
impl LiveScene {
    pub fn progress(&self) -> LiveProgress {
        self.state().progress.clone()
    }

    /// The scene that was published last, once.
    pub fn take_scene(&self) -> Option<SceneData> {
        self.state().scene.take()
    }

    pub fn is_paused(&self) -> bool {
        self.state().wish == Wish::Pause
    }

    pub fn set_paused(&self, paused: bool) {
        self.wish(if paused { Wish::Pause } else { Wish::Go });
    }

    pub fn stop(&self) {
        self.wish(Wish::Stop);
    }

    /// How the training ended; `None` while it goes on.
    pub fn end(&self) -> Option<Result<String, String>> {
        self.state().end.clone()
    }

    pub fn closes(&self) -> bool {
        self.state().closes
    }

    /// Calls `wake` whenever there is something new.
    pub fn on_news(&self, wake: impl Fn() + Send + 'static) {
        self.state().wake = Some(Box::new(wake));
    }

    /// Says that nobody looks any more: a paused training goes on, and no scene is wanted.
    pub fn leave(&self) {
        let mut state = self.state();
        state.left = true;
        state.scene = None;
        state.wake = None;
        if state.wish == Wish::Pause {
            state.wish = Wish::Go;
        }
        self.0.changed.notify_all();
    }

    fn wish(&self, wish: Wish) {
        let mut state = self.state();
        // a stop is not taken back
        if state.wish != Wish::Stop {
            state.wish = wish;
        }
        self.0.changed.notify_all();
    }

    fn state(&self) -> MutexGuard<'_, State> {
        self.0.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

#[cfg(test)]
mod tests {
    use std::sync::mpsc::channel;
    use std::thread;

    use dpges_core::scene::SceneInfo;

    use super::*;
    use crate::fixtures::neutral;

    fn scene() -> SceneData {
        neutral(SceneInfo::default(), [1, 0])
    }

    #[test]
    fn a_scene_is_wanted_only_by_a_window_that_has_taken_the_last() {
        let live = LiveScene::new();
        assert!(live.wants_scene());
        live.publish(scene());
        assert!(!live.wants_scene(), "it was not taken");
        assert!(live.take_scene().is_some() && live.take_scene().is_none());
        assert!(!live.wants_scene(), "half a second has not passed");
        live.state().last_wanted = Instant::now().checked_sub(PAUSE);
        assert!(live.wants_scene());
        live.leave();
        assert!(!live.wants_scene(), "nobody looks");
    }

    #[test]
    fn news_wake_the_window() {
        let live = LiveScene::new();
        let (sender, receiver) = channel();
        live.on_news(move || sender.send(()).unwrap());
        live.report(LiveProgress { step: 3, ..LiveProgress::default() });
        live.publish(scene());
        live.finish(Ok("done".to_owned()));
        assert_eq!(receiver.try_iter().count(), 3);
        assert_eq!((live.progress().step, live.end()), (3, Some(Ok("done".to_owned()))));
    }

    #[test]
    fn a_paused_training_waits_until_it_goes_on_stops_or_nobody_looks() {
        let ways: [fn(&LiveScene); 3] = [|live| live.set_paused(false), LiveScene::stop, LiveScene::leave];
        for release in ways {
            let live = LiveScene::new();
            live.set_paused(true);
            let (sender, passed) = channel();
            let trainer = live.clone();
            let thread = thread::spawn(move || {
                trainer.wait_while_paused(|| false);
                sender.send(trainer.should_stop()).unwrap();
            });
            assert!(passed.try_recv().is_err(), "it did not wait");
            release(&live);
            let stops = passed.recv().unwrap();
            assert_eq!(stops, live.should_stop());
            thread.join().unwrap();
        }
        LiveScene::new().wait_while_paused(|| false);
        let given_up = LiveScene::new();
        given_up.set_paused(true);
        given_up.wait_while_paused(|| true);
    }

    #[test]
    fn a_stop_is_not_taken_back() {
        let live = LiveScene::new();
        live.stop();
        live.set_paused(true);
        assert!(live.should_stop() && !live.is_paused());
    }
}
