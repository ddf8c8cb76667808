//! A disc met by rays, with the low-pass filter of 2DGS (its sections 4.2 and 4.3); where a ray meets it and the way
//! back from there are those of [`footprint`](crate::footprint::surfel::cpu).

use pulp::Simd;

use super::projected::{CameraPair, Drawn, Group, Projected, Sums, add_depths, add_to_probe};
use crate::backend::lanes::Lanes;
use crate::backend::real::Real;
use crate::footprint::CUTOFF;
use crate::footprint::gaussian::cpu::{ParameterGrad, Parameters};
use crate::footprint::moments::{FIRST_MOMENTS, add_first_moments};
use crate::footprint::surfel::cpu as disc;
use crate::footprint::surfel::cpu::{Disc, DiscGrad, MIN_FACING, Plane};
use crate::math::{CameraOf, M3, V3, add, apply_transposed, column, dot, rotation_backward, scale};
use crate::tiles::{PixelRect, TileGrid};

/// The low-pass filter is centred in the box around the disc at this radius, in σ (2DGS).
const LOW_PASS_RADIUS: f64 = 3.0;
/// Stands for no low-pass filter: further away than any disc reaches, and finite, so that 0 times it is 0. px
const NOWHERE: f64 = 1e15;

/// Centre of the box around a disc at [`LOW_PASS_RADIUS`].
struct BoxCentre {
    /// x / z and y / z
    slopes: [f64; 2],
    /// Offset from the projected centre of the disc, in units of the slopes.
    offset: [f64; 2],
    determinant: f64,
}

impl BoxCentre {
    /// `None` if the disc reaches the camera's plane at that radius.
    fn new(disc: &Disc) -> Option<Self> {
        let [a, b] = scaled_axes(disc);
        let squared = LOW_PASS_RADIUS * LOW_PASS_RADIUS;
        let determinant = squared * (a[2] * a[2] + b[2] * b[2]) - disc.centre[2] * disc.centre[2];
        // from the projected centre, so that a small disc loses nothing to cancellation
        let offset = [0, 1].map(|i| {
            let slope = disc.anchor_ray[i];
            squared * ((a[i] - slope * a[2]) * a[2] + (b[i] - slope * b[2]) * b[2]) / determinant
        });
        let slopes = [0, 1].map(|i| disc.anchor_ray[i] + offset[i]);
        (determinant < 0.0).then_some(Self { slopes, offset, determinant })
    }

    /// Gradients with respect to the two scaled axes and the centre, camera axes, from that with respect to the slopes.
    fn backward(&self, disc: &Disc, grad_slopes: [f64; 2]) -> [V3<f64>; 3] {
        let [a, b] = scaled_axes(disc);
        let squared = LOW_PASS_RADIUS * LOW_PASS_RADIUS;
        let mut grads = [[0.0; 3]; 3];
        for (i, grad_slope) in grad_slopes.into_iter().enumerate() {
            let twice = 2.0 * self.slopes[i];
            let grad_numerator = grad_slope / self.determinant;
            for (grad, (vector, weight)) in grads.iter_mut().zip([(a, squared), (b, squared), (disc.centre, -1.0)]) {
                grad[i] += weight * vector[2] * grad_numerator;
                grad[2] += weight * (vector[i] - twice * vector[2]) * grad_numerator;
            }
        }
        grads
    }
}

fn scaled_axes(disc: &Disc) -> [V3<f64>; 2] {
    [0, 1].map(|j| scale(column(&disc.axes, j), disc.scales[j]))
}

fn disc_of<T: Real>(camera: &CameraOf<f64>, parameters: &Parameters<T>) -> Disc {
    let [scale_u, scale_v, _] = parameters.log_scales.map(T::as_f64);
    let surfel = disc::Parameters {
        position: parameters.position.map(T::as_f64),
        quaternion: parameters.quaternion.map(T::as_f64),
        log_scales: [scale_u, scale_v],
    };
    Disc::new(camera, &surfel)
}

fn union(a: PixelRect, b: PixelRect) -> PixelRect {
    match (a.is_empty(), b.is_empty()) {
        (true, _) => b,
        (_, true) => a,
        _ => PixelRect { x0: a.x0.min(b.x0), x1: a.x1.max(b.x1), y0: a.y0.min(b.y0), y1: a.y1.max(b.y1) },
    }
}

/// How one coordinate of the projected centre, in px, moves the linear functions of a [`Plane`].
#[derive(Clone, Copy, Debug)]
struct CentreSlopes<T> {
    /// Coefficients of u and of v: at the anchor, and slope per px along the other coordinate.
    u: [T; 2],
    v: [T; 2],
    distance: T,
}

