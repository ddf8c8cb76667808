//! Targets of renders: photographs, and the pixels that count.

use burn::tensor::{Device, Int, Tensor};

use crate::error::{Error, Result};
use crate::ops::unpack::{pack, unpack};

/// Which pixels of a view count, on a device.
#[derive(Clone, Debug)]
pub struct Mask {
    /// [1, H, W] 1 where a pixel does not count, else 0.
    ignored: Tensor<3>,
    /// Number of all pixels over the number of those that count.
    pixels_per_counted: f64,
}

impl Mask {
    /// `counted` [H × W], row by row: whether a pixel of a view of `width` × `height` px counts.
    ///
    /// # Errors
    /// [`Error::Shape`] if these are not as many pixels, [`Error::Option`] if none of them counts.
    pub fn new(counted: &[bool], width: usize, height: usize, device: &Device) -> Result<Self> {
        Ok(PackedMask::new(counted, width, height, device)?.mask())
    }

    /// The same without a tape.
    #[must_use]
    pub fn inner(self) -> Self {
        Self { ignored: self.ignored.inner(), ..self }
    }

    /// `image` [C, H, W] with `value`, without gradient, where pixels do not count.
    pub fn filled(&self, image: Tensor<3>, value: f64) -> Tensor<3> {
        let ignored = self.ignored.clone().repeat_dim(0, image.dims()[0]).greater_elem(0.5);
        image.mask_fill(ignored, value)
    }

    /// The mean `[1]` over the pixels that count, from `mean` over all pixels of what is 0 where they do not.
    pub fn of_counted(&self, mean: Tensor<1>) -> Tensor<1> {
        mean * self.pixels_per_counted
    }

    /// Number of all pixels over the number of those that count.
    pub fn pixels_per_counted(&self) -> f64 {
        self.pixels_per_counted
    }
}

/// A [`Mask`] that stays on a device, 8 bits per pixel.
#[derive(Clone, Debug)]
pub struct PackedMask {
    /// [⌈H W / 4⌉] 255 where a pixel does not count, else 0, off the tape.
    words: Tensor<1, Int>,
    /// 1, H, W
    shape: [usize; 3],
    pixels_per_counted: f64,
    /// Whether its [`mask`](Self::mask) is on a tape.
    on_tape: bool,
}

impl PackedMask {
    /// `counted` [H × W], row by row: whether a pixel of a view of `width` × `height` px counts.
    ///
    /// # Errors
    /// [`Error::Shape`] if these are not as many pixels, [`Error::Option`] if none of them counts.
    pub fn new(counted: &[bool], width: usize, height: usize, device: &Device) -> Result<Self> {
        if counted.len() != width * height {
            let (expected, found) = (format!("[{height} × {width}]"), vec![counted.len()]);
            return Err(Error::Shape { tensor: "mask".to_owned(), expected, found });
        }
        let count = counted.iter().filter(|&&counts| counts).count();
        if count == 0 {
            let expected = "a pixel that counts".to_owned();
            return Err(Error::Option { option: "mask", expected, found: "none".to_owned() });
        }
        let ignored: Vec<u8> = counted.iter().map(|&counts| if counts { 0 } else { u8::MAX }).collect();
        Ok(Self {
            words: pack(&ignored, &device.clone().inner()),
            shape: [1, height, width],
            pixels_per_counted: counted.len() as f64 / count as f64,
            on_tape: device.is_autodiff(),
        })
    }

    /// Size on the device of the mask of a view of so many pixels, bytes.
    pub fn size_bytes(pixels: usize) -> usize {
        pixels.next_multiple_of(size_of::<i32>())
    }

    pub fn mask(&self) -> Mask {
        let ignored = unpack(&self.words, self.shape).expect("words are those of this shape");
        let ignored = if self.on_tape { ignored.autodiff() } else { ignored };
        Mask { ignored, pixels_per_counted: self.pixels_per_counted }
    }
}

/// Mean `[1]` of `values` [C, H, W] over the pixels that count.
pub fn mean_of_counted(values: Tensor<3>, mask: Option<&Mask>) -> Tensor<1> {
    match mask {
        None => values.mean(),
        Some(mask) => mask.of_counted(mask.filled(values, 0.0).mean()),
    }
}

/// A photograph, and which of its pixels count.
#[derive(Clone, Debug)]
pub struct Target {
    /// [3, H, W]
    pub image: Tensor<3>,
    /// `None` if all pixels count.
    pub mask: Option<Mask>,
}

impl From<Tensor<3>> for Target {
    /// All pixels count.
    fn from(image: Tensor<3>) -> Self {
        Self { image, mask: None }
    }
}

impl Target {
    /// The same without a tape.
    #[must_use]
    pub fn inner(self) -> Self {
        Self { image: self.image.inner(), mask: self.mask.map(Mask::inner) }
    }

    /// [1, H, W] 1 where a pixel does not count, else 0; `None` if all count.
    pub(super) fn ignored(&self) -> Option<&Tensor<3>> {
        self.mask.as_ref().map(|mask| &mask.ignored)
    }

    /// Number of all pixels over the number of those that count.
    pub(super) fn pixels_per_counted(&self) -> f64 {
        self.mask.as_ref().map_or(1.0, Mask::pixels_per_counted)
    }
}
