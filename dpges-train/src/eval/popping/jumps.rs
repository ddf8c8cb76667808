//! Jumps: how often a pixel changes at once, however small the steps of the camera are.
//!
//! A picture that changes continuously changes less from one frame to the next the more frames a path has. FLIP of frames has a
//! floor of its own, and cannot show what does not become smaller.

use dpges_core::Result;
use dpges_core::camera::Camera;
use dpges_core::render::Render;
use dpges_core::scene::tensors::tensor_to_rows;
use serde::{Deserialize, Serialize};

use crate::eval::rendered::{Rendered, TrainingRenderer};

/// Steps of the path that are measured: they double until the number of jumps stands still, or there are no more.
const STEPS: [usize; 4] = [128, 256, 512, 1024];
/// Share of the jumps at half of the steps from which on they stand still.
const STANDS_STILL: f64 = 0.95;
/// Levels of 256 by which a pixel jumps.
const LEVELS: [f32; 2] = [8.0, 16.0];

/// How often a pixel changes by more than some levels of 256 from one frame to the next, summed over a path, mean over the pixels.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Jumps {
    /// By more than 8 levels in some channel.
    pub jumps_8: f64,
    /// By more than 16.
    pub jumps_16: f64,
    pub jumps_frames: usize,
    /// `jumps_8` by cause; absent of scenes that are not peeled.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub jumps_by_cause: Option<Causes>,
}

/// Jumps by the difference between their two frames. The fields add up to [`Jumps::jumps_8`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Causes {
    /// The surfels alone do not jump.
    pub gaussians: f64,
    /// The same layers in the same order: an edge that is as steep as the step of the camera is long.
    pub same_layers: f64,
    /// Layers change places.
    pub order: f64,
    /// A layer comes or goes, and there is room for more.
    pub rims: f64,
    /// Layers are pushed out by others.
    pub overflow: f64,
    /// Another core, closer to the one before than half a margin.
    pub near_cores: f64,
    /// Another core further away.
    pub far_cores: f64,
    /// A core comes or goes.
    pub core_or_none: f64,
}

