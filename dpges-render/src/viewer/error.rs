//! Why there is no window, or no longer one.

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

/// The last part of a message, without the places in source files that winit puts before it.
fn cause(message: &str) -> String {
    message.rsplit(": ").next().unwrap_or(message).trim_end_matches('.').to_owned()
}

impl From<eframe::Error> for ViewerError {
    fn from(error: eframe::Error) -> Self {
        let reason = error.to_string();
        match error {
            eframe::Error::WinitEventLoop(_) => Self::NoDisplay { reason: cause(&reason) },
            eframe::Error::Wgpu(_) => Self::NoGpu { reason },
            _ => Self::Window { reason },
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_cause_is_what_is_said() {
        let message = "winit EventLoopError: os error at src/linux/mod.rs:765: neither DISPLAY nor another is set.";
        assert_eq!(cause(message), "neither DISPLAY nor another is set");
        assert_eq!(cause("no display"), "no display");
    }
}
