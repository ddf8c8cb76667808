//! The points of rendering: the scene as it was trained, every knob alone, then some together.

use std::cell::OnceCell;
use std::path::Path;

use dpges_core::camera::Camera;
use dpges_core::scene::SceneData;
use dpges_train::eval::pictures::save_png;
use dpges_train::eval::simplify::Contributions;

use super::combine::combinations;
use super::knob::{Change, apply, label};
use super::measure::{Bench, Seen};
use super::point::{Kind, Point};
use super::store::Store;
use crate::cli::Result;

/// Folder of the pictures in that of the measurements.
pub const PICTURES: &str = "pictures";

/// Measures points that are not in the store yet.
pub struct Sweep<'a> {
    pub bench: Bench<'a>,
    pub out: &'a Path,
    pub store: Store,
    /// Labels of what the time was too short for.
    not_run: Vec<String>,
}

/// A scene whose rendering is changed.
pub struct Subject<'a> {
    pub scene: &'a SceneData,
    /// In its coordinates: where it is looked at from, for what primitives contribute and how their colours change.
    pub cameras: &'a [Camera],
    /// Whether a knob is turned.
    pub is_wanted: &'a dyn Fn(&str) -> bool,
}

impl<'a> Sweep<'a> {
    pub fn new(bench: Bench<'a>, out: &'a Path, store: Store) -> Self {
        Self { bench, out, store, not_run: Vec::new() }
    }

    /// Measures `subject` at every setting, as long as `goes_on` says so.
    pub fn render(&mut self, subject: &Subject, goes_on: &dyn Fn() -> bool) -> Result<()> {
        let mut singles = Change::all(subject.scene, self.bench.sums_floats());
        singles.retain(|change| (subject.is_wanted)(change.knob()));
        let alone: Vec<Vec<Change>> =
            std::iter::once(Vec::new()).chain(singles.iter().map(|&change| vec![change])).collect();
        let contributions = OnceCell::new();
        self.measure(subject, &alone, &contributions, goes_on)?;
        if !singles.iter().all(|single| self.store.has(&single.to_string(), None)) {
            self.leave_out("combinations", None);
            return Ok(());
        }
        let together = combinations(&singles, &self.store.trade.points);
        self.measure(subject, &together, &contributions, goes_on)
    }

    fn measure(
        &mut self,
        subject: &Subject,
        settings: &[Vec<Change>],
        contributions: &OnceCell<Contributions>,
        goes_on: &dyn Fn() -> bool,
    ) -> Result<()> {
        let centres: Vec<[f64; 3]> = subject.cameras.iter().map(|camera| camera.centre().to_array()).collect();
        for changes in settings {
            let name = label(changes);
            if self.store.has(&name, None) {
                tracing::info!("{name}: already measured");
                continue;
            }
            if !goes_on() {
                self.leave_out(&name, None);
                continue;
            }
            if contributions.get().is_none() && changes.iter().any(|change| matches!(change, Change::Primitives(_))) {
                tracing::info!("what primitives contribute to {} views", subject.cameras.len());
                let found = Contributions::measure(subject.scene, subject.cameras, self.bench.device)?;
                // fails if it is known, and it is not
                let _ = contributions.set(found);
            }
            let nothing = Contributions { surfels: Vec::new(), gaussians: Vec::new() };
            let scene = apply(subject.scene, changes, contributions.get().unwrap_or(&nothing), &centres);
            let point = self.point(&scene, changes, &name, None)?;
            self.store.add(point)?;
        }
        Ok(())
    }

    /// The measurement of `scene` with `changes`, as a point of rendering.
    pub fn point(&self, scene: &SceneData, changes: &[Change], label: &str, seed: Option<u64>) -> Result<Point> {
        let Seen { psnr, ssim, flip, perceptual, times, bytes, gpu_bytes, picture } = self.bench.see(scene, changes)?;
        tracing::info!("{label}: {psnr:.2} dB, {:.2} ms, {:.2} MB", times.p50_ms, bytes as f64 / 1e6);
        let file = format!("{PICTURES}/{}.png", file_stem(label, seed));
        save_png(&picture, &self.out.join(&file))?;
        Ok(Point {
            label: label.to_owned(),
            kind: Kind::Rendering,
            knobs: changes.iter().map(|change| change.knob().to_owned()).collect(),
            seed,
            psnr,
            ssim,
            flip,
            perceptual,
            frame_ms: times.p50_ms,
            frame_p99_ms: times.p99_ms,
            frames: times.frames,
            device: self.store.trade.subject.device.clone(),
            bytes,
            surfels: scene.surfels.len(),
            gaussians: scene.gaussians.len(),
            gpu_bytes,
            training_seconds: None,
            training_peak_bytes: None,
            picture: file,
        })
    }

    /// Notes that there was no time for a point.
    pub fn leave_out(&mut self, label: &str, seed: Option<u64>) {
        self.not_run.push(seed.map_or_else(|| label.to_owned(), |seed| format!("{label}, seed {seed}")));
    }

    /// Completes the file of the points. Returns them.
    pub fn finish(mut self) -> Result<Store> {
        self.store.finish(self.not_run)?;
        Ok(self.store)
    }
}

/// The name of a point as that of a file: letters, digits, `.` and `-`.
fn file_stem(label: &str, seed: Option<u64>) -> String {
    let label = label.replace('%', "");
    let words: Vec<&str> =
        label.split(|c: char| !c.is_alphanumeric() && c != '.').filter(|word| !word.is_empty()).collect();
    let seed = seed.map(|seed| format!("-seed-{seed}")).unwrap_or_default();
    words.join("-") + &seed
}

#[cfg(test)]
mod tests {
    use super::super::knob::tests::scene;
    use super::*;

    #[test]
    fn labels_become_names_of_files_that_differ() {
        assert_eq!(file_stem("layers=2 + primitives=50%", None), "layers-2-primitives-50");
        assert_eq!(file_stem("modulation=0.5w", None), "modulation-0.5w");
        assert_eq!(file_stem("budget-half", Some(3)), "budget-half-seed-3");
        let all = Change::all(&scene().0, true);
        let stems: std::collections::HashSet<String> =
            all.iter().map(|change| file_stem(&change.to_string(), None)).collect();
        assert_eq!(stems.len(), all.len());
    }
}
