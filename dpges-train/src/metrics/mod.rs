//! Measures of how alike two pictures look, on the host. PSNR and SSIM are in [`dpges_core::metrics`].

mod flip;

pub use flip::flip;
