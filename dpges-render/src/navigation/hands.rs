//! The meaning of mouse, touch, wheel and keys for a view, whatever tells of them.

use std::f64::consts::PI;

use glam::{DVec2, DVec3};

use super::motion::Motion;

/// Approach of a notch of a wheel, as the natural logarithm of the factor.
pub(crate) const NOTCH: f64 = 0.18;
/// Speed of flying by keys, sizes of the scene per second.
pub(crate) const WALK: f64 = 0.8;
/// Speed of turning by keys, rad/s.
pub(crate) const TURN: f64 = 1.2;
/// Approach by keys per second, as the natural logarithm of the factor.
const APPROACH: f64 = 1.5;
const FASTER: f64 = 4.0;
/// Angle of a drag over the height of the picture, rad.
const HALF_TURN: f64 = PI;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Drag {
    /// About the focus.
    Orbit,
    /// About the eye.
    Look,
    Pan,
}

impl Drag {
    /// A way of `heights` of the picture, to the right and downwards.
    pub(crate) fn motion(self, heights: DVec2) -> Motion {
        match self {
            Self::Orbit => Motion { orbit: HALF_TURN * heights, ..Motion::NONE },
            Self::Look => Motion { look: HALF_TURN * heights, ..Motion::NONE },
            Self::Pan => Motion { pan: heights, ..Motion::NONE },
        }
    }
}

/// The centre about which dragging turns.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Mode {
    /// The focus.
    #[default]
    Orbit,
    /// The eye.
    Fly,
}

impl Mode {
    pub fn drag(self) -> Drag {
        match self {
            Self::Orbit => Drag::Orbit,
            Self::Fly => Drag::Look,
        }
    }
}

#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Input {
    /// Way of the fingers or the mouse since the last frame; followed at once.
    pub drag: Motion,
    pub dragging: bool,
    /// A push, as by a wheel: an amount that is covered smoothly.
    pub push: Motion,
    /// Motion per second that the keys ask for.
    pub keys: Motion,
}

/// Held keys: −1, 0 or 1 on every axis.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Keys {
    /// Right, down, forward.
    pub walk: DVec3,
    /// To the right, downwards.
    pub turn: DVec2,
    /// Nearer.
    pub approach: f64,
    pub faster: bool,
}

impl Keys {
    /// Motion per second, where turning is as in `mode`.
    pub(crate) fn motion(&self, mode: Mode) -> Motion {
        let angles = TURN * self.turn;
        let (orbit, look) = if mode == Mode::Fly { (DVec2::ZERO, angles) } else { (angles, DVec2::ZERO) };
        let (walk, approach) = (WALK * self.walk, APPROACH * self.approach);
        (if self.faster { FASTER } else { 1.0 }) * Motion { orbit, look, walk, approach, ..Motion::NONE }
    }
}

impl Input {
    pub fn is_active(&self) -> bool {
        self.drag != Motion::NONE || self.push != Motion::NONE || self.keys != Motion::NONE
    }

    /// A wheel turned by `notches`, forwards.
    pub fn wheel(&mut self, notches: f64) {
        self.push = self.push + Motion { approach: NOTCH * notches, ..Motion::NONE };
    }

    /// Fingers that spread by `factor`.
    pub fn pinch(&mut self, factor: f64) {
        if factor > 0.0 && factor.is_finite() {
            self.drag = self.drag + Motion { approach: factor.ln(), ..Motion::NONE };
        }
    }
}
