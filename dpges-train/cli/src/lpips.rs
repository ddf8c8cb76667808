//! `--lpips`: the networks that LPIPS is measured with.

use burn::tensor::Device;
use clap::Args;
use dpges_train::metrics::lpips::Lpips;
use dpges_train::metrics::lpips::choice::{Choice, load};

use super::Result;

#[derive(Debug, Args)]
pub struct LpipsArgs {
    /// Measure LPIPS with the network in this file, AlexNet or VGG16; once for each of them. `vgg` and `alex` are those
    /// that tools/lpips_weights.py has put into the user's data folder; `none` measures no LPIPS [default: vgg, if it is
    /// there]
    #[arg(long = "lpips", value_name = "FILE")]
    chosen: Vec<Choice>,
}

impl LpipsArgs {
    /// Whether nothing was said about networks.
    pub fn is_empty(&self) -> bool {
        self.chosen.is_empty()
    }

    /// The networks as they were asked for.
    pub fn chosen(&self) -> &[Choice] {
        &self.chosen
    }

    /// The networks on `device`: those that were chosen, or else VGG16 if it is installed.
    pub fn load(&self, device: &Device) -> Result<Vec<Lpips>> {
        Ok(load(&self.chosen, device)?)
    }
}
