//! Turns the description of a dataset into one to train on: pictures, cameras, split, extent, origin.

use std::collections::HashSet;
use std::path::{Component, Path, PathBuf};
use std::sync::Arc;

use dpges_core::camera::Camera;
use glam::DVec3;
use rayon::prelude::*;

use super::companions::Companions;
use super::conventions::{DEPTHS, MASKS, is_read};
use super::error::{DatasetError, Result};
use super::finding::Kind;
use super::folder::Folder;
use super::formats::cloud;
use super::formats::source::{DepthFile, Frame, RawPoints, Source, Split};
use super::image::decoder::ImageDecoder;
use super::image::masks::Masked;
use super::image::{codec, depth, masks, reading};
use super::key::stem;
use super::layout::Layout;
use super::names::{in_folder, listing};
use super::near_plane::near_plane;
use super::reprojection;
use super::world::{drop_lost, mean_and_extent};
use super::{Dataset, Format, LoadOptions, PointCloud, Tracks, View, inventory, panoramas};

/// Distance of the cameras from the origin, in extents, beyond which the world is moved there. f32 has 24 bits: at
/// 100 extents positions are rounded to 100 · 2⁻²⁴ = 6·10⁻⁶ extents, a fraction of a pixel.
const RECENTRE_BEYOND_EXTENTS: f64 = 100.0;

/// # Errors
/// [`DatasetError`]; the first view by name that is at fault, whatever the number of threads.
pub(super) fn assemble(layout: &Layout, mut source: Source, options: &LoadOptions) -> Result<Dataset> {
    let root = &layout.folder.root;
    check(&source, options)?;
    forget_placeholders(&mut source);
    panoramas::cut(&mut source)?;
    check_cameras(&source, options.near.unwrap_or(1.0))?;
    let train_centres: Vec<DVec3> = frames_of(&source, Split::Train).map(|frame| frame.camera.centre()).collect();
    let (mean, extent) = mean_and_extent(&train_centres);
    let offset = if mean.length() > RECENTRE_BEYOND_EXTENTS * extent { mean } else { DVec3::ZERO };
    if let Some(path) = &options.points {
        let cameras: Vec<Camera> = frames_of(&source, Split::Train).map(|frame| frame.camera).collect();
        source.points = cloud::read(path, &cameras, &source.points, extent, &mut source.notices)?;
        source.used.push(path.clone());
    }
    let lost = drop_lost(&mut source.points, mean, extent);
    if lost > 0 {
        let message = format!("{lost} of the points are not finite, or far from everything");
        source.notices.add(Kind::Missing, message, "they are left out");
    }
    let near = options.near.unwrap_or_else(|| near_plane(&source.frames, &source.points, extent));
    source.frames.iter_mut().for_each(|frame| frame.camera.near = near);

    if let Some(scale) = options.image_scale {
        for frame in &mut source.frames {
            frame.image = scaled_image(&layout.folder, frame, scale)?;
        }
    }
    let mut used: HashSet<PathBuf> =
        source.used.iter().chain(source.frames.iter().map(|frame| &frame.image)).cloned().collect();
    let masks = Companions::new(&layout.folder, MASKS, options.image_scale);
    let depths = Companions::new(&layout.folder, DEPTHS, None);
    for frame in &mut source.frames {
        frame.mask = masks::find(frame, &masks, options.image_scale.is_some())?;
        let unit = depth::DEFAULT_UNIT;
        frame.depth = frame.depth.take().or_else(|| Some(DepthFile { path: depths.of(&frame.image)?, unit }));
        used.extend(frame.mask.iter().chain(frame.depth.iter().map(|depth| &depth.path)).cloned());
    }
    if options.depth.is_some() {
        check_depth(root, &source)?;
    }
    let with_alpha = look_at(&mut source)?;
    let mut notices = std::mem::take(&mut source.notices);
    let what = "photographs are missing, and their views left out";
    notices.add_files(Kind::Missing, what, root, &source.missing, "restore the files if they should be there");
    let left_out: Vec<&str> = frames_of(&source, Split::Neither).map(|frame| frame.name.as_str()).collect();
    let what = "views are in none of the lists of the dataset, and left out";
    notices.add_names(Kind::Aside, what, &left_out, "add them to a list to use them");
    notices.0.extend(inventory::survey(layout, &source, used, options.depth.is_some()).0);

    for frame in &mut source.frames {
        frame.camera.camera_from_world = frame.camera.camera_from_world.recentred(offset);
    }
    let background = match options.background {
        Some(background) => background,
        None if source.format == Format::Blender && !with_alpha.is_empty() => [1.0; 3],
        None => [0.0; 3],
    };
    // photographs to train on come first: they are needed more often
    let frames: Vec<&Frame> =
        [Split::Train, Split::Test].into_iter().flat_map(|split| frames_of(&source, split)).collect();
    // most photographs show a world, so what few leave out is no background
    let is_rare = source.format != Format::Blender && 2 * with_alpha.len() < frames.len();
    let alpha_masks = options.alpha_masks || is_rare;
    let decoder = Arc::new(ImageDecoder::new(&LoadOptions { alpha_masks, ..options.clone() }, background));
    let has_masks = frames.iter().any(|frame| frame.mask.is_some());
    let (mut train, spare_memory) = reading::views(&frames, options.memory, &decoder)?;
    let read: HashSet<String> = train.iter().map(|view| view.name.clone()).collect();
    let left_out = |frame: &&mut Frame| !read.contains(&frame.name);
    source.frames.iter_mut().filter(left_out).for_each(|frame| frame.split = Split::Neither);
    let hides = |view: &&View| with_alpha.contains(&view.name) && view.photograph.ignored_pixels() > Some(0);
    let cut_out: Vec<&str> = train.iter().filter(hides).map(|view| &*view.name).collect();
    if is_rare && !options.alpha_masks {
        let what = "photographs have alpha where most have none, and what is transparent there does not count";
        notices.add_names(Kind::Changed, what, &cut_out, "remove it, or cut out the object in all photographs");
    }
    let test = train.split_off(frames_of(&source, Split::Train).count());
    let masked = Masked::of(train.iter().chain(&test));
    if has_masks && masked.ignored_pixels == 0 {
        let message = format!("the masks of {} views mask nothing: none of their pixels is black", masked.masked_views);
        notices.add(Kind::Unused, message, "make what is not to count black (0, not nearly so)");
    }
    let reprojection_px = reprojection::judge(&source, &train, &mut notices);
    Ok(Dataset {
        train,
        test,
        validation: Vec::new(),
        points: recentred_points(source.points, &source.frames, offset),
        offset,
        extent,
        background,
        format: source.format,
        near,
        reprojection_px,
        notices,
        spare_memory,
    })
}