impl<T: Real> CentreSlopes<T> {
    /// Depth of the centre held.
    fn along_axes(camera: &CameraOf<f64>, disc: &Disc) -> [Self; 2] {
        let [tangent_u, tangent_v, normal] = [0, 1, 2].map(|j| column(&disc.axes, j));
        let focals = [camera.fx, camera.fy];
        [(0, 1, 1.0), (1, 0, -1.0)].map(|(own, other, sign): (usize, usize, f64)| {
            let per_px = disc.centre[2] / focals[own];
            // components of ray × t_v and t_u × ray
            let linear = |tangent: V3<f64>, weight: f64| {
                let at_anchor = disc.anchor_ray[other] * tangent[2] - tangent[other];
                [at_anchor, tangent[2] / focals[other]].map(|value| T::of(value * weight * per_px))
            };
            Self {
                u: linear(tangent_v, sign / disc.scales[0]),
                v: linear(tangent_u, -sign / disc.scales[1]),
                distance: T::of(normal[own] * per_px),
            }
        })
    }

    /// Gradient with respect to the coordinate from those with respect to u, v and distance, `offset` px away from
    /// the anchor along the other coordinate.
    #[inline(always)]
    fn gradient<S: Simd>(
        &self,
        to_u: Lanes<T, S>,
        to_v: Lanes<T, S>,
        to_distance: Lanes<T, S>,
        offset: Lanes<T, S>,
    ) -> Lanes<T, S> {
        let all = |value: T| Lanes::splat(offset.simd(), value);
        let linear = |[at_anchor, slope]: [T; 2]| all(slope).mul_add(offset, all(at_anchor));
        to_u * linear(self.u) + to_v * linear(self.v) + to_distance * all(self.distance)
    }
}

/// A disc anchored at its projected centre.
#[derive(Clone, Copy, Debug)]
pub struct DiscFootprint<T> {
    plane: Plane<T>,
    /// Centre of the low-pass filter, px from the anchor.
    low_pass: [T; 2],
    strength: T,
    near: T,
    centre_depth: T,
    colour: V3<T>,
    reach: PixelRect,
    /// Along x and along y.
    centre_slopes: [CentreSlopes<T>; 2],
}

impl<T: Real> DiscFootprint<T> {
    /// 2 |d|², d in px from the centre of the low-pass filter.
    #[inline(always)]
    fn squared_on_screen<S: Simd>(&self, dx: Lanes<T, S>, dy: T) -> Lanes<T, S> {
        let all = |value: T| Lanes::splat(dx.simd(), value);
        let (x, y) = (dx - all(self.low_pass[0]), dy - self.low_pass[1]);
        all(T::of(2.0)) * x.mul_add(x, all(y * y))
    }
}

impl<T: Real> Projected<T> for DiscFootprint<T> {
    /// Gradient of the exponent, moments of the gradients of the plane's u, v and facing, offsets of the low-pass
    /// filter weighted by the gradient of the exponent.
    const SUMS: usize = 12;

    fn new(view: &CameraPair<T>, parameters: &Parameters<T>, colour: V3<T>) -> Option<Self> {
        let camera = &view.exact;
        let disc = disc_of(camera, parameters);
        let opacity = parameters.opacity.as_f64();
        let visible = disc.centre[2] > camera.near && opacity > CUTOFF;
        visible.then(|| {
            // rounding must not cut off a pixel that reaches the cutoff
            let squared_radius = 2.0 * (opacity / CUTOFF).ln() * (1.0 + 1e-5);
            let mut reach = disc.reach(camera, squared_radius);
            let low_pass = BoxCentre::new(&disc).map_or([NOWHERE; 2], |centre| {
                let offset = [camera.fx * centre.offset[0], camera.fy * centre.offset[1]];
                let (x, y) = (disc.plane.anchor[0] + offset[0], disc.plane.anchor[1] + offset[1]);
                // ρ = 2 |d|², so that a distance in px counts twice
                let radius = (0.5 * squared_radius).sqrt();
                let bounds = [x - radius, x + radius, y - radius, y + radius];
                reach = union(reach, PixelRect::covering(bounds, camera.width, camera.height));
                offset
            });
            Self {
                plane: disc.plane.cast(),
                low_pass: low_pass.map(T::of),
                strength: parameters.opacity,
                near: view.camera.near,
                centre_depth: T::of(disc.centre[2]),
                colour,
                reach,
                centre_slopes: CentreSlopes::along_axes(camera, &disc),
            }
        })
    }

    fn normal_axis(_: &Parameters<T>) -> usize {
        2
    }

    #[inline(always)]
    fn colour(&self) -> V3<T> {
        self.colour
    }

    fn centre_depth(&self) -> T {
        self.centre_depth
    }

    #[inline(always)]
    fn anchor(&self) -> [T; 2] {
        self.plane.anchor
    }

    fn reach(&self, _: TileGrid) -> PixelRect {
        self.reach
    }

    #[inline(always)]
    fn draw<S: Simd>(&self, dx: Lanes<T, S>, dy: T) -> Option<Drawn<T, S>> {
        let all = |value: f64| Lanes::splat(dx.simd(), T::of(value));
        let [u, v, z, facing] = self.plane.meet(dx, dy);
        let (on_disc, on_screen) = (u.mul_add(u, v * v), self.squared_on_screen(dx, dy));
        let squared = Lanes::select(on_screen.below(on_disc), on_screen, on_disc);
        let weight = Lanes::splat(dx.simd(), self.strength) * (all(-0.5) * squared).exp_nonpositive();
        // edge-on z is infinite or NaN; 0 is before the near plane, and not drawn
        let depth = z.only(all(MIN_FACING).below(facing.abs()));
        let drawn = weight.at_least(all(CUTOFF)) & Lanes::splat(dx.simd(), self.near).below(depth);
        Drawn::new(drawn, weight, depth)
    }

