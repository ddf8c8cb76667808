//! Errors of scenes, cameras and devices.

use dpges_core::scene::Rendering;

use crate::options::Display;

pub type Result<T, E = RenderError> = std::result::Result<T, E>;

#[derive(Debug, thiserror::Error)]
pub enum RenderError {
    /// A camera or an option that cannot be.
    #[error(transparent)]
    Input(#[from] dpges_core::Error),
    #[error("{count} {what} are more than the {most} that fit into a texture of this device (side {side_px} px)")]
    TooMany { what: &'static str, count: usize, most: usize, side_px: u32 },
    #[error("a picture of {width} x {height} px is larger than this device can make, which is {side_px} px a side")]
    PictureTooLarge { width: usize, height: usize, side_px: u32 },
    #[error("there is nothing to render: upload a scene first")]
    NoScene,
    #[error("{display} cannot be shown of a scene of blended {rendering}: it has no peeled surfels")]
    Display { display: Display, rendering: Rendering },
    #[error("no graphics adapter was found ({0}): install a driver for Vulkan, Metal, DX12 or GL")]
    NoAdapter(String),
    #[error("the graphics adapter `{adapter}` cannot be used: {reason}")]
    Adapter { adapter: String, reason: String },
    #[error("the graphics device failed: {0}")]
    Device(String),
}
