//! `--lpips`: the networks that LPIPS is measured with.

use clap::Args;
use dpges_train::metrics::lpips::choice::Choice;

#[derive(Debug, Args)]
pub struct LpipsArgs {
    /// Measure LPIPS with the network in this file, AlexNet or VGG16; once for each of them. `vgg` and `alex` are those
    /// that tools/lpips_weights.py has put into the user's data folder; `none` measures no LPIPS [default: vgg, if it is
    /// there]
    #[arg(long = "lpips", value_name = "FILE")]
    pub chosen: Vec<Choice>,
}
