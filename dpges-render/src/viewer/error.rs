//! Why there is no window, or no longer one.

/// Why a viewer could not start or go on.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ViewerError {
    #[error(
        "there is no display for a window ({reason}): run it in a desktop session, over `ssh -X`, or under `xvfb-run`; \
         `dpges render` writes pictures without a window"
    )]
    NoDisplay { reason: String },
    #[error(
        "no graphics adapter can draw the window ({reason}): install the driver of the GPU (where there is none, Mesa's \
         software Vulkan, Debian's mesa-vulkan-drivers, does its work)"
    )]
    NoGpu { reason: String },
    #[error("the graphics device failed ({reason}): start the viewer again; a newer driver may help")]
    Device { reason: String },
    #[error("the window failed: {reason}")]
    Window { reason: String },
}

impl From<eframe::Error> for ViewerError {
    fn from(error: eframe::Error) -> Self {
        let reason = error.to_string();
        match error {
            eframe::Error::WinitEventLoop(_) => Self::NoDisplay { reason },
            eframe::Error::Wgpu(_) => Self::NoGpu { reason },
            _ => Self::Window { reason },
        }
    }
}
