//! The window as a user drives it, without a display.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use dpges_core::camera::CameraFromWorld;
use dpges_core::scene::{Peeling, Rendering, SceneData, SceneInfo};
use egui::{Key, Modifiers};
use egui_kittest::Harness;
use egui_kittest::kittest::Queryable;
use glam::{DVec3, dvec3};

use super::app::Viewer;
use super::comparison::Comparison;
use super::editing::{Combine, Tool};
use super::live::{LiveProgress, LiveScene};
use super::loading::{Opened, Opener, open_scene};
use super::messages::Message;
use super::start::{DeviceFailure, Start};
use super::views::{DatasetViews, Views};
use crate::fixtures::{neutral, pinhole};
use crate::{Display, Rgb8Image};

fn scene(count: usize) -> SceneData {
    let info = SceneInfo { layer_count: 2, modulation: 40.0, ..SceneInfo::default() };
    let mut scene = neutral(info, [count, 5]);
    scene.surfels.positions = (0..3 * count).map(|at| (at as f32).sin()).collect();
    scene
}

fn views(count: usize) -> DatasetViews {
    let camera = |at: usize| {
        let eye = dvec3((at as f64).cos(), (at as f64).sin(), 0.5) * 4.0;
        pinhole(CameraFromWorld::look_at(eye, DVec3::ZERO, DVec3::Z), 40.0, [40, 30])
    };
    let cameras = (0..count).map(|at| (format!("photo {at}"), camera(at))).collect();
    let photograph = |_| Some(Rgb8Image { width: 40, height: 30, bytes: vec![90; 3600] });
    DatasetViews { cameras, photograph: Box::new(photograph) }
}

fn opened(count: usize) -> Opened {
    Opened::whole(scene(count), Views::Ready(views(6)))
}

fn window(start: Start, opener: Opener) -> Harness<'static, Viewer> {
    let context = egui::Context::default();
    let viewer = Viewer::new(&context, None, None, start, opener, DeviceFailure::default()).unwrap();
    let show = |ui: &mut egui::Ui, viewer: &mut Viewer| viewer.show(ui);
    let mut harness =
        Harness::builder().with_size([1100.0, 900.0]).with_step_dt(1.0 / 60.0).build_ui_state(show, viewer);
    harness.run_steps(3);
    harness
}

fn with(opened: Opened) -> Harness<'static, Viewer> {
    window(Start::Scene { name: "room".to_owned(), opened: Box::new(opened) }, Arc::new(open_scene))
}

fn with_scene() -> Harness<'static, Viewer> {
    with(opened(20))
}

fn press(harness: &mut Harness<'_, Viewer>, key: Key) {
    harness.key_press(key);
    harness.run_steps(2);
}

fn hold(harness: &mut Harness<'_, Viewer>, key: Key) {
    harness.key_down(key);
    harness.run_steps(3);
    harness.key_up(key);
}

fn click(harness: &mut Harness<'_, Viewer>, label: &str) {
    harness.get_by_label(label).click();
    harness.run_steps(2);
}

/// Asks the window to close.
fn close(harness: &mut Harness<'_, Viewer>) {
    let viewport = harness.input_mut().viewports.entry(egui::ViewportId::ROOT).or_default();
    viewport.events.push(egui::ViewportEvent::Close);
    harness.step();
    harness.input_mut().viewports.entry(egui::ViewportId::ROOT).or_default().events.clear();
    harness.run_steps(3);
}

/// Steps until the threads have brought what they were asked for.
fn wait(harness: &mut Harness<'_, Viewer>, until: impl Fn(&Viewer) -> bool) {
    while !until(harness.state()) {
        std::thread::yield_now();
        harness.step();
    }
    harness.run_steps(2);
}

#[test]
fn the_start_page_says_what_to_do_and_opens_what_is_typed() {
    let opener: Opener = Arc::new(|path: &Path| match path.file_name() {
        Some(name) if name == "good" => Ok(opened(7)),
        _ => Err(format!("cannot read {}: it is no scene", path.display())),
    });
    let mut harness = window(Start::Page, opener);
    harness.get_by_label_contains("Drop a scene file");
    harness.get_by_label_contains("dpges train --out");
    let context = harness.ctx.clone();
    harness.state_mut().open(&context, PathBuf::from("/nowhere/bad"));
    wait(&mut harness, |viewer| viewer.state.message.is_some());
    harness.get_by_label_contains("cannot read /nowhere/bad: it is no scene");
    harness.get_by_label_contains("Drop a scene file");

    harness.state_mut().open(&context, PathBuf::from("/runs/good"));
    wait(&mut harness, |viewer| viewer.state.scene.is_some());
    harness.get_by_label_contains("7 surfels, 5 Gaussians");
    assert!(harness.query_by_label_contains("cannot read").is_none(), "the old message is gone");

    harness.state_mut().open(&context, PathBuf::from("/nowhere/worse"));
    wait(&mut harness, |viewer| viewer.state.message.is_some());
    harness.get_by_label_contains("/nowhere/worse");
    harness.get_by_label_contains("7 surfels, 5 Gaussians");
    click(&mut harness, "close");
    assert_eq!(harness.state().state.message, None);
}

