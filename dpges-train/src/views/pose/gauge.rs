//! The common part of the corrections of all cameras: a similarity of the whole world, which no photograph shows.

use dpges_core::camera::CameraFromWorld;
use glam::{DMat3, DVec3};

use crate::views::pose::PoseCorrection;

/// A small motion of the whole world about the mean c̄ of the camera centres. It turns a camera at c by ω and shifts it by
/// `τ + ω × (c − c̄) + σ (c − c̄)`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Similarity {
    /// ω, rad, along world axes.
    pub turn: DVec3,
    /// τ, world units.
    pub shift: DVec3,
    /// σ: by how much distances grow, relative to themselves.
    pub growth: f64,
}

/// Tells similarities from what cameras do apart from each other, by least squares: a turn of one radian weighs as much as a
/// shift of one extent.
#[derive(Clone, Debug)]
pub struct Gauge {
    extent: f64,
    /// [views] (c − c̄), world units.
    arms: Vec<DVec3>,
    /// Σ |c − c̄|², square world units; 0 if all cameras are at one place but for rounding errors.
    spread: f64,
    /// `(Σ I + (|d|² I − d dᵀ))⁻¹` with d = (c − c̄) in extents: the common turn from the sum of all turns and moments.
    turn_from_moment: DMat3,
}

impl Gauge {
    /// The gauge of cameras where they were recorded, in a scene of `extent`, world units.
    pub fn new(recorded: &[CameraFromWorld], extent: f64) -> Self {
        let centres = recorded.iter().map(CameraFromWorld::centre);
        let middle = centres.clone().sum::<DVec3>() / recorded.len().max(1) as f64;
        let arms: Vec<DVec3> = centres.map(|centre| centre - middle).collect();
        let spread: f64 = arms.iter().map(|arm| arm.length_squared()).sum();
        let spread = if spread > f64::EPSILON * extent * extent { spread } else { 0.0 };
        let columns = |arm: DVec3| DMat3::from_cols(arm.x * arm, arm.y * arm, arm.z * arm);
        let normal = arms.iter().map(|arm| *arm / extent).fold(DMat3::ZERO, |sum, arm| {
            sum + DMat3::from_diagonal(DVec3::splat(1.0 + arm.length_squared())) - columns(arm)
        });
        let turn_from_moment = if arms.is_empty() { DMat3::ZERO } else { normal.inverse() };
        Self { extent, arms, spread, turn_from_moment }
    }

    /// The similarity that is nearest to the `corrections` of all views.
    pub fn common(&self, corrections: &[PoseCorrection]) -> Similarity {
        let count = self.arms.len().max(1) as f64;
        let shifts = || corrections.iter().map(|correction| DVec3::from(correction.translation));
        let turns = corrections.iter().map(|correction| DVec3::from(correction.rotation)).sum::<DVec3>();
        // moments and growth are about the mean: neither sees the common shift
        let moments = self.arms.iter().zip(shifts()).map(|(arm, shift)| arm.cross(shift)).sum::<DVec3>();
        let growths = self.arms.iter().zip(shifts()).map(|(arm, shift)| arm.dot(shift)).sum::<f64>();
        Similarity {
            turn: self.turn_from_moment * (turns + moments / (self.extent * self.extent)),
            shift: shifts().sum::<DVec3>() / count,
            growth: if self.spread > 0.0 { growths / self.spread } else { 0.0 },
        }
    }

    /// Takes what is common to the `corrections` of all views away.
    pub fn hold(&self, corrections: &mut [PoseCorrection]) {
        let Similarity { turn, shift, growth } = self.common(corrections);
        for (correction, arm) in corrections.iter_mut().zip(&self.arms) {
            let common = shift + turn.cross(*arm) + growth * *arm;
            correction.rotation = (DVec3::from(correction.rotation) - turn).to_array();
            correction.translation = (DVec3::from(correction.translation) - common).to_array();
        }
    }
}

#[cfg(test)]
mod tests {
    use glam::DQuat;

    use super::*;

    const EXTENT: f64 = 2.5;
    const COMMON: Similarity =
        Similarity { turn: DVec3::new(0.02, -0.01, 0.03), shift: DVec3::new(-0.1, 0.4, 0.2), growth: -0.015 };

    /// Cameras without any symmetry, away from the origin.
    fn cameras() -> Vec<CameraFromWorld> {
        let camera = |at: usize| {
            let turn = 2.4 * at as f64;
            let eye = DVec3::new(5.0 + 2.0 * turn.cos(), -3.0 + 1.5 * turn.sin(), 1.0 + 0.2 * at as f64);
            CameraFromWorld::look_at(eye, DVec3::new(5.0, -3.0, 0.5), DVec3::Z)
        };
        (0..7).map(camera).collect()
    }

    fn middle(cameras: &[CameraFromWorld]) -> DVec3 {
        cameras.iter().map(CameraFromWorld::centre).sum::<DVec3>() / cameras.len() as f64
    }

    /// The corrections of a similarity, by its definition.
    fn of_similarity(similarity: Similarity, cameras: &[CameraFromWorld]) -> Vec<PoseCorrection> {
        let Similarity { turn, shift, growth } = similarity;
        let correction = |camera: &CameraFromWorld| {
            let arm = camera.centre() - middle(cameras);
            let translation = shift + turn.cross(arm) + growth * arm;
            PoseCorrection { rotation: turn.to_array(), translation: translation.to_array() }
        };
        cameras.iter().map(correction).collect()
    }

    fn irregular(count: usize) -> Vec<PoseCorrection> {
        let number = |at: usize| 0.01 * (12.9898 * (at as f64 + 1.0)).sin();
        let vector = |at: usize| [number(at), number(at + 1), number(at + 2)];
        (0..count)
            .map(|view| PoseCorrection { rotation: vector(6 * view), translation: vector(6 * view + 3) })
            .collect()
    }

