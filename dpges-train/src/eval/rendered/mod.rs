//! A scene on a device of Burn, from which views are rendered, and pictures of what was rendered.

mod layers;
mod median_depth;

use std::borrow::Cow;
use std::sync::Arc;
use std::time::Instant;

use burn::tensor::{DType, Device, Tensor};
use dpges_core::Result;
use dpges_core::camera::Camera;
use dpges_core::ops::composite::{Geometry, geometry};
use dpges_core::ops::environment::environment;
use dpges_core::ops::peel::PeelOptions;
use dpges_core::ranks::{Alone, Ranks};
use dpges_core::render::blended::{BlendedOptions, BlendedRender, render_blended};
use dpges_core::render::pose::PoseProbe;
use dpges_core::render::summed::{SummedOptions, SummedRender, WeightedSumTensors, render_summed};
use dpges_core::render::{Render, RenderOptions, Values, ViewRequest, render};
use dpges_core::scene::schema::Columns;
use dpges_core::scene::tensors::{rows_to_tensor, tensor_to_rows};
use dpges_core::scene::{Gaussians, Rendering, SceneData, Surfels};
use dpges_render::Rgb8Image;
use dpges_render::frame_times::{FrameTimes, Rounds};

use crate::dataset::Dataset;
use crate::device::place::Place;
use crate::eval::floaters::{Floaters, Visibility};
pub use layers::{LayerPictures, layer_pictures};

/// The picture of an image [3, H, W] with display-referred values.
pub fn to_picture(image: &Tensor<3>) -> Rgb8Image {
    let [_, height, width] = image.dims();
    Rgb8Image::from_planes(&tensor_to_rows(image), width, height)
}

/// `camera` for a picture whose sides are `factor` of its own, at least 1 px.
pub fn scaled(camera: &Camera, factor: f64) -> Camera {
    let side = |length: usize| ((length as f64 * factor).round() as usize).max(1);
    camera.resized(side(camera.width), side(camera.height))
}

/// A scene as f32 tensors, with the options that it was trained with.
#[derive(Clone, Debug)]
pub struct TrainingRenderer {
    pub(super) surfels: Surfels,
    pub(super) gaussians: Gaussians,
    /// Those that `gaussians` are sharded over.
    ranks: Arc<dyn Ranks>,
    /// All that render this scene.
    job: Arc<dyn Ranks>,
    /// [(degree + 1)², 3]
    environment: Option<Tensor<2>>,
    options: Options,
    device: Device,
}

#[derive(Clone, Debug)]
enum Options {
    Peeled(RenderOptions),
    Blended(BlendedOptions),
    Summed(SummedOptions, Box<WeightedSumTensors>),
}

/// A rendered view of a scene of any kind.
#[derive(Clone, Debug)]
pub enum Rendered {
    Peeled(Box<Render>),
    Blended(Box<BlendedRender>),
    Summed(Box<SummedRender>),
}

impl Rendered {
    /// The image, [3, H, W], display-referred and not clamped.
    pub fn image(&self) -> &Tensor<3> {
        match self {
            Self::Peeled(render) => &render.composite.image,
            Self::Blended(render) => &render.image,
            Self::Summed(render) => &render.image,
        }
    }

    /// The same view with an environment [3, H, W] behind everything.
    fn in_front_of(self, environment: Tensor<3>) -> Self {
        match self {
            Self::Peeled(render) => Self::Peeled(Box::new(render.in_front_of(environment))),
            Self::Blended(render) => Self::Blended(Box::new(render.in_front_of(environment))),
            Self::Summed(render) => Self::Summed(Box::new(render.in_front_of(environment))),
        }
    }

    /// The layers of a view of surfels and Gaussians; `None` for blended and summed Gaussians.
    pub fn peeled(&self) -> Option<&Render> {
        match self {
            Self::Peeled(render) => Some(render),
            Self::Blended(_) | Self::Summed(_) => None,
        }
    }

    /// Share of the picture that surfels cover; `None` without layers. Where it is low, Gaussians are summed without any order.
    pub fn coverage(&self) -> Option<f64> {
        let behind = self.peeled()?.seen.behind_all();
        Some(1.0 - f64::from(tensor_to_rows(&behind.mean())[0]))
    }
}

