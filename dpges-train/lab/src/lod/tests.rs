use std::fs;
use std::path::Path;

use dpges_core::camera::Camera;
use dpges_core::scene::lobes::ABSENT;
use dpges_core::scene::lod::Index;
use dpges_core::scene::tensors::tensor_to_rows;
use dpges_core::scene::{ColourModel, EnvironmentData};
use dpges_core::testing::scenes::{Recipe, random, realistic};
use dpges_train::eval::rendered::TrainingRenderer;

use super::*;
use crate::fixtures::device;

/// 200 surfels and 1800 Gaussians in a room, with a sky, in colours that change slowly.
fn scene() -> (SceneData, Camera) {
    let (mut scene, camera) = realistic(200, 1800, 96, 64, 1).into_scene();
    let smooth = |positions: &[f32]| -> Vec<f32> {
        let of = |p: &[f32]| [(2.0 * p[0]).sin(), (3.0 * p[1]).cos(), p[2].sin()];
        positions.chunks_exact(3).flat_map(of).collect()
    };
    scene.surfels.colour.base = smooth(&scene.surfels.positions);
    scene.gaussians.colour.base = smooth(&scene.gaussians.positions);
    scene.surfels.colour.detail.fill(ABSENT);
    scene.gaussians.colour.detail.fill(ABSENT);
    (SceneData { environment: Some(EnvironmentData::neutral(1)), ..scene }, camera)
}

fn exported(scene: &SceneData, camera: Camera, fit: Option<(usize, &Device)>, out: &Path) -> Index {
    write(scene.clone(), &Options { cell_primitives: 300, cameras: &[camera], fit }, out).unwrap()
}

fn image(scene: &SceneData, camera: &Camera) -> Vec<f32> {
    tensor_to_rows(TrainingRenderer::new(scene, &device()).render(camera).unwrap().image())
}

fn psnr(a: &[f32], b: &[f32]) -> f64 {
    let squared: f64 = a.iter().zip(b).map(|(a, b)| f64::from(a.clamp(0.0, 1.0) - b.clamp(0.0, 1.0)).powi(2)).sum();
    -10.0 * (squared / a.len() as f64).log10()
}

#[test]
fn leaves_hold_every_primitive_once_and_about_as_many() {
    let (scene, _) = scene();
    for (most, cells) in [(1, 2048), (300, 8), (1000, 2), (2000, 1), (5000, 1)] {
        let leaves = tree::leaves(&scene, most);
        assert_eq!(leaves.len(), cells);
        for kind in 0..2 {
            let mut rows: Vec<usize> = leaves.iter().flat_map(|leaf| leaf[kind].clone()).collect();
            rows.sort_unstable();
            assert!(rows.into_iter().eq(0..[200, 1800][kind]), "{most}");
        }
        let counts = || leaves.iter().map(|[surfels, gaussians]| surfels.len() + gaussians.len());
        assert!(counts().max().unwrap() <= most && counts().max().unwrap() - counts().min().unwrap() <= 1);
        assert_eq!(tree::leaves(&scene, most), leaves);
    }
    // siblings are two halves of a box that do not overlap along one axis
    let leaves = tree::leaves(&scene, 1000);
    let along = |leaf: &tree::Rows, axis: usize| {
        let of =
            |positions: &[f32], rows: &[usize]| rows.iter().map(|row| positions[3 * row + axis]).collect::<Vec<_>>();
        [of(&scene.surfels.positions, &leaf[0]), of(&scene.gaussians.positions, &leaf[1])].concat()
    };
    let apart = |axis: usize| {
        let most = along(&leaves[0], axis).into_iter().fold(f32::MIN, f32::max);
        most <= along(&leaves[1], axis).into_iter().fold(f32::MAX, f32::min)
    };
    assert!((0..3).any(apart));
}