fn frames_of(source: &Source, split: Split) -> impl Iterator<Item = &Frame> {
    source.frames.iter().filter(move |frame| frame.split == split)
}

/// Takes tracks as unknown where programs that do not know them have written the same for every point.
fn forget_placeholders(source: &mut Source) {
    let Some(view) = source.points.seen_by.placeholder(source.frames.len()) else { return };
    source.points.seen_by = Tracks::default();
    let message = format!("all points are said to be seen by {} alone, which no capture has", source.frames[view].name);
    source.notices.add(Kind::Missing, message, "it is taken as unknown which views see them");
}

/// Checks of the views as a whole.
fn check(source: &Source, options: &LoadOptions) -> Result<()> {
    let path = source.described_in.clone();
    let (missing, all) = (source.missing.len(), source.missing.len() + source.frames.len());
    if 2 * missing > all {
        return Err(DatasetError::MissingMost { path: source.missing[0].clone(), missing, all, described_in: path });
    }
    if source.frames.is_empty() {
        return Err(DatasetError::NoViews { path });
    }
    let held_out = frames_of(source, Split::Test).count();
    if frames_of(source, Split::Train).count() == 0 {
        return Err(DatasetError::NoTrainingViews { path, held_out });
    }
    if held_out == 0 && options.test_every > 0 {
        return Err(DatasetError::NoTestViews { path, reason: source.no_test_reason });
    }
    Ok(())
}

/// Checks of each of the views, with a near plane.
fn check_cameras(source: &Source, near: f64) -> Result<()> {
    source.frames.iter().try_for_each(|frame| {
        Camera { near, ..frame.camera }.validate().map_err(|source| DatasetError::Camera {
            path: frame.described_in.clone(),
            view: frame.name.clone(),
            source: Box::new(source),
        })
    })
}

