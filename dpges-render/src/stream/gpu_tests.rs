//! Streams on whatever graphics adapter there is, from folders.

use std::fs;
use std::path::Path;

use dpges_core::scene::SceneData;
use dpges_core::scene::lod::Index;

use super::fixtures::{camera, filled, forest, write};
use super::residency::FADE_S;
use super::{Levels, Loader, Source, Stream, decode};
use crate::{DepthSource, Headless, Precision, RasterRenderer, RenderOptions};

const EYE: [f64; 3] = [0.2, 0.1, -3.0];

fn renderer(headless: &Headless) -> RasterRenderer {
    headless.float_renderer(Precision::Float, DepthSource::Computed).unwrap()
}

/// Numbers of a picture, four for each pixel.
fn numbers(renderer: &mut RasterRenderer, index: &Index) -> Vec<f32> {
    let texels = renderer.texels(&camera(EYE), &RenderOptions::from(&index.settings)).unwrap();
    bytemuck::pod_collect_to_vec(&texels)
}

fn largest_difference(a: &[f32], b: &[f32]) -> f32 {
    assert_eq!(a.len(), b.len());
    a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max)
}

fn psnr(a: &[f32], b: &[f32]) -> f64 {
    let squares = a.iter().zip(b).map(|(a, b)| f64::from(a - b).powi(2)).sum::<f64>();
    -10.0 * (squares / a.len() as f64).log10()
}

fn read(folder: &Path, index: &Index, cell: usize) -> SceneData {
    index.cell(cell, &Index::read_part(folder, &index.cells[cell].part).unwrap()).unwrap()
}

/// The cells of `level` as one scene, with the sky.
fn whole(folder: &Path, index: &Index, level: u32) -> SceneData {
    let sky = index.sky.as_ref().unwrap();
    let mut scene = index.sky(sky, &Index::read_part(folder, sky).unwrap()).unwrap();
    for cell in index.level(level) {
        let cell = read(folder, index, cell);
        scene.surfels.append(cell.surfels);
        scene.gaussians.append(cell.gaussians);
    }
    scene
}

#[test]
fn the_finest_cut_is_the_scene_and_the_first_the_coarsest_level() {
    let folder = tempfile::tempdir().unwrap();
    let counts = |cell: usize| [40 + cell, 300 + 7 * cell];
    let index = write(folder.path(), forest(2, 3), |index, cell| filled(index, cell, counts(cell)));
    let headless = Headless::new().unwrap();
    let total = |level: u32| index.level(level).map(|cell| index.cells[cell].primitives()).sum::<usize>();
    let largest = index.cells.iter().map(|cell| cell.primitives()).max().unwrap();

    let budget = total(0) + largest;
    let mut streamed = renderer(&headless);
    let mut loader = Loader::new(Levels::open(folder.path(), budget).unwrap(), &mut streamed, || {}).unwrap();
    let mut expected = renderer(&headless);
    let mut compare = |streamed: &mut RasterRenderer, level: u32| {
        expected.upload(&whole(folder.path(), &index, level)).unwrap();
        assert_eq!(streamed.surfel_count(), expected.surfel_count());
        assert_eq!(streamed.gaussian_count(), expected.gaussian_count());
        let [found, wanted] = [streamed, &mut expected].map(|renderer| numbers(renderer, &index));
        assert!(wanted.iter().any(|&value| value > 0.7), "there is something to see");
        let difference = largest_difference(&found, &wanted);
        assert!(difference < 1e-5, "level {level}: {difference}");
    };
    loader.update(&mut streamed, &camera(EYE));
    compare(&mut streamed, 3);
    let most = loader.complete(&mut streamed, &camera(EYE)).unwrap();
    assert!(most > total(0) && most <= budget, "{most} of {budget}");
    compare(&mut streamed, 0);

    // back to an ordinary scene
    let scene = whole(folder.path(), &index, 1);
    streamed.upload(&scene).unwrap();
    compare(&mut streamed, 1);
}

/// A cell whose only child is the same, halfway through its fade, against the cell itself.
fn halfway(headless: &Headless, counts: [usize; 2]) -> [Vec<f32>; 2] {
    let folder = tempfile::tempdir().unwrap();
    let mut index = forest(1, 1);
    index.cells.truncate(2);
    index.cells[0].children.truncate(1);
    (index.cells[1].min, index.cells[1].max) = (index.cells[0].min, index.cells[0].max);
    let index = write(folder.path(), index, |index, _| filled(index, 0, counts));
    let levels = Levels::open(folder.path(), 1_000_000).unwrap();
    let mut renderer = renderer(headless);
    let mut stream = Stream::new(levels.scene(), 1_000_000, &mut renderer).unwrap();
    let camera = camera(EYE);
    let asked = stream.update(&mut renderer, &camera, 0.0);
    assert_eq!(asked, [1]);
    let before = numbers(&mut renderer, &index);
    let source = Source::new(folder.path()).unwrap();
    stream.take(1, decode(&index, 1, &source.read(stream.part(1)).unwrap()));
    stream.update(&mut renderer, &camera, 1.0);
    stream.update(&mut renderer, &camera, 1.0 + 0.3 * FADE_S);
    assert_eq!(renderer.gaussian_count(), 2 * counts[1], "both are drawn");
    let between = numbers(&mut renderer, &index);
    stream.update(&mut renderer, &camera, 1.0 + 2.0 * FADE_S);
    assert_eq!(renderer.gaussian_count(), counts[1]);
    [before, between]
}

#[test]
fn a_cell_that_fades_into_itself_changes_nothing() {
    let headless = Headless::new().unwrap();
    let [before, between] = halfway(&headless, [0, 3000]);
    let difference = largest_difference(&before, &between);
    assert!(difference < 1e-5, "{difference}");
    // rims of surfels cover more where two lie on each other
    let [before, between] = halfway(&headless, [400, 3000]);
    let psnr = psnr(&before, &between);
    assert!(psnr > 30.0, "{psnr} dB");
}

#[test]
fn a_cell_that_cannot_be_read_leaves_its_parent_and_a_message() {
    let folder = tempfile::tempdir().unwrap();
    let index = write(folder.path(), forest(1, 1), |index, cell| filled(index, cell, [20, 200]));
    let headless = Headless::new().unwrap();
    let mut streamed = renderer(&headless);
    let levels = Levels::open(folder.path(), 10_000).unwrap();
    // since it was opened, the file has changed
    let file = folder.path().join("cells.pack");
    let mut bytes = fs::read(&file).unwrap();
    let last = &index.cells[2].part;
    bytes[last.offset as usize..].fill(0);
    fs::write(&file, &bytes).unwrap();
    let mut loader = Loader::new(levels, &mut streamed, || {}).unwrap();
    let error = loader.complete(&mut streamed, &camera(EYE)).unwrap_err().to_string();
    assert!(error.contains("cells.pack") && error.contains("cell 2"), "{error}");
    let status = loader.status();
    assert!(status.failed == 1 && status.retry_in.is_some(), "{status:?}");
    assert_eq!(streamed.gaussian_count(), 200);
}
