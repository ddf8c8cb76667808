//! With programs that only pretend: they note what they are started with and copy what a test has prepared.
#![cfg(unix)]

use std::path::{Path, PathBuf};
use std::process::Command;

use tempfile::TempDir;

use super::*;
use crate::fixtures::{self, Encoding, FixtureScene, assert_says, write_mask, write_png};
use crate::{LoadOptions, load};

/// `STAGE` is replaced by the folder of the test. `STAGE/about` is what COLMAP says of itself.
const COLMAP: &str = r#"#!/bin/sh
if [ "$1" = -h ]; then cat STAGE/about; exit; fi
if [ "$2" = -h ]; then echo "  --SiftExtraction.use_gpu arg (=1)"; exit; fi
echo "$*" >> STAGE/calls
command=$1
while [ $# -gt 1 ]; do
  case $1 in --database_path) database=$2;; --image_path) images=$2;; --output_path) models=$2;; esac
  case "$1 $2" in *"use_gpu 1") [ -e STAGE/no_gpu ] && { echo "no such device"; exit 7; };; esac
  shift
done
[ -e STAGE/fail_$command ] && { echo "out of memory" >&2; exit 3; }
case $command in
  feature_extractor) for image in "$images"/*; do echo "Processed file [1/5]"; done; echo features > "$database";;
  exhaustive_matcher) grep -q features "$database" || exit 4;;
  mapper) cp -r STAGE/models/. "$models"; echo "Registering image #2 (3)";;
esac
"#;

/// Says how long a video is, or copies `STAGE/frames` to the folder of its last argument.
const FFMPEG: &str = r#"#!/bin/sh
case "$*" in
  *-progress*) ;;
  *) echo "  Duration: 00:00:03.00, start: 0.0" >&2; echo "  Stream #0:0: Video: h264, 24x16, 30 fps, 30 tbr" >&2; exit 1;;
esac
echo "ffmpeg $*" >> STAGE/calls
for last in "$@"; do :; done
cp STAGE/frames/* "$(dirname "$last")"
echo "frame=  9"
"#;

/// A folder with programs, photographs and the models that the programs will find.
struct Stage {
    folder: TempDir,
    options: Options,
}

#[derive(Default)]
struct Heard {
    steps: Vec<Step>,
    progress: Vec<(Step, usize, usize)>,
    warnings: Vec<String>,
}

impl Observer for Heard {
    fn progress(&mut self, step: Step, done: usize, total: usize) {
        self.progress.push((step, done, total));
    }

    fn end(&mut self, step: Step, _seconds: f64) {
        self.steps.push(step);
    }

    fn warn(&mut self, message: &str) {
        self.warnings.push(message.to_owned());
    }
}

impl Stage {
    fn new(photographs: usize) -> Self {
        let folder = tempfile::tempdir().unwrap();
        let stage = Self { folder, options: Options::default() };
        for index in 0..photographs {
            write_png(&stage.path(&format!("room/{index:03}.png")), 24, 16, [index as u8, 100, 200]);
        }
        std::fs::write(stage.path("about"), "COLMAP 3.8 (Commit Unknown on Unknown without CUDA)\n").unwrap();
        std::fs::create_dir(stage.path("models")).unwrap();
        stage
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// With COLMAP, which finds a model of all photographs.
    fn ready(photographs: usize) -> Self {
        let stage = Self::new(photographs);
        stage.install("colmap", COLMAP);
        stage.model("0", &(0..photographs).collect::<Vec<_>>());
        stage
    }

    /// Installs the program. Another process writes it: a file that this one has open for writing while another test
    /// starts a process could not be run.
    fn install(&self, name: &str, script: &str) {
        let source = self.path("script");
        std::fs::write(&source, script.replace("STAGE", self.folder.path().to_str().unwrap())).unwrap();
        std::fs::create_dir_all(self.path("bin")).unwrap();
        let to = self.path("bin").join(name);
        assert!(Command::new("install").args(["-m", "755"]).args([&source, &to]).status().unwrap().success());
    }

    /// The model that mapping will find: `models/NAME` with the photographs of these numbers.
    fn model(&self, name: &str, numbers: &[usize]) {
        let scene = scene(numbers.iter().map(|number| format!("{number:03}.png")).collect());
        fixtures::write_model(&self.path("models").join(name), &scene, Encoding::Binary);
    }

    fn try_to(&self, input: &Path, overwrite: bool) -> (Result<Outcome, SfmError>, Heard) {
        let input = Input::find(input, false).unwrap();
        let programs = Programs(vec![self.path("bin")]);
        let dataset = dataset_beside(&input).unwrap();
        let options = &self.options;
        let request = Request { input: &input, dataset: &dataset, options, overwrite, programs: &programs };
        let mut heard = Heard::default();
        let result = reconstruct(&request, &mut heard);
        (result, heard)
    }

    fn reconstruct(&self) -> Result<Outcome, SfmError> {
        self.try_to(&self.path("room"), false).0
    }

    /// Fails unless it is refused, for a reason that has all `parts`.
    #[track_caller]
    fn refuses(&self, parts: &[&str]) {
        assert_says(self.reconstruct().unwrap_err(), parts);
    }

    fn overwrite(&self) -> (Outcome, Heard) {
        let (result, heard) = self.try_to(&self.path("room"), true);
        (result.unwrap(), heard)
    }

    /// The commands that COLMAP was started with, and `ffmpeg`.
    fn calls(&self) -> Vec<String> {
        let text = std::fs::read_to_string(self.path("calls")).unwrap_or_default();
        text.lines().filter_map(|line| line.split(' ').next()).map(str::to_owned).collect()
    }
}

/// A model of photographs with these names.
fn scene(names: Vec<String>) -> FixtureScene {
    let mut scene = fixtures::scene(names.len());
    for (image, name) in scene.images.iter_mut().zip(names) {
        image.name = name;
    }
    scene
}

const ALL: [&str; 3] = ["feature_extractor", "exhaustive_matcher", "mapper"];
const STEPS: [Step; 4] = [Step::Pictures, Step::Features, Step::Matches, Step::Mapping];

#[test]
fn photographs_become_a_dataset_once() {
    let stage = Stage::ready(5);
    let (result, heard) = stage.try_to(&stage.path("room"), false);
    let outcome = result.unwrap();
    assert_eq!(outcome.dataset, stage.path("room_colmap"));
    assert_eq!((outcome.photographs, outcome.placed(), outcome.points), (5, 5, 5));
    assert_eq!((outcome.models.as_slice(), outcome.warnings()), ([5].as_slice(), Vec::new()));
    assert_eq!(heard.steps, STEPS);
    assert_eq!(heard.warnings, Vec::<String>::new());
    assert!(heard.progress.contains(&(Step::Features, 1, 5)) && heard.progress.contains(&(Step::Mapping, 3, 5)));
    assert_eq!(stage.calls(), ALL);
    let calls = std::fs::read_to_string(stage.path("calls")).unwrap();
    assert!(calls.contains("--ImageReader.single_camera 1") && calls.contains("--SiftExtraction.use_gpu 0"), "{calls}");

    let dataset = load(&outcome.dataset, &LoadOptions::default()).unwrap();
    assert_eq!((dataset.train.len(), dataset.test.len(), dataset.points.positions.len()), (4, 1, 5));

    let again = stage.reconstruct().unwrap();
    assert_eq!(
        (again, stage.calls().len()),
        (Outcome { seconds: Vec::new(), ..outcome.clone() }, 3),
        "nothing is left to do"
    );
    std::fs::remove_dir_all(outcome.dataset.join("sparse")).unwrap();
    assert_eq!((stage.reconstruct().unwrap().placed(), stage.calls().len()), (5, 6), "the model is what matters");
}

#[test]
fn a_missing_program_is_named_before_anything_is_done() {
    let mut stage = Stage::new(5);
    stage.refuses(&["COLMAP is not installed", "apt-get install colmap"]);
    assert!(!stage.path("room_colmap").exists());
    stage.install("colmap", COLMAP);
    stage.options.program = SfmProgram::Glomap;
    stage.refuses(&["GLOMAP is not installed", "--sfm colmap"]);
    assert_eq!(stage.calls(), [""; 0]);
}

#[test]
fn after_a_failure_it_goes_on_with_what_colmap_has_found() {
    let mut stage = Stage::ready(5);
    std::fs::write(stage.path("fail_mapper"), "").unwrap();
    stage.refuses(&["mapping", "exit status: 3", "room_colmap/sfm/mapping.log", "out of memory"]);
    assert_eq!(stage.calls(), ALL);
    assert!(!stage.path("room_colmap/sparse").exists());
    let databases = || {
        let files = workspace::file_names(&stage.path("room_colmap/sfm")).unwrap().into_iter();
        files.filter(|name| name.ends_with(".db")).collect::<Vec<_>>()
    };
    assert_eq!(databases(), ["opencv-shared.db"]);
    std::fs::remove_file(stage.path("fail_mapper")).unwrap();
    std::fs::write(stage.path("room_colmap/sfm/opencv-shared.db"), "features of before\n").unwrap();
    stage.options.camera = SfmCamera::SimpleRadial;
    let (result, heard) = stage.try_to(&stage.path("room"), false);
    assert_eq!((result.unwrap().placed(), heard.steps.as_slice()), (5, STEPS.as_slice()));
    let kept = std::fs::read_to_string(stage.path("room_colmap/sfm/opencv-shared.db")).unwrap();
    assert_eq!(kept, "features of before\n", "those of another camera model are others");
}

#[test]
fn the_largest_model_is_taken_and_what_it_lacks_is_said() {
    let stage = Stage::new(9);
    stage.install("colmap", COLMAP);
    stage.model("0", &[0, 1, 2]);
    stage.model("1", &[3, 4, 5, 6]);
    let outcome = stage.reconstruct().unwrap();
    assert_eq!(outcome.models, [4, 3]);
    assert_eq!((outcome.placed(), outcome.unplaced.len()), (4, 5));
    let unplaced = "000.png, 001.png, 002.png, 007.png, 008.png";
    let warnings = ["only 4 of 9", "2 groups that nothing connects, of 4, 3", unplaced];
    assert_says(outcome.warnings().join("\n"), &warnings);
    assert_eq!(load(&outcome.dataset, &LoadOptions::default()).unwrap().train.len(), 3);
}

#[test]
fn too_few_photographs_are_refused_before_and_after() {
    Stage::new(2).refuses(&["holds 2 photographs, at least 3"]);

    let stage = Stage::new(5);
    stage.install("colmap", COLMAP);
    stage.refuses(&["no two of the 5 photographs", "mapping.log"]);
    stage.model("0", &[1, 3]);
    stage.refuses(&["only 2 of 5 photographs"]);
    assert!(!stage.path("room_colmap/sparse").exists());
}

#[test]
fn a_mapper_that_finds_no_pair_is_told_from_one_that_fails() {
    let stage = Stage::new(4);
    stage.install("colmap", &COLMAP.replace("out of memory", "ERROR: failed to create sparse model"));
    std::fs::write(stage.path("fail_mapper"), "").unwrap();
    stage.refuses(&["no two of the 4 photographs"]);
}

#[test]
fn a_video_becomes_its_sharpest_frames() {
    let mut stage = Stage::new(0);
    stage.install("colmap", COLMAP);
    std::fs::write(stage.path("walk.mp4"), "video").unwrap();
    stage.options.video_frames = 3;
    assert_says(stage.try_to(&stage.path("walk.mp4"), false).0.unwrap_err(), &["ffmpeg is not installed"]);
    stage.install("ffmpeg", FFMPEG);
    std::fs::create_dir(stage.path("frames")).unwrap();
    for number in 1..=9u32 {
        let contrast = if number % 3 == 2 { 200 } else { 20 };
        let frame = image::RgbImage::from_fn(24, 16, |x, _| {
            image::Rgb([if x / 4 % 2 == 0 { 0 } else { contrast }, number as u8 * 20, 0])
        });
        frame.save(stage.path(&format!("frames/frame_{number:06}.jpg"))).unwrap();
    }
    let frames = (1..=3).map(|number| format!("frame_{number:05}.jpg"));
    fixtures::write_model(&stage.path("models/0"), &scene(frames.collect()), Encoding::Text);
    let (result, heard) = stage.try_to(&stage.path("walk.mp4"), false);
    let outcome = result.unwrap();
    assert_eq!((outcome.dataset.clone(), outcome.photographs), (stage.path("walk_colmap"), 3));
    assert!(heard.progress.contains(&(Step::Pictures, 9, 9)), "{:?}", heard.progress);
    for (number, original) in [(1, 2), (2, 5), (3, 8)] {
        let taken = std::fs::read(outcome.dataset.join(format!("images/frame_{number:05}.jpg"))).unwrap();
        assert!(taken == std::fs::read(stage.path(&format!("frames/frame_{original:06}.jpg"))).unwrap(), "{number}");
    }
    let calls = std::fs::read_to_string(stage.path("calls")).unwrap();
    assert!(calls.contains("fps=3.000000"), "three candidates for each of three frames in 3 s: {calls}");
    assert_eq!(load(&outcome.dataset, &LoadOptions::default()).unwrap().train.len(), 2);
}

#[test]
fn a_finished_dataset_changes_only_when_asked_to() {
    let mut stage = Stage::ready(5);
    stage.reconstruct().unwrap();
    stage.options.camera = SfmCamera::SimpleRadial;
    assert!(stage.reconstruct().unwrap().seconds.is_empty());
    write_png(&stage.path("room/005.png"), 24, 16, [1, 2, 3]);
    stage.refuses(&["was made of other photographs or masks", "--overwrite"]);
    stage.model("0", &[0, 1, 2, 3, 4, 5]);
    let (outcome, heard) = stage.overwrite();
    assert_eq!((outcome.placed(), heard.steps.as_slice(), stage.calls().len()), (6, STEPS.as_slice(), 6));
    assert!(!stage.path("room_colmap/sfm/opencv-shared.db").exists(), "it begins anew");
}

#[test]
fn what_fails_on_the_gpu_is_done_on_the_cpu() {
    let stage = Stage::ready(5);
    std::fs::write(stage.path("about"), "COLMAP 3.8 (Commit Unknown on Unknown with CUDA)\n").unwrap();
    std::fs::write(stage.path("no_gpu"), "").unwrap();
    let (result, heard) = stage.try_to(&stage.path("room"), false);
    assert_eq!(result.unwrap().placed(), 5);
    assert_eq!(heard.warnings.len(), 2, "{:?}", heard.warnings);
    assert!(heard.warnings[0].contains("features.log") && heard.warnings[1].contains("matches.log"));
    let twice = ["feature_extractor", "feature_extractor", "exhaustive_matcher", "exhaustive_matcher", "mapper"];
    assert_eq!(stage.calls(), twice);
}

#[test]
fn many_numbered_photographs_are_compared_with_their_neighbours() {
    let numbered = |count: usize| (0..count).map(|number| format!("IMG_{number}.jpg")).collect::<Vec<_>>();
    let named =
        |count: usize| (0..count).map(|number| format!("{number}_{}.jpg", "x".repeat(number))).collect::<Vec<_>>();
    let (auto, exhaustive, sequential) = (SfmMatching::Auto, SfmMatching::Exhaustive, SfmMatching::Sequential);
    let cases = [
        (auto, numbered(200), exhaustive),
        (auto, numbered(201), sequential),
        (auto, named(201), exhaustive),
        (auto, [numbered(201), vec!["DSC_0.jpg".to_owned()]].concat(), exhaustive),
        (exhaustive, numbered(300), exhaustive),
        (sequential, named(3), sequential),
    ];
    for (asked, names, expected) in cases {
        assert_eq!(matching(asked, &names), expected, "{asked:?} of {}", names.len());
    }
}

/// How many columns of a mask are black, those at its left.
fn black(path: &Path) -> usize {
    let mask = image::open(path).unwrap().into_luma8();
    (0..24).filter(|&x| mask.get_pixel(x, 7).0 == [0]).count()
}

/// The arguments with which features were looked for last.
fn line_of_features(stage: &Stage) -> String {
    let calls = std::fs::read_to_string(stage.path("calls")).unwrap();
    calls.lines().rfind(|line| line.starts_with("feature_extractor")).unwrap().to_owned()
}

#[test]
fn masks_go_into_the_dataset_and_to_colmap() {
    let mut stage = Stage::ready(5);
    write_mask(&stage.path("room/masks/001.png.png"), [24, 16], 3);
    write_mask(&stage.path("room/masks/002.png"), [24, 16], 5);
    let outcome = stage.reconstruct().unwrap();
    let dataset = stage.path("room_colmap");
    assert_eq!((outcome.masked, outcome.placed()), (2, 5));
    for folder in ["masks", "sfm/masks"] {
        let names = workspace::file_names(&dataset.join(folder)).unwrap();
        assert_eq!(names, ["001.png.png", "002.png.png"], "{folder}");
    }
    let option = format!("--ImageReader.mask_path {}", dataset.join("sfm/masks").display());
    assert_says(line_of_features(&stage), &[&option]);
    let black_for_colmap = || black(&dataset.join("sfm/masks/002.png.png"));
    assert_eq!(black_for_colmap(), 5);
    let loaded = load(&dataset, &LoadOptions::default()).unwrap();
    assert_eq!((loaded.masked().masked_views, loaded.masked().ignored_pixels), (2, 8 * 16));

    stage.options.invert_masks = true;
    stage.overwrite();
    assert_eq!(black_for_colmap(), 24 - 5);
    write_mask(&stage.path("room/masks/003.png"), [24, 16], 5);
    stage.refuses(&["other photographs or masks"]);
    assert_eq!(stage.overwrite().0.masked, 3);
}

#[test]
fn masks_that_were_put_into_a_dataset_stay() {
    let stage = Stage::ready(5);
    let of_dataset = |name: &str| stage.path(&format!("room_colmap/masks/{name}"));
    stage.reconstruct().unwrap();
    let added = of_dataset("003.png");
    write_mask(&added, [24, 16], 7);
    stage.reconstruct().unwrap();
    for (name, from) in [("001.png.png", 3), ("003.png", 3)] {
        write_mask(&stage.path(&format!("room/masks/{name}")), [24, 16], from);
    }
    let (outcome, heard) = stage.overwrite();
    assert_eq!((black(&added), black(&of_dataset("001.png.png")), outcome.masked), (7, 3, 2));
    assert_says(&heard.warnings[0], &["room_colmap/masks has other masks", ": 003.png;"]);
}

#[test]
fn masks_that_do_not_fit_are_refused_before_colmap_starts() {
    let stage = Stage::new(4);
    stage.install("colmap", COLMAP);
    let mask = stage.path("room/masks/002.png");
    write_mask(&mask, [12, 8], 3);
    stage.refuses(&["masks/002.png is 12x8 px", "002.png 24x16", "make the mask anew"]);
    write_mask(&mask, [24, 16], 24);
    stage.refuses(&["no pixel of image", "`002.png`", "--invert-masks"]);
    std::fs::write(&mask, "no picture").unwrap();
    stage.refuses(&["masks/002.png", "replace it"]);
    assert_eq!(stage.calls(), [""; 0]);

    std::fs::rename(&mask, mask.with_file_name("2.png")).unwrap();
    stage.model("0", &[0, 1, 2, 3]);
    let (result, heard) = stage.try_to(&stage.path("room"), false);
    assert_eq!(result.unwrap().masked, 0);
    assert_says(&heard.warnings[0], &["room/masks has no mask that is called like a photograph"]);
}
