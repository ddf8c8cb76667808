use std::convert::Infallible;

use dpges_core::camera::CameraFromWorld;
use dpges_core::scene::{ColourModel, GaussianData, Rendering, SceneData, SceneInfo, SurfelData};
use dpges_core::testing::scenes::realistic;
use dpges_render::CameraPath;
use glam::DVec3;

use super::*;
use crate::dataset::{BuiltinOptions, builtin};
use crate::run::fixtures::device;

const WIDTH: usize = 64;
const HEIGHT: usize = 48;

fn camera(eye: DVec3, target: DVec3) -> Camera {
    Camera::pinhole(CameraFromWorld::look_at(eye, target, DVec3::Z), 120.0, [WIDTH, HEIGHT], 0.1)
}

/// A slow flight over the floor z = 0: one to two pixels a frame.
fn flight() -> Vec<Camera> {
    let ends = [-0.3, 0.3].map(|x| camera(DVec3::new(x, -2.0, 2.0), DVec3::new(x, 0.0, 0.0)));
    CameraPath::new(ends.to_vec(), false).unwrap().frames(16)
}

/// A soft pattern on the floor.
fn floor(camera: &Camera) -> Frame {
    let (mut planes, mut depth) = (vec![0.0; 3 * WIDTH * HEIGHT], vec![0.0; WIDTH * HEIGHT]);
    for pixel in 0..WIDTH * HEIGHT {
        let (x, y) = ((pixel % WIDTH) as f64 + 0.5, (pixel / WIDTH) as f64 + 0.5);
        let direction = camera.unproject(x, y, 1.0) - camera.centre();
        assert!(direction.z < -0.1, "every pixel shows the floor");
        let distance = -camera.centre().z / direction.z;
        let at = camera.centre() + distance * direction;
        depth[pixel] = distance as f32;
        for channel in 0..3 {
            let wave = (9.0 * at.x + channel as f64).sin() * (7.0 * at.y - channel as f64).cos();
            planes[channel * WIDTH * HEIGHT + pixel] = (0.5 + 0.35 * wave) as f32;
        }
    }
    Frame { camera: *camera, planes, depth }
}

fn measured(frames: &[Frame]) -> Measured {
    Measured::of(frames.iter().map(|frame| Ok::<_, Infallible>(frame.clone()))).unwrap().expect("surfaces are seen")
}

fn popping(frames: &[Frame]) -> Popping {
    measured(frames).popping
}

fn renderer(scene: &SceneData) -> TrainingRenderer {
    TrainingRenderer::new(scene, &device())
}

#[test]
fn nothing_pops_before_a_camera_that_stands_still() {
    let (scene, camera) = realistic(1500, 300, 2 * WIDTH, 2 * HEIGHT, 5).into_scene();
    let still = Measured::along(&renderer(&scene), &[camera; 9]).unwrap().expect("surfels are seen").popping;
    assert_eq!((still.flip_1, still.flip_7, still.frames), (0.0, 0.0, 9));
    assert!(still.pixels_compared.iter().all(|&share| share > 0.1 && share <= 1.0), "{still:?}");
}

#[test]
fn what_the_motion_explains_counts_little_and_a_wrong_motion_much() {
    let frames: Vec<Frame> = flight().iter().map(floor).collect();
    let right = popping(&frames);
    assert_eq!(right.frames, 16);
    assert!(right.pixels_compared[0] > 0.85 && right.pixels_compared[1] > 0.6, "{right:?}");
    assert!(right.flip_1 > 0.0 && right.flip_1 < 0.1 && right.flip_7 < 0.1, "{right:?}");
    // the flight back, with the pictures of the flight there: all motion has the other sign
    let cameras = flight().into_iter().rev();
    let back: Vec<Frame> = cameras.zip(&frames).map(|(camera, frame)| Frame { camera, ..frame.clone() }).collect();
    let opposite = popping(&back);
    // a camera that is said to stand still: no motion at all
    let camera = frames[0].camera;
    let none = popping(&frames.iter().map(|frame| Frame { camera, ..frame.clone() }).collect::<Vec<_>>());
    assert!(right.flip_1 < 0.5 * none.flip_1 && none.flip_1 < opposite.flip_1, "{right:?} {none:?} {opposite:?}");
    assert!(
        right.flip_7 < 0.3 * opposite.flip_7 && right.flip_7 < 0.3 * none.flip_7,
        "{right:?} {none:?} {opposite:?}"
    );
}

#[test]
fn the_frame_that_flashes_is_the_worst_and_its_picture_shows_where() {
    let mut frames: Vec<Frame> = flight().iter().map(floor).collect();
    // in the middle of the left half
    let (x, y) = (WIDTH / 4, HEIGHT / 2);
    let square = (y - 4..y + 4).flat_map(|row| (x - 4..x + 4).map(move |column| row * WIDTH + column));
    for pixel in square {
        frames[11].planes[pixel] = 1.0;
    }
    let [worst_1, worst_7] = measured(&frames).worst;
    // the flash comes with frame 11 and goes with frame 12
    assert!(matches!((worst_1.number, worst_1.step), (11 | 12, 1)), "{worst_1}");
    assert_eq!((worst_7.number, worst_7.step), (11, 7), "{worst_7}");
    let picture = &worst_7.picture;
    assert_eq!((picture.width, picture.height), (3 * WIDTH + 4, HEIGHT));
    let at = |column: usize, row: usize| -> [u8; 3] {
        picture.bytes[3 * (row * picture.width + column)..][..3].try_into().unwrap()
    };
    let [before, after, flip] = [0, 1, 2].map(|part| part * (WIDTH + 2));
    assert_eq!(at(after + x, y)[0], 255);
    assert!(at(before + x, y)[0] < 240, "{:?}", at(before + x, y));
    let calm = at(flip + 3 * WIDTH / 4, y);
    let brightness = |colour: [u8; 3]| colour.iter().map(|&byte| u32::from(byte)).sum::<u32>();
    assert!(brightness(at(flip + x, y)) > 2 * brightness(calm), "{:?} {calm:?}", at(flip + x, y));
    let is_grey = |column: usize| at(flip + column, y) == [128; 3];
    assert!((0..WIDTH).any(is_grey) && !is_grey(x), "what left the picture is not compared");

    let folder = tempfile::tempdir().unwrap();
    assert_eq!(worst_7.save(folder.path()).unwrap(), folder.path().join("worst_flip_7.png"));
    assert!(worst_7.save(&folder.path().join("absent")).unwrap_err().to_string().contains("worst_flip_7.png"));
}

