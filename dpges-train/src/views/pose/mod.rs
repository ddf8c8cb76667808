//! Small corrections of where the cameras of photographs stand and look.

pub mod gauge;
pub(crate) mod refinement;

use std::collections::BTreeMap;
use std::fmt;

use dpges_core::camera::CameraFromWorld;
use glam::{DMat3, DVec3};
use serde::{Deserialize, Serialize};

use crate::dataset::View;
pub use refinement::{LARGE_PX, PoseState, are_learnt};

/// Angle below which the series of the Jacobian are used, rad: its terms would cancel.
const SMALL: f64 = 1e-3;

/// A motion of one camera away from its recorded pose: it is turned about its centre, then shifted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct PoseCorrection {
    /// Rotation vector along world axes, rad.
    pub rotation: [f64; 3],
    /// Along world axes, world units.
    pub translation: [f64; 3],
}

impl PoseCorrection {
    /// From the numbers that are trained: a rotation vector, a translation.
    pub fn of_row(row: &[f32; 6]) -> Self {
        let [x, y, z, translation @ ..] = row.map(f64::from);
        Self { rotation: [x, y, z], translation }
    }

    /// The numbers that are trained.
    pub fn row(&self) -> [f32; 6] {
        let ([a, b, c], [x, y, z]) = (self.rotation, self.translation);
        [a, b, c, x, y, z].map(|number| number as f32)
    }

    /// Whether it turns by half a turn at most and shifts by a finite distance, also in f32.
    pub fn is_sound(&self) -> bool {
        let [turn, shift] = [self.rotation, self.translation].map(|vector| DVec3::from(vector).length());
        turn <= std::f64::consts::PI && (shift as f32).is_finite()
    }

    /// The pose with its correction. None leaves it as it is, to the bit.
    pub fn applied(&self, recorded: &CameraFromWorld) -> CameraFromWorld {
        if *self == Self::default() {
            return *recorded;
        }
        recorded.moved(self.rotation.into(), self.translation.into())
    }

    /// The gradient with respect to the six numbers, from that with respect to a further motion of the corrected camera,
    /// as a [`PoseProbe`](dpges_core::render::pose::PoseProbe) has it: `Jᵀ g` of the rotation, with the left Jacobian
    /// `J = I + (1 − cos θ)/θ² [w]× + (θ − sin θ)/θ³ [w]×²` of the exponential map at w, θ = |w|.
    pub fn gradient(&self, of_motion: [f64; 6]) -> [f64; 6] {
        let [gx, gy, gz, tx, ty, tz] = of_motion;
        let [x, y, z] = self.rotation;
        let angle = DVec3::from(self.rotation).length();
        let square = angle * angle;
        let (first, second) = if angle < SMALL {
            (0.5 - square / 24.0, 1.0 / 6.0 - square / 120.0)
        } else {
            ((1.0 - angle.cos()) / square, (angle - angle.sin()) / (square * angle))
        };
        let cross = DMat3::from_cols(DVec3::new(0.0, z, -y), DVec3::new(-z, 0.0, x), DVec3::new(y, -x, 0.0));
        let jacobian = DMat3::IDENTITY + first * cross + second * cross * cross;
        let rotation = jacobian.transpose() * DVec3::new(gx, gy, gz);
        [rotation.x, rotation.y, rotation.z, tx, ty, tz]
    }
}

/// How far cameras have been moved.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PoseChanges {
    pub mean_degrees: f64,
    pub largest_degrees: f64,
    /// In extents of the scene, like the next.
    pub mean_shift: f64,
    pub largest_shift: f64,
}