    fn dot(a: &[PoseCorrection], b: &[PoseCorrection]) -> f64 {
        let product = |(a, b): (&PoseCorrection, &PoseCorrection)| {
            let turns = DVec3::from(a.rotation).dot(b.rotation.into());
            turns + DVec3::from(a.translation).dot(b.translation.into()) / (EXTENT * EXTENT)
        };
        a.iter().zip(b).map(product).sum()
    }

    fn largest(corrections: &[PoseCorrection]) -> f64 {
        corrections.iter().flat_map(|c| c.rotation.into_iter().chain(c.translation)).map(f64::abs).fold(0.0, f64::max)
    }

    /// The seven similarities that all others are sums of.
    fn generators() -> impl Iterator<Item = Similarity> {
        let none = Similarity::default();
        let turns = DVec3::AXES.into_iter().map(move |turn| Similarity { turn, ..none });
        let shifts = DVec3::AXES.into_iter().map(move |shift| Similarity { shift, ..none });
        turns.chain(shifts).chain([Similarity { growth: 1.0, ..none }])
    }

    #[test]
    fn a_similarity_of_all_cameras_is_recognised_and_removed() {
        let cameras = cameras();
        let gauge = Gauge::new(&cameras, EXTENT);
        for similarity in generators().chain([COMMON]) {
            let mut corrections = of_similarity(similarity, &cameras);
            let Similarity { turn, shift, growth } = gauge.common(&corrections);
            assert!((turn - similarity.turn).length() < 1e-12, "{turn}, expected {similarity:?}");
            assert!((shift - similarity.shift).length() < 1e-12, "{shift}, expected {similarity:?}");
            assert!((growth - similarity.growth).abs() < 1e-12, "{growth}, expected {similarity:?}");
            gauge.hold(&mut corrections);
            assert!(largest(&corrections) < 1e-12, "{similarity:?} leaves {corrections:?}");
        }
    }

    #[test]
    fn the_corrections_of_a_turned_and_grown_world_are_a_similarity_but_for_the_square_of_its_size() {
        let cameras = cameras();
        let gauge = Gauge::new(&cameras, EXTENT);
        let middle = middle(&cameras);
        let remainder = |size: f64| {
            let (turn, shift, growth) = (size * COMMON.turn, size * COMMON.shift, size * COMMON.growth);
            let rotation = DQuat::from_scaled_axis(turn);
            let correction = |camera: &CameraFromWorld| {
                let arm = camera.centre() - middle;
                let moved = middle + shift + (1.0 + growth) * (rotation * arm);
                PoseCorrection { rotation: turn.to_array(), translation: (moved - camera.centre()).to_array() }
            };
            let mut corrections: Vec<PoseCorrection> = cameras.iter().map(correction).collect();
            // a correction turns the axes of a camera as the world is turned
            for (correction, camera) in corrections.iter().zip(&cameras) {
                let turned = rotation * (camera.rotation.transpose() * DVec3::Z);
                assert!((correction.applied(camera).rotation.transpose() * DVec3::Z - turned).length() < 1e-12);
            }
            gauge.hold(&mut corrections);
            largest(&corrections)
        };
        let (whole, half) = (remainder(1.0), remainder(0.5));
        assert!(whole < 5e-3 && half < 0.3 * whole, "{whole}, {half}");
    }

    #[test]
    fn what_is_left_has_no_part_in_any_similarity_and_is_kept() {
        let cameras = cameras();
        let gauge = Gauge::new(&cameras, EXTENT);
        let mut corrections = irregular(cameras.len());
        gauge.hold(&mut corrections);
        for similarity in generators() {
            let part = dot(&corrections, &of_similarity(similarity, &cameras));
            assert!(part.abs() < 1e-14, "{similarity:?}: {part}");
        }
        let shift = corrections.iter().map(|correction| DVec3::from(correction.translation)).sum::<DVec3>();
        assert!(shift.length() < 1e-14, "{shift}");
        assert!(largest(&corrections) > 3e-3);
        let kept = corrections.clone();
        gauge.hold(&mut corrections);
        let mut again = kept.clone();
        again.iter_mut().zip(of_similarity(COMMON, &cameras)).for_each(|(a, b)| {
            a.rotation = (DVec3::from(a.rotation) + DVec3::from(b.rotation)).to_array();
            a.translation = (DVec3::from(a.translation) + DVec3::from(b.translation)).to_array();
        });
        gauge.hold(&mut again);
        for (kept, found) in kept.iter().zip(&corrections).chain(kept.iter().zip(&again)) {
            let difference = |a: [f64; 3], b: [f64; 3]| (DVec3::from(a) - DVec3::from(b)).length();
            assert!(difference(kept.rotation, found.rotation) < 1e-13, "{kept:?}, {found:?}");
            assert!(difference(kept.translation, found.translation) < 1e-13, "{kept:?}, {found:?}");
        }
    }

    #[test]
    fn one_camera_or_several_at_one_place_are_held_too() {
        let camera = cameras()[0];
        for count in [0, 1, 3] {
            let gauge = Gauge::new(&vec![camera; count], EXTENT);
            let mut corrections = irregular(count);
            gauge.hold(&mut corrections);
            let sum =
                |of: fn(&PoseCorrection) -> [f64; 3]| corrections.iter().map(|c| DVec3::from(of(c))).sum::<DVec3>();
            assert!(sum(|c| c.rotation).length() < 1e-14 && sum(|c| c.translation).length() < 1e-14);
            assert!(count > 1 || largest(&corrections) < 1e-16);
        }
    }
}