impl TrainingRenderer {
    /// Uploads `scene` to `device`.
    pub fn new(scene: &SceneData, device: &Device) -> Self {
        Self::on_ranks(scene, &device.clone().into())
    }

    /// Uploads `scene`, of summed Gaussians behind surfels the shard of this rank. All ranks then render views of such
    /// a scene together.
    pub fn on_ranks(scene: &SceneData, place: &Place) -> Self {
        let Place { device, ranks: job } = place.clone();
        let (device, alone) = (&device, Place::from(device.clone()).ranks);
        let (gaussians, ranks) = match scene.info.rendering {
            Rendering::Peeled if !job.is_alone() => {
                let own: Vec<usize> = (job.rank()..scene.gaussians.len()).step_by(job.count()).collect();
                (Cow::Owned(scene.gaussians.select(&own)), Arc::clone(&job))
            }
            _ => (Cow::Borrowed(&scene.gaussians), alone),
        };
        let options = match scene.info.rendering {
            Rendering::Peeled => Options::Peeled(RenderOptions::from(&scene.info)),
            Rendering::Ellipsoids | Rendering::Discs | Rendering::Students => {
                Options::Blended(BlendedOptions::new(&scene.info).expect("a scene of blended Gaussians"))
            }
            Rendering::Summed => {
                let options = SummedOptions::new(&scene.info).expect("a scene of weighted sums");
                let sum = scene.info.weighted_sum.as_ref().expect("just used");
                Options::Summed(options, Box::new(WeightedSumTensors::new(sum, device, DType::F32)))
            }
        };
        Self {
            surfels: Surfels::from_data(&scene.surfels, device, DType::F32),
            gaussians: Gaussians::from_data(&gaussians, device, DType::F32),
            ranks,
            job,
            environment: scene.environment.as_ref().map(|e| rows_to_tensor(&e.coefficients, 3, device, DType::F32)),
            options,
            device: device.clone(),
        }
    }

    /// The same scene before a constant `background`.
    #[must_use]
    pub fn before(&self, background: [f64; 3]) -> Self {
        let mut other = self.clone();
        match &mut other.options {
            Options::Peeled(options) => options.background = background,
            Options::Blended(options) => options.background = background,
            Options::Summed(options, _) => options.background = background,
        }
        other
    }

    /// The device that has the scene.
    pub fn device(&self) -> &Device {
        &self.device
    }

    /// Renders the view from `camera`, in the coordinates of the scene.
    ///
    /// # Errors
    /// As [`render`], [`render_blended`] and [`render_summed`].
    pub fn render(&self, camera: &Camera) -> Result<Rendered> {
        self.render_with(&self.options, camera.into())
    }

    /// All ranks that render this scene.
    pub fn job(&self) -> &dyn Ranks {
        &*self.job
    }

    /// Whether all ranks have to render a view together.
    pub fn is_sharded(&self) -> bool {
        !self.ranks.is_alone()
    }

    /// Whether there are no primitives on this rank.
    pub fn is_empty(&self) -> bool {
        self.surfels.is_empty() && self.gaussians.is_empty()
    }

    /// The image [3, H, W] from the `camera` of a `probe`, on the tape of the probe; the scene is not. Of a rank alone.
    ///
    /// # Errors
    /// The errors of [`render`](Self::render).
    pub fn render_probed(&self, camera: &Camera, probe: &PoseProbe) -> Result<Tensor<3>> {
        let taped = Self {
            surfels: self.surfels.map_ref(|_, tensor| tensor.clone().autodiff()),
            gaussians: self.gaussians.map_ref(|_, tensor| tensor.clone().autodiff()),
            ranks: Arc::new(Alone),
            environment: self.environment.clone().map(Tensor::autodiff),
            ..self.clone()
        };
        let options = match self.options.clone() {
            Options::Summed(options, common) => {
                let WeightedSumTensors { sigma, beta, background } = *common;
                let [sigma, beta, background] = [sigma, beta, background].map(Tensor::autodiff);
                Options::Summed(options, Box::new(WeightedSumTensors { sigma, beta, background }))
            }
            other => other,
        };
        let view = ViewRequest { pose: Some(probe), values: Values::KnownFinite, ..camera.into() };
        Ok(taped.render_with(&options, view)?.image().clone())
    }

