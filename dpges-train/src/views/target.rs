//! Photographs on a device, where renders are compared with them.

use burn::tensor::{DType, Device, Int, Tensor, TensorData};
use dpges_core::backend::device::is_gpu;
use dpges_core::counters::transfers::upload;
use dpges_core::losses::{PackedMask, Target};
use dpges_core::ops::unpack::{pack, unpack};

use crate::dataset::Picture;

/// The photograph that a render is compared with.
pub trait ToTarget {
    /// The picture on `device`, and which of its pixels count. It goes to a GPU with 8 bits per value.
    ///
    /// # Panics
    /// If no pixel counts.
    fn target(&self, device: &Device) -> Target;
}

impl ToTarget for Picture {
    fn target(&self, device: &Device) -> Target {
        if is_gpu(device) {
            return PackedPicture::new(self, device).target();
        }
        let shape = [3, self.height, self.width];
        let image = Tensor::from_data(upload(TensorData::new(self.planes(), shape)), (device, DType::F32));
        Target { image, mask: mask(self, device).map(|mask| mask.mask()) }
    }
}

/// Which of the pixels count, on `device`; `None` if all do.
///
/// # Panics
/// If no pixel counts.
fn mask(picture: &Picture, device: &Device) -> Option<PackedMask> {
    picture.counted.as_ref().map(|counted| {
        let mask = PackedMask::new(counted, picture.width, picture.height, device);
        mask.expect("a mask of this size in which a pixel counts")
    })
}

/// A picture that stays on a device, and which of its pixels count.
#[derive(Clone, Debug)]
pub struct PackedPicture {
    /// [⌈3 H W / 4⌉] red, green and blue of every pixel, row by row.
    words: Tensor<1, Int>,
    /// 3, height, width.
    shape: [usize; 3],
    mask: Option<PackedMask>,
    /// Whether its [`target`](Self::target) is on a tape.
    on_tape: bool,
}

impl PackedPicture {
    /// The `picture` on `device`.
    ///
    /// # Panics
    /// If no pixel counts.
    pub fn new(picture: &Picture, device: &Device) -> Self {
        Self {
            words: pack(&picture.bytes, &device.clone().inner()),
            shape: [3, picture.height, picture.width],
            mask: mask(picture, device),
            on_tape: device.is_autodiff(),
        }
    }

    /// Size on the device, bytes.
    pub fn size_bytes(picture: &Picture) -> usize {
        let mask = if picture.counted.is_some() { PackedMask::size_bytes(picture.area()) } else { 0 };
        picture.bytes.len().next_multiple_of(size_of::<i32>()) + mask
    }

    /// The picture to compare a render with, to the bit what [`ToTarget::target`] has.
    pub fn target(&self) -> Target {
        let image = unpack(&self.words, self.shape).expect("words are those of this shape");
        let image = if self.on_tape { image.autodiff() } else { image };
        Target { image, mask: self.mask.as_ref().map(PackedMask::mask) }
    }
}

#[cfg(test)]
mod tests {
    use dpges_core::scene::tensors::tensor_to_rows;

    use super::*;
    use crate::run::fixtures::device;

    #[test]
    fn a_packed_picture_is_the_picture_to_the_bit() {
        let bytes = (0..3 * 7 * 5).map(|at| (at * 53 % 256) as u8).collect();
        let counted = Some((0..7 * 5).map(|pixel| pixel % 3 > 0).collect());
        for counted in [None, counted] {
            let picture = Picture { width: 7, height: 5, bytes: Vec::clone(&bytes), alpha: None, counted };
            for device in [device(), device().autodiff()] {
                let (found, expected) = (PackedPicture::new(&picture, &device).target(), picture.target(&device));
                assert_eq!((found.image.dims(), found.image.is_autodiff()), ([3, 5, 7], device.is_autodiff()));
                let [found_rows, expected_rows] = [&found, &expected].map(|target| tensor_to_rows(&target.image));
                assert_eq!(found_rows, expected_rows);
                let mask = found.mask.map(|mask| {
                    let counted = mask.filled(found.image.ones_like(), 0.0);
                    (tensor_to_rows(&counted.slice([0..1, 0..5, 0..7])), mask.pixels_per_counted())
                });
                let expected = picture.counted.as_ref().map(|counted| {
                    let ones: Vec<f32> = counted.iter().map(|&counts| if counts { 1.0 } else { 0.0 }).collect();
                    let count = ones.iter().sum::<f32>();
                    (ones, 35.0 / f64::from(count))
                });
                assert_eq!(mask, expected);
            }
            let mask = if picture.counted.is_some() { 36 } else { 0 };
            assert_eq!(PackedPicture::size_bytes(&picture), 108 + mask);
        }
    }
}
