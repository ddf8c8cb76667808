//! The alpha of a photograph: laid over a background, or a mask.

use image::DynamicImage;

use crate::Picture;

/// Alpha, of 255, from which on a pixel counts, where alpha is a mask.
const COUNTS: u8 = 128;

/// The meaning of the alpha of images.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Alpha {
    /// How much of the photograph covers this background.
    Matte([f64; 3]),
    /// Which pixels count.
    Mask,
}

impl Alpha {
    /// The picture in `image`. A matte, which is not premultiplied, is composited in float, `alpha · colour + (1 − alpha) ·
    /// background`, then rounded. Where alpha is a mask, colour is as stored, and pixels of less than half alpha do not count.
    pub(crate) fn applied(self, image: DynamicImage) -> Picture {
        let (width, height) = (image.width() as usize, image.height() as usize);
        if !image.color().has_alpha() {
            return Picture { width, height, bytes: image.into_rgb8().into_raw(), alpha: None, counted: None };
        }
        let rgba = image.into_rgba8().into_raw();
        let pixels = rgba.as_chunks::<4>().0;
        match self {
            Self::Mask => {
                let bytes = pixels.iter().flat_map(|&[red, green, blue, _]| [red, green, blue]).collect();
                let counted: Vec<bool> = pixels.iter().map(|&[.., alpha]| alpha >= COUNTS).collect();
                Picture { width, height, bytes, alpha: None, counted: Some(counted).filter(|all| all.contains(&false)) }
            }
            Self::Matte(background) => {
                let composited = |&[colour @ .., alpha]: &[u8; 4]| -> [u8; 3] {
                    let alpha = f32::from(alpha) / 255.0;
                    let over = |colour: u8, background: f64| {
                        (alpha * f32::from(colour) + (1.0 - alpha) * 255.0 * background as f32).round() as u8
                    };
                    std::array::from_fn(|channel| over(colour[channel], background[channel]))
                };
                let bytes = pixels.iter().flat_map(composited).collect();
                let alpha = pixels.iter().map(|&[.., alpha]| alpha).collect();
                Picture { width, height, bytes, alpha: Some(alpha), counted: None }
            }
        }
    }
}
