//! The renderer against the golden files: images of the float64 specification of the model. Ignored without a graphics
//! adapter, unless `DPGES_REQUIRE_GPU` is set.

use std::path::{Path, PathBuf};
use std::process::ExitCode;

use dpges_core::camera::{Camera, CameraFromWorld, Distortion, Lens, Projection};
use dpges_core::scene::schema::{Attribute, Columns};
use dpges_core::scene::{ColourModel, EnvironmentData, Footprint, GaussianData, SceneData, SceneInfo, SurfelData};
use dpges_render::{DepthSource, Display, Headless, MAX_LAYERS, Precision, RasterRenderer, RenderOptions};
use glam::{DMat3, DVec3};
use libtest_mimic::{Arguments, Failed, Trial};
use safetensors::SafeTensors;

/// Least PSNR, dB: with 32-bit and with 16-bit sums, and with depths from corners that are not moved to coarse steps.
const LEAST_DB: [(Precision, DepthSource, f64); 4] = [
    (Precision::Float, DepthSource::Computed, 60.0),
    (Precision::Half, DepthSource::Computed, 40.0),
    (Precision::Float, DepthSource::Rasterised, 50.0),
    (Precision::Half, DepthSource::Rasterised, 40.0),
];

/// GL maps interpolated depths to −1 … 1, where floats are not dense: layers that are 10⁵ near planes away are told apart
/// badly. dB
const LEAST_FAR_ON_GL_DB: f64 = 30.0;

type Check = fn(&Headless) -> Result<(), Failed>;
type Test = Box<dyn FnOnce(&Headless) -> Result<(), Failed> + Send>;

struct Golden {
    scene: SceneData,
    camera: Camera,
    /// [3, H, W]
    image: Vec<f32>,
}

fn files() -> Vec<PathBuf> {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/golden");
    let entries = std::fs::read_dir(&folder).unwrap_or_else(|error| panic!("{}: {error}", folder.display()));
    let mut files: Vec<PathBuf> = entries.map(|entry| entry.unwrap().path()).collect();
    files.retain(|file| file.extension().is_some_and(|extension| extension == "safetensors"));
    files.sort();
    assert!(!files.is_empty(), "no golden files in {}", folder.display());
    files
}

fn numbers(file: &SafeTensors, name: &str) -> Vec<f64> {
    let view = file.tensor(name).unwrap_or_else(|error| panic!("{name}: {error}"));
    view.data().as_chunks::<8>().0.iter().map(|&bytes| f64::from_le_bytes(bytes)).collect()
}

impl Golden {
    fn load(path: &Path) -> Self {
        let bytes = std::fs::read(path).unwrap();
        let (_, header) = SafeTensors::read_metadata(&bytes).unwrap();
        let metadata = header.metadata().clone().unwrap();
        let file = SafeTensors::deserialize(&bytes).unwrap();
        let number = |key: &str| metadata[key].parse::<f64>().unwrap();
        let [fx, fy, cx, cy] = numbers(&file, "camera.intrinsics").try_into().unwrap();
        let [width, height] = ["width", "height"].map(|key| number(key) as usize);
        let camera_from_world = CameraFromWorld {
            rotation: DMat3::from_cols_slice(&numbers(&file, "camera.rotation")).transpose(),
            translation: DVec3::from_slice(&numbers(&file, "camera.translation")),
        };
        let camera = Camera { camera_from_world, fx, fy, cx, cy, width, height, near: number("near"), lens: None };
        let lobes = file.tensor("gaussians.colour.lobes").unwrap().shape()[1];
        let model = ColourModel::SphericalBeta { lobes };
        let read = |attribute: &'static Attribute| {
            if attribute.is_left_out(model) {
                return Vec::new();
            }
            floats(&file, &attribute.name.replace(".detail", ".lobes"))
        };
        let scene = SceneData {
            info: SceneInfo {
                colour_model: model,
                modulation: number("modulation"),
                layer_count: number("layer_count") as usize,
                footprint: if metadata["footprint"] == "opacity" { Footprint::Opacity } else { Footprint::Kernel },
                peeling: metadata["peeling"].parse().unwrap(),
                background: numbers(&file, "background").try_into().unwrap(),
                ..SceneInfo::default()
            },
            surfels: SurfelData::generate(model, SurfelData::ATTRIBUTES.iter().map(read)),
            gaussians: GaussianData::generate(model, GaussianData::ATTRIBUTES.iter().map(read)),
            environment: (file.tensor("environment").is_ok())
                .then(|| EnvironmentData { coefficients: floats(&file, "environment") }),
        };
        let pixels = floats(&file, "out.image");
        let plane = |channel: usize| pixels.iter().skip(channel).step_by(3).copied();
        let image = (0..3).flat_map(plane).collect();
        Self { scene, camera, image }
    }
}

fn can(headless: &Headless, precision: Precision) -> bool {
    precision == Precision::Half || RasterRenderer::best_precision(headless.device()) == precision
}

