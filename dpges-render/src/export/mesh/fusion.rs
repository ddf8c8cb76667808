//! Depths of many views fused into a truncated signed distance field (TSDF; Curless and Levoy 1996).

use std::collections::{BTreeSet, HashSet};

use dpges_core::camera::Camera;
use glam::DVec3;
use rayon::prelude::*;

use super::super::error::ExportError;
use super::TriangleMesh;
use super::field::{BLOCK, BLOCK_LEN, Block, BlockKey, Field};
use super::surface::extract;
use crate::percentile::percentiles;

/// Distances from a surface end here, voxels. At least 2; noise of the depths asks for more.
const TRUNCATION_VOXELS: f64 = 4.0;
/// Pixels that surfels cover less have no depth.
const MIN_COVERAGE: f32 = 0.5;

#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FusionOptions {
    /// Distance between lattice points, world units.
    pub voxel: f64,
    /// Depths beyond are not fused, world units.
    pub farthest: f64,
    /// Voxels that the memory may be filled with, 20 bytes each.
    pub max_voxels: usize,
}

impl FusionOptions {
    /// Voxels of `voxel` world units, all depths, 640 MB.
    pub fn new(voxel: f64) -> Self {
        Self { voxel, farthest: f64::INFINITY, max_voxels: 32 << 20 }
    }
}

/// Points of the surfaces that are to be fused, from which the size of voxels follows.
#[derive(Debug, Default)]
pub struct SurfaceSample {
    /// With unit directions from the camera.
    points: Vec<(DVec3, DVec3)>,
    /// Sizes of pixels there, world units.
    pixels: Vec<f64>,
}

/// Blocks have to be so many times fewer than there is room for: a sample does not touch all of them.
const SAMPLE_RESERVE: f64 = 1.5;
/// Voxels over the median size of a pixel: finer ones show noise, coarser ones less than the views.
const VOXEL_PIXELS: f64 = 1.5;

impl SurfaceSample {
    /// Adds every `stride`-th pixel of a view both ways, up to the depth `farthest`.
    ///
    /// # Errors
    /// [`ExportError::View`].
    pub fn add(&mut self, view: &DepthView<'_>, stride: usize, farthest: f64) -> Result<(), ExportError> {
        view.check()?;
        let camera = view.camera;
        for y in (stride / 2..camera.height).step_by(stride) {
            for x in (stride / 2..camera.width).step_by(stride) {
                let Some(depth) = view.at(x, y).filter(|&depth| depth <= farthest) else { continue };
                let point = camera.unproject(x as f64 + 0.5, y as f64 + 0.5, depth);
                self.points.push((point, (point - camera.centre()).normalize()));
                self.pixels.push(depth / camera.fy);
            }
        }
        Ok(())
    }

    /// The size of voxels that show what the views show, or the smallest of which there may be `max_voxels`; world units.
    ///
    /// # Errors
    /// [`ExportError::NoSurface`] of no points.
    pub fn voxel(&self, max_voxels: usize) -> Result<f64, ExportError> {
        let [pixel] = percentiles(self.pixels.clone(), [0.5]).ok_or(ExportError::NoSurface)?;
        Ok(self.smallest_voxel(VOXEL_PIXELS * pixel, max_voxels))
    }

    /// The smallest size of voxels from `wanted` on of which there may be `max_voxels`, world units, rounded up to two digits.
    pub fn smallest_voxel(&self, wanted: f64, max_voxels: usize) -> f64 {
        let most = (max_voxels as f64 / (SAMPLE_RESERVE * BLOCK_LEN as f64)) as usize;
        let fits = |voxel: f64| {
            let mut keys = HashSet::new();
            for (point, direction) in &self.points {
                keys.extend(keys_along(*point, *direction, voxel));
                if keys.len() > most {
                    return false;
                }
            }
            true
        };
        let mut voxel = wanted;
        while !fits(voxel) {
            voxel *= 1.1;
        }
        let digit = 10f64.powf(voxel.log10().floor() - 1.0);
        if voxel == wanted { voxel } else { (voxel / digit).ceil() * digit }
    }
}

/// Blocks of `voxel` world units within the truncation of a surface at `point`, on the ray in `direction`.
fn keys_along(point: DVec3, direction: DVec3, voxel: f64) -> impl Iterator<Item = BlockKey> {
    let reach = TRUNCATION_VOXELS.ceil() as i32;
    let key = move |step: i32| {
        let sample = (point + f64::from(step) * voxel * direction) / (f64::from(BLOCK) * voxel);
        sample.to_array().map(|x| x.floor() as i32)
    };
    (-reach..=reach).map(key)
}

