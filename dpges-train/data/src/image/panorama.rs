//! Panoramas: equirectangular pictures of all directions, cut into the pinhole pictures of the faces of a cube, and made of them.
//!
//! The direction (x, y, z), in OpenCV axes, appears at `((½ + λ / 2π) width, (½ + φ / π) height)` with λ = atan2(x, z) and
//! φ = atan2(y, √(x² + z²)): forward is the middle, right is a quarter of the width further right, up is the upper border (COLMAP's
//! `EQUIRECTANGULAR`; nerfstudio, OpenSfM and Metashape agree). Faces reach past the edges of the cube, so that neighbours overlap.

use std::f64::consts::{PI, TAU};
use std::iter::zip;

use dpges_core::camera::{Camera, CameraFromWorld};
use glam::{DMat3, DVec2, DVec3};
use rayon::prelude::*;

use crate::{DepthKind, Picture};

/// Tangent of half the field of view of a face: of 47.5°.
const REACH: f64 = 1.091_308_501_069_271;
/// Tangent of the angle from the axis of a face, of 42.5°, up to which none of its neighbours reaches.
const ALONE: f64 = 0.916_331_174_017_423_4;
/// Samples along a side of a pixel that is averaged over, at most. Pixels that cover more lie beside the poles, where they cover many
/// columns of nearly the same direction.
const MOST_SAMPLES: usize = 16;

/// A side of the cube around a panorama.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Face {
    Front,
    Right,
    Back,
    Left,
    Up,
    Down,
}

impl Face {
    pub const ALL: [Self; 6] = [Self::Front, Self::Right, Self::Back, Self::Left, Self::Up, Self::Down];

    /// Ending that it adds to the name of the photograph, before the extension.
    fn ending(self) -> &'static str {
        match self {
            Self::Front => "_front",
            Self::Right => "_right",
            Self::Back => "_back",
            Self::Left => "_left",
            Self::Up => "_up",
            Self::Down => "_down",
        }
    }

    /// The name of the view of this face of the `photograph`: `a/b_front.jpg` of `a/b.jpg`.
    pub fn name_in(self, photograph: &str) -> String {
        let folders = photograph.rfind('/').map_or(0, |slash| slash + 1);
        let dot = photograph[folders..].rfind('.').map_or(photograph.len(), |dot| folders + dot);
        let (stem, extension) = photograph.split_at(dot);
        format!("{stem}{}{extension}", self.ending())
    }

    /// The name of the photograph of which a view of this face has the name `view`.
    pub fn photograph_of(self, view: &str) -> String {
        match view.rfind(self.ending()) {
            Some(at) => [&view[..at], &view[at + self.ending().len()..]].concat(),
            None => view.to_owned(),
        }
    }

    /// From axes of the panorama to those of the face.
    fn rotation(self) -> DMat3 {
        let (x, y, z) = (DVec3::X, DVec3::Y, DVec3::Z);
        let [right, down, forward] = match self {
            Self::Front => [x, y, z],
            Self::Right => [-z, y, x],
            Self::Back => [-x, y, -z],
            Self::Left => [z, y, -x],
            Self::Up => [x, z, -y],
            Self::Down => [x, -z, y],
        };
        DMat3::from_cols(right, down, forward).transpose()
    }

    /// The pinhole camera of this face of a panorama of `width` px with a pose, which has at least as many pixels per radian as the
    /// panorama everywhere, and as many in its middle.
    pub fn camera(self, pose: &CameraFromWorld, width: usize, near: f64) -> Camera {
        let side = ((REACH * width as f64 / PI).round() as usize).max(1);
        let turned = CameraFromWorld {
            rotation: self.rotation() * pose.rotation,
            translation: self.rotation() * pose.translation,
        };
        Camera::pinhole(turned, 0.5 * side as f64 / REACH, [side; 2], near)
    }

    /// Direction in axes of the panorama at a position on the face, of its side.
    fn direction(self, at: DVec2) -> DVec3 {
        let [x, y] = [at.x, at.y].map(|position| REACH * (2.0 * position - 1.0));
        self.rotation().transpose() * DVec3::new(x, y, 1.0)
    }
}

/// Position on a panorama, of its width and height, of a direction in its axes.
pub(crate) fn position(direction: DVec3) -> DVec2 {
    let DVec3 { x, y, z } = direction;
    DVec2::new(0.5 + x.atan2(z) / TAU, 0.5 + y.atan2(x.hypot(z)) / PI)
}

