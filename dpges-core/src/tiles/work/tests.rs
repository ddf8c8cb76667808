use burn::tensor::DType;
use glam::{DMat3, DVec3};

use super::*;
use crate::camera::CameraFromWorld;
use crate::render::{Render, RenderOptions, render};
use crate::scene::{ColourModel, Gaussians, Surfels};
use crate::testing::golden::values;
use crate::testing::lenses::{behind, every_model};
use crate::testing::scenes::{Recipe, TestScene, random};

/// 3 × 2 tiles; a pixel is 1/32 of a world unit at depth 1.
fn camera() -> Camera {
    let camera_from_world = CameraFromWorld { rotation: DMat3::IDENTITY, translation: DVec3::ZERO };
    let (fx, fy, cx, cy) = (32.0, 32.0, 24.0, 16.0);
    Camera { camera_from_world, fx, fy, cx, cy, width: 48, height: 32, near: 0.1, lens: None }
}

/// Round Gaussians of 1 px whose centres are at (x, y) px and depth z.
fn gaussians(centres: &[[f32; 3]]) -> GaussianData {
    let mut gaussians = GaussianData::neutral(ColourModel::SphericalBeta { lobes: 0 }, centres.len());
    gaussians.positions =
        centres.iter().flat_map(|&[x, y, z]| [(x - 24.0) / 32.0 * z, (y - 16.0) / 32.0 * z, z]).collect();
    gaussians.log_scales = centres.iter().flat_map(|&[.., z]| [(z / 32.0).ln(); 3]).collect();
    gaussians.opacities = vec![1.0; centres.len()];
    gaussians
}

#[test]
fn entries_are_the_tiles_that_ellipses_touch() {
    // in the middle of a tile, where four tiles meet, and in the last tile behind the others
    let gaussians = gaussians(&[[8.0, 8.0, 1.0], [16.0, 16.0, 1.0], [40.0, 24.0, 5.0]]);
    let work = |ends: Option<&[f32]>| gaussian_work(&gaussians, &camera(), ScreenFilter::Compensated, ends);
    let counted = |work: &TileWork| (work.tiles, work.entries, work.longest, work.evaluated_pairs);
    let all = work(None);
    // each reaches the four regions of 8 × 4 px around it
    assert_eq!(counted(&all), (6, 6, 2, 12 * 32));
    let mut ends = vec![4.0; 48 * 32];
    assert_eq!(counted(&work(Some(&ends))), (6, 5, 2, 8 * 32));
    // one pixel that sees further brings the Gaussian back into the list of its tile, but there it is not
    ends[17 * 48 + 47] = 6.0;
    assert_eq!(counted(&work(Some(&ends))), (6, 6, 2, 8 * 32));
    // and here one of the regions that it reaches is back
    ends[22 * 48 + 34] = 6.0;
    let back = work(Some(&ends));
    assert_eq!(counted(&back), (6, 6, 2, 9 * 32));
    assert!(back.inside_pairs > work(Some(&[4.0; 48 * 32])).inside_pairs && back.inside_pairs < all.inside_pairs);
    assert_eq!(TileWork::default().inside_share(), None);
}

fn rendered(surfels: &SurfelData, gaussians: &GaussianData, camera: &Camera) -> Render {
    let device = crate::backend::device::cpu();
    let surfels = Surfels::from_data(surfels, &device, DType::F32);
    let gaussians = Gaussians::from_data(gaussians, &device, DType::F32);
    render(&surfels, &gaussians, camera, &RenderOptions::default()).unwrap()
}

/// Every primitive drawn alone, all pixels of the image looked at.
fn brute_force(scene: &TestScene) -> (usize, usize) {
    let TestScene { surfels, gaussians, camera } = scene;
    let of_surfel = |i: usize| {
        let ids = rendered(&surfels.select(&[i]), &gaussians.select(&[]), camera).layers.ids.into_data();
        ids.iter::<i32>().filter(|&id| id >= 0).count()
    };
    let of_gaussian = |i: usize| {
        let render = rendered(&surfels.select(&[]), &gaussians.select(&[i]), camera);
        values(&render.composite.gaussian_weight).iter().filter(|&&weight| weight > 0.0).count()
    };
    ((0..surfels.len()).map(of_surfel).sum(), (0..gaussians.len()).map(of_gaussian).sum())
}

/// The work of surfels and of Gaussians, whose pairs inside are those of [`brute_force`], more than `least`.
fn checked(name: &str, scene: &TestScene, least: usize) -> [TileWork; 2] {
    let (surfels, gaussians) = brute_force(scene);
    let of_surfels = surfel_work(&scene.surfels, &scene.camera, &PeelOptions::default());
    let of_gaussians = gaussian_work(&scene.gaussians, &scene.camera, ScreenFilter::Compensated, None);
    assert!(surfels > least && gaussians > least, "{name}: {surfels}, {gaussians}: too few to compare");
    assert_eq!(of_surfels.inside_pairs, surfels as u64, "{name}");
    assert_eq!(of_gaussians.inside_pairs, gaussians as u64, "{name}");
    [of_surfels, of_gaussians]
}

#[test]
fn pairs_inside_are_those_of_every_primitive_drawn_alone() {
    for seed in 1..4 {
        let scene = random(seed, &Recipe { width: 50, height: 35, ..Recipe::default() });
        let [of_surfels, of_gaussians] = checked(&format!("seed {seed}"), &scene, 100);
        for work in [of_surfels, of_gaussians] {
            let share = work.inside_share().unwrap();
            assert!(work.tiles == 12 && share > 0.0 && share < 1.0, "seed {seed}: {work:?}");
        }
        assert_eq!(of_surfels.evaluated_pairs, 256 * of_surfels.entries as u64);
        assert!(of_gaussians.evaluated_pairs < 256 * of_gaussians.entries as u64, "seed {seed}: {of_gaussians:?}");
    }
}

#[test]
fn pairs_inside_are_those_that_lenses_show() {
    // one of each projection
    for (name, distortion) in every_model().into_iter().step_by(4) {
        let mut scene = random(2, &Recipe { width: 50, height: 35, ..Recipe::default() });
        scene.camera = behind(scene.camera, distortion, 120.0);
        checked(name, &scene, 0);
    }
}