/// Surfels from one camera, in the coordinates of the scene.
#[derive(Clone, Copy, Debug)]
pub struct DepthView<'a> {
    pub camera: &'a Camera,
    /// [H, W] mean camera-space z of the surfels at a pixel, world units.
    pub depth: &'a [f32],
    /// [H, W] how much of a pixel surfels cover, 0 to 1. Pixels below one half have no depth.
    pub coverage: &'a [f32],
    /// [3, H, W] display-referred.
    pub colour: &'a [f32],
}

/// Views that become a mesh.
pub struct Fusion {
    options: FusionOptions,
    field: Field,
}

impl Fusion {
    /// # Errors
    /// [`ExportError::Voxel`] for a voxel that is not positive and finite.
    pub fn new(options: FusionOptions) -> Result<Self, ExportError> {
        if !(options.voxel.is_finite() && options.voxel > 0.0) {
            return Err(ExportError::Voxel { found: options.voxel });
        }
        Ok(Self { options, field: Field::default() })
    }

    /// Fuses one more view.
    ///
    /// # Errors
    /// [`ExportError::View`] if a plane has another size than the camera, [`ExportError::TooManyVoxels`] if the view
    /// needs more memory than the options allow; then it is not fused.
    pub fn add(&mut self, view: &DepthView<'_>) -> Result<(), ExportError> {
        view.check()?;
        let options = &self.options;
        let keys: Vec<BlockKey> =
            view.blocks(options).into_iter().filter(|key| !self.field.places.contains_key(key)).collect();
        if (self.field.blocks.len() + keys.len()) * BLOCK_LEN > options.max_voxels {
            let FusionOptions { voxel, max_voxels, .. } = *options;
            return Err(ExportError::TooManyVoxels { voxel, limit: max_voxels });
        }
        keys.into_iter().for_each(|key| self.field.insert(key));
        self.field.blocks.par_iter_mut().for_each(|block| view.fuse(options, block));
        Ok(())
    }

    /// The surface between what was seen and what lies behind it.
    ///
    /// # Errors
    /// [`ExportError::NoSurface`] if there is none.
    pub fn finish(self) -> Result<TriangleMesh, ExportError> {
        let mesh = extract(&self.field, self.options.voxel);
        if mesh.triangles.is_empty() { Err(ExportError::NoSurface) } else { Ok(mesh) }
    }
}

