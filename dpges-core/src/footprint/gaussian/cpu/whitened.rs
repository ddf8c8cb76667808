//! A Gaussian that rays meet in the frame in which it is a sphere (HTGS).
//!
//! With X, Y, Z the rows of its scaled axes in camera axes, and (x, y, z) its centre, the ray through an offset (δx, δy) from
//! the projected centre, over the focal lengths, lies in the planes `A − δx Z` and `B − δy Z`, where `A = X − x/z Z` and
//! `B = Y − y/z Z`. In units of the standard deviations its direction is `d = (A − δx Z) × (B − δy Z)` and its moment
//! `m = −z (δx B − δy A)`: the products of δx and δy cancel. Counted from the projected centre, small Gaussians lose nothing to
//! rounding. All rows are divided by the largest scale, so that no product underflows.

use super::{ParameterGrad, Parameters};
use crate::backend::real::Real;
use crate::backend::simd::LANES;
use crate::footprint::CUTOFF;
use crate::math::{
    CameraOf, M3, V3, add, apply_transposed, column, cross, dot, rotation, rotation_backward, scale, sub,
};
use crate::tiles::PixelRect;

/// Smallest |d|² that is divided by.
pub const MIN_SQUARED_DIRECTION: f64 = 1e-36;
/// Sums over pixels: gradients of A, B and Z, of the logarithm of z, of δx and δy, and of the exponent.
pub const SUMS: usize = 13;

/// One Gaussian seen by one camera: `strength · exp(−½ r²)` with `r² = k² |m|² / |d|²`, see the module.
#[derive(Clone, Copy, Debug)]
pub struct Whitened<T> {
    /// Projected centre, px.
    pub mean: [T; 2],
    /// 1 / focal lengths, 1 / px.
    per_px: [T; 2],
    a: V3<T>,
    b: V3<T>,
    z: V3<T>,
    /// Depth of the centre, world units.
    pub depth: T,
    /// k: depth over the largest scale.
    distance: T,
    /// max(0, opacity)
    strength: T,
    pub colour: V3<T>,
    reach: PixelRect,
}

/// The ray through a pixel.
#[derive(Clone, Copy)]
struct Ray<T> {
    delta: [T; 2],
    moment: V3<T>,
    direction: V3<T>,
    /// 1 / |d|²
    inverse: T,
}

/// Gradients of a pixel: those of A, B, Z, of the logarithm of k, of δx and δy, of the depth of the centre.
pub struct RayGrad<T> {
    pub a: V3<T>,
    pub b: V3<T>,
    pub z: V3<T>,
    pub distance: T,
    pub delta: [T; 2],
    pub depth: T,
}

/// Scaled axes in camera axes, by rows, over the largest scale; the relative scales; and the logarithm of the largest.
fn rows<T: Real>(camera: &CameraOf<T>, p: &Parameters<T>) -> (M3<T>, M3<T>, V3<T>, T) {
    let world = rotation(p.quaternion);
    let axes: M3<T> = std::array::from_fn(|i| std::array::from_fn(|j| dot(camera.rotation[i], column(&world, j))));
    let largest = p.log_scales[0].max(p.log_scales[1]).max(p.log_scales[2]);
    let relative = p.log_scales.map(|scale| (scale - largest).exp());
    let rows = axes.map(|row| std::array::from_fn(|j| row[j] * relative[j]));
    (rows, axes, relative, largest)
}