#[test]
fn the_last_path_counts() {
    let mut harness = window(Start::Page, Arc::new(|path: &Path| Err(path.display().to_string())));
    let context = harness.ctx.clone();
    for path in ["first", "second"] {
        harness.state_mut().open(&context, path.into());
    }
    wait(&mut harness, |viewer| viewer.state.message.is_some());
    assert_eq!(harness.state().state.message, Some(Message::Error("second".to_owned())));
}

#[test]
fn the_options_are_those_of_the_scene_until_the_panel_changes_them() {
    let mut harness = with_scene();
    let options = harness.state().state.options;
    assert_eq!((options.layer_count, options.modulation, options.display), (2, 40.0, Display::Image));
    click(&mut harness, "normals");
    assert_eq!(harness.state().state.options.display, Display::Normal);
    press(&mut harness, Key::Num5);
    assert_eq!(harness.state().state.options.display, Display::Depth);
    harness.state_mut().state.options.layer_count = 4;
    harness.state_mut().state.options.peeling = Peeling::Nearest;
    click(&mut harness, "As trained");
    let options = harness.state().state.options;
    assert_eq!((options.layer_count, options.peeling, options.display), (2, Peeling::Continuous, Display::Depth));
}

#[test]
fn scenes_that_are_blended_show_nothing_but_an_image() {
    let mut harness = with_scene();
    press(&mut harness, Key::Num4);
    assert_eq!(harness.state().state.options.display, Display::Transmittance);
    let mut blended = scene(0);
    blended.info.rendering = Rendering::Ellipsoids;
    let mut harness = with(Opened::whole(blended, Views::None));
    press(&mut harness, Key::Num4);
    assert_eq!(harness.state().state.options.display, Display::Image);
}

#[test]
fn cameras_are_stepped_through_in_a_ring_and_left_by_the_hands() {
    let mut harness = with_scene();
    assert_eq!(harness.state().state.at_view, Some(0));
    press(&mut harness, Key::PageUp);
    assert_eq!(harness.state().state.at_view, Some(5));
    assert!(harness.state().state.navigator.is_flying());
    press(&mut harness, Key::PageDown);
    press(&mut harness, Key::PageDown);
    assert_eq!(harness.state().state.chosen_view, Some(1));
    harness.run_steps(200);
    let eye = harness.state().state.navigator.viewpoint().pose.eye;
    assert!((eye - views(6).cameras[1].1.centre()).length() < 1e-9, "{eye}");
    harness.get_by_label("photo 3").click();
    harness.run_steps(200);
    assert_eq!(harness.state().state.at_view, Some(3));
    hold(&mut harness, Key::W);
    assert_eq!((harness.state().state.at_view, harness.state().state.chosen_view), (None, Some(3)));
}

#[test]
fn the_comparison_says_how_to_get_back_to_its_camera() {
    let mut harness = with_scene();
    press(&mut harness, Key::C);
    assert_eq!(harness.state().state.comparing.kind, Comparison::SideBySide);
    click(&mut harness, "wipe");
    assert_eq!(harness.state().state.comparing.kind, Comparison::Wipe);
    assert!(harness.query_by_label("Back to it").is_none());
    hold(&mut harness, Key::ArrowLeft);
    harness.run_steps(120);
    click(&mut harness, "Back to it");
    assert_eq!(harness.state().state.at_view, Some(0));
}

#[test]
fn the_window_rests_unless_something_moves() {
    let mut harness = with_scene();
    harness.run();
    press(&mut harness, Key::PageDown);
    assert!(harness.try_run().is_err(), "it flies");
    harness.run_steps(200);
    harness.run();
}

/// Presses a key with ctrl.
fn ctrl(harness: &mut Harness<'_, Viewer>, key: Key) {
    harness.key_press_modifiers(Modifiers::COMMAND, key);
    harness.run_steps(2);
}

