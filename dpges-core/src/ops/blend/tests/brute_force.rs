//! `blend` as its contract has it: at every pixel all primitives in order, every plane from its definition.

use crate::camera::Camera;
use crate::footprint::CUTOFF;
use crate::footprint::gaussian::cpu::{Parameters, Splat};
use crate::math::{CameraOf, M3, V3, apply, column, cross, dot, rotation, scale};
use crate::ops::blend::{
    ALL_PLANES, BlendOptions, CORE, CORE_ALPHA, DEPTH_PLANE, DISTORTION_PLANE, Form, NORMAL_PLANE, far,
};
use crate::scene::{BlendOrder, ScreenFilter, Transparency};

/// The part of a primitive that decides α and z at a pixel.
#[derive(Clone, Copy)]
pub enum Shape {
    Ellipse(Splat<f64>),
    Student {
        /// With the absolute value of the opacity.
        splat: Splat<f64>,
        opacity: f64,
        degrees: f64,
        bound: f64,
    },
    /// Met by rays in the frame in which it is a sphere.
    Whitened {
        /// From camera axes to standard deviations.
        whitening: M3<f64>,
        centre: V3<f64>,
        opacity: f64,
        /// fx, fy, cx, cy
        intrinsics: [f64; 4],
    },
    Disc {
        /// T_u, T_v, T_w of 2DGS: from (u, v, 1) to (x z, y z, z), px.
        rows: M3<f64>,
        /// Centre of the low-pass filter, px.
        low_pass: Option<[f64; 2]>,
        opacity: f64,
        near: f64,
    },
}

#[derive(Clone, Copy)]
pub struct Primitive {
    /// Row of its parameters.
    pub row: usize,
    pub shape: Shape,
    centre_depth: f64,
    /// In camera axes, as its inverse covariance is.
    centre: V3<f64>,
    inverse_covariance: M3<f64>,
    colour: V3<f64>,
    normal: V3<f64>,
}

/// One pixel: its planes and median depth.
#[derive(Clone, Copy, Default)]
pub struct Pixel {
    pub planes: [f64; ALL_PLANES],
    pub median_depth: f64,
}

/// u, v and depth of the hit at a pixel (2DGS, equation 8).
fn meet(rows: &M3<f64>, [x, y]: [f64; 2]) -> Option<V3<f64>> {
    let along = |row: V3<f64>, at: f64| -> V3<f64> { std::array::from_fn(|i| at * rows[2][i] - row[i]) };
    let hit = cross(along(rows[0], x), along(rows[1], y));
    let (u, v) = (hit[0] / hit[2], hit[1] / hit[2]);
    (hit[2] != 0.0).then(|| [u, v, dot(rows[2], [u, v, 1.0])])
}

impl Shape {
    /// Whether the low-pass filter decides α at a pixel.
    pub fn is_filtered(&self, at: [f64; 2]) -> bool {
        match self {
            Self::Disc { rows, low_pass: Some(centre), .. } => {
                meet(rows, at).is_some_and(|[u, v, _]| on_screen(*centre, at) < u * u + v * v)
            }
            _ => false,
        }
    }

    /// α before it is capped and z.
    fn fragment(&self, at: [f64; 2]) -> Option<(f64, f64)> {
        let (alpha, z) = match self {
            Self::Ellipse(splat) => (
                {
                    let [u, v] = splat.in_deviations(at[0] - splat.mean[0], at[1] - splat.mean[1]);
                    splat.weight(u, v)
                },
                splat.depth,
            ),
            Self::Student { splat, opacity, degrees, bound } => {
                let [dx, dy] = [at[0] - splat.mean[0], at[1] - splat.mean[1]];
                let [u, v] = splat.in_deviations(dx, dy);
                let kernel = (1.0 + (u * u + v * v) / degrees).powf(-0.5 * (degrees + 2.0));
                let inside = dx.abs() <= *bound && dy.abs() <= *bound;
                (if inside { opacity * kernel } else { 0.0 }, splat.depth)
            }
            Self::Whitened { whitening, centre, opacity, intrinsics: [fx, fy, cx, cy] } => {
                let ray = apply(whitening, [(at[0] - cx) / fx, (at[1] - cy) / fy, 1.0]);
                let centre = apply(whitening, *centre);
                let z = dot(ray, centre) / dot(ray, ray);
                let offset: V3<f64> = std::array::from_fn(|i| z * ray[i] - centre[i]);
                (opacity * (-0.5 * dot(offset, offset)).exp(), z)
            }
            Self::Disc { rows, low_pass, opacity, near } => {
                let [u, v, z] = meet(rows, at).filter(|hit| hit[2] > *near)?;
                let squared = low_pass.map_or(f64::INFINITY, |centre| on_screen(centre, at)).min(u * u + v * v);
                (opacity * (-0.5 * squared).exp(), z)
            }
        };
        (alpha.abs() >= CUTOFF).then_some((alpha, z))
    }
}