impl<T: Real> Whitened<T> {
    /// `None` where α stays below the cutoff, and where the ellipsoid at the cutoff reaches the near plane (HTGS).
    pub fn new(camera: &CameraOf<T>, p: &Parameters<T>, colour: V3<T>) -> Option<Self> {
        let centre = camera.transform(p.position);
        let depth = centre[2];
        let strength = p.opacity.max(T::zero());
        let squared_radius = T::of(2.0) * (strength / T::of(CUTOFF)).ln() * T::of(1.0 + 1e-5);
        let ([x, y, z], _, _, largest) = rows(camera, p);
        let size = largest.exp();
        let reach = size * (squared_radius.max(T::zero()) * dot(z, z)).sqrt();
        let visible =
            strength >= T::of(CUTOFF) && depth - reach > camera.near && size < T::INFINITY && size > T::zero();
        visible.then(|| {
            let slopes = [centre[0] / depth, centre[1] / depth];
            let [a, b] = [sub(x, scale(z, slopes[0])), sub(y, scale(z, slopes[1]))];
            let distance = depth / size;
            let mean = [camera.fx * slopes[0] + camera.cx, camera.fy * slopes[1] + camera.cy];
            // where a plane through the camera touches the ellipsoid: κ |A − δ Z| = |δ| z
            let square = |value: T| value * value;
            let denominator = square(distance) - squared_radius * dot(z, z);
            let touched = |plane: V3<T>| {
                let middle = -squared_radius * dot(plane, z) / denominator;
                let half = (square(middle) + squared_radius * dot(plane, plane) / denominator).sqrt();
                [middle - half, middle + half]
            };
            let [[left, right], [top, bottom]] = [touched(a), touched(b)];
            let bounds = [
                mean[0] + camera.fx * left,
                mean[0] + camera.fx * right,
                mean[1] + camera.fy * top,
                mean[1] + camera.fy * bottom,
            ];
            Self {
                mean,
                per_px: [T::one() / camera.fx, T::one() / camera.fy],
                a,
                b,
                z,
                depth,
                distance,
                strength,
                colour,
                reach: PixelRect::covering(bounds.map(T::as_f64), camera.width, camera.height),
            }
        })
    }

    /// Pixels at which α can reach the cutoff: the bounding box of the ellipsoid.
    pub fn reach(&self) -> PixelRect {
        self.reach
    }

    #[inline(always)]
    fn ray(&self, dx: T, dy: T) -> Ray<T> {
        let delta = [dx * self.per_px[0], dy * self.per_px[1]];
        let moment = sub(scale(self.b, delta[0]), scale(self.a, delta[1]));
        let direction = cross(sub(self.a, scale(self.z, delta[0])), sub(self.b, scale(self.z, delta[1])));
        let inverse = T::one() / dot(direction, direction).max(T::of(MIN_SQUARED_DIRECTION));
        Ray { delta, moment, direction, inverse }
    }

    /// α before it is capped, and the depth at which it is largest along the ray, at offsets from the mean, px. α is 0 below
    /// the cutoff.
    #[inline(always)]
    pub fn fragments(&self, dx: &[T; LANES], dy: T, weight: &mut [T; LANES], depth: &mut [T; LANES]) {
        let squared = self.distance * self.distance;
        for lane in 0..LANES {
            let ray = self.ray(dx[lane], dy);
            weight[lane] = squared * dot(ray.moment, ray.moment) * ray.inverse;
        }
        for weight in weight.iter_mut() {
            *weight = self.strength * (T::of(-0.5) * *weight).exp_nonpositive();
        }
        for weight in weight.iter_mut() {
            *weight = if *weight >= T::of(CUTOFF) { *weight } else { T::zero() };
        }
        for lane in 0..LANES {
            let ray = self.ray(dx[lane], dy);
            let along = dot(self.z, cross(ray.direction, ray.moment)) * ray.inverse;
            // elsewhere it may be infinite
            depth[lane] = if weight[lane] > T::zero() { self.depth * (T::one() - along) } else { self.depth };
        }
    }

    /// From the gradients of the exponent and of the depth of the fragment at an offset from the mean, px.
    #[inline(always)]
    pub fn pixel_backward(&self, dx: T, dy: T, power: T, grad_depth: T) -> RayGrad<T> {
        let Ray { delta: [x, y], moment, direction, inverse } = self.ray(dx, dy);
        let squared = self.distance * self.distance;
        let deviations = squared * dot(moment, moment) * inverse;
        let ahead = cross(direction, moment);
        let along = dot(self.z, ahead) * inverse;
        let grad_along = -self.depth * grad_depth * inverse;
        let two = T::of(2.0);
        let grad_moment = add(scale(moment, -power * squared * inverse), scale(cross(self.z, direction), grad_along));
        let grad_direction = add(
            scale(direction, power * deviations * inverse - two * grad_along * along),
            scale(cross(moment, self.z), grad_along),
        );
        let (plane_a, plane_b) = (sub(self.a, scale(self.z, x)), sub(self.b, scale(self.z, y)));
        let (grad_a, grad_b) = (cross(plane_b, grad_direction), cross(grad_direction, plane_a));
        RayGrad {
            a: sub(grad_a, scale(grad_moment, y)),
            b: add(grad_b, scale(grad_moment, x)),
            z: sub(scale(ahead, grad_along), add(scale(grad_a, x), scale(grad_b, y))),
            distance: -power * deviations,
            delta: [dot(self.b, grad_moment) - dot(self.z, grad_a), -dot(self.a, grad_moment) - dot(self.z, grad_b)],
            depth: grad_depth * (T::one() - along),
        }
    }

