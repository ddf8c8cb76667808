//! A Gaussian that rays meet in the frame in which it is a sphere (HTGS).
//!
//! With X, Y, Z the rows of its scaled axes in camera axes, and (x, y, z) its centre, the ray through an offset (δx, δy) from
//! the projected centre, over the focal lengths, lies in the planes `A − δx Z` and `B − δy Z`, where `A = X − x/z Z` and
//! `B = Y − y/z Z`. In units of the standard deviations its direction is `d = (A − δx Z) × (B − δy Z)` and its moment
//! `m = −z (δx B − δy A)`: the products of δx and δy cancel. Counted from the projected centre, small Gaussians lose nothing to
//! rounding. All rows are divided by the largest scale, so that no product underflows.

use pulp::Simd;

use super::{ParameterGrad, Parameters};
use crate::backend::lanes::{Lanes, Mask};
use crate::backend::number::Arithmetic;
use crate::backend::real::Real;
use crate::footprint::CUTOFF;
use crate::math::{
    CameraOf, M3, V3, add, apply_transposed, column, cross, dot, rotation, rotation_backward, scale, sub, times,
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

impl<N: Arithmetic> RayGrad<N> {
    /// As [`Whitened::towards`], with Z, the depth and the slopes of the centre.
    #[inline(always)]
    fn towards(&self, z: V3<N>, depth: N, slopes: [N; 2]) -> V3<N> {
        let [x, y] = [-dot(z, self.a) - self.delta[0], -dot(z, self.b) - self.delta[1]];
        [x, y, self.distance + depth * self.depth - slopes[0] * x - slopes[1] * y]
    }
}

/// Scaled axes in camera axes, by rows, over the largest scale; the relative scales; and the logarithm of the largest.
fn rows<T: Real>(camera: &CameraOf<T>, p: &Parameters<T>) -> (M3<T>, V3<T>, T) {
    let largest = p.log_scales[0].max(p.log_scales[1]).max(p.log_scales[2]);
    // relative before the exponential: none overflows, and 1 is among them, so that rows do not vanish together
    let relative = p.log_scales.map(|scale| (scale - largest).exp());
    let rows = camera.axes(&rotation(p.quaternion)).map(|row| times(row, relative));
    (rows, relative, largest)
}

impl<T: Real> Whitened<T> {
    /// `None` where α stays below the cutoff, and where the ellipsoid at the cutoff reaches the near plane (HTGS).
    pub fn new(camera: &CameraOf<T>, p: &Parameters<T>, colour: V3<T>) -> Option<Self> {
        let centre = camera.transform(p.position);
        let depth = centre[2];
        let strength = p.opacity.max(T::zero());
        let squared_radius = T::of(2.0) * (strength / T::of(CUTOFF)).ln() * T::of(1.0 + 1e-5);
        let ([x, y, z], _, largest) = rows(camera, p);
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
    fn rows<S: Simd>(&self, simd: S) -> [V3<Lanes<T, S>>; 3] {
        let row = |row: V3<T>| Lanes::splat_three(simd, row);
        [row(self.a), row(self.b), row(self.z)]
    }

    #[inline(always)]
    fn ray<S: Simd>(&self, dx: Lanes<T, S>, dy: T) -> Ray<Lanes<T, S>> {
        let all = |value: T| Lanes::splat(dx.simd(), value);
        let [a, b, z] = self.rows(dx.simd());
        let delta = [dx * all(self.per_px[0]), all(dy * self.per_px[1])];
        let moment = sub(scale(b, delta[0]), scale(a, delta[1]));
        let direction = cross(sub(a, scale(z, delta[0])), sub(b, scale(z, delta[1])));
        let inverse = all(T::one()) / dot(direction, direction).max(all(T::of(MIN_SQUARED_DIRECTION)));
        Ray { delta, moment, direction, inverse }
    }

    /// At offsets from the mean, px: where α reaches the cutoff, α before it is capped, and the depth at which it is largest
    /// along the ray, finite everywhere.
    #[inline(always)]
    pub fn fragments<S: Simd>(&self, dx: Lanes<T, S>, dy: T) -> (Mask<T, S>, [Lanes<T, S>; 2]) {
        let all = |value: T| Lanes::splat(dx.simd(), value);
        let ray = self.ray(dx, dy);
        let squared = all(self.distance * self.distance) * dot(ray.moment, ray.moment) * ray.inverse;
        let weight = all(self.strength) * (all(T::of(-0.5)) * squared).exp_nonpositive();
        let drawn = weight.at_least(all(T::of(CUTOFF)));
        let [.., z] = self.rows(dx.simd());
        let along = dot(z, cross(ray.direction, ray.moment)) * ray.inverse;
        let depth = all(self.depth) * (all(T::one()) - along);
        // where nothing is drawn the ray may be parallel to the plane, and its depth anything
        (drawn, [weight, Lanes::select(drawn, depth, all(self.depth))])
    }

    /// Gradients at offsets from the mean, px, from those of the exponent and of the depth of the fragments there.
    #[inline(always)]
    pub fn pixel_backward<S: Simd>(
        &self,
        dx: Lanes<T, S>,
        dy: T,
        power: Lanes<T, S>,
        grad_depth: Lanes<T, S>,
    ) -> RayGrad<Lanes<T, S>> {
        let all = |value: T| Lanes::splat(dx.simd(), value);
        let ([a, b, z], depth) = (self.rows(dx.simd()), all(self.depth));
        let Ray { delta: [x, y], moment, direction, inverse } = self.ray(dx, dy);
        let squared = all(self.distance * self.distance);
        let deviations = squared * dot(moment, moment) * inverse;
        let ahead = cross(direction, moment);
        let along = dot(z, ahead) * inverse;
        let grad_along = -depth * grad_depth * inverse;
        let grad_moment = sub(scale(cross(z, direction), grad_along), scale(moment, power * squared * inverse));
        let grad_direction = add(
            scale(direction, power * deviations * inverse - all(T::of(2.0)) * grad_along * along),
            scale(cross(moment, z), grad_along),
        );
        let (plane_a, plane_b) = (sub(a, scale(z, x)), sub(b, scale(z, y)));
        let (grad_a, grad_b) = (cross(plane_b, grad_direction), cross(grad_direction, plane_a));
        RayGrad {
            a: sub(grad_a, scale(grad_moment, y)),
            b: add(grad_b, scale(grad_moment, x)),
            z: sub(scale(ahead, grad_along), add(scale(grad_a, x), scale(grad_b, y))),
            distance: -(power * deviations),
            delta: [dot(b, grad_moment) - dot(z, grad_a), -dot(a, grad_moment) - dot(z, grad_b)],
            depth: grad_depth * (all(T::one()) - along),
        }
    }

    /// Gradient with respect to the centre in camera axes, times its depth.
    #[inline(always)]
    pub fn towards<S: Simd>(&self, grad: &RayGrad<Lanes<T, S>>, slopes: [T; 2]) -> V3<Lanes<T, S>> {
        let all = |value: T| Lanes::splat(grad.depth.simd(), value);
        let z = Lanes::splat_three(grad.depth.simd(), self.z);
        grad.towards(z, all(self.depth), [all(slopes[0]), all(slopes[1])])
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
    let (rows, relative, _) = rows(camera, p);
    let grad_z = sub(grad.z, add(scale(grad.a, slopes[0]), scale(grad.b, slopes[1])));
    let grad_rows = [grad.a, grad.b, grad_z];
    let log_scales = std::array::from_fn(|j| dot(column(&rows, j), column(&grad_rows, j)));
    // rows = W R · relative scales
    let grad_axes = grad_rows.map(|row| times(row, relative));
    let grad_rotation: M3<T> =
        std::array::from_fn(|i| std::array::from_fn(|j| dot(column(&camera.rotation, i), column(&grad_axes, j))));
    let grad_centre = scale(grad.towards(whitened.z, whitened.depth, slopes), T::one() / whitened.depth);
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
    use pulp::Scalar;

    use super::*;
    use crate::camera::{Camera, CameraFromWorld};

    const P: Parameters<f64> = Parameters {
        position: [0.3, -0.2, 2.0],
        quaternion: [0.7, 0.3, -0.5, 0.2],
        log_scales: [-1.1, -2.0, -2.7],
        opacity: 0.8,
        degrees_of_freedom: f64::INFINITY,
    };

    fn camera<T: Real>() -> CameraOf<T> {
        let camera_from_world = CameraFromWorld {
            rotation: DMat3::from_rotation_y(0.2) * DMat3::from_rotation_x(-0.1),
            translation: DVec3::new(0.1, 0.05, 0.3),
        };
        let (fx, fy, cx, cy) = (60.0, 66.0, 31.0, 22.0);
        CameraOf::new(&Camera { camera_from_world, fx, fy, cx, cy, width: 64, height: 48, near: 0.2, lens: None })
    }

    /// α, 0 below the cutoff, and depth at an offset from the mean, px.
    fn fragment<T: Real>(whitened: &Whitened<T>, [dx, dy]: [T; 2]) -> [T; 2] {
        let (drawn, [weight, depth]) = whitened.fragments(Lanes::splat(Scalar::new(), dx), dy);
        [weight.only(drawn).sum(), depth.sum()]
    }

    #[test]
    fn boxes_are_filled() {
        let whitened = Whitened::new(&camera::<f64>(), &P, [0.0; 3]).unwrap();
        let PixelRect { x0, x1, y0, y1 } = whitened.reach();
        let pixels = (y0..y1).flat_map(|y| (x0..x1).map(move |x| [x, y].map(|at| f64::from(at) + 0.5)));
        let is_drawn = |[x, y]: &[f64; 2]| fragment(&whitened, [x - whitened.mean[0], y - whitened.mean[1]])[0] > 0.0;
        let drawn = pixels.filter(is_drawn).count() as u32;
        // an ellipse covers π / 4 of an axis-parallel box, one that is turned less
        assert!(drawn > 200 && 2 * drawn > (x1 - x0) * (y1 - y0), "{drawn}");
    }

    #[test]
    fn what_reaches_the_near_plane_does_not_exist() {
        let camera = camera::<f64>();
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
        let (single, exact) = (camera::<f32>(), camera::<f64>());
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
                let [weight, depth] = fragment(&found, offset.map(|at| at as f32)).map(f64::from);
                let [weight64, depth64] = fragment(&expected, offset);
                assert!((weight - weight64).abs() < 2e-3, "{log_scales:?} {offset:?}: {weight}");
                assert!(weight64 == 0.0 || (depth / depth64 - 1.0).abs() < 1e-4, "{log_scales:?}");
            }
        }
    }
}
