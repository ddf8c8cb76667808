//! Measures of how alike two pictures look. `docs/guide/measure.md` says what each means.

mod flip;
pub mod lpips;
#[cfg(test)]
mod masked;
mod ms_ssim;
mod plane;
mod psnr;
mod scores;
mod ssim;
mod ssimulacra2;
#[cfg(test)]
pub mod test_pictures;

pub use self::ssimulacra2::ssimulacra2;
pub use flip::{flip, flip_map};
pub use ms_ssim::ms_ssim;
pub use psnr::{psnr, quantised};
pub use scores::{Fitted, METRICS, Metric, Perceptual, Scores};
pub use ssim::{OF_IGNORED_PIXELS, mean_ssim};