    #[inline(always)]
    fn gather<S: Simd, const MAPS: bool>(&self, group: &Group<T, S>, sums: &mut Sums<Lanes<T, S>>) {
        let (dx, dy, power, blended) = (group.dx, group.dy, group.power, group.blended);
        let all = |value: T| Lanes::splat(dx.simd(), value);
        let [u, v, _, facing] = self.plane.meet(dx, dy);
        // the comparison of `draw` the other way round: the gradient goes to the term that was drawn
        let by_disc = blended & self.squared_on_screen(dx, dy).at_least(u.mul_add(u, v * v));
        // what is not blended may be infinite
        let inverse = (all(T::one()) / facing).only(blended);
        let (u, v, on_disc) = (u.only(by_disc), v.only(by_disc), power.only(by_disc));
        let (mut grad_facing, mut to_distance) = (on_disc * u.mul_add(u, v * v), all(T::zero()));
        if MAPS {
            grad_facing = grad_facing - group.grad_depth * group.depth;
            to_distance = group.grad_depth * inverse;
        }
        let to_facing = grad_facing * inverse;
        let (to_u, to_v) = (-(on_disc * u * inverse), -(on_disc * v * inverse));
        let on_screen = power - on_disc;
        let [sum, moments @ .., screen_x, screen_y] = &mut *sums.footprint else {
            unreachable!("twelve sums");
        };
        *sum = *sum + power;
        for (moments, values) in moments.chunks_exact_mut(FIRST_MOMENTS).zip([to_u, to_v, to_facing]) {
            add_first_moments(moments, values, dx, all(dy));
        }
        *screen_x = on_screen.mul_add(dx - all(self.low_pass[0]), *screen_x);
        *screen_y = on_screen.mul_add(all(dy - self.low_pass[1]), *screen_y);
        if !sums.probe.is_empty() {
            let distance = to_distance.only(by_disc);
            let [slopes_x, slopes_y] = &self.centre_slopes;
            let grad_x = slopes_x.gradient(to_u, to_v, distance, all(dy));
            add_to_probe(sums.probe, grad_x, slopes_y.gradient(to_u, to_v, distance, dx));
        }
        if MAPS {
            add_depths(sums.maps, to_distance);
        }
    }

    fn backward(&self, view: &CameraPair<T>, parameters: &Parameters<T>, sums: &Sums<T>) -> ParameterGrad<T> {
        let camera = &view.exact;
        let disc = disc_of(camera, parameters);
        let quaternion = parameters.quaternion.map(T::as_f64);
        // in f64 from here on, since an edge-on disc magnifies rounding errors
        let sum: [f64; 12] = std::array::from_fn(|i| sums.footprint[i].as_f64());
        let linear = |first: usize, unit: f64| {
            [sum[first] / unit, sum[first + 1] / (camera.fx * unit), sum[first + 2] / (camera.fy * unit)]
        };
        // u and v fall as their scales rise: ∂u / ∂ ln s = −u
        let shrinking = |function: V3<f64>, first: usize| -dot(function, [sum[first], sum[first + 1], sum[first + 2]]);
        let grad = DiscGrad {
            u: linear(1, disc.scales[0]),
            v: linear(4, disc.scales[1]),
            facing: linear(7, 1.0),
            distance: sums.maps.last().map_or(0.0, |sum| sum.as_f64()),
            log_scales: [shrinking(disc.plane.u, 1), shrinking(disc.plane.v, 4)],
        };
        let (mut position, mut turn, mut log_scales) = disc.backward(camera, quaternion, &grad);
        if let Some(centre) = BoxCentre::new(&disc) {
            let grad_slopes = [2.0 * camera.fx * sum[10], 2.0 * camera.fy * sum[11]];
            let [grad_a, grad_b, grad_centre] = centre.backward(&disc, grad_slopes);
            let mut grad_rotation: M3<f64> = [[0.0; 3]; 3];
            for (j, (grad, axis)) in [grad_a, grad_b].into_iter().zip(scaled_axes(&disc)).enumerate() {
                log_scales[j] += dot(grad, axis);
                let grad = scale(apply_transposed(&camera.rotation, grad), disc.scales[j]);
                for (row, value) in grad_rotation.iter_mut().zip(grad) {
                    row[j] = value;
                }
            }
            position = add(position, apply_transposed(&camera.rotation, grad_centre));
            for (sum, value) in turn.iter_mut().zip(rotation_backward(quaternion, &grad_rotation)) {
                *sum += value;
            }
        }
        ParameterGrad {
            position: position.map(T::of),
            quaternion: turn.map(T::of),
            log_scales: [T::of(log_scales[0]), T::of(log_scales[1]), T::zero()],
            opacity: sums.footprint[0] / self.strength,
            degrees_of_freedom: T::zero(),
        }
    }
}