    /// The view from `camera` and its median depth [height × width]: that of the first surfel, or of the first
    /// blended Gaussian, behind which no more than half of the light passes, world units; 0 where there is none. Of summed
    /// Gaussians, which have no order, it is their mean depth where they have at least half of the weight.
    ///
    /// # Errors
    /// The errors of [`render`](Self::render).
    pub fn render_with_depth(&self, camera: &Camera) -> Result<(Rendered, Vec<f32>)> {
        let mut options = self.options.clone();
        match &mut options {
            Options::Peeled(_) => {}
            Options::Blended(options) => options.blend.maps = true,
            Options::Summed(options, _) => options.depth = true,
        }
        let rendered = self.render_with(&options, camera.into())?;
        let depth = median_depth::median_depth(&rendered, camera);
        Ok((rendered, depth))
    }

    fn render_with(&self, options: &Options, view: ViewRequest<'_>) -> Result<Rendered> {
        let (surfels, gaussians, ViewRequest { camera, pose, .. }) = (&self.surfels, &self.gaussians, view);
        let rendered = match options {
            Options::Peeled(options) => {
                let view = ViewRequest { ranks: &*self.ranks, ..view };
                Rendered::Peeled(Box::new(render(surfels, gaussians, view, options)?))
            }
            Options::Blended(options) => Rendered::Blended(Box::new(render_blended(gaussians, view, options)?)),
            Options::Summed(options, common) => {
                Rendered::Summed(Box::new(render_summed(gaussians, common, view, options)?))
            }
        };
        let Some(coefficients) = &self.environment else { return Ok(rendered) };
        let coefficients = pose.map_or_else(|| coefficients.clone(), |pose| pose.environment(coefficients));
        Ok(rendered.in_front_of(environment(&coefficients, camera)?))
    }

    /// How many primitives float, see [`floaters`](crate::eval::floaters); `None` if `dataset`, in the coordinates of
    /// the scene, does not say which view saw what.
    ///
    /// # Errors
    /// As [`render`].
    pub fn floaters(&self, dataset: &Dataset) -> Result<Option<Floaters>> {
        let visibility = self.visibility(dataset)?;
        let Some(Floaters { surfels, gaussians }) = visibility.map(|visibility| visibility.floaters()) else {
            return Ok(None);
        };
        let mut gaussians = [gaussians as f64];
        self.ranks.add_up(&mut gaussians);
        Ok(Some(Floaters { surfels, gaussians: gaussians[0] as usize }))
    }

    /// The votes by which primitives on this rank float, under the same conditions.
    ///
    /// # Errors
    /// As [`render`].
    pub fn visibility(&self, dataset: &Dataset) -> Result<Option<Visibility>> {
        let peel = match &self.options {
            Options::Peeled(options) => options.peel,
            Options::Blended(_) | Options::Summed(..) => PeelOptions::default(),
        };
        Visibility::measure(&self.surfels, &self.gaussians, &peel, dataset)
    }

    /// How long pictures from `cameras` take.
    ///
    /// # Errors
    /// As [`render`].
    pub fn frame_times(&self, cameras: &[Camera], rounds: Rounds) -> Result<FrameTimes> {
        let mut times = Vec::new();
        for round in 0..rounds.warm_up + rounds.counted {
            for camera in cameras {
                let start = Instant::now();
                // reading one number waits for the picture
                drop(self.render(camera)?.image().clone().slice([0..1, 0..1, 0..1]).into_data());
                if round >= rounds.warm_up {
                    times.push(1e3 * start.elapsed().as_secs_f64());
                }
            }
        }
        Ok(FrameTimes::new(times, Vec::new()))
    }

    /// `[N]` of the surfels.
    pub(super) fn margins(&self) -> Vec<f32> {
        tensor_to_rows(&self.surfels.margins)
    }

    /// Blended depth and normals of the surfels in a `view` from `camera`.
    pub fn geometry(&self, camera: &Camera, view: &Render) -> Geometry {
        geometry(&self.surfels, &view.layers, &view.seen.weights, camera)
    }
}
