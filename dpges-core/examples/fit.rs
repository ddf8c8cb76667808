//! Fits one surfel and one Gaussian to a square: cargo run --release --example fit
use burn::module::{Module, Param};
use burn::tensor::{DType, Tensor, TensorData};
use burn_optim::{AdamConfig, GradientsParams};
use dpges_core::*;

/// Position, log-scales and base colour of the surfel and of the Gaussian, one row each.
#[derive(Module, Debug)]
struct Pair {
    surfel: [Param<Tensor<2>>; 3],
    gaussian: [Param<Tensor<2>>; 3],
}

fn main() -> Result<()> {
    let device = backend::device::cpu().autodiff();
    let camera_from_world = CameraFromWorld::look_at([0.0, 0.0, -4.0].into(), [0.0; 3].into(), [0.0, -1.0, 0.0].into());
    let camera = Camera::pinhole(camera_from_world, 60.0, [48, 48], 0.01);
    let row = |values: &[f32]| Param::from_data(TensorData::new(values.to_vec(), [1, values.len()]), &device);
    let surfel = [row(&[0.0; 3]), row(&[-1.5; 2]), row(&[0.0; 3])];
    let mut pair = Pair { surfel, gaussian: [row(&[0.0, 0.0, -0.5]), row(&[-1.5; 3]), row(&[0.0; 3])] };
    let (model, none) = (ColourModel::SphericalBeta { lobes: 0 }, Tensor::zeros([1, 0], &device));
    let disc = Surfels::from_data(&SurfelData::neutral(model, 1), &device, DType::F32);
    let ball = Gaussians::from_data(&GaussianData::neutral(model, 1), &device, DType::F32);
    let colour = |base| Colour::new(model, base, none.clone());
    let target = Tensor::<3>::zeros([3, 48, 48], &device).slice_fill([0..3, 18..34, 14..30], 0.8);
    let mut optimiser = AdamConfig::new().init();
    for step in 0..200 {
        let [positions, log_scales, base] = pair.surfel.each_ref().map(|param| param.val());
        let surfels = Surfels { positions, log_scales, colour: colour(base), ..disc.clone() };
        let [positions, log_scales, base] = pair.gaussian.each_ref().map(|param| param.val());
        let gaussians = Gaussians { positions, log_scales, colour: colour(base), ..ball.clone() };
        let image = render(&surfels, &gaussians, &camera, &RenderOptions::default())?.composite.image;
        let loss = (image - target.clone()).powi_scalar(2).mean();
        println!("step {step}: mean squared error {:.5}", loss.clone().into_scalar::<f64>());
        let gradients = GradientsParams::from_grads(loss.backward(), &pair);
        pair = optimiser.step(0.01, pair, gradients);
    }
    Ok(())
}
