//! The window with pictures, on whatever graphics adapter there is.

use std::path::PathBuf;
use std::sync::Arc;

use dpges_core::camera::CameraFromWorld;
use dpges_core::scene::SceneInfo;
use egui::Key;
use egui_kittest::Harness;
use egui_kittest::kittest::Queryable;
use egui_kittest::wgpu::{WgpuTestRenderer, create_render_state, default_wgpu_setup};
use glam::{DVec3, dvec3};

use super::app::Viewer;
use super::canvas::Canvas;
use super::comparison::Comparison;
use super::loading::{Opened, open_scene};
use super::messages::Message;
use super::start::{DeviceFailure, Start};
use super::views::{DatasetViews, Views};
use crate::fixtures::{neutral, pinhole};
use crate::stream::fixtures::{filled, forest, write};
use crate::stream::{Levels, StreamStatus};
use crate::{Display, RenderOptions, Rgb8Image};

/// Distance of the first camera from the disc.
const DISTANCE: f64 = 4.0;

/// A grey disc with a radius of 1 around the origin, seen from +z.
fn opened() -> Opened {
    let mut scene = neutral(SceneInfo::default(), [1, 0]);
    scene.surfels.log_scales.fill(0.3f32.ln());
    let camera = |eye| pinhole(CameraFromWorld::look_at(eye, DVec3::ZERO, DVec3::Y), 60.0, [80, 60]);
    let eyes = [dvec3(0.0, 0.0, DISTANCE), dvec3(3.0, 0.0, 3.0)];
    let cameras = eyes.into_iter().map(|eye| (format!("{eye}"), camera(eye))).collect();
    let red = |_| Some(Rgb8Image { width: 80, height: 60, bytes: [200, 0, 0].repeat(4800) });
    Opened::whole(scene, Views::Ready(DatasetViews { cameras, photograph: Box::new(red) }))
}

fn window_with(opened: Opened) -> Harness<'static, Viewer> {
    let gpu = create_render_state(default_wgpu_setup(), Default::default());
    let start = Start::Scene { name: "scene".to_owned(), opened: Box::new(opened) };
    let (context, failure) = (egui::Context::default(), DeviceFailure::default());
    let viewer = Viewer::new(&context, Some(&gpu), None, start, Arc::new(open_scene), failure).unwrap();
    let show = |ui: &mut egui::Ui, viewer: &mut Viewer| viewer.show(ui);
    let renderer = WgpuTestRenderer::from_render_state(gpu);
    Harness::builder().with_size([640.0, 480.0]).renderer(renderer).build_ui_state(show, viewer)
}

/// The disc, without the panel.
fn window() -> Harness<'static, Viewer> {
    let mut harness = window_with(opened());
    harness.run_steps(2);
    harness.key_press(Key::N);
    harness.run_steps(3);
    harness
}

fn pixel(harness: &mut Harness<'_, Viewer>, offset: [f32; 2]) -> [u8; 3] {
    let place = harness.ctx.content_rect().center() + offset.into();
    let picture = harness.render().unwrap();
    let [red, green, blue, _] = picture.get_pixel(place.x as u32, place.y as u32).0;
    [red, green, blue]
}

fn click(harness: &mut Harness<'_, Viewer>, offset: [f32; 2]) {
    let place = harness.ctx.content_rect().center() + offset.into();
    harness.drag_at(place);
    harness.step();
    harness.drop_at(place);
    harness.run_steps(2);
}

fn is_grey(colour: [u8; 3]) -> bool {
    colour.iter().all(|&channel| channel.abs_diff(128) < 4)
}

#[test]
fn the_window_shows_the_scene_and_its_display_modes() {
    let mut harness = window();
    assert!(is_grey(pixel(&mut harness, [0.0, 0.0])));
    assert_eq!(pixel(&mut harness, [300.0, 0.0]), [0; 3], "beside the disc");
    harness.key_press(Key::Num6);
    harness.run_steps(2);
    assert_eq!(harness.state().state.options.display, Display::Normal);
    let [x, y, z] = pixel(&mut harness, [0.0, 0.0]);
    assert!(x.abs_diff(128) < 4 && y.abs_diff(128) < 4 && z > 250, "{x} {y} {z}");
}

#[test]
fn photographs_are_wiped_over_the_scene_and_subtracted_from_it() {
    let mut harness = window();
    harness.state_mut().state.comparing.kind = Comparison::Wipe;
    harness.run_steps(2);
    assert!(is_grey(pixel(&mut harness, [-30.0, 0.0])));
    assert_eq!(pixel(&mut harness, [30.0, 0.0]), [200, 0, 0]);
    harness.state_mut().state.comparing.divider = 0.75;
    harness.run_steps(2);
    assert!(is_grey(pixel(&mut harness, [30.0, 0.0])));
    harness.state_mut().state.comparing.kind = Comparison::Error;
    harness.run_steps(2);
    let mean = harness.state().state.comparing.mean_error().unwrap();
    assert!(mean > 0.2 && mean < 0.35, "{mean}");
}

