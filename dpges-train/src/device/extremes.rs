//! Random scenes at the extremes: whether everything is finite, and how far f32 is from f64.

use burn::tensor::Device;
use dpges_core::testing::extremes::{Hazard, extreme};
use dpges_core::testing::precision::{Deviation, Distribution, Way, deviations};
use serde::Serialize;

/// The scenes that deviate most, of which the report names this many.
const NAMED: usize = 10;

/// The results of many extreme scenes.
#[derive(Debug, Serialize)]
pub struct Extremes {
    pub device: String,
    /// Seeds 0 to this, exclusive.
    pub scenes: u64,
    /// Tensors with values that are not finite.
    pub non_finite: usize,
    /// By way of rendering and tensor; without scenes in which rounding decides what is there.
    pub tensors: Vec<Line>,
    /// Pictures of peeled scenes, by what is extreme about them.
    pub pictures: Vec<Line>,
    /// Gradients of peeled scenes, all tensors together, by what is extreme about them.
    pub gradients: Vec<Line>,
    /// The gradients and pictures that deviate most.
    pub worst: Vec<Worst>,
}

/// One group of tensors.
#[derive(Debug, Serialize)]
pub struct Line {
    pub name: String,
    pub count: usize,
    pub median: f64,
    /// 99.9 % do not exceed it.
    pub nearly_all: f64,
    pub largest: f64,
}

#[derive(Debug, Serialize)]
pub struct Worst {
    pub seed: u64,
    pub hazards: String,
    pub way: &'static str,
    pub tensor: &'static str,
    pub error: f64,
    pub non_finite: usize,
}

/// A scene that cannot be rendered.
#[derive(Debug, thiserror::Error)]
#[error("scene {seed} ({hazards}) is refused: {reason}; the seed makes the same scene again, please report it")]
pub struct Refused {
    seed: u64,
    hazards: String,
    reason: dpges_core::Error,
}

/// Renders the scenes of the first `count` seeds in every way on `device`. Calls `progress` after each.
///
/// # Errors
/// [`Refused`] if a scene cannot be rendered.
pub fn measure(
    count: u64,
    device: &Device,
    description: &str,
    mut progress: impl FnMut(),
) -> Result<Extremes, Refused> {
    let mut all = Vec::new();
    for seed in 0..count {
        let extreme = extreme(seed);
        for way in Way::ALL {
            let found = deviations(&extreme, way, device);
            all.extend(found.map_err(|reason| Refused { seed, hazards: names(&extreme.hazards), reason })?);
        }
        progress();
    }
    Ok(Extremes::of(&all, count, description))
}

impl Extremes {
    fn of(all: &[Deviation], scenes: u64, description: &str) -> Self {
        let rounding = |d: &Deviation| d.hazards.iter().any(|hazard| hazard.is_decided_by_rounding());
        let mut tensors = Vec::new();
        for way in Way::ALL {
            let mut named: Vec<&'static str> = Vec::new();
            all.iter().filter(|d| d.way == way).for_each(|d| {
                if !named.contains(&d.tensor) {
                    named.push(d.tensor);
                }
            });
            for tensor in named {
                let name = format!("{}: {tensor}", way.name());
                tensors.extend(line(name, all, |d| d.way == way && d.tensor == tensor && !rounding(d)));
            }
        }
        let by_hazard = |is_picture: bool| {
            let of = |d: &Deviation| d.way == Way::Peeled && (d.tensor == "image") == is_picture;
            let mut lines: Vec<Line> =
                line("none".to_owned(), all, |d| of(d) && d.hazards.is_empty()).into_iter().collect();
            for hazard in Hazard::ALL {
                lines.extend(line(format!("{hazard:?}"), all, |d| of(d) && d.hazards == [hazard]));
            }
            let several = |d: &Deviation| d.hazards.len() > 1;
            lines.extend(line("two or three".to_owned(), all, |d| of(d) && several(d) && !rounding(d)));
            let name = "two or three, with one that rounding decides";
            lines.extend(line(name.to_owned(), all, |d| of(d) && several(d) && rounding(d)));
            lines
        };
        let mut order: Vec<&Deviation> = all.iter().collect();
        order.sort_by(|a, b| b.error.total_cmp(&a.error));
        let worst = order.into_iter().take(NAMED).map(|d| Worst {
            seed: d.seed,
            hazards: names(&d.hazards),
            way: d.way.name(),
            tensor: d.tensor,
            error: d.error,
            non_finite: d.non_finite,
        });
        Self {
            device: description.to_owned(),
            scenes,
            non_finite: all.iter().filter(|d| d.non_finite > 0).count(),
            tensors,
            pictures: by_hazard(true),
            gradients: by_hazard(false),
            worst: worst.collect(),
        }
    }

