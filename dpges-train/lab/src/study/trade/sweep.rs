//! The rows of rendering: the scene as it was trained, every knob alone, then some together.

use dpges_core::camera::Camera;
use dpges_core::scene::SceneData;
use dpges_train::eval::simplify::Contributions;

use super::super::Result;
use super::super::store::Study;
use super::bench::Bench;
use super::combine::combinations;
use super::knob::{Change, apply, label};

/// A scene whose rendering is changed.
pub struct Sweep<'a> {
    pub bench: &'a Bench<'a>,
    pub scene: &'a SceneData,
    /// In its coordinates: where it is looked at from, for what primitives contribute and how their colours change.
    pub cameras: &'a [Camera],
    /// Whether a knob is turned.
    pub is_wanted: &'a dyn Fn(&str) -> bool,
    /// Whether there is time for another row.
    pub goes_on: &'a dyn Fn() -> bool,
}

impl Sweep<'_> {
    /// Measures the rows that `study` lacks.
    ///
    /// # Errors
    /// If a scene cannot be drawn, or a file not be written.
    pub fn measure(&self, study: &mut Study) -> Result<()> {
        let mut singles = Change::all(self.scene, self.bench.sums_floats());
        singles.retain(|change| (self.is_wanted)(change.knob()));
        let alone: Vec<Vec<Change>> =
            std::iter::once(Vec::new()).chain(singles.iter().map(|&change| vec![change])).collect();
        let mut contributions = None;
        self.measure_each(study, &alone, &mut contributions)?;
        if singles.iter().all(|single| study.has(&single.to_string(), None)) {
            let together = combinations(&singles, &study.content.rows);
            return self.measure_each(study, &together, &mut contributions);
        }
        study.leave_out("combinations", None);
        Ok(())
    }

    fn measure_each(
        &self,
        study: &mut Study,
        settings: &[Vec<Change>],
        contributions: &mut Option<Contributions>,
    ) -> Result<()> {
        for changes in settings {
            let name = label(changes);
            if study.has(&name, None) {
                tracing::info!("{name}: already measured");
            } else if !(self.goes_on)() {
                study.leave_out(&name, None);
            } else {
                if contributions.is_none() && changes.iter().any(|change| matches!(change, Change::Primitives(_))) {
                    tracing::info!("what primitives contribute to {} views", self.cameras.len());
                    *contributions = Some(Contributions::measure(self.scene, self.cameras, self.bench.device)?);
                }
                let scene = apply(self.scene, changes, contributions.as_ref(), self.cameras);
                study.add(self.bench.row(&scene, changes, &name, None)?)?;
            }
        }
        Ok(())
    }
}