/// The unit vector in axes of a panorama at a position, of its width and height.
pub(crate) fn direction(at: DVec2) -> DVec3 {
    let ((sin_across, cos_across), (sin, cos)) = ((TAU * (at.x - 0.5)).sin_cos(), (PI * (at.y - 0.5)).sin_cos());
    DVec3::new(cos * sin_across, sin, cos * cos_across)
}

/// Positions, of the size of a picture, of samples evenly spread over a pixel: more where it covers more than one pixel of a source
/// of size `of`, in which `source` says where a position lies.
fn samples(
    pixel: [usize; 2],
    size: [usize; 2],
    of: [usize; 2],
    source: impl Fn(DVec2) -> DVec2,
) -> impl Iterator<Item = DVec2> {
    let scale = DVec2::new(size[0] as f64, size[1] as f64).recip();
    let corner = DVec2::new(pixel[0] as f64, pixel[1] as f64);
    let middle = source((corner + 0.5) * scale);
    let covered = [DVec2::new(1.0, 0.5), DVec2::new(0.5, 1.0)].map(|side| {
        let mut half = source((corner + side) * scale) - middle;
        // a panorama has no border to the left and right
        half.x -= half.x.round();
        2.0 * (half * DVec2::new(of[0] as f64, of[1] as f64)).abs().max_element()
    });
    let count = (covered[0].max(covered[1]) - 0.01).ceil().clamp(1.0, MOST_SAMPLES as f64) as usize;
    (0..count * count).map(move |at| {
        let within = DVec2::new((at % count) as f64 + 0.5, (at / count) as f64 + 0.5) / count as f64;
        (corner + within) * scale
    })
}

/// The four pixels around a position, of the size of a picture, and their weights. A picture that `wraps` has its first column to the
/// right of the last.
fn around(at: DVec2, [width, height]: [usize; 2], wraps: bool) -> [(usize, f32); 4] {
    let (x, y) = (at.x * width as f64 - 0.5, at.y * height as f64 - 0.5);
    let column = |x: f64| match wraps {
        true => x.rem_euclid(width as f64) as usize % width,
        false => x.clamp(0.0, (width - 1) as f64) as usize,
    };
    let row = |y: f64| y.clamp(0.0, (height - 1) as f64) as usize;
    let ([left, right], [top, bottom]) =
        ([0.0, 1.0].map(|next| column(x.floor() + next)), [0.0, 1.0].map(|next| row(y.floor() + next)));
    let (wx, wy) = ((x - x.floor()) as f32, (y - y.floor()) as f32);
    [
        (top * width + left, (1.0 - wx) * (1.0 - wy)),
        (top * width + right, wx * (1.0 - wy)),
        (bottom * width + left, (1.0 - wx) * wy),
        (bottom * width + right, wx * wy),
    ]
}

/// A face of a `panorama` as a picture of `side` px: the mean, in display-referred values, over what each pixel covers. A pixel counts
/// if all that it is made of do.
pub(super) fn cut(panorama: &Picture, face: Face, side: usize) -> Picture {
    let (size, of) = ([side; 2], [panorama.width, panorama.height]);
    let source = |at: DVec2| position(face.direction(at));
    let mut bytes = Vec::with_capacity(3 * side * side);
    let mut alpha = panorama.alpha.as_ref().map(|_| Vec::with_capacity(side * side));
    let mut counted = panorama.counted.as_ref().map(|_| Vec::with_capacity(side * side));
    for pixel in 0..side * side {
        let (mut sum, mut taken, mut counts) = ([0f32; 4], 0.0, true);
        for at in samples([pixel % side, pixel / side], size, of, source) {
            for (index, weight) in around(source(at), of, true).into_iter().filter(|&(_, weight)| weight > 0.0) {
                (0..3).for_each(|channel| sum[channel] += weight * f32::from(panorama.bytes[3 * index + channel]));
                sum[3] += weight * panorama.alpha.as_ref().map_or(0.0, |alpha| f32::from(alpha[index]));
                counts &= panorama.counts(index);
            }
            taken += 1.0;
        }
        let [red, green, blue, coverage] = sum.map(|sum| (sum / taken).round() as u8);
        bytes.extend([red, green, blue]);
        alpha.iter_mut().for_each(|alpha| alpha.push(coverage));
        counted.iter_mut().for_each(|counted| counted.push(counts));
    }
    Picture { width: side, height: side, bytes, alpha, counted }
}