/// Looks at the headers of all pictures, whether they fit their cameras as they are stored, and whether they are whole. Returns
/// the names of the views of those with alpha.
fn look_at(source: &mut Source) -> Result<HashSet<String>> {
    let frames: Vec<&mut Frame> = source.frames.iter_mut().filter(|frame| frame.split != Split::Neither).collect();
    let headers: Vec<Result<codec::Header>> = frames.par_iter().map(|frame| codec::header(&frame.image)).collect();
    let (mut turned, mut deep, mut with_alpha) = (Vec::new(), Vec::new(), HashSet::new());
    let headers = headers.into_iter().collect::<Result<Vec<codec::Header>>>()?;
    for (frame, header) in frames.into_iter().zip(&headers) {
        let fits = |[width, height]: [usize; 2]| frame.check_aspect(&frame.image, [width, height], &[""; 2]).is_ok();
        let (found, orientation) = ([header.width, header.height], header.orientation);
        let is_upright = orientation < 5;
        match (fits(found), fits([header.height, header.width])) {
            (false, true) if !is_upright => {
                let (path, described_in) = (frame.image.clone(), frame.described_in.clone());
                return Err(DatasetError::Orientation { path, found, orientation, described_in });
            }
            // the size says that the camera is that of the pixels as they are stored
            (true, false) if !is_upright && frame.is_sized => {}
            _ if orientation > 1 => turned.push(format!("{} (EXIF orientation {orientation})", frame.name)),
            _ => {}
        }
        frame.header = Some(*header);
        with_alpha.extend(header.has_alpha.then(|| frame.name.clone()));
        if header.is_deep {
            deep.push(frame.image.display());
        }
    }
    if let Some(first) = deep.first() {
        tracing::info!("{} images of 16 bits per value are rounded to 8, such as {first}", deep.len());
    }
    let what = "photographs are to be turned, as their EXIF says, and are not";
    let advice = "if their cameras are those of upright pictures, turn the pixels (`mogrify -auto-orient`)";
    source.notices.add_names(Kind::Orientation, what, &turned, advice);
    Ok(with_alpha)
}

/// `…/images/…` as `…/images_<scale>/…`, with another extension if there is none with this one.
fn scaled_image(files: &Folder, frame: &Frame, scale: u32) -> Result<PathBuf> {
    let relative = frame.image.strip_prefix(&files.root).unwrap_or(&frame.image);
    let is_base = |part: &Component<'_>| part.as_os_str().to_string_lossy().split('_').next() == Some("images");
    let mut components = relative.components();
    let above: PathBuf = components.by_ref().take_while(|part| !is_base(part)).collect();
    let place = files.root.join(if above == relative { Path::new("") } else { &above });
    let folder = place.join(format!("images_{scale}"));
    if above == relative || !folder.is_dir() {
        return Err(DatasetError::MissingScale { available: image_folders(&place), path: folder });
    }
    let file = folder.join(components.collect::<PathBuf>());
    if file.is_file() {
        return Ok(file);
    }
    let key = files.key_of(&file);
    let mut similar = files.files.range(stem(&key).to_owned()..).take_while(|(other, _)| other.starts_with(stem(&key)));
    let found = similar.find(|(other, _)| stem(other) == stem(&key) && is_read(other));
    let words = &["scaled photograph", ", or read those in images/, without --image-scale"];
    found.map(|(_, path)| path.clone()).ok_or_else(|| frame.missing(file, words))
}

fn image_folders(root: &Path) -> String {
    let mut folders = in_folder(root).unwrap_or_default();
    folders.retain(|name| (name == "images" || name.starts_with("images_")) && root.join(name).is_dir());
    if folders.is_empty() { format!("no image folders but {}", listing(root)) } else { folders.join(", ") }
}

/// # Errors
/// [`DatasetError::Missing`] for the first training view whose map is not there, [`DatasetError::NoDepth`] if no
/// training view has one.
fn check_depth(root: &Path, source: &Source) -> Result<()> {
    let mut found = false;
    for frame in frames_of(source, Split::Train) {
        let Some(file) = &frame.depth else { continue };
        if !file.path.is_file() {
            let words = &["depth map", ", remove its `depth_file_path`, or set `data.depth` = \"none\""];
            return Err(frame.missing(file.path.clone(), words));
        }
        found = true;
    }
    let path = root.join(depth::FOLDER);
    if found { Ok(()) } else { Err(DatasetError::NoDepth { found: listing(&path), path }) }
}

