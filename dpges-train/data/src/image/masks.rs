//! Which pixels of photographs count: mask files, and what becomes of them where a photograph is made smaller.

use std::fmt;
use std::path::{Path, PathBuf};

use super::codec;
use crate::View;
use crate::companions::Companions;
use crate::error::{DatasetError, Result};
use crate::formats::source::Frame;

/// How much of a set of views is masked.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Masked {
    pub views: usize,
    /// Views with a mask, or with a lens that shows nothing at some of their pixels.
    pub masked_views: usize,
    /// Pixels of all views.
    pub pixels: usize,
    /// Pixels that do not count.
    pub ignored_pixels: usize,
}

impl Masked {
    /// The summary of these views.
    pub fn of<'a>(views: impl IntoIterator<Item = &'a View>) -> Self {
        views.into_iter().fold(Self::default(), |sum, view| {
            let ignored = view.photograph.ignored_pixels();
            Self {
                views: sum.views + 1,
                masked_views: sum.masked_views + usize::from(ignored.is_some()),
                pixels: sum.pixels + view.camera.width * view.camera.height,
                ignored_pixels: sum.ignored_pixels + ignored.unwrap_or(0),
            }
        })
    }
}

impl fmt::Display for Masked {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let percent = 100.0 * self.ignored_pixels as f64 / self.pixels.max(1) as f64;
        let (masked, views) = (self.masked_views, self.views);
        write!(
            f,
            "{masked} of {views} views have masks, or a lens that does not fill them; {percent:.1} % of all pixels do not count"
        )
    }
}

/// The file with the mask of a frame: that of `masks` for a photograph of a scale, the one that the frame names, or else that of
/// `masks`.
///
/// # Errors
/// [`DatasetError::Missing`] if the file that the frame names is missing.
pub(crate) fn find(frame: &Frame, masks: &Companions<'_>, is_scaled: bool) -> Result<Option<PathBuf>> {
    let own = masks.of(&frame.image);
    match &frame.mask {
        Some(named) if !(is_scaled && own.is_some()) => {
            let lacks_it = || frame.missing(named.clone(), &["mask", " or remove its name"]);
            named.is_file().then(|| Some(named.clone())).ok_or_else(lacks_it)
        }
        _ => Ok(own),
    }
}