#[test]
fn level_0_is_the_scene_and_the_others_are_about_half_of_the_finer() {
    let folder = tempfile::tempdir().unwrap();
    let (scene, camera) = scene();
    let out = folder.path().join("new/lod");
    let index = exported(&scene, camera, None, &out);
    assert_eq!((Index::open(&out).unwrap(), index.level_count(), index.cells.len()), (index.clone(), 4, 15));
    let whole = image(&scene, &camera);
    let finest = level(&index, 0).unwrap();
    assert_eq!((finest.surfels.len(), finest.gaussians.len()), (200, 1800));
    let loss = psnr(&image(&finest, &camera), &whole);
    assert!(loss > 45.0, "{loss}");
    for coarse in 1..4 {
        // each merged cell rounds up its surfels and its Gaussians
        let (all, half) = (level(&index, coarse).unwrap(), 2000 >> coarse);
        assert!((half..half + 8).contains(&(all.surfels.len() + all.gaussians.len())));
    }
    for cell in &index.cells {
        assert!(cell.primitives() <= 300 && cell.size > 0.0);
        assert_eq!(cell.parent.is_none(), cell.level == 3);
    }
    // the same bytes again, in place of the old ones; nothing else is left
    let files = |out: &Path| -> Vec<(std::ffi::OsString, Vec<u8>)> {
        let files = fs::read_dir(out).unwrap().map(|file| file.unwrap());
        let mut files: Vec<_> = files.map(|file| (file.file_name(), fs::read(file.path()).unwrap())).collect();
        files.sort_unstable();
        files
    };
    let before = files(&out);
    assert_eq!(exported(&scene, camera, None, &out), index);
    assert_eq!(files(&out), before);
    // and in place of an index that was cut off
    let whole = fs::read(out.join("index.json")).unwrap();
    fs::write(out.join("index.json"), &whole[..100]).unwrap();
    assert!(Index::open(&out).unwrap_err().to_string().contains("export it again"));
    assert_eq!(exported(&scene, camera, None, &out), index);
    assert_eq!(files(&out), before);
    fs::write(out.join("index.json"), "{}").unwrap();
    let taken = write(scene.clone(), &Options { cell_primitives: 300, cameras: &[camera], fit: None }, &out);
    assert!(matches!(taken, Err(LodError::Taken(_))));
    fs::write(out.join("index.json"), whole).unwrap();
    assert_eq!(fs::read_dir(out.parent().unwrap()).unwrap().count(), 1);
    let described = describe::describe(&out).unwrap();
    let parts = before.iter().filter(|(name, _)| name != "index.json" && name != "cameras.json");
    assert_eq!(described.bytes, parts.map(|(_, bytes)| bytes.len() as u64).sum::<u64>());
    assert!(described.rows().last().unwrap().1.trim_start().starts_with("0      8        200       1800"));
}

#[test]
fn coarser_levels_look_like_the_scene_in_small_pictures_and_a_fit_brings_them_nearer() {
    let (scene, camera) = scene();
    let device = device();
    let mut psnrs = Vec::new();
    for fit in [None, Some((20, &device))] {
        let folder = tempfile::tempdir().unwrap();
        let out = folder.path().join("lod");
        let index = exported(&scene, camera, fit, &out);
        let small = Pictures::new(&scene, &[camera], 1, &device).unwrap();
        let view = &small.of(1)[0];
        assert_eq!((view.camera.width, view.camera.height), (48, 32));
        let target = view.picture().unwrap().planes();
        psnrs.push([1, 2].map(|coarse| psnr(&image(&level(&index, coarse).unwrap(), &view.camera), &target)));
    }
    let [merged, fitted] = psnrs[..] else { unreachable!() };
    assert!(merged[0] > 25.0 && merged[1] > 22.0, "{merged:?}");
    assert!(fitted[0] > merged[0] + 2.0 && fitted[1] > merged[1] + 2.0, "{merged:?} {fitted:?}");
}

#[test]
fn equal_gaussians_at_one_place_become_one_that_looks_the_same() {
    for model in ["sb2", "sb0", "sh2"] {
        let model: ColourModel = model.parse().unwrap();
        let made = random(5, &Recipe { surfels: 0, gaussians: 1, model, ..Default::default() });
        let (mut scene, camera) = made.into_scene();
        scene.gaussians = scene.gaussians.select(&[0, 0]);
        scene.gaussians.opacities.fill(0.7);
        let ahead = camera.unproject(0.5 * camera.width as f64, 0.5 * camera.height as f64, 4.0);
        scene.gaussians.positions = ahead.as_vec3().to_array().repeat(2);
        scene.gaussians.log_scales = [-1.0, -1.4, -2.0].repeat(2);
        let both = image(&scene, &camera);
        let mut first = scene.clone();
        first.gaussians = first.gaussians.select(&[0]);
        // pixels of one alone are those where neither is cut off
        let one = image(&first, &camera);
        scene.gaussians = half_of_gaussians(&scene.gaussians, |_| 1.0);
        assert_eq!(scene.gaussians.len(), 1);
        let merged = image(&scene, &camera);
        let mut seen = 0;
        for ((both, merged), one) in both.iter().zip(&merged).zip(&one) {
            if *one != 0.0 {
                seen += 1;
                assert!((both - merged).abs() < 1e-4, "{model}: {both} {merged}");
            } else {
                // the weight of both is 2/255 at most where one is cut off
                assert!((both - merged).abs() <= 2.0 / 255.0 * 3.0, "{model}: {both} {merged}");
            }
        }
        assert!(seen > 50, "{seen}");
    }
}