#[test]
fn primitives_are_deleted_brought_back_and_saved_over_nothing_unasked() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("edited.safetensors");
    let mut harness = with_scene();
    harness.state_mut().state.editing.file = file.display().to_string();
    press(&mut harness, Key::Delete);
    harness.get_by_label_contains("20 surfels, 5 Gaussians");
    harness.state_mut().state.editing.scene.as_mut().unwrap().marks.select([0, 1, 22], Combine::Replace);
    press(&mut harness, Key::Delete);
    harness.get_by_label_contains("18 surfels, 4 Gaussians");
    ctrl(&mut harness, Key::Z);
    harness.get_by_label_contains("20 surfels, 5 Gaussians");
    ctrl(&mut harness, Key::Y);
    harness.get_by_label_contains("18 surfels, 4 Gaussians");
    ctrl(&mut harness, Key::S);
    let saved = std::fs::read(&file).unwrap();
    assert_eq!(SceneData::load(&file).unwrap().surfels, scene(20).surfels.select(&(2..20).collect::<Vec<_>>()));

    ctrl(&mut harness, Key::Z);
    ctrl(&mut harness, Key::S);
    click(&mut harness, "Back");
    assert!(std::fs::read(&file).unwrap() == saved, "it was there already");
    ctrl(&mut harness, Key::S);
    click(&mut harness, "Replace");
    assert_eq!(SceneData::load(&file).unwrap(), scene(20));
}

#[test]
fn edits_are_not_lost_unasked() {
    let start = Start::Scene { name: "room".to_owned(), opened: Box::new(opened(20)) };
    let mut harness = window(start, Arc::new(|_: &Path| Ok(opened(7))));
    ctrl(&mut harness, Key::A);
    press(&mut harness, Key::Delete);
    let context = harness.ctx.clone();
    harness.state_mut().open(&context, PathBuf::from("other"));
    harness.run_steps(2);
    click(&mut harness, "Back");
    harness.get_by_label_contains("0 surfels, 0 Gaussians");
    close(&mut harness);
    click(&mut harness, "Back");
    harness.state_mut().open(&context, PathBuf::from("other"));
    harness.run_steps(2);
    click(&mut harness, "Leave them");
    wait(&mut harness, |viewer| viewer.state.scene.as_ref().is_some_and(|scene| scene.counts == [7, 5]));
    assert!(!harness.state().state.editing.is_unsaved());
}

#[test]
fn the_panel_edits_as_keys_do() {
    let mut harness = with_scene();
    for label in ["Edit", "Brush", "All", "Delete"] {
        harness.get_by_label(label).click_accesskit();
        harness.run_steps(8);
    }
    assert_eq!(harness.state().state.editing.tool, Some(Tool::Brush));
    harness.get_by_label("0 selected; not saved");
    harness.get_by_label_contains("0 surfels, 0 Gaussians");
    harness.get_by_label("Undo").click_accesskit();
    harness.run_steps(2);
    harness.get_by_label("25 selected");
}

#[test]
fn tools_are_taken_and_laid_down() {
    let mut harness = with_scene();
    for (key, tool) in [(Key::M, None), (Key::R, Some(Tool::Box)), (Key::B, Some(Tool::Brush)), (Key::B, None)] {
        press(&mut harness, key);
        assert_eq!(harness.state().state.editing.tool, tool, "{key:?}");
    }
    assert!(!harness.state().state.measuring.active);
    press(&mut harness, Key::R);
    press(&mut harness, Key::Escape);
    assert_eq!(harness.state().state.editing.tool, None);
    let live = LiveScene::new();
    let mut harness = window(Start::Live(live.clone(), None), Arc::new(open_scene));
    live.publish(scene(9));
    harness.run_steps(2);
    press(&mut harness, Key::B);
    assert!(matches!(&harness.state().state.message, Some(Message::Note(text)) if text.contains("not edited")));
}

#[test]
fn scenes_that_are_drawn_in_less_time_are_saved_as_they_are() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("edited.safetensors");
    let mut fast = opened(20);
    fast.drawn.layer_count = 1;
    let mut harness = with(fast);
    assert_eq!(harness.state().state.options.layer_count, 1);
    harness.state_mut().state.editing.file = file.display().to_string();
    ctrl(&mut harness, Key::S);
    assert_eq!(SceneData::load(&file).unwrap(), scene(20));
}

#[test]
fn keys_open_the_help_and_hide_the_panel() {
    let mut harness = with_scene();
    press(&mut harness, Key::F1);
    harness.get_by_label("Mouse and keys");
    harness.get_by_label("double click");
    press(&mut harness, Key::Escape);
    assert!(harness.query_by_label("Mouse and keys").is_none());
    press(&mut harness, Key::N);
    assert!(harness.query_by_label("As trained").is_none());
}

#[test]
fn views_are_added_to_the_path_and_played() {
    let mut harness = with_scene();
    press(&mut harness, Key::K);
    harness.state_mut().state.go_to_view(2, true);
    press(&mut harness, Key::K);
    assert_eq!(harness.state().state.path.cameras.len(), 2);
    harness.state_mut().state.path.seconds = 0.5;
    press(&mut harness, Key::Space);
    assert!(harness.state().state.path.is_playing());
    harness.run_steps(100);
    assert!(!harness.state().state.path.is_playing());
    let eye = harness.state().state.navigator.viewpoint().pose.eye;
    assert!((eye - views(6).cameras[2].1.centre()).length() < 1e-6, "{eye}");
}