fn recentred_points(points: RawPoints, frames: &[Frame], offset: DVec3) -> PointCloud {
    let RawPoints { positions, colours, mut seen_by } = points;
    seen_by.keep_views(frames.iter().map(|frame| frame.split == Split::Train));
    let positions = positions.iter().map(|position| (position - offset).as_vec3().to_array()).collect();
    PointCloud { positions, colours, seen_by }
}

#[cfg(test)]
mod tests {
    use dpges_core::camera::CameraFromWorld;

    use super::super::fixtures::{self, Encoding, assert_refused, assert_says, colmap_folder, said, write_mask};
    use super::super::load;
    use super::*;
    use crate::MaxResolution;

    #[test]
    fn geo_referenced_worlds_keep_sub_millimetre_precision() {
        let far = DVec3::new(5e6, -4.2e6, 300.0);
        let mut scene = fixtures::scene(10);
        let loaded = |scene: &fixtures::FixtureScene| {
            load(colmap_folder(scene, Encoding::Binary).path(), &LoadOptions::default()).unwrap()
        };
        let near_data = loaded(&scene);
        assert_eq!(near_data.offset, DVec3::ZERO);
        for image in &mut scene.images {
            image.pose = image.pose.recentred(-far);
        }
        scene.points.iter_mut().for_each(|point| point.position += far);
        let data = loaded(&scene);
        assert!((data.offset - far).length() < 10.0);
        let shift = far - data.offset;
        for (found, near) in data.points.positions.iter().zip(&near_data.points.positions) {
            let difference = DVec3::from_array(found.map(f64::from)) - shift - DVec3::from_array(near.map(f64::from));
            assert!(difference.length() < 1e-6, "{difference}");
        }
        for (found, near) in data.train.iter().zip(&near_data.train) {
            assert!((found.camera.centre() - shift - near.camera.centre()).length() < 1e-6);
        }
        assert!((data.extent - near_data.extent).abs() < 1e-6);
    }

    #[test]
    fn a_scaled_folder_is_read_as_shipped_and_intrinsics_follow() {
        let scene = fixtures::scene(9);
        let folder = colmap_folder(&scene, Encoding::Text);
        let options = LoadOptions { image_scale: Some(2), ..Default::default() };
        assert_refused(folder.path(), &options, &["images_2", "there are images;"]);
        for image in &scene.images {
            fixtures::write_png(&folder.path().join("images_2").join(&image.name), 12, 8, [10, 20, 30]);
        }
        let data = load(folder.path(), &options).unwrap();
        assert_eq!(said(&data), "");
        let camera = data.train[0].camera;
        assert_eq!((camera.width, camera.height), (12, 8));
        assert_eq!((camera.fx, camera.cx, camera.cy), (10.0, 6.0, 4.0));
        assert_eq!(data.train[0].picture().unwrap().bytes[..3], [10, 20, 30]);
    }

    #[test]
    fn a_scaled_folder_may_have_other_endings_and_must_have_all() {
        let scene = fixtures::scene(9);
        let folder = colmap_folder(&scene, Encoding::Text);
        let options = LoadOptions { image_scale: Some(2), ..Default::default() };
        for image in &scene.images[1..] {
            let name = image.name.replace(".png", ".JPG");
            fixtures::save(&folder.path().join("images_2").join(name), image::RgbImage::new(12, 8));
        }
        let file = scene.images[0].name.as_str();
        assert_refused(folder.path(), &options, &["images_2", file, "is missing", "without --image-scale"]);
        fixtures::save(&folder.path().join("images_2").join(file), image::RgbImage::new(12, 8));
        let data = load(folder.path(), &options).unwrap();
        assert_eq!((data.train.len() + data.test.len(), said(&data)), (9, String::new()));
    }

