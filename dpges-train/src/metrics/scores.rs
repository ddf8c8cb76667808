//! Scores of a view, or means over views, and their presentation.

use serde::{Deserialize, Serialize};

use super::lpips::Network;

/// Metrics that take longer than PSNR, SSIM and FLIP. Each is absent where it was not measured or the picture is too
/// small for it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Perceptual {
    /// From 0 to 1.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ms_ssim: Option<f64>,
    /// At most 100.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ssimulacra2: Option<f64>,
    /// An error by the features of AlexNet.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub lpips_alex: Option<f64>,
    /// An error by the features of VGG16.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub lpips_vgg: Option<f64>,
}

/// PSNR and SSIM of the right half of a picture after something was fitted to its left half. Absent where they were not
/// measured or the picture has no two halves.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Fitted {
    /// After the exposure that fits best was applied, dB.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub psnr_fitted: Option<f64>,
    /// Likewise.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ssim_fitted: Option<f64>,
    /// From the camera that fits best, and after the exposure if that is fitted as well, dB.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub psnr_posed: Option<f64>,
    /// Likewise.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ssim_posed: Option<f64>,
}

/// The quality of a picture, or its mean over pictures.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Scores {
    /// dB
    pub psnr: f64,
    pub ssim: f64,
    /// An error, from 0 to 1.
    pub flip: f64,
    #[serde(flatten)]
    pub perceptual: Perceptual,
    #[serde(flatten)]
    pub fitted: Fitted,
}

/// One of the numbers in [`Scores`].
#[derive(Clone, Copy, Debug)]
pub struct Metric {
    /// As JSON, CSV and file names call it.
    pub key: &'static str,
    /// As people call it.
    pub title: &'static str,
    /// Unit behind its values, with a space, or nothing.
    pub unit: &'static str,
    /// Digits behind the point.
    pub digits: usize,
    /// Whether less is better.
    pub is_error: bool,
    of: fn(&Scores) -> Option<f64>,
}

/// All of them, in the order in which they are shown: three that every evaluation has, then those of [`Perceptual`] and of
/// [`Fitted`].
pub static METRICS: [Metric; 11] = [
    Metric::new("psnr", "PSNR", 2, |scores| Some(scores.psnr)).in_decibels(),
    Metric::new("ssim", "SSIM", 4, |scores| Some(scores.ssim)),
    Metric::new("flip", "FLIP", 4, |scores| Some(scores.flip)).less_is_better(),
    Metric::new("ms_ssim", "MS-SSIM", 4, |scores| scores.perceptual.ms_ssim),
    Metric::new("ssimulacra2", "SSIMULACRA2", 2, |scores| scores.perceptual.ssimulacra2),
    Metric::new("lpips_alex", "LPIPS (Alex)", 4, |scores| scores.perceptual.lpips_alex).less_is_better(),
    Metric::new("lpips_vgg", "LPIPS (VGG)", 4, |scores| scores.perceptual.lpips_vgg).less_is_better(),
    Metric::new("psnr_fitted", "fitted PSNR", 2, |scores| scores.fitted.psnr_fitted).in_decibels(),
    Metric::new("ssim_fitted", "fitted SSIM", 4, |scores| scores.fitted.ssim_fitted),
    Metric::new("psnr_posed", "posed PSNR", 2, |scores| scores.fitted.psnr_posed).in_decibels(),
    Metric::new("ssim_posed", "posed SSIM", 4, |scores| scores.fitted.ssim_posed),
];

impl Perceptual {
    pub fn lpips_mut(&mut self, network: Network) -> &mut Option<f64> {
        match network {
            Network::Alex => &mut self.lpips_alex,
            Network::Vgg => &mut self.lpips_vgg,
        }
    }
}

impl Scores {
    /// The mean over `views`, of which there is at least one; of what may be absent where every view has it.
    pub fn mean(views: &[Self]) -> Self {
        let mean = |of: fn(&Self) -> f64| views.iter().map(of).sum::<f64>() / views.len() as f64;
        let if_known = |of: fn(&Self) -> Option<f64>| mean_if_known(views.iter().map(of));
        Self {
            psnr: mean(|view| view.psnr),
            ssim: mean(|view| view.ssim),
            flip: mean(|view| view.flip),
            perceptual: Perceptual {
                ms_ssim: if_known(|view| view.perceptual.ms_ssim),
                ssimulacra2: if_known(|view| view.perceptual.ssimulacra2),
                lpips_alex: if_known(|view| view.perceptual.lpips_alex),
                lpips_vgg: if_known(|view| view.perceptual.lpips_vgg),
            },
            fitted: Fitted {
                psnr_fitted: if_known(|view| view.fitted.psnr_fitted),
                ssim_fitted: if_known(|view| view.fitted.ssim_fitted),
                psnr_posed: if_known(|view| view.fitted.psnr_posed),
                ssim_posed: if_known(|view| view.fitted.ssim_posed),
            },
        }
    }
}