/// dB over the pixels of [3, H, W] but the `left_out` worst.
fn psnr(found: &[f32], expected: &[f32], left_out: usize) -> f64 {
    assert_eq!(found.len(), expected.len());
    let area = found.len() / 3;
    let of_value = |at: usize| f64::from(found[at] - expected[at]).powi(2);
    let mut errors: Vec<f64> = (0..area).map(|pixel| (0..3).map(|c| of_value(c * area + pixel)).sum()).collect();
    errors.sort_by(f64::total_cmp);
    errors.truncate(area - left_out);
    -10.0 * (errors.iter().sum::<f64>() / (3 * errors.len()) as f64).log10()
}

/// The permutation of `count` rows that a linear congruence makes.
fn shuffled(count: usize) -> Vec<usize> {
    let mut rows: Vec<usize> = (0..count).collect();
    let mut state = 12345u64;
    for last in (1..count).rev() {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        rows.swap(last, (state >> 33) as usize % (last + 1));
    }
    rows
}

fn floats(file: &SafeTensors, name: &str) -> Vec<f32> {
    numbers(file, name).into_iter().map(|value| value as f32).collect()
}

/// Whether the driver moves corners to steps of 1/16 px.
fn has_coarse_corners(headless: &Headless) -> bool {
    headless.adapter_name().contains("SwiftShader")
}

fn agrees(headless: &Headless, path: &Path) -> Result<(), Failed> {
    let golden = Golden::load(path);
    let options = RenderOptions::from(&golden.scene.info);
    assert!(golden.scene.info.layer_count <= MAX_LAYERS);
    // in strict order a pixel on an edge may be on its other side in f32
    let on_edges = if options.peeling.is_continuous() { 0 } else { golden.camera.width * golden.camera.height / 1000 };
    let name = path.file_stem().unwrap().to_string_lossy();
    let is_far_on_gl = headless.backend() == wgpu::Backend::Gl && name == "large_world";
    for (precision, depths, least) in LEAST_DB.into_iter().filter(|&(precision, _, _)| can(headless, precision)) {
        let is_rasterised = depths == DepthSource::Rasterised;
        let least = if is_far_on_gl && is_rasterised { LEAST_FAR_ON_GL_DB } else { least };
        let mut renderer = headless.float_renderer(precision, depths)?;
        renderer.upload(&golden.scene)?;
        let found = headless.planes(&mut renderer, &golden.camera, &options)?;
        let db = psnr(&found, &golden.image, on_edges);
        println!("{name}, {precision:?}, {depths:?}: {db:.1} dB");
        if db < least && !(is_rasterised && has_coarse_corners(headless)) {
            return Err(format!("{precision:?}, {depths:?}: {db:.2} dB, expected at least {least}").into());
        }
        let beside = Camera { cx: golden.camera.cx + 1.0, ..golden.camera };
        let wrong = headless.planes(&mut renderer, &beside, &options)?;
        if psnr(&wrong, &golden.image, on_edges) >= least {
            return Err("a picture that is shifted by a pixel is not told from the right one".into());
        }
    }
    Ok(())
}

fn order_does_not_matter(headless: &Headless) -> Result<(), Failed> {
    // a sum of halves depends on its order in the last place of 11 bits
    let (precision, depths) =
        (RasterRenderer::best_precision(headless.device()), RasterRenderer::best_depths(headless.device()));
    let tolerance = if precision == Precision::Float { 1e-5 } else { 4e-3 };
    let mut renderer = headless.float_renderer(precision, depths)?;
    for path in files() {
        let Golden { mut scene, camera, .. } = Golden::load(&path);
        let options = RenderOptions::from(&scene.info);
        renderer.upload(&scene)?;
        let before = headless.planes(&mut renderer, &camera, &options)?;
        scene.surfels = scene.surfels.select(&shuffled(scene.surfels.len()));
        scene.gaussians = scene.gaussians.select(&shuffled(scene.gaussians.len()));
        renderer.upload(&scene)?;
        let after = headless.planes(&mut renderer, &camera, &options)?;
        let largest = before.iter().zip(&after).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        println!("{}: largest difference {largest:.1e}", path.file_stem().unwrap().to_string_lossy());
        if largest > tolerance {
            return Err(format!("{}: shuffled primitives differ by {largest}", path.display()).into());
        }
    }
    Ok(())
}

