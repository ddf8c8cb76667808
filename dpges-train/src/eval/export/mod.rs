//! Files for other programs: what needs a device or a dataset. The formats are those of [`dpges_render::export`].

pub mod format;
pub mod mesh;
pub mod page;
pub mod splats;

use dpges_render::export::ExportError;

/// Why there is no file.
#[derive(Debug, thiserror::Error)]
pub enum ExportFailure {
    #[error(transparent)]
    Export(#[from] ExportError),
    #[error(transparent)]
    Core(#[from] dpges_core::Error),
}
