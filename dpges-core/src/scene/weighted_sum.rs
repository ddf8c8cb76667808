//! The numbers that all Gaussians of a weighted sum share.

use serde::{Deserialize, Serialize};

/// How a weighted sum weighs a Gaussian by its depth d (Hou et al., "Sort-free Gaussian Splatting via Weighted Sum
/// Rendering").
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Hash, Serialize, Deserialize)]
pub enum DepthWeight {
    /// 1 (DIR-WSR).
    #[serde(rename = "dir")]
    Direct,
    /// exp(−σ d^β) (EXP-WSR).
    #[serde(rename = "exp")]
    Exponential,
    /// max(0, 1 − d / σ) (LC-WSR).
    #[default]
    #[serde(rename = "lc")]
    Linear,
}

/// A picture as a weighted sum of Gaussians, which needs no order:
///
/// `C = (w_b C_b + Σ α_i w(d_i) c_i) / (w_b + Σ α_i w(d_i))`, where α_i is the opacity of a Gaussian times a factor that
/// depends on the direction it is seen from, at least 0, times its footprint, and w its [`DepthWeight`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct WeightedSum {
    pub weight: DepthWeight,
    /// σ: world units with [`DepthWeight::Linear`], per world unit to the power of β with [`DepthWeight::Exponential`].
    pub sigma: f32,
    /// β, of [`DepthWeight::Exponential`].
    pub beta: f32,
    /// w_b: weight of the background.
    pub background: f32,
}

impl WeightedSum {
    /// Smallest weight of the background that is used, so that no pixel is divided by 0.
    pub const LEAST_BACKGROUND: f64 = 1e-4;
    /// Smallest σ that is used.
    pub const LEAST_SIGMA: f64 = 1e-6;

    pub(super) fn is_finite(&self) -> bool {
        [self.sigma, self.beta, self.background].iter().all(|value| value.is_finite())
    }
}

impl Default for WeightedSum {
    fn default() -> Self {
        Self { weight: DepthWeight::default(), sigma: 10.0, beta: 1.0, background: 0.02 }
    }
}