/// A rim over two cores in the same plane, as far away: each hides half of the others, whatever their indices.
fn surfels_at_one_depth_mix(headless: &Headless) -> Result<(), Failed> {
    let info = SceneInfo { layer_count: 3, modulation: 30.0, ..SceneInfo::default() };
    let mut surfels = SurfelData::neutral(info.colour_model, 3);
    let gaussians = GaussianData::neutral(info.colour_model, 0);
    // opacity at 3 σ
    let (sigma, alpha) = (0.3f64, (info.footprint.squared_radius(30.0) - 9.0) * info.footprint.rim_slope(30.0));
    surfels.margins.fill(0.1);
    surfels.positions =
        [[3.0 * sigma, 0.0, 0.0], [0.0; 3], [0.0; 3]].as_flattened().iter().map(|&x| x as f32).collect();
    surfels.log_scales.fill(sigma.ln() as f32);
    surfels.colour.base = vec![1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0];
    let camera_from_world = CameraFromWorld::look_at(DVec3::Z * 4.0, DVec3::ZERO, DVec3::Y);
    let camera = Camera::pinhole(camera_from_world, 10.0, [9, 9], 0.01);
    let [of_rim, of_core] = [0.25 * alpha, 0.5 * (1.0 - 0.5 * alpha)];
    let shares = [of_rim, of_core, of_core].map(|weight| weight / (of_rim + 2.0 * of_core));
    let [rim, green, blue] = [0, 1, 2];
    // a colour is 0.5 + Y0 base
    let y0 = 0.282_094_791_773_878_14;
    let mut renderer = headless.float_renderer(Precision::Half, RasterRenderer::best_depths(headless.device()))?;
    for order in [[rim, green, blue], [blue, rim, green], [green, blue, rim]] {
        let scene = SceneData {
            info: info.clone(),
            surfels: surfels.select(&order),
            gaussians: gaussians.clone(),
            environment: None,
        };
        renderer.upload(&scene)?;
        let planes = headless.planes(&mut renderer, &camera, &RenderOptions::from(&scene.info))?;
        let found = [0, 1, 2].map(|channel| (f64::from(planes[channel * 81 + 40]) - 0.5) / y0);
        println!("{order:?}: {found:.3?}, expected {shares:.3?}");
        if found.iter().zip(shares).any(|(found, expected)| (found - expected).abs() > 0.005) {
            return Err(format!("surfels in the order {order:?} give {found:?}, expected {shares:?}").into());
        }
    }
    Ok(())
}

fn displays_differ(headless: &Headless) -> Result<(), Failed> {
    let path = files().into_iter().find(|file| file.file_stem().is_some_and(|stem| stem == "basic")).unwrap();
    let Golden { scene, camera, .. } = Golden::load(&path);
    let mut renderer = headless.renderer()?;
    renderer.upload(&scene)?;
    let picture = |renderer: &mut _, display| {
        headless.draw(renderer, &camera, &RenderOptions { display, ..RenderOptions::from(&scene.info) })
    };
    let pictures =
        Display::ALL.iter().map(|&display| picture(&mut renderer, display)).collect::<Result<Vec<_>, _>>()?;
    for (index, picture) in pictures.iter().enumerate() {
        assert!(pictures[..index].iter().all(|other| other != picture), "{} looks like another", Display::ALL[index]);
        assert!(picture.bytes.iter().any(|&byte| byte != picture.bytes[0]), "{} is empty", Display::ALL[index]);
    }
    Ok(())
}

fn a_lens_is_refused_by_name(headless: &Headless) -> Result<(), Failed> {
    let Golden { scene, camera, .. } = Golden::load(&files()[0]);
    let camera = Camera { lens: Some(Lens::new(Distortion::new(Projection::Equidistant))), ..camera };
    let mut renderer = headless.renderer()?;
    renderer.upload(&scene)?;
    let drawn = headless.draw(&mut renderer, &camera, &RenderOptions::from(&scene.info));
    let message = drawn.err().ok_or("it was drawn")?.to_string();
    if message.contains("`lens` is Equidistant") && message.contains("only pinhole cameras") {
        Ok(())
    } else {
        Err(message.into())
    }
}

fn main() -> ExitCode {
    let mut arguments = Arguments::from_args();
    arguments.test_threads = arguments.test_threads.or(Some(1));
    let headless = Headless::new();
    if std::env::var_os("DPGES_REQUIRE_GPU").is_some() {
        headless.as_ref().expect("DPGES_REQUIRE_GPU is set");
    }
    let ignored = headless.is_err();
    let trial = |name: String, test: Test| {
        let headless = headless.as_ref().ok().cloned();
        Trial::test(name, move || test(headless.as_ref().ok_or("no graphics adapter")?)).with_ignored_flag(ignored)
    };
    let mut trials: Vec<Trial> = files()
        .into_iter()
        .map(|path| {
            let name = format!("agrees_with_{}", path.file_stem().unwrap().to_string_lossy());
            trial(name, Box::new(move |headless| agrees(headless, &path)))
        })
        .collect();
    let others: [(&str, Check); 4] = [
        ("order_does_not_matter", order_does_not_matter),
        ("surfels_at_one_depth_mix", surfels_at_one_depth_mix),
        ("displays_differ", displays_differ),
        ("a_lens_is_refused_by_name", a_lens_is_refused_by_name),
    ];
    trials.extend(others.map(|(name, test)| trial(name.to_owned(), Box::new(test))));
    libtest_mimic::run(&arguments, trials).exit_code()
}