/// [side × side] of a face the nearest of the `steps` [rows × columns] of the depth map of a panorama. Metric depths, distances from
/// the centre, become camera-space z.
pub(super) fn cut_depth(
    steps: &[u16],
    [columns, rows]: [usize; 2],
    kind: DepthKind,
    face: Face,
    side: usize,
) -> Vec<u16> {
    let of = |pixel: usize| {
        let at = DVec2::new((pixel % side) as f64 + 0.5, (pixel / side) as f64 + 0.5) / side as f64;
        let direction = face.direction(at);
        let on_map = position(direction);
        let [column, row] =
            [(on_map.x, columns), (on_map.y, rows)].map(|(at, count)| ((at * count as f64) as usize).min(count - 1));
        match steps[row * columns + column] {
            steps if steps == 0 || kind == DepthKind::Relative => steps,
            steps => ((f64::from(steps) / direction.length()).round() as u16).max(1),
        }
    };
    (0..side * side).map(of).collect()
}

/// Position and weight of a direction on each of the faces; the sum of the weights is 1. Across an overlap they pass from one face to
/// the other, so that no seam is seen where these differ.
fn on_faces(direction: DVec3) -> [(DVec2, f64); 6] {
    let mut found = Face::ALL.map(|face| {
        let DVec3 { x, y, z } = face.rotation() * direction;
        let at = DVec2::new(x, y) / z;
        let inside = if z > 0.0 { (REACH - at.abs().max_element()) / (REACH - ALONE) } else { 0.0 };
        (0.5 + 0.5 * at / REACH, inside.clamp(0.0, 1.0))
    });
    let sum: f64 = found.iter().map(|(_, weight)| weight).sum();
    found.iter_mut().for_each(|(_, weight)| *weight /= sum);
    found
}

/// A panorama of `size` of faces with `side` px in the order of [`Face::ALL`], of which `value` says what a pixel has: the mean over
/// what each of its pixels covers, [height × width].
pub fn stitched(size: [usize; 2], side: usize, value: impl Fn(usize, usize) -> [f32; 4] + Sync) -> Vec<[f32; 4]> {
    let of = |pixel: usize| {
        let (mut sum, mut taken) = ([0f32; 4], 0.0);
        let at = [pixel % size[0], pixel / size[0]];
        let middle =
            direction(DVec2::new(at[0] as f64 + 0.5, at[1] as f64 + 0.5) / DVec2::new(size[0] as f64, size[1] as f64));
        let nearest = nearest_face(middle);
        let source = |at: DVec2| on_faces(direction(at))[nearest].0;
        for at in samples(at, size, [side; 2], source) {
            for (face, (at, weight)) in
                on_faces(direction(at)).into_iter().enumerate().filter(|(_, (_, weight))| *weight > 0.0)
            {
                for (index, share) in around(at, [side; 2], false) {
                    zip(&mut sum, value(face, index)).for_each(|(sum, value)| *sum += weight as f32 * share * value);
                }
            }
            taken += 1.0;
        }
        sum.map(|sum| sum / taken)
    };
    (0..size[0] * size[1]).into_par_iter().map(of).collect()
}

/// [height × width] of a panorama of `size` the distances from its centre, of depths, camera-space z, of faces with `side` px in the
/// order of [`Face::ALL`]; 0 where that is 0.
pub fn stitched_depth(size: [usize; 2], side: usize, depth: impl Fn(usize, usize) -> f32 + Sync) -> Vec<f32> {
    let of = |pixel: usize| {
        let at = DVec2::new((pixel % size[0]) as f64 + 0.5, (pixel / size[0]) as f64 + 0.5);
        let direction = direction(at / DVec2::new(size[0] as f64, size[1] as f64));
        let face = nearest_face(direction);
        let [column, row] =
            on_faces(direction)[face].0.to_array().map(|at| ((at * side as f64) as usize).min(side - 1));
        let z = (Face::ALL[face].rotation() * direction).z;
        depth(face, row * side + column) / z as f32
    };
    (0..size[0] * size[1]).into_par_iter().map(of).collect()
}

