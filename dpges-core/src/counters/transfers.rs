//! Data between host and device, counted at every place of a training step that hands a tensor over or reads one back:
//! photographs, masks, rows of scenes, the numbers of a step.
//!
//! [`upload`] and [`download`] return what they are given. A GPU also hands back the lengths of its tile lists, 4 bytes
//! each. Not counted are the numbers that a launch takes beside its buffers, such as the camera. On a CPU the same places
//! count, though nothing has far to go.

use std::cell::Cell;

use burn::tensor::{DType, Device, Element, Tensor, TensorData};
use serde::Serialize;

/// Transfers between host and device.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Transfers {
    /// Tensors that went to the device.
    pub uploads: u64,
    pub uploaded_bytes: u64,
    /// Tensors that came from the device.
    pub downloads: u64,
    pub downloaded_bytes: u64,
    /// Reads that the host waited for: everything that was handed to the device before had to be done. The lengths of tile
    /// lists are none within [`defer_readback`](crate::tiles::lists::defer_readback), which hands over more work
    /// before it waits for them.
    pub waits: u64,
}

thread_local! {
    static COUNTED: Cell<Transfers> = const {
        Cell::new(Transfers { uploads: 0, uploaded_bytes: 0, downloads: 0, downloaded_bytes: 0, waits: 0 })
    };
}

/// All transfers of this thread so far.
pub fn transfers() -> Transfers {
    COUNTED.get()
}

/// Counts `data` on its way to a device.
pub fn upload(data: TensorData) -> TensorData {
    let before = COUNTED.get();
    let uploaded_bytes = before.uploaded_bytes + data.as_bytes().len() as u64;
    COUNTED.set(Transfers { uploads: before.uploads + 1, uploaded_bytes, ..before });
    data
}

/// A tensor of `numbers` on `device`, counted on their way.
pub fn uploaded<E: Element, const D: usize>(
    numbers: Vec<E>,
    shape: [usize; D],
    device: &Device,
    dtype: DType,
) -> Tensor<D> {
    Tensor::from_data(upload(TensorData::new(numbers, shape).convert_dtype(dtype)), (device, dtype))
}

/// Counts `data` that came from a device.
pub fn download(data: TensorData) -> TensorData {
    let before = COUNTED.get();
    let downloaded_bytes = before.downloaded_bytes + data.as_bytes().len() as u64;
    COUNTED.set(Transfers { downloads: before.downloads + 1, downloaded_bytes, ..before });
    data
}

/// Counts a wait for the device, in which `read` reads something.
pub fn wait<T>(read: impl FnOnce() -> T) -> T {
    let before = COUNTED.get();
    COUNTED.set(Transfers { waits: before.waits + 1, ..before });
    read()
}

impl Transfers {
    /// Transfers since the count was `earlier`.
    #[must_use]
    pub fn since(self, earlier: Self) -> Self {
        Self {
            uploads: self.uploads - earlier.uploads,
            uploaded_bytes: self.uploaded_bytes - earlier.uploaded_bytes,
            downloads: self.downloads - earlier.downloads,
            downloaded_bytes: self.downloaded_bytes - earlier.downloaded_bytes,
            waits: self.waits - earlier.waits,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bytes_and_waits_of_this_thread_are_counted() {
        let before = transfers();
        let up = upload(TensorData::new(vec![1.0f32; 6], [2, 3]));
        let down = wait(|| download(up.clone()));
        assert_eq!(down, up);
        std::thread::spawn(|| upload(TensorData::new(vec![1i64], [1]))).join().unwrap();
        let expected = Transfers { uploads: 1, uploaded_bytes: 24, downloads: 1, downloaded_bytes: 24, waits: 1 };
        assert_eq!(transfers().since(before), expected);
    }
}