#[test]
fn merging_keeps_the_mean_the_spread_and_the_sum_of_weights() {
    /// Mass, mean, mean red, and the variance along x of the weight.
    fn moments(gaussians: &GaussianData) -> [f64; 6] {
        let blob = |row: usize| {
            let sigmas: [f64; 3] = std::array::from_fn(|axis| f64::from(gaussians.log_scales[3 * row + axis]).exp());
            let place: [f64; 3] = std::array::from_fn(|axis| gaussians.positions[3 * row + axis].into());
            let turn: [f64; 4] = std::array::from_fn(|at| gaussians.quaternions[4 * row + at].into());
            let frame = glam::DMat3::from_quat(glam::DQuat::from_xyzw(turn[1], turn[2], turn[3], turn[0]).normalize());
            let mass = f64::from(gaussians.opacities[row]) * blob::mean_area(sigmas);
            (mass, DVec3::from_array(place), blob::covariance(frame, sigmas.into()).x_axis.x)
        };
        let blobs: Vec<_> = (0..gaussians.len()).map(blob).collect();
        let total: f64 = blobs.iter().map(|(mass, ..)| mass).sum();
        let middle = blobs.iter().map(|(mass, place, _)| *place * *mass).sum::<DVec3>() / total;
        let reds = gaussians.colour.base.iter().step_by(3);
        let red: f64 = blobs.iter().zip(reds).map(|((mass, ..), red)| mass * f64::from(*red)).sum();
        let spread = blobs.iter().map(|(mass, place, own)| mass * (own + (place.x - middle.x).powi(2))).sum::<f64>();
        [total, middle.x, middle.y, middle.z, red / total, spread / total]
    }
    let (scene, _) = scene();
    let half = half_of_gaussians(&scene.gaussians, |_| 1.0);
    assert_eq!(half.len(), 900);
    for (before, after) in moments(&scene.gaussians).into_iter().zip(moments(&half)) {
        assert!((before - after).abs() < 1e-4 * before.abs().max(1.0), "{before} {after}");
    }
}

#[test]
fn two_surfels_side_by_side_become_one_that_covers_both() {
    let model = ColourModel::default();
    let mut surfels = SurfelData::neutral(model, 2);
    surfels.positions = vec![-1.0, 0.0, 0.0, 1.0, 0.0, 0.0];
    surfels.log_scales.fill((1.0f32 / 2.61).ln());
    surfels.margins = vec![0.1, 0.3];
    surfels.colour.base = vec![1.0, 0.0, 0.0, 0.0, 1.0, 0.0];
    let one = half_of_surfels(&surfels, 30.0, |_| 1.0);
    assert_eq!((one.len(), &one.colour.base[..]), (1, &[0.5, 0.5, 0.0][..]));
    assert!(one.positions.iter().all(|x| x.abs() < 1e-6) && (one.margins[0] - 0.2).abs() < 1e-6);
    // discs of radius 1: an ellipse of semi-axes √5 and 1 has their variance
    let radii: Vec<f32> = one.log_scales.iter().map(|scale| 2.61 * scale.exp()).collect();
    assert!((radii[0] - 5f32.sqrt()).abs() < 0.01 && (radii[1] - 1.0).abs() < 0.01, "{radii:?}");
    let [w, x, y, z] = std::array::from_fn(|at| f64::from(one.quaternions[at]));
    let normal = glam::DQuat::from_xyzw(x, y, z, w) * DVec3::Z;
    assert!(normal.z.abs() > 0.999_99, "{normal}");
}

#[test]
fn folders_of_others_and_scenes_that_cannot_be_merged_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("thesis.tex"), "text").unwrap();
    let (scene, camera) = scene();
    let options = Options { cell_primitives: 300, cameras: &[camera], fit: None };
    let told = |scene: SceneData, out: &Path| write(scene, &options, out).unwrap_err().to_string();
    let taken = told(scene.clone(), folder.path());
    assert!(taken.contains("name another folder") && taken.contains(&*folder.path().to_string_lossy()), "{taken}");
    assert!(told(scene.clone(), &folder.path().join("thesis.tex")).contains("name another"));
    let sorted = SceneInfo { rendering: Rendering::Ellipsoids, ..scene.info.clone() };
    assert!(told(SceneData { info: sorted, ..scene.clone() }, &folder.path().join("a")).contains("ellipsoids"));
    let none = SceneData { surfels: scene.surfels.select(&[]), gaussians: scene.gaussians.select(&[]), ..scene };
    assert!(told(none, &folder.path().join("b")).contains("no primitives"));
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
}

#[test]
fn cameras_around_a_scene_look_at_it_from_outside() {
    let (scene, _) = scene();
    let cameras = around(&scene);
    let middle = cameras.iter().map(Camera::centre).sum::<DVec3>() / cameras.len() as f64;
    for camera in &cameras {
        camera.validate().unwrap();
        let depth = camera.depth(middle);
        assert!(depth > 0.9 * (camera.centre() - middle).length() && depth > 1.0, "{depth}");
    }
}