    /// Gradient with respect to the centre in camera axes, times its depth.
    #[inline(always)]
    pub fn towards(&self, grad: &RayGrad<T>, slopes: [T; 2]) -> V3<T> {
        let [x, y] = [-dot(self.z, grad.a) - grad.delta[0], -dot(self.z, grad.b) - grad.delta[1]];
        [x, y, grad.distance + self.depth * grad.depth - slopes[0] * x - slopes[1] * y]
    }

    /// x / z and y / z of the centre.
    #[inline(always)]
    pub fn slopes(&self, camera: &CameraOf<T>) -> [T; 2] {
        [(self.mean[0] - camera.cx) / camera.fx, (self.mean[1] - camera.cy) / camera.fy]
    }
}

/// Gradients with respect to the raw parameters, from the sums over the pixels, in the order of [`SUMS`], and of the depth of
/// the centre.
pub fn backward<T: Real>(
    camera: &CameraOf<T>,
    p: &Parameters<T>,
    whitened: &Whitened<T>,
    sums: [T; SUMS],
    grad_depth: T,
) -> ParameterGrad<T> {
    let three = |first: usize| [sums[first], sums[first + 1], sums[first + 2]];
    let grad = RayGrad {
        a: three(0),
        b: three(3),
        z: three(6),
        distance: sums[9],
        delta: [sums[10], sums[11]],
        depth: grad_depth,
    };
    let slopes = whitened.slopes(camera);
    let (rows, _, relative, _) = rows(camera, p);
    let grad_z = sub(grad.z, add(scale(grad.a, slopes[0]), scale(grad.b, slopes[1])));
    let grad_rows = [grad.a, grad.b, grad_z];
    let log_scales = std::array::from_fn(|j| dot(column(&rows, j), column(&grad_rows, j)));
    // rows = W R · relative scales
    let grad_axes = grad_rows.map(|row| -> V3<T> { std::array::from_fn(|j| row[j] * relative[j]) });
    let grad_rotation: M3<T> =
        std::array::from_fn(|i| std::array::from_fn(|j| dot(column(&camera.rotation, i), column(&grad_axes, j))));
    let grad_centre = scale(whitened.towards(&grad, slopes), T::one() / whitened.depth);
    ParameterGrad {
        position: apply_transposed(&camera.rotation, grad_centre),
        quaternion: rotation_backward(p.quaternion, &grad_rotation),
        log_scales,
        opacity: if p.opacity > T::zero() { sums[12] / whitened.strength } else { T::zero() },
        degrees_of_freedom: T::zero(),
    }
}

#[cfg(test)]
mod tests {
    use glam::{DMat3, DVec3};

    use super::*;
    use crate::camera::{Camera, CameraFromWorld};

    const P: Parameters<f64> = Parameters {
        position: [0.3, -0.2, 2.0],
        quaternion: [0.7, 0.3, -0.5, 0.2],
        log_scales: [-1.1, -2.0, -2.7],
        opacity: 0.8,
        degrees_of_freedom: f64::INFINITY,
    };

    fn camera() -> CameraOf<f64> {
        let camera_from_world = CameraFromWorld {
            rotation: DMat3::from_rotation_y(0.2) * DMat3::from_rotation_x(-0.1),
            translation: DVec3::new(0.1, 0.05, 0.3),
        };
        let (fx, fy, cx, cy) = (60.0, 66.0, 31.0, 22.0);
        CameraOf::new(&Camera { camera_from_world, fx, fy, cx, cy, width: 64, height: 48, near: 0.2, lens: None })
    }

    /// The least squared distance of a ray from the centre in standard deviations, and its depth, by whitening the ray itself.
    fn brute_force(camera: &CameraOf<f64>, at: [f64; 2]) -> [f64; 2] {
        let along = [(at[0] - camera.cx) / camera.fx, (at[1] - camera.cy) / camera.fy, 1.0];
        let axes = rotation(P.quaternion);
        let whiten = |vector: V3<f64>| -> V3<f64> {
            let world = apply_transposed(&camera.rotation, vector);
            std::array::from_fn(|j| dot(column(&axes, j), world) / P.log_scales[j].exp())
        };
        let (ray, centre) = (whiten(along), whiten(camera.transform(P.position)));
        let depth = dot(ray, centre) / dot(ray, ray);
        let offset = sub(scale(ray, depth), centre);
        [dot(offset, offset), depth]
    }

