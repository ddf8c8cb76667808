//! Contributions of primitives to pictures: the sum of the weights with which each is blended into their pixels.

use burn::tensor::{Device, Tensor};
use dpges_core::Result;
use dpges_core::camera::Camera;
use dpges_core::scene::schema::Columns;
use dpges_core::scene::tensors::tensor_to_rows;
use dpges_core::scene::{ColourData, ColourModel, SH_C0, SceneData};

use crate::eval::rendered::TrainingRenderer;

/// Sums over the pixels of all views, in pixels.
#[derive(Clone, Debug, PartialEq)]
pub struct Contributions {
    /// `[N]`
    pub surfels: Vec<f64>,
    /// `[M]`
    pub gaussians: Vec<f64>,
}

impl Contributions {
    /// Renders `scene` on `device` from each of `cameras`, in its coordinates. A pixel is linear in the colours of the
    /// primitives, so that the gradient of the sum of all pixels with respect to a colour is the sum of the primitive's
    /// weights. Colours are replaced by grey: one that is clamped has no gradient.
    ///
    /// # Errors
    /// The errors of [`TrainingRenderer::render`].
    pub fn measure(scene: &SceneData, cameras: &[Camera], device: &Device) -> Result<Self> {
        Self::fold(scene, cameras, device, |sum, weight| *sum += weight)
    }

    /// Like [`measure`](Self::measure), but the largest of one view in place of the sum over all; of weights that take colour
    /// away their absolute value.
    ///
    /// # Errors
    /// The errors of [`TrainingRenderer::render`].
    pub fn largest(scene: &SceneData, cameras: &[Camera], device: &Device) -> Result<Self> {
        Self::fold(scene, cameras, device, |most, weight| *most = weight.abs().max(*most))
    }

    fn fold(scene: &SceneData, cameras: &[Camera], device: &Device, add: impl Fn(&mut f64, f64)) -> Result<Self> {
        let mut sums = Self { surfels: vec![0.0; scene.surfels.len()], gaussians: vec![0.0; scene.gaussians.len()] };
        let mut scene = SceneData { environment: None, ..scene.clone() };
        scene.surfels.colour = grey(scene.surfels.model(), scene.surfels.len());
        scene.gaussians.colour = grey(scene.gaussians.model(), scene.gaussians.len());
        let mut renderer = TrainingRenderer::new(&scene, &device.clone().autodiff());
        for base in [&mut renderer.surfels.colour.base, &mut renderer.gaussians.colour.base] {
            *base = base.clone().require_grad();
        }
        for camera in cameras {
            let gradients = renderer.render(camera)?.image().clone().sum().backward();
            let add_all = |sums: &mut [f64], base: &Tensor<2>| {
                let Some(gradient) = base.grad(&gradients) else { return };
                let rows = tensor_to_rows(&gradient);
                let weight = |row: &[f32; 3]| row.iter().map(|&x| f64::from(x)).sum::<f64>() / (3.0 * SH_C0);
                sums.iter_mut().zip(rows.as_chunks::<3>().0).for_each(|(sum, row)| add(sum, weight(row)));
            };
            add_all(&mut sums.surfels, &renderer.surfels.colour.base);
            add_all(&mut sums.gaussians, &renderer.gaussians.colour.base);
        }
        Ok(sums)
    }

    /// The `share` (0 to 1) of all primitives that contribute most, surfels and Gaussians together: the rows of both, in
    /// their order. If contributions are equal, surfels go first, then earlier rows.
    pub fn heaviest(&self, share: f64) -> [Vec<usize>; 2] {
        let surfels = self.surfels.len();
        let all: Vec<f64> = self.surfels.iter().chain(&self.gaussians).copied().collect();
        let mut order: Vec<usize> = (0..all.len()).collect();
        order.sort_by(|&a, &b| all[b].total_cmp(&all[a]));
        order.truncate((share.clamp(0.0, 1.0) * all.len() as f64).ceil() as usize);
        order.sort_unstable();
        let (of_surfels, of_gaussians) = order.split_at(order.partition_point(|&row| row < surfels));
        [of_surfels.to_vec(), of_gaussians.iter().map(|row| row - surfels).collect()]
    }

    /// `scene`, which was measured, with its [`heaviest`](Self::heaviest) primitives alone.
    pub fn keep_heaviest(&self, scene: &SceneData, share: f64) -> SceneData {
        let [surfels, gaussians] = self.heaviest(share);
        SceneData {
            surfels: scene.surfels.select(&surfels),
            gaussians: scene.gaussians.select(&gaussians),
            ..scene.clone()
        }
    }
}

/// Colours of ½ from everywhere, of primitives with colours of `model`. Opacities depend on the direction as before.
fn grey(model: ColourModel, count: usize) -> ColourData {
    let model = if model.opacity_len() > 0 { model } else { ColourModel::SphericalBeta { lobes: 0 } };
    ColourData::new(model, vec![0.0; 3 * count], vec![0.0; model.detail_len() * count])
}

#[cfg(test)]
mod tests {
    use dpges_core::scene::{Rendering, WeightedSum};
    use dpges_core::testing::scenes::{Recipe, random};