    #[test]
    fn alpha_of_few_photographs_says_what_does_not_count_and_that_of_all_is_a_matte() {
        let scene = fixtures::scene(9);
        let folder = colmap_folder(&scene, Encoding::Text);
        let cut_out = |name: &str| {
            let alpha = |x: u32| if x < 6 { 0 } else { 255 };
            let image = image::RgbaImage::from_fn(24, 16, |x, _| image::Rgba([9, 9, 9, alpha(x)]));
            fixtures::save(&folder.path().join("images").join(name), image);
        };
        cut_out("left/002.png");
        let found = || {
            let data = load(folder.path(), &LoadOptions::default()).unwrap();
            let view = data.train.iter().find(|view| view.name == "left/002.png").unwrap();
            let counted = view.picture().unwrap().counted.as_ref().map(|counted| [counted[5], counted[6]]);
            (counted, view.photograph.has_transparency(), said(&data))
        };
        let (counted, has_transparency, said) = found();
        assert_eq!((counted, has_transparency), (Some([false, true]), false));
        assert_says(said, &["Changed: photographs have alpha where most have none", "(1): left/002.png"]);
        scene.images.iter().for_each(|image| cut_out(&image.name));
        assert_eq!(found(), (None, true, String::new()));
    }

    #[test]
    fn tracks_that_say_nothing_are_unknown() {
        let mut scene = fixtures::scene(9);
        scene.points.iter_mut().for_each(|point| point.track = vec![107]);
        let data = load(colmap_folder(&scene, Encoding::Text).path(), &LoadOptions::default()).unwrap();
        assert!(data.points.seen_by.are_unknown());
        assert_says(said(&data), &["all points are said to be seen by", "left/001.png"]);
        scene.points[0].track = vec![107, 114];
        scene.points[1].track = vec![107, 121];
        let data = load(colmap_folder(&scene, Encoding::Text).path(), &LoadOptions::default()).unwrap();
        assert!(!data.points.seen_by.are_unknown());
    }

    #[test]
    fn the_longer_side_is_capped_and_intrinsics_follow() {
        let folder = colmap_folder(&fixtures::scene(9), Encoding::Text);
        let full = load(folder.path(), &LoadOptions::default()).unwrap();
        let options = LoadOptions { max_resolution: MaxResolution(12), near: Some(0.5), ..Default::default() };
        let small = load(folder.path(), &options).unwrap();
        let camera = small.train[0].camera;
        assert_eq!((camera.width, camera.height, camera.fx, camera.near), (12, 8, 10.0, 0.5));
        assert_eq!(small.train[0].picture().unwrap().bytes.len(), 3 * 12 * 8);
        assert_eq!(full.train[0].camera.width, 24);
        let enough = LoadOptions { max_resolution: MaxResolution(24), ..Default::default() };
        let same = load(folder.path(), &enough).unwrap();
        assert_eq!(same.train[0].picture().unwrap(), full.train[0].picture().unwrap());
    }

    #[test]
    fn a_lens_that_folds_before_the_first_pixel_is_refused_by_name() {
        let mut scene = fixtures::scene(9);
        // the principal point is a corner between four pixels
        (scene.model, scene.params) = ((2, "SIMPLE_RADIAL"), vec![20.0, 12.0, 8.0, -1e6]);
        let folder = colmap_folder(&scene, Encoding::Text);
        let options = LoadOptions { undistort: false, ..Default::default() };
        assert_refused(folder.path(), &options, &["images.txt", "`left/001.png`", "lens", "shows nothing"]);
    }

    #[test]
    fn photographs_that_keep_their_lens_keep_their_masks_and_are_read_again_alike() {
        let mut scene = fixtures::scene(9);
        (scene.model, scene.params) = ((2, "SIMPLE_RADIAL"), vec![20.0, 12.0, 8.0, 0.1]);
        let folder = colmap_folder(&scene, Encoding::Binary);
        write_mask(&folder.path().join("masks/left/003.png"), [24, 16], 18);
        let of_view = |undistort: bool, memory: usize| {
            let options = LoadOptions { undistort, memory, ..Default::default() };
            let data = load(folder.path(), &options).unwrap();
            let view = data.train.iter().find(|view| view.name == "left/003.png").unwrap();
            assert_eq!((view.camera.lens.is_some(), view.photograph.is_kept()), (!undistort, memory > 0));
            view.picture().unwrap()
        };
        let [read_again, kept] = [0, usize::MAX].map(|memory| of_view(false, memory));
        assert_eq!(read_again, kept);
        let columns: Vec<bool> = (0..24 * 16).map(|pixel| pixel % 24 >= 18).collect();
        assert_eq!(kept.counted.as_ref(), Some(&columns));
        // without the lens, what does not count gets into the first column that does
        assert_ne!(of_view(true, usize::MAX).counted, kept.counted);
    }

