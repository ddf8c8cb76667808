//! A picture with depth, and what another camera would see of it.

use dpges_core::Result;
use dpges_core::camera::Camera;
use dpges_core::scene::tensors::tensor_to_rows;
use rayon::prelude::*;

use crate::eval::rendered::TrainingRenderer;
use crate::metrics::quantised;

/// A surface is seen in both frames if its depth agrees to this relative error with that between four pixels, ...
const DEPTH_TOLERANCE: f64 = 0.02;
/// ... and with that of each of them to this one: they are not on both sides of an edge.
const EDGE: f64 = 0.1;

/// The picture of a camera, and its depth.
#[derive(Clone, Debug)]
pub struct Frame {
    pub camera: Camera,
    /// [3 × height × width] display-referred.
    pub planes: Vec<f32>,
    /// [height × width] depth of the surface, world units; 0 or infinite where there is none.
    pub depth: Vec<f32>,
}

/// An earlier frame as a later camera would show it.
#[derive(Clone, Debug)]
pub struct Warped {
    /// [3 × height × width] of the earlier frame; of the later one where [`is_seen`](Self::is_seen) is false, so that what
    /// cannot be compared does not differ.
    pub planes: Vec<f32>,
    /// [height × width] whether the surface of the pixel is seen in both frames.
    pub is_seen: Vec<bool>,
}

impl Frame {
    /// Renders the picture, rounded to 8 bits, and its [median depth](TrainingRenderer::render_with_depth).
    pub fn render(renderer: &TrainingRenderer, camera: &Camera) -> Result<Self> {
        let (view, depth) = renderer.render_with_depth(camera)?;
        Ok(Self { camera: *camera, planes: tensor_to_rows(&quantised(view.image().clone())), depth })
    }

    /// `earlier` as this frame's camera would show it: every pixel takes its colour from where its surface was. Pixels
    /// without a surface, and those whose surface was hidden, outside of the picture or beside an edge, are left out.
    ///
    /// # Panics
    /// If the frames differ in size.
    pub fn warped(&self, earlier: &Self) -> Warped {
        let area = self.camera.width * self.camera.height;
        assert_eq!(
            (earlier.camera.width, earlier.camera.height, earlier.planes.len(), earlier.depth.len()),
            (self.camera.width, self.camera.height, self.planes.len(), area),
            "frames of one size"
        );
        let colours: Vec<Option<[f32; 3]>> =
            (0..area).into_par_iter().map(|pixel| self.colour_before(pixel, earlier)).collect();
        let mut planes = self.planes.clone();
        for (pixel, colour) in colours.iter().enumerate() {
            for (channel, value) in colour.iter().flatten().enumerate() {
                planes[channel * area + pixel] = *value;
            }
        }
        Warped { planes, is_seen: colours.iter().map(Option::is_some).collect() }
    }

    /// The colour in `earlier` of the surface at `pixel`, between four pixels; `None` if it is not seen there.
    fn colour_before(&self, pixel: usize, earlier: &Self) -> Option<[f32; 3]> {
        let Camera { width, height, .. } = self.camera;
        let depth = f64::from(self.depth[pixel]);
        if depth <= 0.0 || !depth.is_finite() {
            return None;
        }
        let world = self.camera.unproject((pixel % width) as f64 + 0.5, (pixel / width) as f64 + 0.5, depth);
        let (x, y, depth) = earlier.camera.project(world)?;
        let (left, top) = ((x - 0.5).floor(), (y - 0.5).floor());
        if left < 0.0 || top < 0.0 || left + 1.0 >= width as f64 || top + 1.0 >= height as f64 {
            return None;
        }
        let corner = top as usize * width + left as usize;
        let corners = [corner, corner + 1, corner + width, corner + width + 1];
        let depths = corners.map(|at| f64::from(earlier.depth[at]));
        if depths.iter().any(|there| (there - depth).abs() > EDGE * depth) {
            return None;
        }
        let (right, down) = (x - 0.5 - left, y - 0.5 - top);
        let weights = [(1.0 - right) * (1.0 - down), right * (1.0 - down), (1.0 - right) * down, right * down];
        // of a plane it is 1 / z that changes evenly over the picture
        let inverse: f64 = depths.iter().zip(weights).map(|(there, weight)| weight / there).sum();
        if (inverse * depth - 1.0).abs() > DEPTH_TOLERANCE {
            return None;
        }
        Some([0, 1, 2].map(|channel| {
            let plane = &earlier.planes[channel * width * height..];
            corners.iter().zip(weights).map(|(&at, weight)| weight * f64::from(plane[at])).sum::<f64>() as f32
        }))
    }
}