    use super::*;
    use crate::run::fixtures::device;

    fn scene(rendering: Rendering) -> (SceneData, Camera) {
        let sum = (rendering == Rendering::Summed).then(WeightedSum::default);
        let harmonics = ColourModel::HarmonicsAndOpacity { degree: 1 };
        let model = if sum.is_some() { harmonics } else { Recipe::default().model };
        let made = random(7, &Recipe { surfels: 6, gaussians: 9, model, ..Recipe::default() });
        let (mut scene, camera) = made.into_scene();
        (scene.info.rendering, scene.info.weighted_sum) = (rendering, sum);
        if rendering != Rendering::Peeled {
            scene.surfels = scene.surfels.select(&[]);
        }
        (scene, camera)
    }

    fn sum(scene: &SceneData, camera: &Camera) -> f64 {
        let render = TrainingRenderer::new(scene, &device()).render(camera).unwrap();
        tensor_to_rows(render.image()).iter().map(|&x| f64::from(x)).sum()
    }

    #[test]
    fn a_contribution_is_what_brighter_colour_adds_to_the_picture() {
        for rendering in [Rendering::Peeled, Rendering::Ellipsoids, Rendering::Summed] {
            let (mut scene, camera) = scene(rendering);
            scene.surfels.colour = grey(scene.info.colour_model, scene.surfels.len());
            scene.gaussians.colour = grey(scene.info.colour_model, scene.gaussians.len());
            scene.info.colour_model = scene.gaussians.model();
            let found = Contributions::measure(&scene, &[camera, camera], &device()).unwrap();
            let before = sum(&scene, &camera);
            let mut largest = 0.0f64;
            let mut check = |changed: &SceneData, expected: f64| {
                let twice = 2.0 * (sum(changed, &camera) - before) / (3.0 * SH_C0);
                assert!((twice - expected).abs() < 2e-3 * twice.max(1.0), "{twice}, {expected}: {found:?}");
                largest = largest.max(expected);
            };
            for (row, &expected) in found.surfels.iter().enumerate() {
                let mut changed = scene.clone();
                changed.surfels.colour.base[3 * row..][..3].fill(1.0);
                check(&changed, expected);
            }
            for (row, &expected) in found.gaussians.iter().enumerate() {
                let mut changed = scene.clone();
                changed.gaussians.colour.base[3 * row..][..3].fill(1.0);
                check(&changed, expected);
            }
            assert!(largest > 1.0, "something is seen: {found:?}");
        }
    }

    #[test]
    fn the_largest_is_that_of_one_view() {
        let (scene, camera) = scene(Rendering::Peeled);
        let beside = |shares: f64| Camera { cx: camera.cx + shares * camera.width as f64, ..camera };
        let cameras = [beside(-0.5), beside(0.5)];
        let [one, other] = cameras.map(|camera| Contributions::measure(&scene, &[camera], &device()).unwrap());
        let both = Contributions::largest(&scene, &cameras, &device()).unwrap();
        let largest = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a.abs().max(b.abs())).collect::<Vec<_>>();
        assert_eq!(both.surfels, largest(&one.surfels, &other.surfels));
        assert_eq!(both.gaussians, largest(&one.gaussians, &other.gaussians));
        assert!(both != one && both != other, "each side shows something: {both:?}");
    }

    #[test]
    fn colours_do_not_change_what_is_contributed() {
        let (coloured, camera) = scene(Rendering::Peeled);
        let mut black = coloured.clone();
        black.surfels.colour.base.fill(-9.0);
        black.gaussians.colour.base.fill(-9.0);
        let measure = |scene: &SceneData| Contributions::measure(scene, &[camera], &device()).unwrap();
        assert_eq!(measure(&coloured), measure(&black));
    }

    #[test]
    fn the_heaviest_are_kept_in_their_order() {
        let all = Contributions { surfels: vec![0.5, 9.0, 0.0], gaussians: vec![3.0, 0.5, 7.0] };
        assert_eq!(all.heaviest(0.5), [vec![1], vec![0, 2]]);
        assert_eq!(all.heaviest(0.6), [vec![0, 1], vec![0, 2]], "of equal ones the surfel");
        assert_eq!(all.heaviest(1.0), [vec![0, 1, 2], vec![0, 1, 2]]);
        let nothing = [Vec::<usize>::new(), Vec::new()];
        assert_eq!(all.heaviest(0.0), nothing);
        assert_eq!(Contributions { surfels: vec![], gaussians: vec![] }.heaviest(0.5), nothing);

        let (scene, camera) = scene(Rendering::Peeled);
        let measured = Contributions::measure(&scene, &[camera], &device()).unwrap();
        let half = measured.keep_heaviest(&scene, 0.5);
        assert_eq!(half.surfels.len() + half.gaussians.len(), 8);
        let [surfels, gaussians] = measured.heaviest(0.5);
        assert_eq!(
            (half.surfels, half.gaussians),
            (scene.surfels.select(&surfels), scene.gaussians.select(&gaussians))
        );
    }
}
