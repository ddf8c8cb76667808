//! Corrections of the poses of the training views in training: whether a run has them, their steps.
//!
//! They are a few numbers per view, and the camera of a step has to be known before it begins: they are kept and stepped
//! on the host. So that no GPU is waited for, a gradient takes effect before the step after the next, on every device.

use std::collections::{BTreeMap, HashMap};

use dpges_core::camera::CameraFromWorld;

use crate::config::Poses;
use crate::dataset::Dataset;
use crate::optimizer::ParameterRows;
use crate::optimizer::pose_step::PoseStep;
use crate::views::pose::PoseCorrection;
use crate::views::pose::gauge::Gauge;

/// Name of the corrections, and of their steps and gradients, in a checkpoint.
pub const POSES: &str = "poses";
const STEPS: &str = "pose_steps";
const GRADIENTS: &str = "pose_gradients";
/// Distance of points from where photographs show them above which a run with `train.poses = "auto"` corrects cameras, px.
/// Structure from motion leaves a tenth to a third of it in pictures of 640 px.
pub const LARGE_PX: f64 = 1.0;

/// The corrections of a run; empty in runs without any. No similarity of the whole world is part of them: the scene cannot
/// drift with all cameras together.
#[derive(Clone, Debug, Default)]
pub struct PoseState(Option<Refinement>);

#[derive(Clone, Debug)]
struct Refinement {
    /// Poses of the dataset, as they were recorded.
    recorded: Vec<CameraFromWorld>,
    gauge: Gauge,
    /// [views] a rotation vector, rad, and a translation, world units, along world axes.
    corrections: Vec<[f32; 6]>,
    /// [views] Adam's.
    moments: [Vec<[f32; 6]>; 2],
    /// [views] how often each was stepped.
    steps: Vec<u32>,
    /// In the order of the steps.
    waiting: Vec<Waiting>,
}

#[derive(Clone, Copy, Debug, PartialEq)]
struct Waiting {
    /// Number of the step that it comes from.
    step: usize,
    view: usize,
    /// With respect to a motion of the corrected camera.
    gradient: [f32; 6],
}

impl PoseState {
    /// Corrections of the training views of `dataset` that change nothing yet.
    pub fn new(dataset: &Dataset) -> Self {
        let views = dataset.train.len();
        let recorded: Vec<CameraFromWorld> = dataset.train.iter().map(|view| view.camera.camera_from_world).collect();
        Self(Some(Refinement {
            gauge: Gauge::new(&recorded, dataset.extent),
            recorded,
            corrections: vec![[0.0; 6]; views],
            moments: [vec![[0.0; 6]; views], vec![[0.0; 6]; views]],
            steps: vec![0; views],
            waiting: Vec::new(),
        }))
    }

    /// Takes the corrections of the training views of `dataset`, as they were recorded, out of a checkpoint, if there are
    /// any.
    ///
    /// # Errors
    /// A message if they are those of other views, or incomplete.
    pub fn from_rows(
        rows: &mut HashMap<String, ParameterRows>,
        columns: &mut BTreeMap<String, Vec<f32>>,
        dataset: &Dataset,
    ) -> Result<Self, String> {
        let Some(found) = rows.remove(POSES) else { return Ok(Self::default()) };
        let views = dataset.train.len();
        let steps = columns.remove(STEPS).unwrap_or_default();
        let gradients = columns.remove(GRADIENTS).unwrap_or_default();
        let (count, width) = (found.count, found.width);
        let Some([first, second]) = found.moments.filter(|_| (count, width, steps.len()) == (views, 6, views)) else {
            return Err(format!("`{POSES}` is {count} × {width}, expected {views} × 6 with moments and steps"));
        };
        let of_six = |rows: Vec<f32>| rows.as_chunks().0.to_vec();
        let (gradients, rest) = gradients.as_chunks::<8>();
        let waiting: Vec<Waiting> = gradients
            .iter()
            .map(|&[step, view, gradient @ ..]| Waiting { step: step as usize, view: view as usize, gradient })
            .collect();
        if !rest.is_empty() || waiting.iter().any(|waiting| waiting.view >= count || waiting.step == 0) {
            return Err(format!("column `{GRADIENTS}` does not fit {count} views"));
        }
        let Self(fresh) = Self::new(dataset);
        Ok(Self(fresh.map(|fresh| Refinement {
            corrections: of_six(found.raw),
            moments: [of_six(first), of_six(second)],
            steps: steps.into_iter().map(|steps| steps as u32).collect(),
            waiting,
            ..fresh
        })))
    }

