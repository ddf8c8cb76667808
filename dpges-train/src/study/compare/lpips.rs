//! LPIPS of the runs of a comparison, which training does not measure.

use std::path::Path;

use dpges_core::scene::SceneData;
use dpges_train::eval::rendered::Renderer;
use dpges_train::eval::{Measures, evaluate_each};
use dpges_train::metrics::lpips::{Lpips, Network};
use dpges_train::metrics::{Perceptual, Scores};
use dpges_train::run::folder::{RunFolder, write_json};

use super::super::series::Common;
use super::super::series::row::{Row, read_report};
use crate::cli::{Failure, Result};

/// Measures LPIPS of the held-out views by `networks`, and adds it to the `eval.json` of every run that lacks it in the folder
/// `out` of a comparison.
pub fn measure(out: &Path, rows: &[Row], common: &Common, networks: &[Lpips]) -> Result<()> {
    let views = &common.dataset.test;
    for run in rows.iter().flat_map(|row| &row.runs) {
        if networks.iter().all(|lpips| is_known(lpips.network, &run.test)) {
            continue;
        }
        let folder = RunFolder::new(out.join(&run.folder));
        tracing::info!("{}: measuring LPIPS of {} views", folder.path().display(), views.len());
        let scene = SceneData::load(&folder.scene())?;
        let renderer = Renderer::new(&scene, &common.device);
        let measures = Measures::perceptual(networks);
        let found = evaluate_each(&renderer, &scene, views, &common.device, measures, |_, _| Ok::<_, Failure>(()))?;
        let mut report = read_report(&folder.evaluation())?;
        for (view, found) in report.evaluation.views.iter_mut().zip(&found.views) {
            add(&mut view.perceptual, &found.perceptual);
        }
        add(&mut report.evaluation.perceptual, &found.perceptual);
        write_json(&folder.evaluation(), &report)?;
    }
    Ok(())
}

fn is_known(network: Network, scores: &Scores) -> bool {
    match network {
        Network::Alex => scores.perceptual.lpips_alex.is_some(),
        Network::Vgg => scores.perceptual.lpips_vgg.is_some(),
    }
}

/// Adds what `known` lacks.
fn add(known: &mut Perceptual, found: &Perceptual) {
    known.ms_ssim = known.ms_ssim.or(found.ms_ssim);
    known.ssimulacra2 = known.ssimulacra2.or(found.ssimulacra2);
    known.lpips_alex = known.lpips_alex.or(found.lpips_alex);
    known.lpips_vgg = known.lpips_vgg.or(found.lpips_vgg);
}
