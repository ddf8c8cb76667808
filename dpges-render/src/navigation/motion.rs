//! Motions of a view by hands and inertia: an amount, or an amount per second.

use std::ops::{Add, Mul};

use glam::{DVec2, DVec3};

/// A change of view. The parts are applied in the order of the fields.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Motion {
    /// Turn about the focus, to the right and downwards, rad.
    pub orbit: DVec2,
    /// Turn about the eye, to the right and downwards, rad.
    pub look: DVec2,
    /// Shift of the picture at the depth of the focus, to the right and downwards, in heights of the picture.
    pub pan: DVec2,
    /// Natural logarithm of the factor by which the distance to the focus shrinks.
    pub approach: f64,
    /// Shift of the eye along the axes of the camera (x right, y down, z forward), in sizes of the scene.
    pub walk: DVec3,
}

/// Rates below this are rest: less than a pixel in a second.
const REST: f64 = 5e-4;

impl Motion {
    pub const NONE: Self =
        Self { orbit: DVec2::ZERO, look: DVec2::ZERO, pan: DVec2::ZERO, approach: 0.0, walk: DVec3::ZERO };

    pub fn is_rest(&self) -> bool {
        let Self { orbit, look, pan, approach, walk } = self;
        orbit.length() + look.length() + pan.length() + approach.abs() + walk.length() < REST
    }
}

impl Add for Motion {
    type Output = Self;

    fn add(self, other: Self) -> Self {
        Self {
            orbit: self.orbit + other.orbit,
            look: self.look + other.look,
            pan: self.pan + other.pan,
            approach: self.approach + other.approach,
            walk: self.walk + other.walk,
        }
    }
}

impl Mul<Motion> for f64 {
    type Output = Motion;

    fn mul(self, motion: Motion) -> Motion {
        Motion {
            orbit: self * motion.orbit,
            look: self * motion.look,
            pan: self * motion.pan,
            approach: self * motion.approach,
            walk: self * motion.walk,
        }
    }
}