/// Half side of the square in which a student is drawn, px, from the root p, q, r of its inverse covariance.
fn bound([p, q, r]: V3<f64>, degrees: f64) -> f64 {
    let (x, y, xy) = ((1.0 + (q / r).powi(2)) / (p * p), 1.0 / (r * r), -q / (p * r * r));
    let mid = 0.5 * (x + y);
    let deviation = (mid + (mid * mid - (x * y - xy * xy)).max(0.1).sqrt()).sqrt();
    let quantiles = [63.657, 9.925, 5.841, 4.604, 4.032, 3.707, 3.499, 3.355, 3.25, 3.169, 3.106, 3.055, 3.012];
    let whole = degrees.floor() as usize;
    let reach = if whole < 13 {
        let (own, next) = (quantiles[whole - 1], quantiles[whole]);
        next + (own - next) * degrees.fract()
    } else {
        3.0
    };
    (reach * deviation).ceil()
}

/// ρ of the low-pass filter.
fn on_screen(centre: [f64; 2], at: [f64; 2]) -> f64 {
    2.0 * ((centre[0] - at[0]).powi(2) + (centre[1] - at[1]).powi(2))
}

/// T_u, T_v, T_w and the centre of the box at 3 σ.
fn disc(camera: &CameraOf<f64>, p: &Parameters<f64>) -> (M3<f64>, Option<[f64; 2]>) {
    let world = rotation(p.quaternion);
    let [a, b] = [0, 1].map(|j| scale(apply(&camera.rotation, column(&world, j)), p.log_scales[j].exp()));
    let centre = camera.transform(p.position);
    let view: M3<f64> = std::array::from_fn(|i| [a[i], b[i], centre[i]]);
    let rows: M3<f64> = [
        std::array::from_fn(|i| camera.fx * view[0][i] + camera.cx * view[2][i]),
        std::array::from_fn(|i| camera.fy * view[1][i] + camera.cy * view[2][i]),
        view[2],
    ];
    let weighted = |row: V3<f64>| 9.0 * row[0] * rows[2][0] + 9.0 * row[1] * rows[2][1] - row[2] * rows[2][2];
    let determinant = weighted(rows[2]);
    let low_pass = [weighted(rows[0]) / determinant, weighted(rows[1]) / determinant];
    (rows, (determinant < 0.0).then_some(low_pass))
}

impl Primitive {
    pub fn new(
        camera: &Camera,
        options: &BlendOptions,
        row: usize,
        p: &Parameters<f64>,
        colour: V3<f64>,
    ) -> Option<Self> {
        let BlendOptions { form, filter, .. } = *options;
        let of = CameraOf::<f64>::new(camera);
        let centre = of.transform(p.position);
        let axes: M3<f64> = std::array::from_fn(|d| apply(&of.rotation, column(&rotation(p.quaternion), d)));
        let shape = match form {
            Form::Ellipsoids => Shape::Ellipse(Splat::new(&of, p, colour, filter)?),
            Form::Discs => {
                let (rows, low_pass) = disc(&of, p);
                Shape::Disc { rows, low_pass, opacity: p.opacity, near: camera.near }
            }
            Form::Students => {
                let magnitude = Parameters { opacity: p.opacity.abs(), ..*p };
                let splat = Splat::new(&of, &magnitude, colour, ScreenFilter::Off)?;
                let bound = bound(splat.root, p.degrees_of_freedom);
                Shape::Student { splat, opacity: p.opacity, degrees: p.degrees_of_freedom, bound }
            }
            Form::Whitened => {
                let radius = (2.0 * (p.opacity / CUTOFF).ln()).max(0.0).sqrt();
                let ahead = (0..3).map(|d| (axes[d][2] * p.log_scales[d].exp()).powi(2)).sum::<f64>().sqrt();
                if p.opacity < CUTOFF || centre[2] - radius * ahead <= camera.near {
                    return None;
                }
                let whitening = std::array::from_fn(|d| scale(axes[d], (-p.log_scales[d]).exp()));
                let intrinsics = [camera.fx, camera.fy, camera.cx, camera.cy];
                Shape::Whitened { whitening, centre, opacity: p.opacity, intrinsics }
            }
        };
        let [s, t, r] = p.log_scales;
        let axis = match form {
            Form::Discs => 2,
            _ if s <= t && s <= r => 0,
            _ if t <= r => 1,
            _ => 2,
        };
        let normal = if dot(axes[axis], centre) > 0.0 { scale(axes[axis], -1.0) } else { axes[axis] };
        let precision = p.log_scales.map(|scale| scale.exp().max(1e-3).powi(-2));
        let inverse_covariance = std::array::from_fn(|i| {
            std::array::from_fn(|j| (0..3).map(|d| axes[d][i] * precision[d] * axes[d][j]).sum())
        });
        (centre[2] > camera.near).then_some(Self {
            row,
            shape,
            centre_depth: centre[2],
            centre,
            inverse_covariance,
            colour,
            normal,
        })
    }

    /// t* of StopThePop.
    fn depth_along_ray(&self, camera: &Camera, at: [f64; 2]) -> f64 {
        let ray = camera.ray(at[0], at[1]).expect("it is shown").normalize().to_array();
        let towards = apply(&self.inverse_covariance, ray);
        dot(towards, self.centre) / dot(towards, ray).max(1e-5)
    }
}

