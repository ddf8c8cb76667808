//! `cargo bench -p dpges-benches --bench halves`: what pictures lose if one buffer has 16 bits per number instead of 32
//! (half precision), as PSNR against the picture with 32, and if all that lose nothing visible have 16.
//!
//! `--scene FILE --data DATASET` measures a trained scene from the held-out views of a dataset instead of the synthetic one.

use std::path::PathBuf;

use burn::tensor::{DType, Device, Tensor, TensorData};
use clap::Parser;
use dpges_benches::{cpus, machine};
use dpges_core::camera::Camera;
use dpges_core::ops::colour::colour;
use dpges_core::ops::composite::{CompositeOptions, composite};
use dpges_core::ops::environment::environment;
use dpges_core::ops::interval_limits::interval_limits;
use dpges_core::ops::peel::{Layers, PeelOptions, peel};
use dpges_core::ops::splat::splat;
use dpges_core::scene::tensors::{rows_to_tensor, tensor_to_rows};
use dpges_core::scene::{Gaussians, Rendering, SceneData, Surfels};
use dpges_core::testing::scenes::realistic;
use dpges_train::dataset::{LoadOptions, load};
use dpges_train::metrics::psnr;
use half::f16;

/// PSNR from which a loss is not visible, dB.
const INVISIBLE_DB: f64 = 50.0;
/// Primitives that share the origin of their positions.
const BLOCK: usize = 256;
/// Parts that Gaussians are added in where their sums have 16 bits all the time.
const PARTS: usize = 64;

#[derive(Debug, Parser)]
struct Arguments {
    #[arg(long, default_value_t = 10_000)]
    surfels: usize,
    #[arg(long, default_value_t = 100_000)]
    gaussians: usize,
    #[arg(long, default_value_t = 400)]
    width: usize,
    #[arg(long, default_value_t = 400)]
    height: usize,
    /// A scene of surfels and Gaussians instead of the synthetic one
    #[arg(long, requires = "data")]
    scene: Option<PathBuf>,
    /// The dataset that it was trained on
    #[arg(long, requires = "scene")]
    data: Option<PathBuf>,
    /// Longest side of the views of the dataset, px
    #[arg(long, default_value_t = 1600)]
    resolution: usize,
    /// At most this many held-out views, evenly chosen
    #[arg(long, default_value_t = 4)]
    views: usize,
    /// Given by `cargo bench`
    #[arg(long, hide = true)]
    bench: bool,
}

/// A buffer that can have 16 bits per number.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Buffer {
    Positions,
    PositionsFromMiddle,
    PositionsInBlocks,
    Quaternions,
    LogScales,
    Scales,
    Margins,
    Opacities,
    Base,
    Detail,
    Colours,
    Alpha,
    Depth,
    Limits,
    Sums,
    SumsInParts,
    Transmittance,
    Target,
}

impl Buffer {
    const ALL: [(Self, &str); 18] = [
        (Self::Positions, "positions, from the origin"),
        (Self::PositionsFromMiddle, "positions, from the middle of the scene"),
        (Self::PositionsInBlocks, "positions, from the middle of blocks of 256 neighbours"),
        (Self::Quaternions, "quaternions"),
        (Self::LogScales, "log-scales"),
        (Self::Scales, "scales"),
        (Self::Margins, "margins of surfels"),
        (Self::Opacities, "opacities"),
        (Self::Base, "base colours"),
        (Self::Detail, "lobes or harmonics"),
        (Self::Colours, "colours of primitives from a camera"),
        (Self::Alpha, "opacities of layers"),
        (Self::Depth, "depths of layers"),
        (Self::Limits, "limits of depth intervals"),
        (Self::Sums, "sums of Gaussians, rounded once"),
        (Self::SumsInParts, "sums of Gaussians, rounded after each of 64 parts"),
        (Self::Transmittance, "transmittances before Gaussians"),
        (Self::Target, "picture"),
    ];
}

fn half(value: f32) -> f32 {
    f16::from_f32(value).to_f32()
}

fn halved<const D: usize>(tensor: &Tensor<D>) -> Tensor<D> {
    let numbers: Vec<f32> = tensor_to_rows(tensor).into_iter().map(half).collect();
    Tensor::from_data(TensorData::new(numbers, tensor.dims()), (&tensor.device(), DType::F32))
}

