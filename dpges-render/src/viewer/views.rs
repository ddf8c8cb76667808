//! The cameras of a dataset, and what they took.

use dpges_core::camera::Camera;

use crate::Rgb8Image;

/// The photograph of a view, by its place in the list; `None` if there is none.
pub type Photograph = Box<dyn Fn(usize) -> Option<Rgb8Image> + Send>;

/// Cameras that one can fly to, and the photographs to compare the scene with.
pub struct DatasetViews {
    /// Names and cameras, in the coordinates of the scene.
    pub cameras: Vec<(String, Camera)>,
    /// A photograph has the size of its camera.
    pub photograph: Photograph,
}

pub enum Views {
    None,
    Ready(DatasetViews),
    /// Read on a thread of its own while the scene is shown already; the error is what the window says.
    Later(ReadViews),
}

pub type ReadViews = Box<dyn FnOnce() -> Result<DatasetViews, String> + Send>;