    /// The corrections with their moments; `None` in runs without any.
    pub fn rows(&self) -> Option<(&'static str, ParameterRows)> {
        let Refinement { corrections, moments, .. } = self.0.as_ref()?;
        let rows = ParameterRows {
            count: corrections.len(),
            width: 6,
            raw: corrections.as_flattened().to_vec(),
            moments: Some(moments.each_ref().map(|moment| moment.as_flattened().to_vec())),
        };
        Some((POSES, rows))
    }

    /// The numbers in a checkpoint, with names.
    pub fn columns(&self) -> Vec<(&'static str, Vec<f32>)> {
        let Some(Refinement { steps, waiting, .. }) = &self.0 else { return Vec::new() };
        let steps = steps.iter().map(|&steps| steps as f32).collect();
        let gradients = waiting
            .iter()
            .flat_map(|Waiting { step, view, gradient }| [*step as f32, *view as f32].into_iter().chain(*gradient));
        vec![(STEPS, steps), (GRADIENTS, gradients.collect())]
    }

    /// Whether poses are refined.
    pub fn is_on(&self) -> bool {
        self.0.is_some()
    }

    /// Poses of the training views as they were recorded, by their indices; empty in runs without corrections.
    pub fn recorded(&self) -> &[CameraFromWorld] {
        self.0.as_ref().map_or(&[], |refinement| &refinement.recorded)
    }

    /// Corrections of the training views, by their indices; empty in runs without any.
    pub fn corrections(&self) -> Vec<PoseCorrection> {
        self.0.iter().flat_map(|refinement| &refinement.corrections).map(PoseCorrection::of_row).collect()
    }

    /// Keeps the `gradient` of step number `step`, on the training view with index `view`, until it takes effect.
    pub fn keep(&mut self, step: usize, view: usize, gradient: [f32; 6]) {
        if let Some(refinement) = &mut self.0 {
            refinement.waiting.push(Waiting { step, view, gradient });
        }
    }

    /// Lets the gradients take effect whose steps were taken before the last of `completed`, and takes away what all views
    /// have in common. Returns whether there were any. `step_of` says how the step after so many was taken.
    pub fn advance(&mut self, completed: usize, step_of: impl Fn(usize) -> PoseStep) -> bool {
        let Some(refinement) = &mut self.0 else { return false };
        let (due, later): (Vec<Waiting>, Vec<Waiting>) =
            std::mem::take(&mut refinement.waiting).into_iter().partition(|waiting| waiting.step < completed);
        refinement.waiting = later;
        for waiting in &due {
            refinement.step(waiting, step_of(waiting.step - 1));
            let mut corrections: Vec<_> = refinement.corrections.iter().map(PoseCorrection::of_row).collect();
            refinement.gauge.hold(&mut corrections);
            refinement.corrections = corrections.iter().map(PoseCorrection::row).collect();
        }
        !due.is_empty()
    }
}

impl Refinement {
    /// One step of the view of a gradient alone.
    fn step(&mut self, Waiting { view, gradient, .. }: &Waiting, mut step: PoseStep) {
        let correction = PoseCorrection::of_row(&self.corrections[*view]);
        let gradient = correction.gradient(gradient.map(f64::from));
        self.steps[*view] += 1;
        step.adam.time = u64::from(self.steps[*view]);
        let [first, second] = &mut self.moments;
        step.take(&mut self.corrections[*view], [&mut first[*view], &mut second[*view]], gradient);
    }
}

/// Whether a run on `dataset` with `train.poses` learns poses.
pub fn are_learnt(poses: Poses, dataset: &Dataset) -> bool {
    match poses {
        Poses::Off => false,
        Poses::On => true,
        Poses::Auto => dataset.reprojection_px.is_some_and(|px| px > LARGE_PX),
    }
}

#[cfg(test)]
mod tests {
    use dpges_core::ops::adam::AdamStep;

    use super::*;
    use crate::dataset::{BuiltinOptions, builtin};
    use crate::run::fixtures::dataset;
    use crate::views::pose::gauge::Similarity;

    const ADAM: AdamStep = AdamStep { learning_rate: 0.0, beta_1: 0.9, beta_2: 0.999, epsilon: 1e-15, time: 1 };
    const STEP: PoseStep = PoseStep { rate: 0.01, extent: 10.0, adam: ADAM };
    const GRADIENT: [f32; 6] = [1.0, -1.0, 2.0, -0.5, 0.25, -3.0];

    fn raw(state: &PoseState) -> Vec<f32> {
        state.rows().unwrap().1.raw
    }

    fn advance(state: &mut PoseState, completed: usize) -> bool {
        state.advance(completed, |_| STEP)
    }

