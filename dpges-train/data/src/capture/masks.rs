//! Masks beside the photographs: they go into the dataset, and COLMAP looks for no features where nothing counts.

use std::io::Cursor;
use std::path::{Path, PathBuf};

use image::{GrayImage, ImageFormat};
use rayon::prelude::*;

use super::error::{SfmError, io};
use crate::{DatasetError, image_header, read_mask};

/// The name of the mask of a photograph, for COLMAP and for datasets.
pub(super) fn file_name(photograph: &str) -> String {
    format!("{photograph}.png")
}

/// Writes `masks` of photographs in folder `images` to `folder` as COLMAP reads them: 8-bit grey, black where nothing counts.
/// They are black where the photograph counts if they are `inverted`.
///
/// # Errors
/// [`DatasetError::MaskSize`], [`DatasetError::NothingCounts`] and those of reading images, of the first that has one;
/// [`SfmError::File`].
pub(super) fn write(masks: &[(String, PathBuf)], images: &Path, inverted: bool, folder: &Path) -> Result<(), SfmError> {
    let of = |(name, mask): &(String, PathBuf)| -> Result<(), SfmError> {
        let image = images.join(name);
        let header = image_header(&image)?;
        let counted = read_mask(mask, &image, [header.width, header.height], inverted)?;
        if !counted.contains(&true) {
            return Err(DatasetError::NothingCounts { path: image, view: name.clone() }.into());
        }
        let grey = counted.into_iter().map(|counts| if counts { 255 } else { 0 }).collect();
        let grey = GrayImage::from_raw(header.width as u32, header.height as u32, grey);
        let (grey, mut bytes) = (grey.expect("a value for each pixel"), Vec::new());
        grey.write_to(&mut Cursor::new(&mut bytes), ImageFormat::Png).expect("memory takes any picture");
        let place = folder.join(file_name(name));
        std::fs::write(&place, bytes).map_err(io("cannot write", &place))
    };
    let written: Vec<Result<(), SfmError>> = masks.par_iter().map(of).collect();
    written.into_iter().collect()
}