/// Number of the face that a direction passes nearest to its middle.
fn nearest_face(direction: DVec3) -> usize {
    let ahead = Face::ALL.map(|face| (face.rotation() * direction).z);
    (0..6).fold(0, |best, face| if ahead[face] > ahead[best] { face } else { best })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures::psnr;
    use crate::{builtin_geometry, builtin_panorama, builtin_photograph};

    fn pose() -> CameraFromWorld {
        CameraFromWorld::look_at(DVec3::new(1.4, -1.1, 1.2), DVec3::new(0.0, 0.0, 0.3), DVec3::Z)
    }

    #[test]
    fn directions_are_where_nerfstudio_and_colmap_have_them() {
        let places = [
            (DVec3::Z, [0.5, 0.5]),
            (DVec3::X, [0.75, 0.5]),
            (-DVec3::X, [0.25, 0.5]),
            (DVec3::new(-1e-9, 0.0, -1.0), [0.0, 0.5]),
            (DVec3::new(1e-9, 0.0, -1.0), [1.0, 0.5]),
            (DVec3::new(0.0, -1.0, 1e-9), [0.5, 0.0]),
            (DVec3::new(0.0, 1.0, 1.0), [0.5, 0.75]),
        ];
        for (towards, at) in places {
            assert!((position(towards) - DVec2::from_array(at)).length() < 1e-8, "{towards}");
        }
        for at in (0..200)
            .map(|step| DVec2::new(f64::from(step % 20) + 0.5, f64::from(step / 20) + 0.5) / DVec2::new(20.0, 10.0))
        {
            let towards = direction(at);
            assert!((position(3.0 * towards) - at).length() < 1e-12);
            // `Cameras._generate_rays_from_coords`, in axes of OpenGL
            let (theta, phi) = (-PI * (2.0 * at.x - 1.0), PI * at.y);
            let opengl = DVec3::new(-theta.sin() * phi.sin(), phi.cos(), -theta.cos() * phi.sin());
            assert!((towards - DVec3::new(opengl.x, -opengl.y, -opengl.z)).length() < 1e-12);
        }
    }

    #[test]
    fn faces_have_names_and_share_the_centre() {
        for face in Face::ALL {
            for name in ["a/pano.1_front.jpg", "b", "c.d/e"] {
                assert_eq!(face.photograph_of(&face.name_in(name)), name);
            }
            let camera = face.camera(&pose(), 1024, 0.1);
            assert!((camera.centre() - pose().centre()).length() < 1e-12);
            assert!((camera.fx - 1024.0 / TAU).abs() < 0.3 && camera.camera_from_world.rotation.determinant() > 0.99);
        }
        assert_eq!(Face::Up.name_in("c.d/e.png"), "c.d/e_up.png");
        assert!(
            (REACH - 47.5f64.to_radians().tan()).abs() < 1e-12 && (ALONE - 42.5f64.to_radians().tan()).abs() < 1e-12
        );
    }

    #[test]
    fn faces_of_a_panorama_are_the_pictures_of_their_cameras() {
        let (panorama, distances) = builtin_panorama(&pose(), 384, 2);
        let steps: Vec<u16> = distances.iter().map(|distance| (1e4 * distance) as u16).collect();
        for face in Face::ALL {
            let full = face.camera(&pose(), 384, 0.01);
            // at full size it is interpolated, at the smallest the mean of many samples
            for (side, least) in [(full.width, 29.5), (full.width / 2, 33.0), (30, 35.0)] {
                let truth = builtin_photograph(&full.resized(side, side), 3, 0.0);
                let found = psnr(&cut(&panorama, face, side).bytes, &truth.bytes);
                assert!(found > least, "{face:?} of {side} px: {found} dB");
            }
            let (depth, _) = builtin_geometry(&full);
            let cut = cut_depth(&steps, [384, 192], DepthKind::Metric, face, full.width);
            let is_near = |(step, depth): &(u16, f32)| (f32::from(*step) / 1e4 / depth - 1.0).abs() < 0.02;
            let near = zip(cut, depth).filter(is_near).count();
            assert!(near as f64 > 0.97 * (full.width * full.width) as f64, "{face:?}: {near}");
        }
    }

    #[test]
    fn what_does_not_count_has_no_part_in_what_does() {
        let (mut panorama, _) = builtin_panorama(&pose(), 128, 1);
        let is_counted = |pixel: usize| pixel / 128 < 40 || pixel % 128 < 3;
        panorama.counted = Some((0..128 * 64).map(is_counted).collect());
        let mut overpainted = panorama.clone();
        (0..128 * 64).filter(|&pixel| !is_counted(pixel)).for_each(|pixel| overpainted.bytes[3 * pixel] ^= 0x80);
        let mut shares = Vec::new();
        for face in Face::ALL {
            let [clean, overpainted] = [&panorama, &overpainted].map(|panorama| cut(panorama, face, 30));
            let counted = clean.counted.clone().unwrap();
            (0..900).filter(|&pixel| counted[pixel]).for_each(|pixel| {
                assert_eq!(clean.colour(pixel), overpainted.colour(pixel), "{face:?}, pixel {pixel}");
            });
            shares.push(counted.iter().filter(|&&counts| counts).count());
        }
        // all of the upper face, two thirds of that in front
        assert!(shares[4] == 900 && shares[5] < 100 && (540..660).contains(&shares[0]), "{shares:?}");
    }
}