impl PoseChanges {
    /// Summary of all `corrections`, in a scene of `extent`, world units.
    pub fn of(corrections: &[PoseCorrection], extent: f64) -> Self {
        let numbers = |of: fn(&PoseCorrection) -> [f64; 3], unit: f64| {
            let sizes = corrections.iter().map(|correction| DVec3::from(of(correction)).length() / unit);
            let mean = sizes.clone().sum::<f64>() / corrections.len().max(1) as f64;
            (mean, sizes.fold(0.0, f64::max))
        };
        let (mean_degrees, largest_degrees) = numbers(|correction| correction.rotation, 1f64.to_radians());
        let (mean_shift, largest_shift) = numbers(|correction| correction.translation, extent);
        Self { mean_degrees, largest_degrees, mean_shift, largest_shift }
    }
}

impl fmt::Display for PoseChanges {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { mean_degrees, largest_degrees, mean_shift, largest_shift } = self;
        write!(
            f,
            "turned by {mean_degrees:.3}° and shifted by {:.3} % of the extent on average, by {largest_degrees:.3}° and \
             {:.3} % at most",
            100.0 * mean_shift,
            100.0 * largest_shift
        )
    }
}

/// The correction of a view and what it makes of its camera: an entry of `poses.json`.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct RefinedPose {
    #[serde(flatten)]
    pub correction: PoseCorrection,
    /// Three rows of `[R | t]`, `x_camera = R x_world + t`, in the coordinates of the files of the dataset.
    pub camera_from_world: [[f64; 4]; 3],
}

impl RefinedPose {
    /// The pose of a camera that was recorded in a world shifted by `-offset`, see
    /// [`Dataset::offset`](crate::dataset::Dataset).
    pub fn new(correction: PoseCorrection, recorded: &CameraFromWorld, offset: DVec3) -> Self {
        let CameraFromWorld { rotation, translation } = correction.applied(recorded).recentred(-offset);
        let row = |row: usize| {
            let DVec3 { x, y, z } = rotation.row(row);
            [x, y, z, translation[row]]
        };
        Self { correction, camera_from_world: [row(0), row(1), row(2)] }
    }
}

/// Refined poses of views by their names.
pub type RefinedPoses = BTreeMap<String, RefinedPose>;

/// Corrects the cameras of those of `views` that have a refined pose.
pub fn refine(views: &mut [View], poses: &RefinedPoses) {
    for view in views {
        if let Some(pose) = poses.get(&view.name) {
            view.camera.camera_from_world = pose.correction.applied(&view.camera.camera_from_world);
        }
    }
}

#[cfg(test)]
mod tests {
    use dpges_core::testing::gradients::central_differences;

    use super::*;
    use crate::dataset::builtin;
    use crate::run::fixtures::options;

    fn pose() -> CameraFromWorld {
        CameraFromWorld::look_at(DVec3::new(1.0, -3.0, 2.0), DVec3::ZERO, DVec3::Z)
    }

    /// A smooth number of a pose.
    fn number(pose: &CameraFromWorld) -> f64 {
        let entries = pose.rotation.to_cols_array().into_iter().chain(pose.translation.to_array());
        entries.enumerate().map(|(at, entry)| ((at as f64 + 1.0) * entry).sin()).sum()
    }

    fn of_numbers(numbers: &[f64; 6]) -> PoseCorrection {
        let [x, y, z, translation @ ..] = *numbers;
        PoseCorrection { rotation: [x, y, z], translation }
    }

    fn slopes(at: [f64; 6], of: impl Fn(&[f64; 6]) -> f64) -> [f64; 6] {
        let slopes = central_differences(&at, &[0, 1, 2, 3, 4, 5], 1e-6, |moved| of(moved.try_into().unwrap()));
        std::array::from_fn(|index| slopes[index].expect("it is smooth"))
    }