    /// Tables in Markdown.
    pub fn markdown(&self) -> String {
        let table = |title: &str, lines: &[Line]| {
            let rows: String = lines
                .iter()
                .map(|line| {
                    let Line { name, count, median, nearly_all, largest } = line;
                    format!("| {name} | {count} | {median:.1e} | {nearly_all:.1e} | {largest:.1e} |\n")
                })
                .collect();
            format!("| {title} | tensors | median | 99.9 % | largest |\n|---|---|---|---|---|\n{rows}\n")
        };
        let worst: String = self
            .worst
            .iter()
            .map(|w| format!("| {} | {} | {} | {} | {:.1e} |\n", w.seed, w.hazards, w.way, w.tensor, w.error))
            .collect();
        format!(
            "{} scenes on {}; {} tensors with values that are not finite.\n\n{}{}{}\
             | scene | extreme | way | tensor | error |\n|---|---|---|---|---|\n{worst}",
            self.scenes,
            self.device,
            self.non_finite,
            table("tensor, unless rounding decides", &self.tensors),
            table("pictures by what is extreme, peeled", &self.pictures),
            table("gradients by what is extreme, peeled", &self.gradients),
        )
    }
}

fn line(name: String, all: &[Deviation], of: impl Fn(&Deviation) -> bool) -> Option<Line> {
    let errors = all.iter().filter(|d| of(d)).map(|d| d.error).collect();
    let Distribution { count, median, nearly_all, largest } = Distribution::of(errors)?;
    Some(Line { name, count, median, nearly_all, largest })
}

fn names(hazards: &[Hazard]) -> String {
    hazards.iter().map(|hazard| format!("{hazard:?}")).collect::<Vec<_>>().join(", ")
}

#[cfg(test)]
mod tests {
    use super::*;

    fn deviation(hazards: &[Hazard], tensor: &'static str, error: f64) -> Deviation {
        let non_finite = usize::from(error.is_infinite());
        Deviation { seed: 7, hazards: hazards.to_vec(), way: Way::Peeled, tensor, non_finite, error }
    }

    #[test]
    fn deviations_are_grouped_and_the_worst_named() {
        let needles = [Hazard::Needles];
        let all = [
            deviation(&[], "image", 0.5),
            deviation(&needles, "image", 0.25),
            deviation(&needles, "gaussians.positions", f64::INFINITY),
            deviation(&[Hazard::EdgeOn, Hazard::Needles], "image", 0.0),
        ];
        let found = Extremes::of(&all, 3, "a device");
        let names = |lines: &[Line]| lines.iter().map(|line| (line.name.clone(), line.count)).collect::<Vec<_>>();
        assert_eq!(names(&found.tensors), [("peeled: image".into(), 3), ("peeled: gaussians.positions".into(), 1)]);
        assert_eq!(names(&found.pictures), [("none".into(), 1), ("Needles".into(), 1), ("two or three".into(), 1)]);
        assert_eq!(names(&found.gradients), [("Needles".into(), 1)]);
        assert_eq!((found.non_finite, found.worst[0].tensor, found.worst.len()), (1, "gaussians.positions", 4));
        let text = found.markdown();
        assert!(text.contains("3 scenes on a device; 1 tensors") && text.contains("| Needles | 1 | 2.5e-1"), "{text}");
    }

    #[test]
    fn a_few_scenes_are_measured() {
        let device = "cpu".parse::<crate::device::DeviceName>().unwrap().open().unwrap();
        let found = measure(6, &device, "cpu", || ()).unwrap();
        assert_eq!((found.scenes, found.non_finite), (6, 0), "{}", found.markdown());
        assert!(found.tensors.len() > 20, "{}", found.markdown());
    }
}
