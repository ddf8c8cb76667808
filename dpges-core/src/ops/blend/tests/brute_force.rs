//! `blend` as its contract has it: at every pixel all primitives in order, every plane from its definition.

use crate::camera::Camera;
use crate::footprint::CUTOFF;
use crate::footprint::gaussian::cpu::{Parameters, Splat};
use crate::math::{CameraOf, M3, V3, apply, column, cross, dot, rotation, scale};
use crate::ops::blend::{ALL_PLANES, BlendOptions, DEPTH_PLANE, DISTORTION_PLANE, Form, NORMAL_PLANE, far};

/// The part of a primitive that decides α and z at a pixel.
#[derive(Clone, Copy)]
pub enum Shape {
    Ellipse(Splat<f64>),
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
            Self::Disc { rows, low_pass, opacity, near } => {
                let [u, v, z] = meet(rows, at).filter(|hit| hit[2] > *near)?;
                let squared = low_pass.map_or(f64::INFINITY, |centre| on_screen(centre, at)).min(u * u + v * v);
                (opacity * (-0.5 * squared).exp(), z)
            }
        };
        (alpha >= CUTOFF).then_some((alpha, z))
    }
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
        let shape = match form {
            Form::Ellipsoids => Shape::Ellipse(Splat::new(&of, p, colour, filter)?),
            Form::Discs => {
                let (rows, low_pass) = disc(&of, p);
                Shape::Disc { rows, low_pass, opacity: p.opacity, near: camera.near }
            }
        };
        let [s, t, r] = p.log_scales;
        let axis = match form {
            Form::Discs => 2,
            Form::Ellipsoids if s <= t && s <= r => 0,
            Form::Ellipsoids if t <= r => 1,
            Form::Ellipsoids => 2,
        };
        let normal = apply(&of.rotation, column(&rotation(p.quaternion), axis));
        let normal = if dot(normal, centre) > 0.0 { scale(normal, -1.0) } else { normal };
        (centre[2] > camera.near).then_some(Self { row, shape, centre_depth: centre[2], colour, normal })
    }
}

/// Front to back.
pub fn sort(primitives: &mut [Primitive]) {
    primitives.sort_by(|a, b| a.centre_depth.total_cmp(&b.centre_depth).then(a.row.cmp(&b.row)));
}

/// Blends sorted `primitives` at a point of the image.
pub fn pixel(primitives: &[Primitive], camera: &Camera, options: &BlendOptions, at: [f64; 2]) -> Pixel {
    let mapped = |z: f64| far(camera.near) / (far(camera.near) - camera.near) * (1.0 - camera.near / z);
    let mut out = Pixel::default();
    let mut blended: Vec<[f64; 2]> = Vec::new();
    let mut through = 1.0;
    for Primitive { shape, colour, normal, .. } in primitives {
        let Some((alpha, z)) = shape.fragment(at) else { continue };
        let alpha = alpha.min(options.max_alpha);
        let behind = through * (1.0 - alpha);
        if behind < options.min_transmittance {
            break;
        }
        let weight = alpha * through;
        for c in 0..3 {
            out.planes[c] += weight * colour[c];
            out.planes[NORMAL_PLANE + c] += weight * normal[c];
        }
        out.planes[DEPTH_PLANE] += weight * z;
        for [other, m] in &blended {
            out.planes[DISTORTION_PLANE] += weight * other * (mapped(z) - m).powi(2);
        }
        blended.push([weight, mapped(z)]);
        if through > 0.5 && behind <= 0.5 {
            out.median_depth = z;
        }
        through = behind;
    }
    out.planes[3] = 1.0 - through;
    out
}

/// Centre of pixel `i`, px.
pub fn centre_of(camera: &Camera, i: usize) -> [f64; 2] {
    [(i % camera.width) as f64 + 0.5, (i / camera.width) as f64 + 0.5]
}