/// Front to back.
pub fn sort(primitives: &mut [Primitive]) {
    primitives.sort_by(|a, b| a.centre_depth.total_cmp(&b.centre_depth).then(a.row.cmp(&b.row)));
}

/// Primitives that are met in front of the camera, exactly in the order along the ray.
fn by_ray(primitives: &[Primitive], camera: &Camera, at: [f64; 2]) -> Vec<Primitive> {
    let met = primitives.iter().map(|primitive| (primitive.depth_along_ray(camera, at), *primitive));
    let mut met: Vec<(f64, Primitive)> = met.filter(|(depth, _)| *depth >= 0.0).collect();
    met.sort_by(|(a, _), (b, _)| a.total_cmp(b));
    met.into_iter().map(|(_, primitive)| primitive).collect()
}

/// w of every fragment of a pixel, of α and z each, in order, up to where it ends; and its median depth.
fn sorted_weights(fragments: &[[f64; 2]], options: &BlendOptions) -> (Vec<f64>, f64) {
    let (mut weights, mut median_depth, mut through) = (Vec::new(), 0.0, 1.0);
    for [alpha, z] in fragments {
        let behind = through * (1.0 - alpha);
        let ends = behind < options.min_transmittance;
        if ends && options.form != Form::Whitened {
            break;
        }
        weights.push(alpha * through);
        if median_depth == 0.0 && behind <= 0.5 {
            median_depth = *z;
        }
        through = behind;
        if ends {
            break;
        }
    }
    (weights, median_depth)
}

/// w of every fragment of a pixel, of α and z each (HTGS).
fn hybrid_weights(fragments: &[[f64; 2]], transparency: Transparency, options: &BlendOptions) -> Vec<f64> {
    let mut order: Vec<usize> = (0..fragments.len()).filter(|&i| fragments[i][0] >= CORE_ALPHA).collect();
    order.sort_by(|&i, &j| fragments[i][1].total_cmp(&fragments[j][1]));
    order.truncate(if transparency == Transparency::Tail { 0 } else { CORE });
    let (mut weights, mut through, mut open) = (vec![0.0; fragments.len()], 1.0, true);
    for &i in &order {
        if open {
            weights[i] = fragments[i][0] * through;
            through *= 1.0 - fragments[i][0];
            open = through >= options.min_transmittance;
        }
    }
    if open && transparency != Transparency::Nearest {
        let tail: Vec<usize> = (0..fragments.len()).filter(|i| !order.contains(i)).collect();
        let sum: f64 = tail.iter().map(|&i| fragments[i][0]).sum();
        let hidden: f64 = 1.0 - tail.iter().map(|&i| 1.0 - fragments[i][0]).product::<f64>();
        tail.iter().for_each(|&i| weights[i] = through * hidden * fragments[i][0] / sum);
    }
    weights
}

/// Blends sorted `primitives` at a point of the image; in the order of rays as if queues had no end. There is no median depth of
/// a [`Transparency`] other than [`Transparency::Sorted`].
pub fn pixel(primitives: &[Primitive], camera: &Camera, options: &BlendOptions, at: [f64; 2]) -> Pixel {
    let mapped = |z: f64| far(camera.near) / (far(camera.near) - camera.near) * (1.0 - camera.near / z);
    let resorted = (options.order == BlendOrder::Rays).then(|| by_ray(primitives, camera, at));
    let primitives = resorted.as_deref().unwrap_or(primitives);
    let seen = primitives.iter().filter_map(|primitive| Some((primitive, primitive.shape.fragment(at)?)));
    let (seen, fragments): (Vec<&Primitive>, Vec<[f64; 2]>) = seen
        .map(|(primitive, (alpha, z))| (primitive, [alpha.clamp(-options.max_alpha, options.max_alpha), z]))
        .unzip();
    let (weights, median_depth) = match options.order.transparency() {
        None | Some(Transparency::Sorted) => sorted_weights(&fragments, options),
        Some(transparency) => (hybrid_weights(&fragments, transparency, options), 0.0),
    };
    let mut out = Pixel { median_depth, ..Pixel::default() };
    for (i, &weight) in weights.iter().enumerate() {
        for c in 0..3 {
            out.planes[c] += weight * seen[i].colour[c];
            out.planes[NORMAL_PLANE + c] += weight * seen[i].normal[c];
        }
        out.planes[3] += weight;
        out.planes[DEPTH_PLANE] += weight * fragments[i][1];
        for j in 0..i {
            let apart = mapped(fragments[i][1]) - mapped(fragments[j][1]);
            out.planes[DISTORTION_PLANE] += weight * weights[j] * apart.powi(2);
        }
    }
    out
}

/// Centre of pixel `i`, px.
pub fn centre_of(camera: &Camera, i: usize) -> [f64; 2] {
    [(i % camera.width) as f64 + 0.5, (i / camera.width) as f64 + 0.5]
}