#[test]
fn a_training_is_shown_paused_and_stopped_from_the_window() {
    let live = LiveScene::new();
    let mut harness = window(Start::Live(live.clone(), Some(views(6))), Arc::new(open_scene));
    harness.get_by_label_contains("on its way");
    live.publish(scene(9));
    let psnr = Some(21.5);
    live.report(LiveProgress { step: 30, steps: 600, psnr, text: "growing".to_owned() });
    harness.run_steps(2);
    harness.get_by_label_contains("9 surfels");
    harness.get_by_label("21.50 dB");
    let before = *harness.state().state.navigator.viewpoint();
    live.publish(scene(11));
    harness.run_steps(2);
    harness.get_by_label_contains("11 surfels");
    assert_eq!(*harness.state().state.navigator.viewpoint(), before, "the view stays where it is");

    click(&mut harness, "Pause");
    assert!(live.is_paused());
    click(&mut harness, "Resume");
    assert!(!live.is_paused());
    click(&mut harness, "Stop");
    assert!(live.should_stop());
    live.finish(Err("step 31 failed".to_owned()));
    harness.run_steps(2);
    harness.get_by_label("step 31 failed");
    assert!(harness.query_by_label("Stop").is_none());
}

#[test]
fn closing_the_window_asks_what_becomes_of_the_training() {
    let live = LiveScene::new();
    let mut harness = window(Start::Live(live.clone(), None), Arc::new(open_scene));
    close(&mut harness);
    harness.get_by_label("The training is not over");
    click(&mut harness, "Back");
    assert!(harness.query_by_label("The training is not over").is_none() && !live.should_stop());
    close(&mut harness);
    click(&mut harness, "Stop training");
    assert!(live.should_stop());
}

#[test]
fn other_scenes_are_not_opened_over_a_training() {
    let mut harness = window(Start::Live(LiveScene::new(), None), Arc::new(open_scene));
    let context = harness.ctx.clone();
    harness.state_mut().open(&context, PathBuf::from("other"));
    assert!(matches!(&harness.state().state.message, Some(Message::Note(text)) if text.contains("dpges view")));
}

#[test]
fn views_come_after_their_scene_and_the_view_goes_to_the_first_unless_it_was_moved() {
    for moves in [false, true] {
        let (release, released) = std::sync::mpsc::channel::<()>();
        let read = move || {
            released.recv().unwrap();
            Ok(views(6))
        };
        let mut harness = with(Opened::whole(scene(20), Views::Later(Box::new(read))));
        harness.get_by_label("reading the dataset");
        if moves {
            hold(&mut harness, Key::W);
            harness.run_steps(120);
        }
        let before = harness.state().state.navigator.viewpoint().pose.eye;
        release.send(()).unwrap();
        wait(&mut harness, |viewer| viewer.state.views.is_some());
        harness.get_by_label("photo 3");
        let first = views(6).cameras[0].1.centre();
        let expected = if moves { before } else { first };
        assert!((harness.state().state.navigator.viewpoint().pose.eye - expected).length() < 1e-9);
        assert_eq!(harness.state().state.at_view, if moves { None } else { Some(0) });
    }
}

#[test]
fn views_that_cannot_be_read_leave_the_scene() {
    let read = || Err("the folder photographs is gone".to_owned());
    let mut harness = with(Opened::whole(scene(20), Views::Later(Box::new(read))));
    wait(&mut harness, |viewer| viewer.state.message.is_some());
    harness.get_by_label_contains("the folder photographs is gone");
    harness.get_by_label_contains("20 surfels");
}

#[test]
fn a_failed_device_and_a_finished_command_close_the_window() {
    let closes = |harness: &Harness<'_, Viewer>| {
        let commands = &harness.output().viewport_output[&egui::ViewportId::ROOT].commands;
        commands.contains(&egui::ViewportCommand::Close)
    };
    let failure = DeviceFailure::default();
    let context = egui::Context::default();
    let viewer = Viewer::new(&context, None, None, Start::Page, Arc::new(open_scene), failure.clone()).unwrap();
    let show = |ui: &mut egui::Ui, viewer: &mut Viewer| viewer.show(ui);
    let mut harness = Harness::builder().build_ui_state(show, viewer);
    harness.step();
    assert!(!closes(&harness));
    failure.set("it was lost".to_owned());
    harness.step();
    assert!(closes(&harness));

    let live = LiveScene::new();
    let mut harness = window(Start::Live(live.clone(), None), Arc::new(open_scene));
    live.close_window();
    harness.step();
    assert!(closes(&harness));
}
