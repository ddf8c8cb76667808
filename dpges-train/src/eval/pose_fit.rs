//! Where the camera of one photograph is, by the photograph: the scene stays as it is.

use burn::tensor::{DType, Device, Tensor};
use dpges_core::Result;
use dpges_core::camera::Camera;
use dpges_core::losses::{Target, rgb};
use dpges_core::render::pose::PoseProbe;
use dpges_core::scene::tensors::tensor_to_rows;

use crate::config::OptimizerConfig;
use crate::eval::rendered::TrainingRenderer;
use crate::optimizer::pose_step::PoseStep;
use crate::views::pose::PoseCorrection;

const STEPS: usize = 80;
/// Learning rate of the first step, rad and extents, and the factor on it at the last. All steps together reach 0.02, which
/// is more than a degree.
const RATE: f64 = 1e-3;
const DECAY: f64 = 0.01;
/// Share of D-SSIM in what is minimised (3DGS).
const DSSIM: f64 = 0.2;

/// The correction of `camera` with which `renderer` comes nearest to `target`, in a scene of `extent`, world units: the best
/// of a descent that begins with none. The loss compares the render as `exposed` shows it, which may depend on the render:
/// a photograph that is brighter than the scene says nothing about where its camera is.
///
/// # Errors
/// The errors of [`TrainingRenderer::render`], [`dpges_core::Error::Shape`] if the target has another size.
pub fn fitted_pose(
    renderer: &TrainingRenderer,
    camera: &Camera,
    target: impl Fn(&Device) -> Result<Target>,
    exposed: impl Fn(Tensor<3>) -> Tensor<3>,
    extent: f64,
    device: &Device,
) -> Result<PoseCorrection> {
    let mut best = (f64::INFINITY, PoseCorrection::default());
    if renderer.is_empty() {
        return Ok(best.1);
    }
    let tape = device.clone().autodiff();
    let target = target(&tape)?;
    let (mut row, mut moments) = ([0.0; 6], [[0.0; 6]; 2]);
    for step in 0..STEPS {
        let correction = PoseCorrection::of_row(&row);
        let here = Camera { camera_from_world: correction.applied(&camera.camera_from_world), ..*camera };
        let probe = PoseProbe::new(&here, &tape, DType::F32);
        let image = exposed(renderer.render_probed(&here, &probe)?);
        let loss = rgb(&image, target.clone(), DSSIM)?.total;
        let value = f64::from(tensor_to_rows(&loss.clone().inner())[0]);
        if value < best.0 {
            best = (value, correction);
        }
        let Some(gradient) = probe.gradient(&mut loss.backward()).map(|gradient| tensor_to_rows(&gradient)) else {
            break;
        };
        let gradient = correction.gradient(std::array::from_fn(|at| f64::from(gradient[at])));
        if gradient.iter().any(|number| !number.is_finite()) {
            break;
        }
        let rate = RATE * DECAY.powf(step as f64 / STEPS as f64);
        let adam = OptimizerConfig::default().adam(step, 1);
        let step = PoseStep { rate, extent, adam };
        let [first, second] = &mut moments;
        step.take(&mut row, [first, second], gradient);
    }
    Ok(best.1)
}

#[cfg(test)]
mod tests {
    use dpges_core::scene::Rendering;
    use dpges_core::testing::scenes::{Recipe, random};
    use glam::DVec3;

    use super::*;
    use crate::dataset::Picture;
    use crate::run::fixtures::device;
    use crate::views::exposure::Correction;
    use crate::views::target::ToTarget;

    #[test]
    fn a_camera_is_found_again_by_its_photograph_whatever_its_exposure() {
        let same = Correction { gain: [1.0; 3], offset: [0.0; 3] };
        let darker = Correction { gain: [0.6, 0.7, 0.5], offset: [0.1, 0.0, 0.2] };
        let device = device();
        let recipe = Recipe { surfels: 30, gaussians: 60, width: 56, height: 48, ..Recipe::default() };
        let cases = [(Rendering::Peeled, same), (Rendering::Ellipsoids, same), (Rendering::Peeled, darker)];
        for (rendering, change) in cases {
            let (mut scene, camera) = random(12, &recipe).into_scene();
            scene.info.rendering = rendering;
            if rendering == Rendering::Ellipsoids {
                scene.surfels = dpges_core::scene::SurfelData::neutral(scene.info.colour_model, 0);
                scene.gaussians.opacities.iter_mut().for_each(|opacity| *opacity = opacity.min(0.9));
            }
            let renderer = TrainingRenderer::new(&scene, &device);
            let taken = change.applied(renderer.render(&camera).unwrap().image().clone());
            let picture = Picture::from_planes(&tensor_to_rows(&taken), camera.width, camera.height);
            let photograph = picture.target(&device).image;
            let exposed = |image: Tensor<3>| {
                if change == same {
                    return image;
                }
                Correction::fitted(&image.clone().inner(), &photograph, None).applied(image)
            };
            let pose = camera.camera_from_world.moved(DVec3::new(3e-3, -4e-3, 2e-3), DVec3::new(-8e-3, 5e-3, 6e-3));
            let wrong = Camera { camera_from_world: pose, ..camera };
            let target = |device: &Device| Ok(picture.target(device));
            let found = fitted_pose(&renderer, &wrong, target, exposed, 1.0, &device).unwrap();
            let found = Camera { camera_from_world: found.applied(&pose), ..camera };
            let misplacement = |other: &Camera| -> f64 {
                let points = scene.gaussians.positions.as_chunks::<3>().0.iter();
                let points = points.map(|position| DVec3::from_array(position.map(f64::from)));
                let pairs = points.filter_map(|point| Some((camera.project(point)?, other.project(point)?)));
                pairs.map(|(a, b)| (a.0 - b.0).hypot(a.1 - b.1)).sum()
            };
            let (before, after) = (misplacement(&wrong), misplacement(&found));
            assert!(after < 0.6 * before, "{rendering}, {change:?}: {after} px, {before} px before");
        }
    }
}