    #[test]
    fn only_pixels_with_a_ray_count_through_a_lens_and_without_it_all_have_one() {
        let mut scene = fixtures::scene(9);
        // it shows a circle of 6.9 px, within pictures of 24 × 16 px
        (scene.model, scene.params) = ((8, "SIMPLE_RADIAL_FISHEYE"), vec![8.0, 12.0, 8.0, -0.2]);
        let folder = colmap_folder(&scene, Encoding::Binary);
        write_mask(&folder.path().join("masks/left/003.png"), [24, 16], 12);
        let read = |options: LoadOptions| load(folder.path(), &options).unwrap();
        let lens = LoadOptions { undistort: false, ..Default::default() };
        for (max_resolution, memory) in [(0, usize::MAX), (0, 0), (12, usize::MAX)] {
            let data = read(LoadOptions { max_resolution: MaxResolution(max_resolution), memory, ..lens.clone() });
            let masked = data.masked();
            assert_eq!((masked.views, masked.masked_views), (9, 9));
            for view in data.train.iter().chain(&data.test).filter(|view| view.name != "left/003.png") {
                let (picture, camera) = (view.picture().unwrap(), &view.camera);
                let counted = picture.counted.as_ref().unwrap();
                for (pixel, &counts) in counted.iter().enumerate() {
                    let (column, row) = (pixel % camera.width, pixel / camera.width);
                    let ray = camera.ray(column as f64 + 0.5, row as f64 + 0.5);
                    assert_eq!(counts, ray.is_some(), "{}: {column}, {row}", view.name);
                }
                let share = counted.iter().filter(|&&counts| counts).count() as f64 / counted.len() as f64;
                // π 6.9² of 24 × 16
                assert!((share - 0.39).abs() < 0.07, "{share}");
                assert_eq!(view.photograph.ignored_pixels(), Some(picture.ignored_pixels()));
            }
        }
        let (bent, straight) = (read(lens), read(LoadOptions::default()));
        let of_view = |data: &Dataset, name: &str| {
            let view = data.train.iter().find(|view| view.name == name).unwrap();
            (view.camera, view.picture().unwrap())
        };
        let [(_, masked), (taken, whole)] = ["left/003.png", "left/004.png"].map(|name| of_view(&bent, name));
        for pixel in 0..24 * 16 {
            assert_eq!(masked.counts(pixel), whole.counts(pixel) && pixel % 24 >= 12, "pixel {pixel}");
        }
        let (pinhole, picture) = of_view(&straight, "left/004.png");
        assert_eq!((pinhole.lens, &picture.counted), (None, &None));
        for pixel in 0..24 * 16 {
            let seen = pinhole.unproject((pixel % 24) as f64 + 0.5, (pixel / 24) as f64 + 0.5, 1.0);
            assert!(taken.pixel(seen).is_some(), "pixel {pixel} is not on the photograph");
        }
    }

    #[test]
    fn images_that_are_missing_or_contradict_their_camera_are_named() {
        let scene = fixtures::scene(9);
        let folder = colmap_folder(&scene, Encoding::Binary);
        let path = folder.path().join("images").join(&scene.images[3].name);
        fixtures::write_png(&path, 24, 20, [0; 3]);
        let options = LoadOptions::default();
        assert_refused(folder.path(), &options, &[&scene.images[3].name, "24x20", "24x16", "images.bin"]);
        let all = load(colmap_folder(&scene, Encoding::Binary).path(), &options).unwrap();
        for removed in 1..=6 {
            let file = folder.path().join("images").join(&scene.images[removed].name);
            std::fs::remove_file(&file).unwrap();
            if removed < 3 {
                continue;
            }
            if removed > 4 {
                let (counted, first) = (format!("missing, {removed} of 9"), &scene.images[removed].name);
                assert_refused(folder.path(), &options, &[&counted, "images.bin", first]);
                continue;
            }
            let data = load(folder.path(), &options).unwrap();
            assert_eq!(data.train.len() + data.test.len(), 9 - removed);
            assert_says(said(&data), &[&format!("their views left out ({removed})"), "left/0"]);
            // the others keep their points
            let seen_by = |data: &Dataset, name: &str| {
                let view = data.train.iter().position(|view| view.name == name).unwrap();
                data.points.seen_by.by_view(data.train.len())[view].clone()
            };
            assert_eq!(seen_by(&data, "left/001.png"), seen_by(&all, "left/001.png"));
        }
    }

