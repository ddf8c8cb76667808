//! The rows of training: runs with other settings, measured as the scene itself is.

use std::time::{Duration, Instant};

use dpges_core::scene::SceneData;
use dpges_train::run::Observer;

use super::super::cell::Cell;
use super::super::store::Study;
use super::super::{StudyError, evaluated};
use super::bench::Bench;

/// Folder of the runs in that of the study.
pub const RUNS: &str = "runs";

/// When measuring ends, if it does.
#[derive(Clone, Copy, Debug, Default)]
pub struct Deadline(Option<Instant>);

impl Deadline {
    pub fn after(length: Option<Duration>) -> Self {
        Self(length.and_then(|length| Instant::now().checked_add(length)))
    }

    pub fn is_over(self) -> bool {
        self.0.is_some_and(|end| Instant::now() >= end)
    }
}

/// Ends a run when the time is over.
pub struct Until {
    deadline: Deadline,
    /// Whether it has ended one.
    stopped: bool,
}

impl Observer for Until {
    fn should_stop(&mut self) -> bool {
        self.stopped |= self.deadline.is_over();
        self.stopped
    }
}

/// Trains by `train` and measures the rows of `cells` that `study` lacks, until the time is over.
///
/// # Errors
/// Those of `train`, unless the time was over; if a scene cannot be drawn, or a file not be written.
pub fn train_each<E: From<StudyError>>(
    cells: &[Cell],
    bench: &Bench,
    study: &mut Study,
    deadline: Deadline,
    mut train: impl FnMut(&Cell, &mut Until) -> Result<(), E>,
) -> Result<(), E> {
    for cell in cells {
        let (label, seed) = (cell.variant.label, Some(cell.seed()));
        if study.has(label, seed) {
            continue;
        }
        if deadline.is_over() {
            study.leave_out(label, seed);
            continue;
        }
        let mut until = Until { deadline, stopped: false };
        match train(cell, &mut until) {
            Err(_) if until.stopped => {
                tracing::info!("{label}: the time is over, the same command goes on with it");
                study.leave_out(label, seed);
                continue;
            }
            other => other?,
        }
        let trained = evaluated::row(cell)?;
        let scene = SceneData::load(&cell.folder.scene()).map_err(StudyError::from)?;
        let mut row = bench.row(&scene, &[], label, seed)?;
        row.settings.clone_from(&trained.settings);
        row.folder = Some(format!("{RUNS}/{}", cell.relative));
        for key in ["training_seconds", "training_peak_bytes"] {
            row.set(key, trained.get(key));
        }
        study.add(row)?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_run_is_stopped_when_the_time_is_over() {
        let mut until = Until { deadline: Deadline::default(), stopped: false };
        assert!(!until.should_stop() && !until.stopped);
        until.deadline = Deadline::after(Some(Duration::ZERO));
        assert!(until.should_stop() && until.stopped);
    }
}
