//! Measures of a scene, and how people read them.

use super::spread::Spread;

/// A number that rows have.
#[derive(Debug)]
pub struct Measure {
    /// As JSON and CSV call it.
    pub key: &'static str,
    /// As people call it, with the unit that they read it in.
    pub title: &'static str,
    /// Factor for readers, and the digits behind the point that they see.
    scale: f64,
    digits: usize,
    /// Digits in CSV; whole numbers have none.
    exact_digits: usize,
    /// Whether people see how it spreads over seeds.
    spreads: bool,
    /// Whether the printed table has it; the page and the files have all.
    pub is_printed: bool,
    /// Of the plot of PSNR against it, if there is one: its name in file names, and the title of the axis.
    pub plot: Option<(&'static str, &'static str)>,
}

/// All of them, in the order of columns: the quality of pictures, of which the names are those of
/// [`METRICS`](dpges_train::metrics::METRICS), popping, validation views, then costs.
pub static MEASURES: [Measure; 32] = [
    quality("psnr", "PSNR, dB", 2),
    quality("ssim", "SSIM", 4),
    quality("flip", "FLIP", 4),
    quality("ms_ssim", "MS-SSIM", 4),
    quality("ssimulacra2", "SSIMULACRA2", 2),
    quality("lpips_alex", "LPIPS (Alex)", 4),
    quality("lpips_vgg", "LPIPS (VGG)", 4),
    quality("lpips_vgg_unscaled", "LPIPS (VGG, 0 to 1)", 4),
    quality("psnr_fitted", "fitted PSNR", 2),
    quality("ssim_fitted", "fitted SSIM", 4),
    quality("psnr_posed", "posed PSNR", 2),
    quality("ssim_posed", "posed SSIM", 4),
    quality("flip_1", "FLIP_1", 4),
    quality("flip_7", "FLIP_7", 4),
    quality("jumps_8", "jumps > 8", 4),
    quality("jumps_16", "jumps > 16", 4).on_the_page(),
    quality("validation_psnr", "validation PSNR", 2),
    quality("validation_ssim", "validation SSIM", 4),
    cost("frame_ms", "frame, ms", 1.0, 2, 4).plotted("frame_time", "median frame time, ms"),
    cost("frame_p99_ms", "99 %, ms", 1.0, 2, 4).on_the_page(),
    cost("frames", "frames", 1.0, 0, 0).on_the_page(),
    cost("frames_per_second", "frames/s", 1.0, 1, 2).on_the_page(),
    cost("longest_px", "longest side, px", 1.0, 0, 0).on_the_page(),
    cost("surfels", "surfels", 1.0, 0, 0),
    cost("gaussians", "Gaussians", 1.0, 0, 0),
    cost("primitives", "primitives", 1.0, 0, 0).on_the_page(),
    cost("coverage", "covered by surfels, %", 100.0, 0, 2).on_the_page(),
    cost("floaters", "floaters", 1.0, 0, 0),
    cost("bytes", "MB", 1e-6, 2, 0).plotted("bytes", "scene file, MB"),
    cost("gpu_bytes", "GPU, MB", 1e-6, 1, 0).on_the_page(),
    cost("training_seconds", "training, s", 1.0, 0, 1).plotted("training_time", "training time, s"),
    cost("training_peak_bytes", "training, MB", 1e-6, 0, 0)
        .on_the_page()
        .plotted("training_memory", "largest memory of the process in training, MB"),
];

const fn quality(key: &'static str, title: &'static str, digits: usize) -> Measure {
    Measure { key, title, scale: 1.0, digits, exact_digits: digits + 2, spreads: true, is_printed: true, plot: None }
}

const fn cost(key: &'static str, title: &'static str, scale: f64, digits: usize, exact_digits: usize) -> Measure {
    Measure { key, title, scale, digits, exact_digits, spreads: false, is_printed: true, plot: None }
}

/// The measure that is called `key`.
///
/// # Panics
/// If there is none.
pub fn measure(key: &str) -> &'static Measure {
    MEASURES.iter().find(|measure| measure.key == key).unwrap_or_else(|| panic!("no measure `{key}` is declared"))
}

impl Measure {
    const fn on_the_page(self) -> Self {
        Self { is_printed: false, ..self }
    }

    const fn plotted(self, name: &'static str, title: &'static str) -> Self {
        Self { plot: Some((name, title)), ..self }
    }

    /// Whether its values are whole numbers.
    pub fn is_whole(&self) -> bool {
        self.exact_digits == 0
    }

    /// In the unit that people read.
    pub fn scaled(&self, Spread { mean, deviation }: Spread) -> Spread {
        Spread { mean: self.scale * mean, deviation: deviation.map(|deviation| self.scale * deviation) }
    }

    /// `spread` as people read it, without the unit.
    pub fn text(&self, spread: Spread) -> String {
        let Spread { mean, deviation } = self.scaled(spread);
        format!("{:.*}", self.digits, Spread { mean, deviation: deviation.filter(|_| self.spreads) })
    }

    /// `value` as CSV has it.
    pub fn exact(&self, value: f64) -> String {
        format!("{value:.*}", self.exact_digits)
    }
}

#[cfg(test)]
mod tests {
    use std::collections::HashSet;

    use dpges_train::metrics::METRICS;

    use super::*;

    #[test]
    fn every_metric_of_an_evaluation_is_a_measure_and_keys_differ() {
        assert!(METRICS.iter().all(|metric| measure(metric.key).spreads));
        assert_eq!(MEASURES.iter().map(|measure| measure.key).collect::<HashSet<_>>().len(), MEASURES.len());
        let texts = |key: &str, mean: f64| {
            let spread = Spread { mean, deviation: Some(mean / 2.0) };
            (measure(key).text(spread), measure(key).exact(mean))
        };
        assert_eq!(texts("bytes", 6_704_000.0), ("6.70".to_owned(), "6704000".to_owned()));
        assert_eq!(texts("psnr", 20.126), ("20.13 ± 10.06".to_owned(), "20.1260".to_owned()));
    }
}