/// `None` if one of `values` is absent, or there are none.
fn mean_if_known(values: impl Iterator<Item = Option<f64>>) -> Option<f64> {
    let values = values.collect::<Option<Vec<f64>>>().filter(|values| !values.is_empty())?;
    Some(values.iter().sum::<f64>() / values.len() as f64)
}

impl Metric {
    const fn new(key: &'static str, title: &'static str, digits: usize, of: fn(&Scores) -> Option<f64>) -> Self {
        Self { key, title, unit: "", digits, is_error: false, of }
    }

    const fn in_decibels(self) -> Self {
        Self { unit: " dB", ..self }
    }

    const fn less_is_better(self) -> Self {
        Self { is_error: true, ..self }
    }

    /// Its value; `None` if it is absent.
    pub fn of(&self, scores: &Scores) -> Option<f64> {
        (self.of)(scores)
    }

    /// Which of `views` it finds worst, the first of equals; `None` if no view has it.
    pub fn worst(&self, views: &[Scores]) -> Option<usize> {
        let badness = |index: usize| self.of(&views[index]).map(|value| if self.is_error { value } else { -value });
        let known = (0..views.len()).filter_map(|index| Some((index, badness(index)?)));
        known.reduce(|worst, other| if other.1 > worst.1 { other } else { worst }).map(|(index, _)| index)
    }

    /// `value` with its unit, or a dash if it is absent.
    pub fn text(&self, value: Option<f64>) -> String {
        value.map_or_else(|| "—".to_owned(), |value| format!("{value:.*}{}", self.digits, self.unit))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn scores(psnr: f64, flip: f64, ssimulacra2: Option<f64>) -> Scores {
        let perceptual = Perceptual { ssimulacra2, ..Perceptual::default() };
        Scores { psnr, ssim: 0.5, flip, perceptual, fitted: Fitted::default() }
    }

    #[test]
    fn the_worst_view_has_the_least_quality_or_the_largest_error() {
        let views = [scores(20.0, 0.1, None), scores(10.0, 0.2, Some(-3.0)), scores(10.0, 0.3, Some(40.0))];
        let worst = |key: &str| METRICS.iter().find(|metric| metric.key == key).unwrap().worst(&views);
        assert_eq!(
            ["psnr", "ssim", "flip", "ssimulacra2", "ms_ssim"].map(worst),
            [Some(1), Some(0), Some(2), Some(1), None]
        );
        assert_eq!(METRICS[0].worst(&[]), None);
    }

    #[test]
    fn a_mean_is_over_all_views_or_absent() {
        let one = Scores {
            perceptual: Perceptual { ms_ssim: Some(0.5), ssimulacra2: Some(10.0), ..Perceptual::default() },
            fitted: Fitted { psnr_fitted: Some(20.0), ssim_fitted: Some(0.5), psnr_posed: Some(1.0), ssim_posed: None },
            ..scores(20.0, 0.25, None)
        };
        let other = Scores {
            fitted: Fitted { psnr_fitted: Some(30.0), psnr_posed: Some(2.0), ..Fitted::default() },
            ..scores(40.0, 0.75, Some(30.0))
        };
        let mean = Scores {
            fitted: Fitted { psnr_fitted: Some(25.0), psnr_posed: Some(1.5), ..Fitted::default() },
            ..scores(30.0, 0.5, Some(20.0))
        };
        assert_eq!(Scores::mean(&[one, other]), mean);
    }

    #[test]
    fn keys_are_those_of_json_and_what_is_absent_has_none() {
        let all =
            Perceptual { ms_ssim: Some(0.5), ssimulacra2: Some(50.0), lpips_alex: Some(0.25), lpips_vgg: Some(0.125) };
        let fitted =
            Fitted { psnr_fitted: Some(21.0), ssim_fitted: Some(0.8), psnr_posed: Some(22.0), ssim_posed: Some(0.85) };
        let whole = Scores { psnr: 20.0, ssim: 0.75, flip: 0.1, perceptual: all, fitted };
        let json = serde_json::to_value(whole).unwrap();
        assert_eq!(json.as_object().unwrap().len(), METRICS.len());
        for metric in &METRICS {
            assert_eq!(json[metric.key].as_f64(), metric.of(&whole), "{}", metric.key);
        }
        assert_eq!(serde_json::from_value::<Scores>(json).unwrap(), whole);
        let basic = scores(20.0, 0.25, None);
        assert!(METRICS[3..].iter().all(|metric| metric.of(&basic).is_none()));
        let few = serde_json::to_string(&basic).unwrap();
        assert_eq!(few, r#"{"psnr":20.0,"ssim":0.5,"flip":0.25}"#);
        assert_eq!(serde_json::from_str::<Scores>(&few).unwrap(), scores(20.0, 0.25, None));
    }

    #[test]
    fn values_have_their_units_and_digits() {
        assert_eq!(METRICS[0].text(Some(23.456)), "23.46 dB");
        assert_eq!(METRICS[1].text(Some(0.98767)), "0.9877");
        assert_eq!(METRICS[3].text(None), "—");
    }
}