#[test]
fn two_clicks_measure_a_distance() {
    let mut harness = window();
    harness.key_press(Key::M);
    harness.run_steps(2);
    click(&mut harness, [0.0, 0.0]);
    click(&mut harness, [60.0, 0.0]);
    let state = &harness.state().state;
    let focal = state.window_px[1] as f64 / state.navigator.viewpoint().lens.height_at_one();
    let expected = 60.0 * DISTANCE / focal;
    let distance = state.measuring.distance().unwrap();
    assert!((distance - expected).abs() < 0.01 * expected, "{distance}, expected {expected}");
    assert!(state.measuring.points.iter().all(|point| point.z.abs() < 1e-2), "{:?}", state.measuring.points);
    click(&mut harness, [300.0, 0.0]);
    assert!(matches!(&harness.state().state.message, Some(Message::Note(text)) if text.contains("no surface")));
}

#[test]
fn what_a_box_selects_is_marked_and_deleted_and_comes_back() {
    let mut harness = window();
    harness.key_press(Key::R);
    harness.run_steps(2);
    let middle = harness.ctx.content_rect().center();
    harness.drag_at(middle - egui::vec2(20.0, 20.0));
    harness.step();
    harness.hover_at(middle + egui::vec2(20.0, 20.0));
    harness.step();
    harness.drop_at(middle + egui::vec2(20.0, 20.0));
    harness.run_steps(2);
    assert_eq!(pixel(&mut harness, [0.0, 0.0]), [255, 0, 255]);
    assert!(is_grey(pixel(&mut harness, [10.0, 0.0])));
    harness.key_press(Key::Delete);
    harness.run_steps(2);
    assert_eq!(pixel(&mut harness, [10.0, 0.0]), [0; 3]);
    harness.key_press_modifiers(egui::Modifiers::COMMAND, Key::Z);
    harness.run_steps(2);
    assert!(is_grey(pixel(&mut harness, [10.0, 0.0])));
}

#[test]
fn screenshots_have_the_chosen_size() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("disc.png");
    let mut harness = window();
    harness.state_mut().state.screenshot.file = file.display().to_string();
    harness.state_mut().state.screenshot.size = Some([90, 50]);
    harness.key_press(Key::P);
    harness.run_steps(2);
    let picture = image::open(&file).unwrap().into_rgb8();
    assert_eq!((picture.width(), picture.height()), (90, 50));
    assert!(is_grey(picture.get_pixel(45, 25).0));
    harness.state_mut().state.screenshot.file = PathBuf::from("/no/such/folder/a.png").display().to_string();
    harness.key_press(Key::P);
    harness.run_steps(2);
    harness.get_by_label_contains("/no/such/folder/a.png");
    assert!(is_grey(pixel(&mut harness, [0.0, 0.0])), "the window shows what it did");
}

#[test]
fn nothing_is_drawn_twice_and_nothing_without_pixels() {
    let gpu = create_render_state(default_wgpu_setup(), Default::default());
    let mut canvas = Canvas::new(&gpu).unwrap();
    let Opened { scene, views: Views::Ready(views), .. } = opened() else { unreachable!() };
    let (camera, options) = (views.cameras[0].1, RenderOptions::from(&scene.info));
    assert!(canvas.draw(&camera, &options).is_err(), "there is no scene yet");
    canvas.upload(&scene).unwrap();
    assert!(canvas.draw(&camera, &options).unwrap() && !canvas.draw(&camera, &options).unwrap());
    let other = RenderOptions { layer_count: 1, ..options };
    assert!(canvas.draw(&camera, &other).unwrap());
    assert!(canvas.depth_at(40, 30).is_some_and(|depth| (depth - DISTANCE).abs() < 1e-3));
    assert_eq!(canvas.depth_at(1, 1), None);
    assert!(canvas.draw(&camera.resized(40, 30), &other).unwrap());
    canvas.picture(&camera, &other).unwrap();
    assert!(canvas.draw(&camera.resized(40, 30), &other).unwrap(), "the renderer drew something else since");

    let mut harness = window();
    harness.set_size([0.0, 0.0].into());
    harness.run_steps(2);
    assert!(harness.state().state.window_px.contains(&0));
    harness.set_size([640.0, 480.0].into());
    harness.run_steps(2);
    assert!(is_grey(pixel(&mut harness, [0.0, 0.0])));
}

#[test]
fn levels_of_detail_come_while_the_window_shows_the_coarsest() {
    let folder = tempfile::tempdir().unwrap();
    let index = write(folder.path(), forest(1, 1), |index, cell| filled(index, cell, [30, 300 + cell]));
    // the last cell is torn
    let file = folder.path().join("cells.pack");
    let whole = std::fs::read(&file).unwrap();
    let mut torn = whole.clone();
    torn[index.cells[2].part.offset as usize..].fill(0);
    std::fs::write(&file, &torn).unwrap();

    let mut harness = window_with(Opened::levels(Levels::open(folder.path(), 5000).unwrap(), Views::None));
    let mut wait = |until: fn(&StreamStatus) -> bool| {
        for _ in 0..2000 {
            harness.step();
            if harness.state().state.stream.as_ref().is_some_and(until) {
                harness.step();
                return;
            }
            std::thread::sleep(std::time::Duration::from_millis(5));
        }
        panic!("{:?}", harness.state().state.stream);
    };
    wait(|stream| stream.failed == 1);
    std::fs::write(&file, &whole).unwrap();
    // two seconds later
    wait(|stream| stream.complete && stream.failed == 0);
    harness.get_by_label("60 surfels, 603 Gaussians, peeled");
    harness.get_by_label("663 of at most 5000 primitives are in memory");
    assert_eq!(harness.state().state.message, None, "it came in the end");
}
