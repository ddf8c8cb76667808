//! Measures of how alike two pictures look. PSNR and SSIM are in [`dpges_core::metrics`]. `docs/guide/measure.md` says what each
//! means.

mod flip;
pub mod lpips;
mod ms_ssim;
mod plane;
mod scores;
mod ssimulacra2;
#[cfg(test)]
pub mod test_pictures;

pub use self::ssimulacra2::ssimulacra2;
pub use flip::{flip, flip_map};
pub use ms_ssim::ms_ssim;
pub use scores::{Fitted, METRICS, Metric, Perceptual, Scores, further_metrics};