/// Rounds positions relative to the middle of the box around them, in blocks of at most `most` neighbours.
fn round_in_blocks(positions: &mut [f32], rows: &mut [usize], most: usize) {
    let at = |positions: &[f32], row: usize, axis: usize| positions[3 * row + axis];
    let range = |axis: usize| {
        rows.iter().fold([f32::INFINITY, f32::NEG_INFINITY], |[low, high], &row| {
            let value = at(positions, row, axis);
            [low.min(value), high.max(value)]
        })
    };
    let ranges = [0, 1, 2].map(range);
    if rows.len() > most {
        let width = |axis: usize| ranges[axis][1] - ranges[axis][0];
        let widest = (0..3).max_by(|&a, &b| width(a).total_cmp(&width(b))).unwrap_or(0);
        let middle = rows.len() / 2;
        rows.select_nth_unstable_by(middle, |&a, &b| at(positions, a, widest).total_cmp(&at(positions, b, widest)));
        let (low, high) = rows.split_at_mut(middle);
        round_in_blocks(positions, low, most);
        return round_in_blocks(positions, high, most);
    }
    for &row in rows.iter() {
        for (axis, [low, high]) in ranges.into_iter().enumerate() {
            let middle = 0.5 * (low + high);
            let value = &mut positions[3 * row + axis];
            *value = middle + half(*value - middle);
        }
    }
}

/// The scene after what `buffer` names was rounded, if it is an attribute.
fn round(scene: &mut SceneData, buffer: Buffer) {
    let SceneData { surfels, gaussians, .. } = scene;
    let each = |columns: [&mut Vec<f32>; 2], rounded: fn(f32) -> f32| {
        columns.into_iter().flatten().for_each(|value| *value = rounded(*value));
    };
    let blocks = |positions: [&mut Vec<f32>; 2], most: usize| {
        for positions in positions {
            let mut rows: Vec<usize> = (0..positions.len() / 3).collect();
            round_in_blocks(positions, &mut rows, most);
        }
    };
    match buffer {
        Buffer::Positions => each([&mut surfels.positions, &mut gaussians.positions], half),
        Buffer::PositionsFromMiddle => blocks([&mut surfels.positions, &mut gaussians.positions], usize::MAX),
        Buffer::PositionsInBlocks => blocks([&mut surfels.positions, &mut gaussians.positions], BLOCK),
        Buffer::Quaternions => each([&mut surfels.quaternions, &mut gaussians.quaternions], half),
        Buffer::LogScales => each([&mut surfels.log_scales, &mut gaussians.log_scales], half),
        Buffer::Scales => {
            each([&mut surfels.log_scales, &mut gaussians.log_scales], |log| half(log.exp()).ln().max(-30.0))
        }
        Buffer::Margins => each([&mut surfels.margins, &mut Vec::new()], half),
        Buffer::Opacities => each([&mut gaussians.opacities, &mut Vec::new()], half),
        Buffer::Base => each([&mut surfels.colour.base, &mut gaussians.colour.base], half),
        Buffer::Detail => each([&mut surfels.colour.detail, &mut gaussians.colour.detail], half),
        _ => {}
    }
}

/// [K, 4, H, W] of the Gaussians, each part of them added to sums of 16 bits.
fn sums_in_parts(gaussians: &Gaussians, colours: &Tensor<2>, limits: &Tensor<3>, camera: &Camera) -> Tensor<4> {
    use dpges_core::scene::schema::Columns;
    let count = gaussians.len();
    let per_part = count.div_ceil(PARTS).max(1);
    let [layers, height, width] = limits.dims();
    let mut sums = Tensor::zeros([layers, 4, height, width], (&limits.device(), DType::F32));
    for first in (0..count).step_by(per_part) {
        let rows = first..(first + per_part).min(count);
        let part = gaussians.map_ref(|_, tensor| tensor.clone().slice_dim(0, rows.clone()));
        let colours = colours.clone().slice_dim(0, rows);
        sums = halved(&(sums + splat(&part, &colours, limits, camera).expect("valid")));
    }
    sums
}

