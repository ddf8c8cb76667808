//! Panoramas of a dataset become views of the faces of a cube, whose pictures are cut when they are read.

use super::error::{DatasetError, Result};
use super::formats::source::{Frame, PanoramaPart, Source};
use super::image::panorama::Face;

/// Difference of the width of a panorama from twice its height, px, by which it was rounded.
const ROUNDED_PX: usize = 2;

/// Puts frames of all faces in the place of each panorama, of the same split. Points are seen by those faces that they appear on.
///
/// # Errors
/// [`DatasetError::Panorama`] unless panoramas are twice as wide as high, [`DatasetError::Malformed`] if faces have names of
/// other views.
pub(super) fn cut(source: &mut Source) -> Result<()> {
    if source.frames.iter().all(|frame| frame.panorama.is_none()) {
        return Ok(());
    }
    let mut cut: Vec<(usize, Frame)> = Vec::new();
    for (old, frame) in std::mem::take(&mut source.frames).into_iter().enumerate() {
        let Some(PanoramaPart { size, .. }) = frame.panorama else {
            cut.push((old, frame));
            continue;
        };
        if size[0].abs_diff(2 * size[1]) > ROUNDED_PX || size[1] == 0 {
            let (path, image, view) = (frame.described_in, frame.image, frame.name);
            return Err(DatasetError::Panorama { path, image, view, found: size });
        }
        cut.extend(Face::ALL.map(|face| {
            let camera = face.camera(&frame.camera.camera_from_world, size[0], frame.camera.near);
            let panorama = Some(PanoramaPart { face, size });
            (old, Frame { name: face.name_in(&frame.name), camera, panorama, ..frame.clone() })
        }));
    }
    cut.sort_by(|(_, a), (_, b)| a.name.cmp(&b.name));
    if let Some(pair) = cut.windows(2).find(|pair| pair[0].1.name == pair[1].1.name) {
        let (path, what) = (&pair[0].1.described_in, format!("the name `{}`", pair[0].1.name));
        return Err(DatasetError::malformed(
            path,
            what,
            "that of a view and of a face of a panorama",
            "different names",
        ));
    }
    let mut new_of = vec![Vec::new(); cut.iter().map(|(old, _)| old + 1).max().unwrap_or(0)];
    cut.iter().enumerate().for_each(|(new, (old, _))| new_of[*old].push(new as u32));
    source.frames = cut.into_iter().map(|(_, frame)| frame).collect();
    let (frames, positions) = (&source.frames, &source.points.positions);
    let shows = |new: &u32, point: usize| {
        let frame = &frames[*new as usize];
        frame.panorama.is_none() || frame.camera.pixel(positions[point]).is_some()
    };
    let seen_by = source.points.seen_by.iter().enumerate();
    let seen_by = seen_by
        .map(|(point, views)| -> Vec<u32> {
            let views = views.iter().flat_map(|&old| &new_of[old as usize]).copied();
            views.filter(|new| shows(new, point)).collect()
        })
        .collect();
    source.points.seen_by = seen_by;
    Ok(())
}

#[cfg(test)]
mod tests {
    use std::path::Path;

    use super::super::fixtures::{
        self, Encoding, assert_refused, colmap_folder, export_panoramas, nerfstudio_frame, write_png, write_transforms,
    };
    use super::super::{BuiltinOptions, DepthKind, LoadOptions, MaxResolution, builtin, builtin_geometry, load};

    fn room() -> (tempfile::TempDir, super::super::Dataset) {
        let options =
            BuiltinOptions { width: 8, height: 8, train_views: 4, test_views: 2, points: 30, ..Default::default() };
        let (folder, data) = (tempfile::tempdir().unwrap(), builtin(&options));
        export_panoramas(folder.path(), &data, 128, 1);
        (folder, data)
    }

    fn mask(path: &Path, counts: impl Fn(u32) -> bool) {
        fixtures::save(path, image::GrayImage::from_fn(128, 64, |_, y| image::Luma([u8::from(counts(y))])));
    }

    #[test]
    fn faces_stay_with_their_photograph_and_are_read_again_alike() {
        let (folder, original) = room();
        let read = |memory: usize| {
            let options = LoadOptions { memory, depth: Some(DepthKind::Metric), ..Default::default() };
            load(folder.path(), &options).unwrap()
        };
        let (mut data, again) = (read(usize::MAX), read(0));
        assert_eq!(
            (data.train.len(), data.test.len(), data.train[2].name.as_str()),
            (24, 12, "images/train_000_front.png")
        );
        assert!((data.extent - original.extent).abs() < 1e-9);
        let mut with_depth = 0;
        for (view, other) in data.train.iter().zip(&again.train) {
            assert_eq!(
                (view.picture().unwrap(), view.camera, &view.depth),
                (other.picture().unwrap(), other.camera, &other.depth)
            );
            assert!(!other.photograph.is_kept() && view.camera.width == 44 && view.camera.lens.is_none());
            let truth = original.train.iter().find(|of| view.name.contains(&of.name)).unwrap();
            assert!((view.camera.centre() - truth.camera.centre()).length() < 1e-9);
            let middle = 22 * 44 + 22;
            let (depth, _) = builtin_geometry(&view.camera);
            let found = view.depth.as_ref().unwrap().value(middle).unwrap();
            with_depth += usize::from((found / f64::from(depth[middle]) - 1.0).abs() < 0.1);
        }
        assert!(with_depth >= 22, "{with_depth} of 24");
        let [found, expected] = [data.train[2].camera, original.train[0].camera];
        let turn = found.camera_from_world.rotation - expected.camera_from_world.rotation;
        assert!(turn.to_cols_array().iter().all(|entry| entry.abs() < 1e-9), "{turn}");
        data.keep_for_validation(2);
        let kept: Vec<String> = data.validation.iter().map(super::super::View::photograph_name).collect();
        assert_eq!((kept.len(), kept.iter().filter(|name| *name == "images/train_001.png").count()), (12, 6));
        let small =
            load(folder.path(), &LoadOptions { max_resolution: MaxResolution(20), ..Default::default() }).unwrap();
        assert_eq!((small.train[0].camera.width, small.train[0].picture().unwrap().bytes.len()), (20, 1200));
    }

