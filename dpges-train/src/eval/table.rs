//! Evaluations in rows of names and values, for people.

use super::floaters::Floaters;
use super::popping::{Jumps, Popping};
use super::{EvalReport, Evaluation, FrameMs};
use crate::config::duration::Seconds;
use crate::metrics::{METRICS, Metric, Scores};

impl EvalReport {
    /// For people. `worst` says what is worst and where its picture is, `notes` what was not measured.
    pub fn rows(&self, worst: &[String], notes: Vec<(&'static str, String)>) -> Vec<(&str, String)> {
        let Evaluation { views, coverage, surfels, gaussians, seconds_per_view, .. } = &self.evaluation;
        let mut scores: Vec<(&str, Scores)> = views.iter().map(|view| (view.name.as_str(), view.scores)).collect();
        scores.push(("mean", self.evaluation.scores()));
        let is_known = |metric: &&Metric| scores.iter().any(|(_, scores)| metric.of(scores).is_some());
        let shown: Vec<&Metric> = METRICS.iter().filter(is_known).collect();
        let line = |cell: &dyn Fn(&Metric) -> String| -> String {
            let cells: Vec<String> =
                shown.iter().map(|metric| format!("{:>1$}", cell(metric), width(metric))).collect();
            cells.join("  ")
        };
        let mut rows = vec![("view", line(&|metric| metric.title.to_owned()))];
        rows.extend(scores.iter().map(|(name, scores)| (*name, line(&|metric| metric.text(metric.of(scores))))));
        rows.extend(worst.iter().map(|worst| ("worst", worst.clone())));
        rows.extend(self.popping.map(|popping| {
            let Popping { flip_1, flip_7, frames, pixels_compared, jumps } = popping;
            let [of_1, of_7] = pixels_compared.map(|share| 100.0 * share);
            let mut text = format!(
                "FLIP_1 {flip_1:.4}, FLIP_7 {flip_7:.4} over {frames} frames, {of_1:.0} % and {of_7:.0} % of the pixels"
            );
            if let Some(Jumps { jumps_8, jumps_16, jumps_frames, .. }) = jumps {
                text += &format!("; jumps > 8 {jumps_8:.4}, > 16 {jumps_16:.4} over {jumps_frames} frames");
            }
            ("popping", text)
        }));
        rows.extend(notes);
        rows.push(("scene", format!("{surfels} surfels, {gaussians} Gaussians, {:.1} MB", self.bytes as f64 / 1e6)));
        rows.extend(coverage.map(|share| ("coverage", format!("surfels cover {:.0} % of the pixels", 100.0 * share))));
        if let Some(Floaters { surfels, gaussians }) = self.floaters {
            rows.push(("floaters", format!("{surfels} surfels, {gaussians} Gaussians")));
        }
        rows.extend(self.training_seconds.map(|seconds| ("training", Seconds(seconds).to_string())));
        rows.push(("rendering", format!("{:.1} ms per view", 1e3 * seconds_per_view)));
        rows.extend(self.frame_ms.as_ref().map(|times| {
            let FrameMs { p50, p99, device, width, height, renderer } = times;
            ("frames", format!("p50 {p50:.2} ms, p99 {p99:.2} ms at {width}x{height} px by `{renderer}` on {device}"))
        }));
        rows.extend(self.peak_memory_bytes.map(|bytes| ("memory", format!("{:.0} MB at most", bytes as f64 / 1e6))));
        rows
    }
}

impl Evaluation {
    /// The means, as those of held-out views.
    pub fn held_out_rows(&self) -> Vec<(&'static str, String)> {
        let Self { psnr, ssim, flip, perceptual, fitted, seconds_per_view, views, .. } = self;
        let mut rows = vec![
            ("held-out PSNR", format!("{psnr:.2} dB (mean of {} views)", views.len())),
            ("held-out SSIM", format!("{ssim:.4}")),
            ("held-out FLIP", format!("{flip:.4}")),
        ];
        rows.extend(perceptual.ms_ssim.map(|value| ("held-out MS-SSIM", format!("{value:.4}"))));
        rows.extend(perceptual.ssimulacra2.map(|value| ("held-out SSIMULACRA2", format!("{value:.2}"))));
        rows.extend(fitted.psnr_fitted.map(|value| ("fitted PSNR", format!("{value:.2} dB, after a fit of exposure"))));
        rows.extend(fitted.ssim_fitted.map(|value| ("fitted SSIM", format!("{value:.4}"))));
        rows.push(("rendering", format!("{:.1} ms per view", 1e3 * seconds_per_view)));
        rows
    }
}

/// Width of a column, characters.
fn width(metric: &Metric) -> usize {
    metric.title.len().max("-100.00".len() + metric.unit.len())
}
