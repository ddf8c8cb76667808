//! `--lpips`: the networks that LPIPS is measured with.

use std::path::PathBuf;

use burn::tensor::Device;
use clap::Args;
use dpges_train::metrics::lpips::{Lpips, Weights};

use super::{Failure, Result};

#[derive(Debug, Args)]
pub struct LpipsArgs {
    /// Measure LPIPS with the network in this file, AlexNet or VGG16; once for each of them.
    /// dpges-train/tools/lpips_weights.py makes the files
    #[arg(long = "lpips", value_name = "FILE")]
    files: Vec<PathBuf>,
}

impl LpipsArgs {
    pub fn is_empty(&self) -> bool {
        self.files.is_empty()
    }

    /// The networks on `device`.
    ///
    /// # Errors
    /// If a file cannot be used, or two hold the same network.
    pub fn load(&self, device: &Device) -> Result<Vec<Lpips>> {
        let mut networks: Vec<Lpips> = Vec::new();
        for file in &self.files {
            let weights = Weights::load(file)?;
            if let Some(first) = networks.iter().position(|loaded| loaded.network == weights.network) {
                let files = format!("{} and {}", self.files[first].display(), file.display());
                return Err(Failure::Usage(format!("--lpips: {files} both hold network `{}`", weights.network)));
            }
            networks.push(Lpips::new(&weights, device));
        }
        Ok(networks)
    }
}