    #[test]
    fn rays_are_met_where_whitening_them_says() {
        let camera = camera();
        let whitened = Whitened::new(&camera, &P, [0.0; 3]).unwrap();
        let mut reached = 0;
        for at in 0..64 * 48 {
            let pixel = [(at % 64) as f64 + 0.5, (at / 64) as f64 + 0.5];
            let (mut weight, mut depth) = ([0.0; LANES], [0.0; LANES]);
            let dx = [pixel[0] - whitened.mean[0]; LANES];
            whitened.fragments(&dx, pixel[1] - whitened.mean[1], &mut weight, &mut depth);
            let [squared, expected] = brute_force(&camera, pixel);
            let alpha = P.opacity * (-0.5 * squared).exp();
            assert!(weight[0] == 0.0 || (depth[0] - expected).abs() < 1e-12 * expected.abs(), "{pixel:?}");
            assert!((weight[0] - if alpha >= CUTOFF { alpha } else { 0.0 }).abs() < 1e-12, "{pixel:?}");
            let PixelRect { x0, x1, y0, y1 } = whitened.reach();
            let inside = (x0..x1).contains(&(pixel[0] as u32)) && (y0..y1).contains(&(pixel[1] as u32));
            assert!(inside || weight[0] == 0.0, "{pixel:?}");
            reached += usize::from(weight[0] > 0.0);
        }
        let PixelRect { x0, x1, y0, y1 } = whitened.reach();
        // an ellipse covers π / 4 of an axis-parallel box, one that is turned less
        assert!(reached > 200 && 2 * reached > ((x1 - x0) * (y1 - y0)) as usize, "{reached}");
    }

    #[test]
    fn what_reaches_the_near_plane_does_not_exist() {
        let camera = camera();
        let at = |depth: f64| {
            let position = apply_transposed(&camera.rotation, sub([0.0, 0.0, depth], camera.transform([0.0; 3])));
            Whitened::new(&camera, &Parameters { position, log_scales: [-1.0; 3], ..P }, [0.0; 3])
        };
        let reach = (-1.0f64).exp() * (2.0 * (255.0 * P.opacity).ln()).sqrt();
        assert!(at(0.2 + 1.01 * reach).is_some() && at(0.2 + 0.99 * reach).is_none());
        assert!(Whitened::new(&camera, &Parameters { opacity: 0.0039, ..P }, [0.0; 3]).is_none());
    }

    #[test]
    fn needles_and_discs_in_f32_are_those_in_f64() {
        let exact = camera();
        let single = CameraOf::<f32> {
            rotation: exact.rotation.map(|row| row.map(|v| v as f32)),
            cofactors: exact.cofactors.map(|row| row.map(|v| v as f32)),
            translation: exact.translation.map(|v| v as f32),
            fx: 60.0,
            fy: 66.0,
            cx: 31.0,
            cy: 22.0,
            near: 0.2,
            width: 64,
            height: 48,
            lens: None,
            coverage: exact.coverage,
        };
        for log_scales in [[-1.0, -7.0, -8.0], [-1.0, -1.2, -9.0], [-6.0, -6.0, -6.0]] {
            let p = Parameters { log_scales, ..P };
            let narrow = Parameters {
                position: p.position.map(|v| v as f32),
                quaternion: p.quaternion.map(|v| v as f32),
                log_scales: p.log_scales.map(|v| v as f32),
                opacity: p.opacity as f32,
                degrees_of_freedom: f32::INFINITY,
            };
            let (found, expected) =
                (Whitened::new(&single, &narrow, [0.0; 3]).unwrap(), Whitened::new(&exact, &p, [0.0; 3]).unwrap());
            for offset in [[0.01, 0.02], [0.3, -0.2], [2.0, 1.0]] {
                let (mut weight, mut depth) = ([0.0; LANES], [0.0; LANES]);
                found.fragments(&[offset[0] as f32; LANES], offset[1] as f32, &mut weight, &mut depth);
                let (mut weight64, mut depth64) = ([0.0; LANES], [0.0; LANES]);
                expected.fragments(&[offset[0]; LANES], offset[1], &mut weight64, &mut depth64);
                assert!((f64::from(weight[0]) - weight64[0]).abs() < 2e-3, "{log_scales:?} {offset:?}: {weight:?}");
                assert!(weight64[0] == 0.0 || (f64::from(depth[0]) / depth64[0] - 1.0).abs() < 1e-4, "{log_scales:?}");
            }
        }
    }
}
