//! A *splat*: the ellipse that a Gaussian projects to (EWA). `cpu` and `cube` are twins. So is its `student` in each: the
//! same ellipse with a kernel of Student's t distribution and an opacity of either sign (SSS).

pub(crate) mod cpu;
#[cfg(feature = "gpu")]
pub(crate) mod cube;
pub(crate) mod tensors;

/// How far a Student's t kernel is drawn by its degrees of freedom ν, in standard deviations of the major axis: the
/// two-sided quantiles of 99 % for ν = 1, 2, 3 … (SSS). From one whole number to the next the published rule rises from the
/// quantile of ν + 1 to that of ν, and falls back.
pub(crate) const STUDENT_REACH: [f64; 13] =
    [63.657, 9.925, 5.841, 4.604, 4.032, 3.707, 3.499, 3.355, 3.250, 3.169, 3.106, 3.055, 3.012];
/// The reach for larger ν.
pub(crate) const STUDENT_LEAST_REACH: f64 = 3.0;
/// Least difference, squared, of an eigenvalue of a projected covariance to their mean, px⁴ (3DGS).
pub(crate) const STUDENT_LEAST_SPREAD: f64 = 0.1;