impl DepthView<'_> {
    fn check(&self) -> Result<(), ExportError> {
        let Camera { width, height, .. } = *self.camera;
        let planes = [("depth", self.depth, 1), ("coverage", self.coverage, 1), ("colour", self.colour, 3)];
        for (what, plane, channels) in planes {
            let expected = channels * width * height;
            if plane.len() != expected {
                return Err(ExportError::View { what, found: plane.len(), expected, width, height });
            }
        }
        Ok(())
    }

    fn at(&self, x_px: usize, y_px: usize) -> Option<f64> {
        let pixel = y_px * self.camera.width + x_px;
        let depth = self.depth[pixel];
        (self.coverage[pixel] >= MIN_COVERAGE && depth > 0.0 && depth.is_finite()).then(|| f64::from(depth))
    }

    /// Blocks within the truncation of a surface, in order.
    fn blocks(&self, options: &FusionOptions) -> BTreeSet<BlockKey> {
        let camera = self.camera;
        let row = |y: usize| {
            let mut keys = BTreeSet::new();
            for x in 0..camera.width {
                let Some(depth) = self.at(x, y).filter(|&depth| depth <= options.farthest) else { continue };
                let point = camera.unproject(x as f64 + 0.5, y as f64 + 0.5, depth);
                keys.extend(keys_along(point, (point - camera.centre()).normalize(), options.voxel));
            }
            keys
        };
        (0..camera.height).into_par_iter().map(row).reduce(BTreeSet::new, |mut all, keys| {
            all.extend(keys);
            all
        })
    }

    /// Takes what this view knows into all voxels of a block.
    fn fuse(&self, options: &FusionOptions, block: &mut Block) {
        let (camera, voxel) = (self.camera, options.voxel);
        let first = block.key.map(|i| f64::from(i * BLOCK));
        let half = 0.5 * f64::from(BLOCK - 1);
        let centre = DVec3::from_array(first.map(|i| (i + half) * voxel));
        let radius = (half + 1.0) * voxel * 3f64.sqrt();
        if camera.depth(centre) + radius < camera.near {
            return;
        }
        for (at, known) in block.voxels.iter_mut().enumerate() {
            let at = at as i32;
            let local = [at % BLOCK, at / BLOCK % BLOCK, at / (BLOCK * BLOCK)];
            let point = DVec3::from_array(std::array::from_fn(|axis| (first[axis] + f64::from(local[axis])) * voxel));
            if let Some((distance, pixel)) = self.distance(options, point) {
                let pixels = camera.width * camera.height;
                let colour = std::array::from_fn(|channel| self.colour[channel * pixels + pixel]);
                known.add(distance as f32, colour);
            }
        }
    }

    /// Truncated distance of a point from the surface along its ray, in units of the truncation, and the nearest pixel.
    /// `None` where the view knows nothing: outside it, where it has no depth, and far behind the surface.
    fn distance(&self, options: &FusionOptions, point: DVec3) -> Option<(f64, usize)> {
        let camera = self.camera;
        let (x, y, z) = camera.project(point)?;
        if !(0.0..camera.width as f64).contains(&x) || !(0.0..camera.height as f64).contains(&y) {
            return None;
        }
        let (column, row, truncation) = (x as usize, y as usize, TRUNCATION_VOXELS * options.voxel);
        let nearest = self.at(column, row).filter(|&depth| depth <= options.farthest)?;
        let depth = self.interpolated(x, y, nearest, truncation);
        let per_depth = (point - camera.centre()).length() / z;
        let distance = (depth - z) * per_depth / truncation;
        (distance >= -1.0).then(|| (distance.min(1.0), row * camera.width + column))
    }

    /// Depth between pixel centres: 1 / depth is linear on a plane. That of the `nearest` pixel at the border of the
    /// view, and where its neighbours belong to another surface.
    fn interpolated(&self, x: f64, y: f64, nearest: f64, truncation: f64) -> f64 {
        let camera = self.camera;
        let ([left, right], [top, bottom]) = (neighbours(x, camera.width), neighbours(y, camera.height));
        let mut inverse = 0.0;
        for (row, share_y) in [top, bottom] {
            for (column, share_x) in [left, right] {
                match self.at(column, row) {
                    Some(depth) if (depth - nearest).abs() < truncation => inverse += share_x * share_y / depth,
                    _ => return nearest,
                }
            }
        }
        1.0 / inverse
    }
}

/// The two pixels whose centres a position lies between, and their shares.
fn neighbours(position: f64, size: usize) -> [(usize, f64); 2] {
    let centre = (position - 0.5).clamp(0.0, (size - 1) as f64);
    let low = centre as usize;
    let share = centre - low as f64;
    [(low, 1.0 - share), ((low + 1).min(size - 1), share)]
}

#[cfg(test)]
mod tests {
    use dpges_core::camera::CameraFromWorld;

    use super::*;
    use crate::fixtures::{directions, pinhole};

    const RADIUS: f64 = 0.8;

    fn cameras() -> Vec<Camera> {
        let camera = |direction: DVec3| {
            let pose = CameraFromWorld::look_at(3.0 * direction, DVec3::ZERO, DVec3::new(0.1, 0.2, 0.97));
            Camera { fy: 95.0, cx: 41.0, cy: 38.5, ..pinhole(pose, 90.0, [80, 80]) }
        };
        directions(30).map(camera).collect()
    }

    /// Exact depth, coverage, and colour: of a ball around the origin whose colour is its position.
    fn ball(camera: &Camera) -> [Vec<f32>; 3] {
        let pixels = camera.width * camera.height;
        let [mut depth, mut coverage, mut colour] = [vec![0.0; pixels], vec![0.0; pixels], vec![0.0; 3 * pixels]];
        for pixel in 0..pixels {
            let (x, y) = ((pixel % camera.width) as f64 + 0.5, (pixel / camera.width) as f64 + 0.5);
            let (eye, ray) = (camera.centre(), camera.unproject(x, y, 1.0) - camera.centre());
            let (a, b, c) = (ray.length_squared(), eye.dot(ray), eye.length_squared() - RADIUS * RADIUS);
            let discriminant = b * b - a * c;
            if discriminant > 0.0 {
                let z = (-b - discriminant.sqrt()) / a;
                let hit = eye + z * ray;
                (depth[pixel], coverage[pixel]) = (z as f32, 1.0);
                for channel in 0..3 {
                    colour[channel * pixels + pixel] = (0.5 + 0.5 * hit[channel]) as f32;
                }
            }
        }
        [depth, coverage, colour]
    }

    fn fused(options: FusionOptions) -> Result<TriangleMesh, ExportError> {
        let mut fusion = Fusion::new(options)?;
        for camera in &cameras() {
            let [depth, coverage, colour] = ball(camera);
            fusion.add(&DepthView { camera, depth: &depth, coverage: &coverage, colour: &colour })?;
        }
        fusion.finish()
    }

