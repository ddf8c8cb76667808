//! Gaussians that steps leave out at random (DropGaussian). Long runs on few outdoor photographs overfit: single
//! Gaussians come to explain single views.

use burn::tensor::{Device, Tensor, TensorData};
use rand::{Rng, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::Sharding;
use crate::config::TrainConfig;

/// Passes over the training views of runs that are short, and long.
const PASSES: [f64; 2] = [50.0, 150.0];

/// How long a run over `views` training views is, from 0, short, to 1.
pub fn length(train: &TrainConfig, views: usize) -> f64 {
    let passes = train.steps as f64 / views.max(1) as f64;
    ((passes - PASSES[0]) / (PASSES[1] - PASSES[0])).clamp(0.0, 1.0)
}

/// The share of Gaussians that steps of the joint stage leave out, in a run over `views` training views.
// most short runs lose by it; at South Building 179 passes gain 0.3 dB with a fifth
pub fn share(train: &TrainConfig, views: usize) -> f64 {
    train.dropout * length(train, views)
}

/// Factors [n, 1] of the opacities of the Gaussians of this rank in the step after `completed` ones: 0 of the `share` that is
/// left out, and 1 / (1 − share) of the others, so that sums are the same on average.
pub fn factors(sharding: &Sharding, share: f64, seed: u64, completed: usize, device: &Device) -> Tensor<2> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    // a stream for each step, so that a resumed run leaves out the same ones without a state in the checkpoint
    rng.set_stream(completed as u64);
    let (least, others) = ((share * f64::from(u32::MAX)) as u32, (1.0 / (1.0 - share)) as f32);
    // drawn for all Gaussians on every rank, so that the number of ranks does not matter
    let all: Vec<f32> = (0..sharding.len()).map(|_| if rng.next_u32() < least { 0.0 } else { others }).collect();
    let own = sharding.own_of(&all, 1);
    let shape = [own.len(), 1];
    Tensor::from_data(TensorData::new(own, shape), device)
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use dpges_core::ranks::Alone;

    use super::*;
    use crate::run::fixtures::{config, device};

    #[test]
    fn more_passes_leave_out_more() {
        let train = |steps: usize| config(&[&format!("train.steps={steps}"), "train.dropout=0.2"]).train;
        for (steps, expected) in [(100, 0.0), (500, 0.0), (1000, 0.1), (1500, 0.2), (9000, 0.2)] {
            let found = share(&train(steps), 10);
            assert!((found - expected).abs() < 1e-12, "{steps} steps: {found}");
        }
    }

    #[test]
    fn others_make_up_for_those_that_are_left_out() {
        let of = |completed| factors(&Sharding::new(10_000, Arc::new(Alone)), 0.2, 7, completed, &device());
        let rows: Vec<f32> = of(3).into_data().iter().collect();
        let left_out = rows.iter().filter(|&&factor| factor == 0.0).count();
        assert!((1900..2100).contains(&left_out), "{left_out}");
        assert!(rows.iter().all(|&factor| factor == 0.0 || factor == 1.25));
        assert_eq!(of(3).into_data(), of(3).into_data());
        assert_ne!(of(3).into_data(), of(4).into_data());
    }
}