    #[test]
    fn the_gradient_of_a_correction_is_that_of_a_further_motion_by_the_jacobian() {
        for numbers in [
            [0.4, -0.7, 0.3, 0.1, -0.2, 0.3],
            [3e-3, 1e-3, -2e-3, 0.01, 0.0, 0.02],
            [1e-4, -2e-4, 3e-4, 0.0, 0.1, 0.0],
            [0.0; 6],
        ] {
            let correction = of_numbers(&numbers);
            let here = correction.applied(&pose());
            let further = |motion: &[f64; 6]| {
                let PoseCorrection { rotation, translation } = of_numbers(motion);
                number(&here.moved(rotation.into(), translation.into()))
            };
            let found = correction.gradient(slopes([0.0; 6], further));
            let expected = slopes(numbers, |numbers| number(&of_numbers(numbers).applied(&pose())));
            for (found, expected) in found.into_iter().zip(expected) {
                assert!((found - expected).abs() < 1e-6 * (1.0 + expected.abs()), "{found}, expected {expected}");
            }
        }
    }

    #[test]
    fn nothing_changes_nothing_and_a_turn_is_about_the_centre() {
        assert_eq!(PoseCorrection::default().applied(&pose()), pose());
        let turned = PoseCorrection { rotation: [0.1, 0.2, -0.3], ..PoseCorrection::default() }.applied(&pose());
        assert!((turned.centre() - pose().centre()).length() < 1e-12 && turned != pose());
    }

    #[test]
    fn refined_poses_are_in_the_coordinates_of_the_files_and_correct_views_by_name() {
        let mut views = builtin(&options(4, [3, 0], 0)).train;
        let correction = PoseCorrection { rotation: [0.01, 0.0, 0.02], translation: [0.1, 0.0, -0.1] };
        let (recorded, offset) = (views[1].camera.camera_from_world, DVec3::new(100.0, 0.0, -50.0));
        let refined = RefinedPose::new(correction, &recorded, offset);
        let text = serde_json::to_string(&BTreeMap::from([(views[1].name.clone(), refined)])).unwrap();
        let poses: RefinedPoses = serde_json::from_str(&text).unwrap();
        let before: Vec<CameraFromWorld> = views.iter().map(|view| view.camera.camera_from_world).collect();
        refine(&mut views, &poses);
        let after: Vec<CameraFromWorld> = views.iter().map(|view| view.camera.camera_from_world).collect();
        assert_eq!([after[0], after[2]], [before[0], before[2]]);
        let [x, y, z] = refined.camera_from_world.map(|row| DVec3::new(row[0], row[1], row[2]));
        let translation = DVec3::from(refined.camera_from_world.map(|row| row[3]));
        let rotation = DMat3::from_cols(x, y, z).transpose();
        let of_files = CameraFromWorld { rotation, translation };
        assert!((of_files.centre() - after[1].centre() - offset).length() < 1e-9);
        assert!(rotation.abs_diff_eq(after[1].rotation, 1e-9));
    }

    #[test]
    fn corrections_without_bounds_are_not_sound() {
        let sound = of_numbers(&[0.4, -0.7, 0.3, 10.0, -2.0, 0.3]);
        assert!(sound.is_sound() && PoseCorrection::default().is_sound());
        for (at, number) in [(1, 4.0), (0, f64::NAN), (2, f64::INFINITY), (3, f64::NAN), (4, 1e200), (5, 1e39)] {
            let mut numbers = [0.0; 6];
            numbers[at] = number;
            assert!(!of_numbers(&numbers).is_sound(), "{numbers:?}");
        }
    }

    #[test]
    fn changes_are_in_degrees_and_extents() {
        let turned = PoseCorrection { rotation: [0.0, 0.02, 0.0], translation: [0.0; 3] };
        let shifted = PoseCorrection { rotation: [0.0; 3], translation: [0.0, 0.3, 0.4] };
        let changes = PoseChanges::of(&[turned, shifted], 2.0);
        assert!((changes.largest_degrees - 0.02f64.to_degrees()).abs() < 1e-12);
        assert!((changes.mean_degrees - 0.01f64.to_degrees()).abs() < 1e-12);
        assert!((changes.largest_shift - 0.25).abs() < 1e-12 && (changes.mean_shift - 0.125).abs() < 1e-12);
        let said = changes.to_string();
        assert!(said.contains("0.573°") && said.contains("12.500 % of the extent"), "{said}");
    }
}