    #[test]
    fn a_ball_comes_back_within_a_fraction_of_a_voxel() {
        let voxel = 0.05;
        let mesh = fused(FusionOptions::new(voxel)).unwrap();
        let points: Vec<DVec3> = mesh.positions.iter().map(|&p| glam::Vec3::from(p).as_dvec3()).collect();
        let errors: Vec<f64> = points.iter().map(|p| (p.length() - RADIUS).abs() / voxel).collect();
        let mean = errors.iter().sum::<f64>() / errors.len() as f64;
        let largest = errors.iter().copied().fold(0.0, f64::max);
        assert!(mean < 0.1 && largest < 0.5, "{mean} {largest} voxels");
        // closed: no edge has one triangle alone; surface nets join sheets at few edges
        let edges: std::collections::HashMap<[u32; 2], usize> = mesh
            .triangles
            .iter()
            .flat_map(|&[a, b, c]| [[a, b], [b, c], [c, a]])
            .fold(Default::default(), |mut count, [a, b]| {
                *count.entry([a.min(b), a.max(b)]).or_default() += 1;
                count
            });
        assert!(edges.values().all(|count| count % 2 == 0));
        assert!(edges.values().filter(|&&count| count > 2).count() < edges.len() / 1000);
        // slivers at those edges aside, triangles face those who see them
        let faces = |&&[a, b, c]: &&[u32; 3]| {
            let [a, b, c] = [a, b, c].map(|index| points[index as usize]);
            (b - a).cross(c - a).dot(a + b + c) > 0.0
        };
        let facing = mesh.triangles.iter().filter(faces).count();
        assert!(facing * 1000 > mesh.triangles.len() * 999, "{facing} of {}", mesh.triangles.len());
        let fits = |&index: &usize| {
            let (point, normal) = (points[index], glam::Vec3::from(mesh.normals[index]).as_dvec3());
            let expected = point.to_array().map(|x| 255.0 * (0.5 + 0.5 * x));
            let off = mesh.colours[index].iter().zip(expected).map(|(&found, x)| (f64::from(found) - x).abs());
            normal.dot(point.normalize()) > 0.95 && off.fold(0.0, f64::max) < 8.0
        };
        let fitting = (0..points.len()).filter(fits).count();
        assert!(fitting * 100 > points.len() * 99, "{fitting} of {}", points.len());
    }

    #[test]
    fn what_does_not_fit_into_memory_is_told_before_it_is_taken() {
        let (camera, mut sample) = (&cameras()[0], SurfaceSample::default());
        let plane = vec![2.0; 80 * 80];
        let view = DepthView { camera, depth: &plane, coverage: &vec![1.0; 80 * 80], colour: &vec![0.5; 3 * 80 * 80] };
        sample.add(&view, 2, 10.0).unwrap();
        // pixels of 2 / 95 world units
        assert!((sample.voxel(usize::MAX).unwrap() - 1.5 * 2.0 / 95.0).abs() < 1e-12);
        let smallest = sample.smallest_voxel(0.001, 300 * BLOCK_LEN);
        let fits = |voxel: f64| {
            Fusion::new(FusionOptions { max_voxels: 300 * BLOCK_LEN, ..FusionOptions::new(voxel) })
                .unwrap()
                .add(&view)
                .is_ok()
        };
        assert!(fits(smallest) && !fits(0.6 * smallest), "{smallest}");
        let error = fused(FusionOptions { max_voxels: 100 * BLOCK_LEN, ..FusionOptions::new(0.01) }).unwrap_err();
        assert!(error.to_string().contains("voxels of 0.01 world units are too small"), "{error}");
        assert!(matches!(fused(FusionOptions::new(0.0)), Err(ExportError::Voxel { .. })));
        let near = fused(FusionOptions { farthest: 1.0, ..FusionOptions::new(0.05) });
        assert!(matches!(near, Err(ExportError::NoSurface)), "all depths lie beyond 2");
    }

    #[test]
    fn views_of_another_size_are_named() {
        let mut fusion = Fusion::new(FusionOptions::new(0.1)).unwrap();
        let camera = &cameras()[0];
        let [depth, coverage, colour] = ball(camera);
        let view = DepthView { camera, depth: &depth, coverage: &coverage[1..], colour: &colour };
        let error = fusion.add(&view).unwrap_err().to_string();
        assert!(error.contains("6399 numbers of coverage, expected 6400"), "{error}");
    }
}