/// Which pixels of a picture count by the mask in file `path`, [height × width]: those that are neither black nor transparent,
/// or, if it is `inverted`, those that are. `image` is the file of the picture, `width` × `height` px.
///
/// # Errors
/// [`DatasetError::MaskSize`] if the sizes differ, [`DatasetError::Read`], [`DatasetError::Decode`].
pub(crate) fn read(path: &Path, image: &Path, [width, height]: [usize; 2], inverted: bool) -> Result<Vec<bool>> {
    let mask = codec::decoded(path)?.into_luma_alpha16();
    let found = [mask.width() as usize, mask.height() as usize];
    if found != [width, height] {
        let (mask, image) = (path.to_owned(), image.to_owned());
        return Err(DatasetError::MaskSize { mask, found, image, expected: [width, height] });
    }
    let counts = |[luma, alpha]: [u16; 2]| luma > 0 && alpha > 0;
    Ok(mask.pixels().map(|pixel| counts(pixel.0) != inverted).collect())
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use image::{Rgb, RgbImage, Rgba, RgbaImage};

    use crate::fixtures::{
        self, Encoding, FixtureScene, assert_refused, colmap_folder, nerfstudio_frame, write_mask, write_transforms,
    };
    use crate::{Dataset, LoadOptions, MaxResolution, Picture, load};

    const SIZE: [u32; 2] = [24, 16];

    fn written() -> (tempfile::TempDir, FixtureScene) {
        let scene = fixtures::scene(9);
        (colmap_folder(&scene, Encoding::Binary), scene)
    }

    fn counted(data: &Dataset, name: &str) -> Option<Vec<bool>> {
        picture(data, name).counted.clone()
    }

    fn picture(data: &Dataset, name: &str) -> Arc<Picture> {
        data.train.iter().find(|view| view.name == name).unwrap().picture().unwrap()
    }

    /// [width × height] whether a column counts.
    fn columns(width: usize, height: usize, counts: impl Fn(usize) -> bool) -> Vec<bool> {
        (0..width * height).map(|pixel| counts(pixel % width)).collect()
    }

    #[test]
    fn masks_are_found_by_both_names_and_may_be_turned_round() {
        let (folder, _) = written();
        write_mask(&folder.path().join("masks/left/001.png.png"), SIZE, 5);
        write_mask(&folder.path().join("masks/left/002.png"), SIZE, 7);
        let data = load(folder.path(), &LoadOptions::default()).unwrap();
        assert_eq!(counted(&data, "left/001.png"), Some(columns(24, 16, |x| x >= 5)));
        assert_eq!(counted(&data, "left/002.png"), Some(columns(24, 16, |x| x >= 7)));
        assert_eq!(counted(&data, "left/003.png"), None);
        let masked = data.masked();
        assert_eq!((masked.views, masked.masked_views, masked.ignored_pixels), (9, 2, 12 * 16));
        assert_eq!(
            masked.to_string(),
            "2 of 9 views have masks, or a lens that does not fill them; 5.6 % of all pixels do not count"
        );
        let inverted = load(folder.path(), &LoadOptions { invert_masks: true, ..Default::default() }).unwrap();
        assert_eq!(counted(&inverted, "left/001.png"), Some(columns(24, 16, |x| x < 5)));
        assert_eq!(counted(&inverted, "left/003.png"), None);
    }

    #[test]
    fn transparent_pixels_of_masks_are_black() {
        let (folder, _) = written();
        let mask = RgbaImage::from_fn(24, 16, |x, _| Rgba([255, 255, 255, if x < 7 { 0 } else { 255 }]));
        fixtures::save(&folder.path().join("masks/left/001.png"), mask);
        let data = load(folder.path(), &LoadOptions::default()).unwrap();
        assert_eq!(counted(&data, "left/001.png"), Some(columns(24, 16, |x| x >= 7)));
    }

    #[test]
    fn smaller_photographs_have_smaller_masks_that_let_nothing_ignored_in() {
        let (folder, scene) = written();
        let image = |name: &str, garbage: u8| {
            let colour = |x: u32, y: u32| if x < 9 { [garbage; 3] } else { [(9 * x) as u8, (13 * y) as u8, 7] };
            let image = RgbImage::from_fn(24, 16, |x, y| Rgb(colour(x, y)));
            image.save(folder.path().join("images").join(name)).unwrap();
        };
        let name = scene.images[0].name.as_str();
        write_mask(&folder.path().join("masks").join(name), SIZE, 9);
        let options = LoadOptions { max_resolution: MaxResolution(12), test_every: 0, ..Default::default() };
        let read = |garbage: u8| {
            image(name, garbage);
            picture(&load(folder.path(), &options).unwrap(), name)
        };
        let (black, white) = (read(0), read(255));
        // the filter of column x reaches from 2 x − 3 to 2 x + 4 in the photograph
        assert_eq!(black.counted, Some(columns(12, 8, |x| x >= 6)));
        for pixel in 0..12 * 8 {
            assert!(!black.counts(pixel) || black.colour(pixel) == white.colour(pixel), "pixel {pixel}");
        }
        assert!(black.bytes != white.bytes);
    }

    #[test]
    fn masks_in_folders_of_a_scale_fit_its_images() {
        let (folder, scene) = written();
        for image in &scene.images {
            fixtures::write_png(&folder.path().join("images_2").join(&image.name), 12, 8, [9; 3]);
        }
        write_mask(&folder.path().join("masks/left/001.png"), SIZE, 5);
        let options = LoadOptions { image_scale: Some(2), ..Default::default() };
        let parts = ["masks/left/001.png is 24x16 px", "images_2/left/001.png 12x8"];
        assert_refused(folder.path(), &options, &parts);
        write_mask(&folder.path().join("masks_2/left/001.png"), [12, 8], 2);
        let data = load(folder.path(), &options).unwrap();
        assert_eq!(counted(&data, "left/001.png"), Some(columns(12, 8, |x| x >= 2)));
    }

    #[test]
    fn a_mask_that_leaves_nothing_is_refused_with_a_hint() {
        let (folder, _) = written();
        write_mask(&folder.path().join("masks/left/004.png"), SIZE, 24);
        assert_refused(folder.path(), &LoadOptions::default(), &["left/004.png", "--invert-masks"]);
        load(folder.path(), &LoadOptions { invert_masks: true, ..Default::default() }).unwrap();
    }

    #[test]
    fn alpha_and_mask_both_take_pixels_away() {
        let (folder, scene) = written();
        let name = scene.images[0].name.as_str();
        let alpha = |x: u32| if x < 20 { 255 } else { 100 };
        let image = RgbaImage::from_fn(24, 16, |x, _| Rgba([8, 80, 160, alpha(x)]));
        image.save(folder.path().join("images").join(name)).unwrap();
        write_mask(&folder.path().join("masks").join(name), SIZE, 3);
        let options = LoadOptions { alpha_masks: true, test_every: 0, ..Default::default() };
        let data = load(folder.path(), &options).unwrap();
        assert_eq!(counted(&data, name), Some(columns(24, 16, |x| (3..20).contains(&x))));
        assert_eq!(picture(&data, name).bytes[3 * 23..3 * 24], [8, 80, 160]);
    }

    #[test]
    fn frames_of_nerfstudio_name_their_masks() {
        let folder = tempfile::tempdir().unwrap();
        let frame = |index: usize, mask: &str| nerfstudio_frame(folder.path(), &index.to_string(), [index, 3], mask);
        let frames = [frame(0, ""), frame(1, r#""mask_path": "./other/first.png","#), frame(2, "")];
        write_transforms(&folder.path().join("transforms.json"), r#""fl_x": 20.0"#, &frames);
        let options = LoadOptions { test_every: 0, ..Default::default() };
        assert_refused(folder.path(), &options, &["other/first.png", "transforms.json"]);
        write_mask(&folder.path().join("other/first.png"), SIZE, 4);
        write_mask(&folder.path().join("masks/2.png"), SIZE, 6);
        let data = load(folder.path(), &options).unwrap();
        assert_eq!(counted(&data, "images/0.png"), None);
        assert_eq!(counted(&data, "images/1.png"), Some(columns(24, 16, |x| x >= 4)));
        assert_eq!(counted(&data, "images/2.png"), Some(columns(24, 16, |x| x >= 6)));
    }
}