impl Causes {
    fn of(&mut self, cause: Cause) -> &mut f64 {
        match cause {
            Cause::Gaussians => &mut self.gaussians,
            Cause::SameLayers => &mut self.same_layers,
            Cause::Order => &mut self.order,
            Cause::Rims => &mut self.rims,
            Cause::Overflow => &mut self.overflow,
            Cause::NearCores => &mut self.near_cores,
            Cause::FarCores => &mut self.far_cores,
            Cause::CoreOrNone => &mut self.core_or_none,
        }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Cause {
    Gaussians,
    SameLayers,
    Order,
    Rims,
    Overflow,
    NearCores,
    FarCores,
    CoreOrNone,
}

impl Jumps {
    /// Those of `renderer` along `path`, which gives the cameras of a number of steps.
    ///
    /// # Errors
    /// The errors of [`TrainingRenderer::render`].
    pub fn along(renderer: &TrainingRenderer, path: impl Fn(usize) -> Vec<Camera>) -> Result<Self> {
        let mut found = Self::default();
        for steps in STEPS {
            let before = std::mem::replace(&mut found, Self::of(renderer, &path(steps))?);
            if before.jumps_frames > 0 && found.jumps_8 >= STANDS_STILL * before.jumps_8 {
                break;
            }
        }
        Ok(found)
    }

    fn of(renderer: &TrainingRenderer, cameras: &[Camera]) -> Result<Self> {
        let margins = renderer.margins();
        let (mut jumps, mut causes) = ([0usize; 2], None::<Causes>);
        let mut earlier: Option<View> = None;
        let mut area = 1;
        for camera in cameras {
            let view = View::new(&renderer.render(camera)?, camera);
            area = view.area;
            if let Some(earlier) = &earlier {
                for pixel in 0..area {
                    let change = view.change(earlier, pixel);
                    for (count, level) in jumps.iter_mut().zip(LEVELS) {
                        *count += usize::from(change > level);
                    }
                    if let (true, Some(layers), Some(before)) = (change > LEVELS[0], &view.layers, &earlier.layers) {
                        let cause = layers.cause(before, pixel, &margins);
                        *causes.get_or_insert_default().of(cause) += 1.0 / area as f64;
                    }
                }
            }
            causes = causes.or_else(|| view.layers.is_some().then(Causes::default));
            earlier = Some(view);
        }
        let [jumps_8, jumps_16] = jumps.map(|count| count as f64 / area as f64);
        Ok(Self { jumps_8, jumps_16, jumps_frames: cameras.len(), jumps_by_cause: causes })
    }
}

/// A frame, display-referred and clamped.
struct View {
    area: usize,
    /// [3, H, W]
    image: Vec<f32>,
    layers: Option<LayersOfView>,
}

impl View {
    fn new(rendered: &Rendered, camera: &Camera) -> Self {
        let area = camera.width * camera.height;
        let layers = rendered.peeled().map(|render| LayersOfView::new(render, area));
        Self { area, image: tensor_to_rows(rendered.image()), layers }
    }

    fn change(&self, earlier: &Self, pixel: usize) -> f32 {
        change(&self.image, &earlier.image, pixel, self.area)
    }
}

/// Largest difference of a channel of two pictures, [3, H, W], in levels of 256.
fn change(a: &[f32], b: &[f32], pixel: usize, area: usize) -> f32 {
    let of_channel = |channel: usize| {
        let [a, b] = [a, b].map(|picture| picture[channel * area + pixel].clamp(0.0, 1.0));
        (a - b).abs()
    };
    255.0 * of_channel(0).max(of_channel(1)).max(of_channel(2))
}

/// The layers of all pixels, [K, H, W] each, and the picture of the surfels alone.
struct LayersOfView {
    area: usize,
    surfel_image: Vec<f32>,
    ids: Vec<i32>,
    alpha: Vec<f32>,
    depth: Vec<f32>,
}

impl LayersOfView {
    fn new(render: &Render, area: usize) -> Self {
        Self {
            area,
            surfel_image: tensor_to_rows(&render.composite.surfel_image),
            ids: render.layers.ids.clone().into_data().iter::<i32>().collect(),
            alpha: tensor_to_rows(&render.layers.alpha),
            depth: tensor_to_rows(&render.layers.depth),
        }
    }

    /// Places of the layers of a pixel.
    fn places(&self, pixel: usize) -> impl Iterator<Item = usize> + Clone {
        (pixel..self.ids.len()).step_by(self.area).take_while(|&place| self.ids[place] >= 0)
    }

    fn core(&self, pixel: usize) -> Option<usize> {
        self.places(pixel).find(|&place| self.alpha[place] >= 1.0)
    }

    fn cause(&self, earlier: &Self, pixel: usize, margins: &[f32]) -> Cause {
        if change(&self.surfel_image, &earlier.surfel_image, pixel, self.area) <= LEVELS[0] {
            return Cause::Gaussians;
        }
        let ids = |view: &Self| view.places(pixel).map(|place| view.ids[place]).collect::<Vec<i32>>();
        let [mut own, mut before] = [ids(self), ids(earlier)];
        if own == before {
            return Cause::SameLayers;
        }
        match (self.core(pixel), earlier.core(pixel)) {
            (Some(a), Some(b)) if self.ids[a] != earlier.ids[b] => {
                let margin = margins[self.ids[a] as usize].max(margins[earlier.ids[b] as usize]);
                let is_near = (self.depth[a] - earlier.depth[b]).abs() < 0.5 * margin;
                if is_near { Cause::NearCores } else { Cause::FarCores }
            }
            (Some(_), None) | (None, Some(_)) => Cause::CoreOrNone,
            (core, _) => {
                own.sort_unstable();
                before.sort_unstable();
                // without a core its place is empty
                let most = self.ids.len() / self.area - usize::from(core.is_none());
                match () {
                    () if own == before => Cause::Order,
                    () if own.len() >= most && before.len() >= most => Cause::Overflow,
                    () => Cause::Rims,
                }
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn layers(ids: [i32; 3], alpha: [f32; 3], depth: [f32; 3], grey: f32) -> LayersOfView {
        LayersOfView {
            area: 1,
            surfel_image: vec![grey; 3],
            ids: ids.to_vec(),
            alpha: alpha.to_vec(),
            depth: depth.to_vec(),
        }
    }

    #[test]
    fn causes_are_told_apart() {
        let margins = [0.4; 6];
        let before = layers([0, 1, 2], [0.5, 0.5, 1.0], [1.0, 2.0, 3.0], 0.0);
        let cause = |ids: [i32; 3], alpha: [f32; 3], depth: [f32; 3], grey: f32| {
            layers(ids, alpha, depth, grey).cause(&before, 0, &margins)
        };
        let (rims, depth) = ([0.5, 0.5, 1.0], [1.0, 2.0, 3.0]);
        assert_eq!(cause([3, 4, 5], rims, depth, 8.0 / 255.0), Cause::Gaussians);
        assert_eq!(cause([0, 1, 2], rims, depth, 0.5), Cause::SameLayers);
        assert_eq!(cause([1, 0, 2], rims, depth, 0.5), Cause::Order);
        assert_eq!(cause([0, 2, -1], [0.5, 1.0, 0.0], depth, 0.5), Cause::Rims);
        assert_eq!(cause([3, 0, 2], rims, depth, 0.5), Cause::Overflow);
        assert_eq!(cause([0, 1, 5], rims, [1.0, 2.0, 3.1], 0.5), Cause::NearCores);
        assert_eq!(cause([0, 1, 5], rims, [1.0, 2.0, 3.3], 0.5), Cause::FarCores);
        assert_eq!(cause([0, 1, 3], [0.5; 3], depth, 0.5), Cause::CoreOrNone);
    }
}