    #[test]
    fn faces_that_a_mask_covers_are_left_out_and_others_keep_theirs() {
        let (folder, _) = room();
        mask(&folder.path().join("masks/train_001.png"), |y| y < 40);
        let data = load(folder.path(), &LoadOptions::default()).unwrap();
        assert_eq!((data.train.len(), data.test.len()), (23, 12));
        let of = |face: &str| data.train.iter().find(|view| view.name == format!("images/train_001_{face}.png"));
        assert!(of("down").is_none() && of("up").unwrap().picture().unwrap().ignored_pixels() == 0);
        let front = of("front").unwrap().picture().unwrap();
        assert!(front.counts(22 * 44 + 22) && !front.counts(43 * 44 + 22));
        mask(&folder.path().join("masks/train_001.png"), |_| false);
        assert_refused(folder.path(), &LoadOptions::default(), &["images/train_001.png", "--invert-masks"]);
    }

    #[test]
    fn points_are_seen_by_the_faces_that_show_them() {
        let mut scene = fixtures::scene(9);
        (scene.model, scene.params) = ((17, "EQUIRECTANGULAR"), vec![24.0, 12.0]);
        let folder = colmap_folder(&scene, Encoding::Text);
        let cameras = folder.path().join("sparse/0/cameras.txt");
        let text = std::fs::read_to_string(&cameras).unwrap().replace("24 16", "24 12");
        std::fs::write(&cameras, text).unwrap();
        scene
            .images
            .iter()
            .for_each(|image| write_png(&folder.path().join("images").join(&image.name), 48, 24, image.rgb));
        let data = load(folder.path(), &LoadOptions::default()).unwrap();
        // twice as large as the camera says
        assert_eq!((data.train.len(), data.train[0].camera.width), (42, 17));
        for (point, views) in data.points.seen_by.iter().enumerate() {
            assert!(!views.is_empty(), "point {point}");
            for &view in views {
                let position = glam::DVec3::from_array(data.points.positions[point].map(f64::from));
                assert!(data.train[view as usize].camera.pixel(position).is_some());
                assert!(data.train[view as usize].name.starts_with("left/00"));
            }
        }
        // cameras look at the middle of the points
        let by_view = data.points.seen_by.by_view(42);
        assert!(by_view.iter().zip(&data.train).all(|(seen, view)| seen.is_empty() || !view.name.contains("back")));
    }

    #[test]
    fn wrong_panoramas_are_refused_by_name() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("transforms.json");
        let write = |header: &str| {
            let frames: Vec<String> =
                (0..2).map(|i| nerfstudio_frame(folder.path(), &i.to_string(), [i, 2], "")).collect();
            write_transforms(&path, header, &frames);
        };
        let refused = |parts: &[&str]| assert_refused(folder.path(), &LoadOptions::default(), parts);
        write(r#""camera_model": "EQUIRECTANGULAR""#);
        refused(&[
            "transforms.json: view `images/0.png` is a panorama of 24x16 px",
            "twice as wide as high",
            "0.png by",
        ]);
        write(r#""camera_model": "EQUIRECTANGULAR", "w": 32, "h": 16"#);
        refused(&["images/1.png is 24x16 px", "32x16", "aspects differ"]);
        write(r#""camera_model": "EQUIRECTANGULAR", "k1": 0.1"#);
        refused(&["camera model EQUIRECTANGULAR of view `images/0.png`", "distortion"]);
        write(r#""camera_model": "EQUIRECTANGULAR", "is_fisheye": true"#);
        refused(&["`is_fisheye` contradicts it"]);
        let mut frames: Vec<String> =
            (0..2).map(|i| nerfstudio_frame(folder.path(), &i.to_string(), [i, 2], "")).collect();
        frames.push(nerfstudio_frame(folder.path(), "0_up", [1, 2], r#""camera_model": "PINHOLE", "fl_x": 9,"#));
        write_png(&folder.path().join("images/0.png"), 32, 16, [0; 3]);
        write_png(&folder.path().join("images/1.png"), 32, 16, [0; 3]);
        write_transforms(&path, r#""camera_model": "EQUIRECTANGULAR""#, &frames);
        refused(&["the name `images/0_up.png`", "a face of a panorama"]);
    }
}