/// The picture of a view in [0, 1], with `buffers` in 16 bits.
fn picture(scene: &SceneData, camera: &Camera, device: &Device, buffers: &[Buffer]) -> Tensor<3> {
    let mut scene = scene.clone();
    buffers.iter().for_each(|&buffer| round(&mut scene, buffer));
    let surfels = Surfels::from_data(&scene.surfels, device, DType::F32);
    let gaussians = Gaussians::from_data(&scene.gaussians, device, DType::F32);
    fn when<const D: usize>(is_half: bool, tensor: Tensor<D>) -> Tensor<D> {
        if is_half { halved(&tensor) } else { tensor }
    }
    let has = |buffer: Buffer| buffers.contains(&buffer);
    let centre = camera.centre().to_array();
    let [of_surfels, of_gaussians] = [(&surfels.colour, &surfels.positions), (&gaussians.colour, &gaussians.positions)]
        .map(|(model, positions)| when(has(Buffer::Colours), colour(model, positions, centre).expect("valid")));
    let options = PeelOptions::from(&scene.info);
    let layers = peel(&surfels.positions, &surfels.quaternions, &surfels.log_scales, camera, &options).expect("valid");
    let layers = Layers {
        alpha: when(has(Buffer::Alpha), layers.alpha),
        depth: when(has(Buffer::Depth), layers.depth),
        ids: layers.ids,
    };
    let limits = interval_limits(&layers, &surfels.margins, scene.info.margin_lookup).expect("valid");
    let limits = when(has(Buffer::Limits), limits);
    let sums = if has(Buffer::SumsInParts) {
        sums_in_parts(&gaussians, &of_gaussians, &limits, camera)
    } else {
        when(has(Buffer::Sums), splat(&gaussians, &of_gaussians, &limits, camera).expect("valid"))
    };
    let blending = CompositeOptions { background: scene.info.background, detach_transmittance: false };
    let mut found = composite(&layers, &of_surfels, &sums, &blending).expect("valid");
    if has(Buffer::Transmittance) {
        let [planes, height, width] = found.transmittance.dims();
        let through = halved(&found.transmittance).slice_dim(0, 0..planes - 1);
        let seen = (sums * through.reshape([planes - 1, 1, height, width])).sum_dim(0).reshape([4, height, width]);
        let (colour, weight) = (seen.clone().slice_dim(0, 0..3), seen.slice_dim(0, 3..4));
        found.image = (found.surfel_image.clone() + colour) / (weight + 1.0);
    }
    if let Some(behind) = &scene.environment {
        let coefficients = rows_to_tensor(&behind.coefficients, 3, device, DType::F32);
        found = found.in_front_of(environment(&coefficients, camera).expect("valid"));
    }
    when(has(Buffer::Target), found.image.clamp(0.0, 1.0))
}

/// The scene, and cameras in its coordinates.
fn subject(arguments: &Arguments) -> (SceneData, Vec<Camera>) {
    let (Some(file), Some(folder)) = (&arguments.scene, &arguments.data) else {
        let Arguments { surfels, gaussians, width, height, .. } = *arguments;
        let (scene, camera) = realistic(surfels, gaussians, width, height, 1).into_scene();
        return (scene, vec![camera]);
    };
    let scene = SceneData::load(file).unwrap_or_else(|error| panic!("{error}"));
    assert_eq!(scene.info.rendering, Rendering::Peeled, "{}: not a scene of surfels and Gaussians", file.display());
    let options = LoadOptions { max_resolution: Some(arguments.resolution), ..LoadOptions::default() };
    let dataset = load(folder, &options).unwrap_or_else(|error| panic!("{error}"));
    let shift = glam::DVec3::from_array(scene.info.offset) - dataset.offset;
    let views = dataset.test;
    assert!(!views.is_empty(), "{}: no held-out views", folder.display());
    let step = views.len().div_ceil(arguments.views.max(1));
    let moved = |camera: Camera| {
        let camera_from_world = camera.camera_from_world.recentred(shift);
        Camera { camera_from_world, near: scene.info.near, ..camera }
    };
    let cameras = views.iter().step_by(step).map(|view| moved(view.camera)).collect();
    (scene, cameras)
}

/// PSNR of all views, mean and smallest, dB.
fn measure(scene: &SceneData, views: &[(Camera, Tensor<3>)], device: &Device, buffers: &[Buffer]) -> [f64; 2] {
    let of_view = |(camera, exact): &(Camera, Tensor<3>)| psnr(picture(scene, camera, device, buffers), exact.clone());
    let found: Vec<f64> = views.iter().map(of_view).collect();
    [found.iter().sum::<f64>() / found.len() as f64, found.into_iter().fold(f64::INFINITY, f64::min)]
}

fn main() {
    let arguments = Arguments::parse();
    let (scene, cameras) = subject(&arguments);
    let device = &cpus()[0].1;
    let exact = |camera: Camera| (camera, picture(&scene, &camera, device, &[]));
    let views: Vec<(Camera, Tensor<3>)> = cameras.into_iter().map(exact).collect();
    let (surfels, gaussians) = (scene.surfels.len(), scene.gaussians.len());
    let Camera { width, height, .. } = views[0].0;
    println!("{}; {surfels} surfels, {gaussians} Gaussians, {} views, {width} × {height} px\n", machine(), views.len());
    println!("| 16 bits | mean, dB | lowest, dB |\n|---|---:|---:|");
    let mut invisible = Vec::new();
    for (buffer, name) in Buffer::ALL {
        let [mean, lowest] = measure(&scene, &views, device, &[buffer]);
        println!("| {name} | {mean:.1} | {lowest:.1} |");
        if lowest >= INVISIBLE_DB {
            invisible.push(buffer);
        }
    }
    let [mean, lowest] = measure(&scene, &views, device, &invisible);
    println!("| all {} of {INVISIBLE_DB} dB or more | {mean:.1} | {lowest:.1} |", invisible.len());
}