/// Wide red and blue Gaussians, one to the left and one to the right: which is nearer depends on the side that they are
/// seen from.
fn two_gaussians() -> SceneData {
    let model = ColourModel::SphericalBeta { lobes: 0 };
    let mut gaussians = GaussianData::neutral(model, 2);
    gaussians.positions = vec![-0.5, 0.0, 0.0, 0.5, 0.0, 0.0];
    gaussians.log_scales.fill(2f32.ln());
    gaussians.colour.base = vec![1.5, -1.5, -1.5, -1.5, -1.5, 1.5];
    let info = SceneInfo { colour_model: model, rendering: Rendering::Ellipsoids, ..SceneInfo::default() };
    SceneData { info, surfels: SurfelData::neutral(model, 0), gaussians, environment: None }
}

#[test]
fn gaussians_whose_order_changes_pop() {
    let renderer = renderer(&two_gaussians());
    let along = |angles: [f64; 2]| {
        let cameras = (0..10).map(|frame| {
            let angle = angles[0] + (angles[1] - angles[0]) * f64::from(frame) / 9.0;
            let eye = 10.0 * DVec3::new(angle.sin(), -angle.cos(), 0.0);
            Camera { fx: 300.0, fy: 300.0, ..camera(eye, DVec3::ZERO) }
        });
        Measured::along(&renderer, &cameras.collect::<Vec<_>>()).unwrap().expect("Gaussians are seen").popping
    };
    let [ordered, swapped] = [along([0.02, 0.06]), along([-0.02, 0.02])];
    assert!(ordered.pixels_compared[1] > 0.5 && swapped.pixels_compared[1] > 0.5, "{ordered:?} {swapped:?}");
    assert!(swapped.flip_7 > 0.3 && swapped.flip_7 > 3.0 * ordered.flip_7, "{ordered:?} {swapped:?}");
    assert!(swapped.flip_1 > ordered.flip_1 + 0.03, "{ordered:?} {swapped:?}");
}

#[test]
fn hidden_surfaces_the_border_and_the_background_are_left_out() {
    let later = floor(&flight()[1]);
    let earlier = floor(&flight()[0]);
    let whole = later.warped(&earlier);
    let count = |warped: &Warped| warped.is_seen.iter().filter(|&&is_seen| is_seen).count();
    assert!(count(&whole) < WIDTH * HEIGHT, "something has come into the picture");
    let covered = Frame { depth: earlier.depth.iter().map(|depth| 0.5 * depth).collect(), ..earlier.clone() };
    let hidden = later.warped(&covered);
    assert_eq!(count(&hidden), 0);
    assert!(hidden.planes == later.planes, "what is left out does not differ");
    for nothing in [0.0, f32::INFINITY] {
        let empty = Frame { depth: vec![nothing; WIDTH * HEIGHT], ..later.clone() };
        assert_eq!((count(&empty.warped(&earlier)), count(&later.warped(&empty))), (0, 0));
    }
}

#[test]
fn a_scene_without_surfaces_has_no_popping() {
    let info = SceneInfo::default();
    let (surfels, gaussians) = (SurfelData::neutral(info.colour_model, 0), GaussianData::neutral(info.colour_model, 0));
    let scene = SceneData { info, surfels, gaussians, environment: None };
    assert_eq!(Measured::along(&renderer(&scene), &flight()[..9]).unwrap(), None);
}

#[test]
fn the_arc_is_short_and_the_same_whatever_a_view_is_used_for() {
    let options = BuiltinOptions { width: 8, height: 8, supersampling: 1, points: 0, ..Default::default() };
    let mut dataset = builtin(&options);
    let info = SceneInfo { near: 0.05, extent: dataset.extent, ..SceneInfo::default() };
    let path = arc(&dataset, &info).unwrap();
    assert_eq!(path.len(), FRAMES);
    let ends = [0, FRAMES - 1].map(|frame| path[frame].centre());
    let is_view = |centre: DVec3| {
        let mut views = dataset.train.iter().chain(&dataset.test);
        views.any(|view| view.camera.centre().distance(centre) < 1e-9)
    };
    assert!(ends.into_iter().all(is_view) && ends[0].distance(ends[1]) < info.extent, "{ends:?}");
    for pair in path.windows(2) {
        let step = pair[0].centre().distance(pair[1].centre());
        assert!(step > 0.0 && step < info.extent / 30.0, "{step}");
        assert_eq!((pair[0].near, pair[0].width), (0.05, 8));
    }
    dataset.keep_for_validation(4);
    assert!(!dataset.validation.is_empty());
    assert_eq!(arc(&dataset, &info).unwrap(), path);
    (dataset.train, dataset.validation) = (Vec::new(), Vec::new());
    dataset.test.truncate(1);
    assert!(arc(&dataset, &info).unwrap_err().to_string().contains("at least two"));
}