    #[test]
    fn sizes_and_orientations_that_contradict_are_refused_or_said() {
        let turned = b"Exif\0\0II*\0\x08\0\0\0\x01\0\x12\x01\x03\0\x01\0\0\0\x06\0\0\0\0\0\0\0";
        for (size, orientation, expected) in
            [([16, 24], 6, "EXIF orientation 6"), ([24, 16], 6, ""), ([24, 16], 3, "left/001.jpg (EXIF orientation 3)")]
        {
            let mut scene = fixtures::scene(3);
            let folder = colmap_folder(&scene, Encoding::Text);
            scene.images[1].name = "left/001.jpg".to_owned();
            fixtures::write_model(&folder.path().join("sparse/0"), &scene, Encoding::Text);
            let path = folder.path().join("images/left/001.jpg");
            fixtures::save(&path, image::RgbImage::new(size[0], size[1]));
            let mut tag = turned.to_vec();
            tag[24] = orientation;
            fixtures::insert_segment(&path, 0xe1, &tag);
            std::fs::remove_file(folder.path().join("images/left/001.png")).unwrap();
            match load(folder.path(), &LoadOptions::default()) {
                Err(error) => assert_says(error, &["left/001.jpg", "16x24", expected, "images.txt"]),
                Ok(data) if expected.is_empty() => assert_eq!(said(&data), ""),
                Ok(data) => assert_says(said(&data), &["Orientation", expected]),
            }
        }
    }

    #[test]
    fn the_near_plane_follows_what_cameras_see_in_any_unit() {
        for scale in [1e-3, 1.0, 1e3] {
            let mut scene = fixtures::scene(9);
            scene.images.iter_mut().for_each(|image| image.pose.translation *= scale);
            scene.points.iter_mut().for_each(|point| point.position *= scale);
            let read = |scene: &fixtures::FixtureScene| {
                load(colmap_folder(scene, Encoding::Binary).path(), &LoadOptions::default()).unwrap()
            };
            let data = read(&scene);
            // cameras are about 3.2 from the middle, and points up to one nearer
            assert!((0.2..0.32).contains(&(data.near / scale)), "{}", data.near);
            assert!(data.train.iter().chain(&data.test).all(|view| view.camera.near == data.near));
            // of no points the extent
            scene.points.clear();
            let none = read(&scene);
            assert!((none.near - 2.5e-3 * none.extent).abs() < 1e-9 * scale && none.points.positions.is_empty());
        }
    }

    #[test]
    fn poses_that_are_not_finite_name_view_and_file() {
        let mut scene = fixtures::scene(9);
        let pose = scene.images[2].pose;
        scene.images[2].pose = CameraFromWorld { translation: DVec3::new(0.0, f64::NAN, 1.0), ..pose };
        let folder = colmap_folder(&scene, Encoding::Binary);
        let parts = [scene.images[2].name.as_str(), "images.bin", "`translation`", "remove it"];
        assert_refused(folder.path(), &LoadOptions::default(), &parts);
    }

    #[test]
    fn splits_that_leave_a_side_empty_are_refused() {
        let folder = colmap_folder(&fixtures::scene(3), Encoding::Binary);
        let every = |test_every| LoadOptions { test_every, ..Default::default() };
        assert_refused(folder.path(), &every(1), &["images.bin", "all 3 are held out"]);
        assert_eq!(load(folder.path(), &every(0)).unwrap().train.len(), 3);
        std::fs::write(folder.path().join("test.txt"), "nobody.png\n").unwrap();
        assert_says(said(&load(folder.path(), &every(8)).unwrap()), &["test.txt is not used", "`nobody.png`"]);
        std::fs::write(folder.path().join("test.txt"), "# nobody\n").unwrap();
        assert_refused(folder.path(), &every(8), &["images.bin", "no test views"]);
    }
}
