//! One step of the backward pass through a pixel, from the fragment that was blended last.

use cubecl::prelude::*;

use super::fragments::{Fragment, Payload};
use super::{FIRST_MOMENT, REFERENCE, SECOND_MOMENT, TOTAL, Thresholds};
use crate::gpu::tile::plane_of;
use crate::gpu::vector::{Vec3, vec3};
use crate::gpu::view::CameraUniforms;

/// Gradients of the planes at a pixel.
#[derive(CubeType, Clone, Copy)]
#[expand(derive(Clone, Copy))]
pub struct PixelGrad {
    pub colour: Vec3,
    pub alpha: f32,
    /// This and the others are 0 without maps.
    depth: f32,
    pub normal: Vec3,
    distortion: f32,
}

#[cube]
pub fn pixel_grad(grad: &[f32], pixel: usize, view: CameraUniforms, #[comptime] maps: bool) -> PixelGrad {
    let plane = plane_of(view);
    let mut depth = 0.0f32;
    let mut x = 0.0f32;
    let mut y = 0.0f32;
    let mut z = 0.0f32;
    let mut distortion = 0.0f32;
    if comptime!(maps) {
        depth = grad[pixel + 4 * plane];
        x = grad[pixel + 5 * plane];
        y = grad[pixel + 6 * plane];
        z = grad[pixel + 7 * plane];
        distortion = grad[pixel + 8 * plane];
    }
    PixelGrad {
        colour: vec3(grad[pixel], grad[pixel + plane], grad[pixel + 2 * plane]),
        alpha: grad[pixel + 3 * plane],
        depth,
        normal: vec3(x, y, z),
        distortion,
    }
}

/// Sums over all fragments of a pixel, for distortion.
#[derive(CubeType, Clone, Copy)]
#[expand(derive(Clone, Copy))]
pub struct Spread {
    pub reference: f32,
    pub total: f32,
    pub first_moment: f32,
    pub second_moment: f32,
}

/// The sums of the pixel with this `state` behind its last fragment.
#[cube]
pub fn spread_of(state: &Array<f32>) -> Spread {
    Spread {
        reference: state[REFERENCE],
        total: state[TOTAL],
        first_moment: state[FIRST_MOMENT],
        second_moment: state[SECOND_MOMENT],
    }
}

/// A pixel before a fragment, and what it says about that.
#[derive(CubeType, Clone, Copy)]
#[expand(derive(Clone, Copy))]
pub struct Back {
    /// T
    pub through: f32,
    /// Derivative with respect to that T.
    pub behind: f32,
    pub power: f32,
    pub covered: f32,
    pub grad_depth: f32,
}

/// Goes back over a fragment, with T behind it and the derivative with respect to that.
#[cube]
pub fn backward(
    found: Fragment,
    payload: Payload,
    through: f32,
    behind: f32,
    of: &PixelGrad,
    spread: &Spread,
    thresholds: Thresholds,
    #[comptime] maps: bool,
) -> Back {
    let alpha = max(min(found.weight, thresholds.max_alpha), -thresholds.max_alpha);
    // α is capped below 1, so that a division recovers T
    let before = through / (1.0f32 - alpha);
    let covered = alpha * before;
    let mut grad_depth = 0.0f32;
    let mut value = payload.colour.x * of.colour.x + payload.colour.y * of.colour.y + payload.colour.z * of.colour.z;
    if comptime!(maps) {
        let inverse = 1.0f32 / found.depth;
        let mapped = thresholds.slope * (spread.reference - inverse);
        let apart = mapped * mapped * spread.total + spread.second_moment - 2.0f32 * mapped * spread.first_moment;
        let of_mapped = of.distortion * 2.0f32 * (mapped * spread.total - spread.first_moment);
        value += of.depth * found.depth + of.distortion * apart;
        value += payload.normal.x * of.normal.x;
        value += payload.normal.y * of.normal.y;
        value += payload.normal.z * of.normal.z;
        grad_depth = covered * (of.depth + of_mapped * thresholds.slope * inverse * inverse);
    }
    Back {
        through: before,
        behind: alpha * value + (1.0f32 - alpha) * behind,
        // a capped α has no gradient
        power: select(f32::abs(found.weight) < thresholds.max_alpha, covered * (value - behind), 0.0f32),
        covered,
        grad_depth,
    }
}
