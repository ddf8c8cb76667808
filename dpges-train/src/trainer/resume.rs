//! A run to and from a [`Checkpoint`].

use std::sync::Arc;

use burn::tensor::Device;
use dpges_core::device::fix_order_of_sums;

use super::statistics::Statistics;
use super::{TrainError, Trainer};
use crate::checkpoint::{Checkpoint, Progress};
use crate::dataset::Dataset;
use crate::optimizer::AttributeRows;
use crate::scene_state::{GaussianState, SurfelState};

impl Trainer {
    /// All that [`resume`](Self::resume) needs to go on to the same result.
    pub fn checkpoint(&self) -> Checkpoint {
        let attributes = self.surfels.rows().into_iter().chain(self.gaussians.rows());
        Checkpoint {
            progress: Progress {
                config: self.config.clone(),
                info: self.info.clone(),
                completed_steps: self.completed_steps,
                rng: self.rng.clone(),
                remaining_views: self.remaining_views.clone(),
                view_names: view_names(&self.dataset),
            },
            attributes: attributes.map(|(name, rows)| (name.to_owned(), rows)).collect(),
            margins: self.surfels.to_data().margins,
            max_pixels: self.statistics.max_pixels(),
            max_contributions: self.statistics.max_contributions(),
        }
    }

    /// Goes on where `checkpoint` was made.
    ///
    /// # Errors
    /// [`TrainError::Resume`] if the dataset is another one or the checkpoint contradicts itself.
    pub fn resume(dataset: Arc<Dataset>, checkpoint: Checkpoint, device: Device) -> Result<Self, TrainError> {
        let Checkpoint { progress, mut attributes, margins, max_pixels, max_contributions } = checkpoint;
        if progress.view_names != view_names(&dataset) {
            let (before, now) = (progress.view_names.len(), dataset.train.len());
            let reason = format!("it was made with {before} training views, and these {now} are not the same ones");
            return Err(TrainError::Resume { reason });
        }
        if progress.config.train.deterministic {
            fix_order_of_sums();
        }
        let model = progress.info.colour_model;
        let surfel_rows = take(&mut attributes, SurfelState::NAMES, [3, 4, 2, 3, model.detail_len()], margins.len())?;
        let widths = [3, 4, 3, 1, 3, model.detail_len()];
        let gaussian_rows = take(&mut attributes, GaussianState::NAMES, widths, max_contributions.len())?;
        if max_pixels.len() != margins.len() {
            return Err(TrainError::Resume { reason: "`max_pixels` and `margins` differ in length".into() });
        }
        Ok(Self {
            schedule: progress.config.schedule(dataset.train.len()),
            surfels: SurfelState::from_rows(surfel_rows, &margins, model, &device),
            gaussians: GaussianState::from_rows(gaussian_rows, model, &device),
            statistics: Statistics::from_rows(&max_pixels, &max_contributions, &device),
            pending: None,
            rng: progress.rng,
            remaining_views: progress.remaining_views,
            completed_steps: progress.completed_steps,
            info: progress.info,
            config: progress.config,
            dataset,
            device,
        })
    }
}

fn view_names(dataset: &Dataset) -> Vec<String> {
    dataset.train.iter().map(|view| view.name.clone()).collect()
}

/// The rows of the named attributes, each `count` × its width.
fn take<const N: usize>(
    attributes: &mut std::collections::HashMap<String, AttributeRows>,
    names: [&str; N],
    widths: [usize; N],
    count: usize,
) -> Result<[AttributeRows; N], TrainError> {
    let mut rows = Vec::with_capacity(N);
    for (name, width) in names.into_iter().zip(widths) {
        let Some(found) = attributes.remove(name) else {
            return Err(TrainError::Resume { reason: format!("attribute `{name}` is missing") });
        };
        if (found.count, found.width) != (count, width) {
            let reason = format!("`{name}` is {} × {}, expected {count} × {width}", found.count, found.width);
            return Err(TrainError::Resume { reason });
        }
        rows.push(found);
    }
    Ok(rows.try_into().expect("one per name"))
}