    #[test]
    fn poses_are_learnt_where_points_are_not_where_photographs_show_them() {
        let of = |pose_degrees: f64| {
            let options =
                BuiltinOptions { train_views: 4, test_views: 0, points: 60, pose_degrees, ..Default::default() };
            builtin(&options)
        };
        let (exact, off) = (of(0.0), of(2.0));
        assert!(exact.reprojection_px.unwrap() < 1e-9 && off.reprojection_px.unwrap() > 1.0);
        assert!(!are_learnt(Poses::Auto, &exact) && are_learnt(Poses::Auto, &off));
        assert!(are_learnt(Poses::On, &exact) && !are_learnt(Poses::Off, &off));
        assert!(!are_learnt(Poses::Auto, &Dataset { reprojection_px: None, ..off }));
    }

    #[test]
    fn gradients_take_effect_a_step_later_and_move_the_view_away_from_the_others() {
        let mut state = PoseState::new(&dataset());
        state.keep(1, 1, GRADIENT);
        assert!(!advance(&mut state, 1) && raw(&state).iter().all(|&number| number == 0.0));
        assert!(advance(&mut state, 2));
        assert!(!advance(&mut state, 3), "only once");
        // a first step is the learning rate, then what all views have in common is taken away
        let data = dataset();
        let recorded: Vec<CameraFromWorld> = data.train.iter().map(|view| view.camera.camera_from_world).collect();
        let mut expected = [PoseCorrection::default(); 3];
        expected[1].rotation = [-0.01, 0.01, -0.01];
        expected[1].translation = [0.1, -0.1, 0.1];
        Gauge::new(&recorded, data.extent).hold(&mut expected);
        let expected = expected.map(|correction| correction.row());
        let raw = raw(&state);
        assert!(raw.iter().zip(expected.as_flattened()).all(|(a, b)| (a - b).abs() < 1e-6), "{raw:?} {expected:?}");
    }

    #[test]
    fn only_the_view_of_a_step_is_stepped_and_the_gauge_is_held() {
        let data = dataset();
        let mut state = PoseState::new(&data);
        for (step, view) in [(1, 0), (2, 1), (3, 0), (4, 2), (5, 0)] {
            state.keep(step, view, GRADIENT.map(|number| number / (step as f32)));
            advance(&mut state, step);
            let Refinement { gauge, .. } = state.0.as_ref().unwrap();
            let Similarity { turn, shift, growth } = gauge.common(&state.corrections());
            assert!(turn.length() < 1e-7 && shift.length() < 1e-6 && growth.abs() < 1e-6, "{turn} {shift} {growth}");
        }
        advance(&mut state, 6);
        let Refinement { steps, moments, .. } = state.0.as_ref().unwrap();
        assert_eq!(*steps, [3, 1, 1]);
        let first: Vec<f32> = moments[0].iter().map(|row| row[3]).collect();
        let expected = [0.1 * (0.81 + 0.9 / 3.0 + 0.2), 0.05, 0.025].map(|mean: f32| -0.5 * mean);
        assert!(first.iter().zip(expected).all(|(a, b)| (a - b).abs() < 1e-6), "{first:?}");
    }

    #[test]
    fn a_state_comes_back_whole_and_that_of_other_views_does_not() {
        let data = dataset();
        let mut state = PoseState::new(&data);
        for step in 1..5 {
            state.keep(step, step % 3, GRADIENT);
            advance(&mut state, step);
        }
        let saved = |state: &PoseState| {
            let columns = state.columns().into_iter().map(|(name, values)| (name.to_owned(), values));
            let (name, rows) = state.rows().unwrap();
            (HashMap::from([(name.to_owned(), rows)]), columns.collect::<BTreeMap<String, Vec<f32>>>())
        };
        let (mut rows, mut columns) = saved(&state);
        let mut back = PoseState::from_rows(&mut rows, &mut columns, &data).unwrap();
        assert!(rows.is_empty() && columns.is_empty());
        assert_eq!(back.0.as_ref().unwrap().waiting.len(), 1);
        assert!(advance(&mut state, 5) && advance(&mut back, 5));
        assert_eq!((back.rows(), back.columns()), (state.rows(), state.columns()));

        let (mut rows, mut columns) = saved(&state);
        let mut fewer = (*data).clone();
        fewer.train.pop();
        let refused = PoseState::from_rows(&mut rows, &mut columns, &fewer).unwrap_err();
        assert!(refused.contains("3 × 6, expected 2 × 6"), "{refused}");
        // too few numbers, and the step before the first
        for gradients in [vec![0.0; 7], vec![0.0; 8]] {
            let (mut rows, mut columns) = saved(&state);
            columns.insert(GRADIENTS.to_owned(), gradients);
            let refused = PoseState::from_rows(&mut rows, &mut columns, &data).unwrap_err();
            assert!(refused.contains(GRADIENTS), "{refused}");
        }
        assert!(!PoseState::from_rows(&mut HashMap::new(), &mut BTreeMap::new(), &data).unwrap().is_on());
        assert!(PoseState::default().corrections().is_empty());
    }
}
