//! How far along a ray a Gaussian is (StopThePop).

use super::{Parameters, Splat};
use crate::backend::real::Real;
use crate::math::{CameraOf, M3, V3, apply, column, dot, rotation, scale};

/// Smallest scale that counts, over the distance of the centre from the camera (StopThePop: 1e-3 world units).
pub const MIN_SCALE: f64 = 2.5e-4;
/// Smallest dᵀ Σ⁻¹ d that is divided by, so that it is not 0.
pub const MIN_FORM: f64 = 1e-30;

/// A Gaussian as rays meet it.
#[derive(Clone, Copy, Debug)]
pub struct AlongRay<T> {
    pub splat: Splat<T>,
    /// S⁻¹ Rᵀ, from camera axes to standard deviations. The form Σ⁻¹ is not expanded, see [`Splat`].
    whitening: M3<T>,
    /// The centre in standard deviations from the camera.
    centre: V3<T>,
}

impl<T: Real> AlongRay<T> {
    pub fn new(camera: &CameraOf<T>, p: &Parameters<T>, splat: Splat<T>) -> Self {
        let (axes, centre) = (rotation(p.quaternion), camera.transform(p.position));
        // a share of the distance, so that the order does not depend on the unit of the dataset
        let least = T::of(MIN_SCALE) * dot(centre, centre).sqrt();
        let whitening: M3<T> = std::array::from_fn(|d| {
            let deviation = p.log_scales[d].exp().max(least);
            scale(apply(&camera.rotation, column(&axes, d)), T::one() / deviation)
        });
        Self { splat, whitening, centre: apply(&whitening, centre) }
    }

    /// t* along a [`unit_ray`], world units from the camera.
    #[inline(always)]
    pub fn depth(&self, ray: V3<T>) -> T {
        let along = apply(&self.whitening, ray);
        dot(along, self.centre) / dot(along, along).max(T::of(MIN_FORM))
    }
}

/// Unit vector of the ray through a point of the image, px, in camera axes; 0 where a lens shows nothing.
pub fn unit_ray<T: Real>(camera: &CameraOf<T>, [x, y]: [T; 2]) -> V3<T> {
    let position = [(x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy];
    let along = match &camera.lens {
        None => [position[0], position[1], T::one()],
        Some(lens) => lens.ray(position.map(T::as_f64)).map_or([T::zero(); 3], |ray| ray.map(T::of)),
    };
    // where a lens shows nothing the ray is 0, and stays 0
    scale(along, T::one() / dot(along, along).max(T::of(1e-20)).sqrt())
}
