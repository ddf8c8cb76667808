//! Files from strangers: whatever the bytes, a reader returns what it read or an error with a message. It never panics.
//!
//! Files of `corpus/` and some written here are changed at random and read again. `DPGES_FUZZ_CASES` sets the number of
//! cases per kind of file (500 unless set), or `DPGES_FUZZ_SECONDS` the time for each kind; `DPGES_FUZZ_SEED` the seed (0):
//! the same numbers make the same cases.

mod mutation;
mod operations;

use std::cell::Cell;
use std::fs;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

use dpges_core::scene::{ColourModel, EnvironmentData, Quality, Rendering, SceneData, WeightedSum};
use dpges_core::testing::scenes::{Recipe, random};
use dpges_train::config::Config;
use dpges_train::dataset::{BuiltinOptions, Dataset, LoadOptions, MaxResolution, builtin, load};
use dpges_train::run::folder::{Origin, RunFolder};
use dpges_train::run::{Run, SavedRun, StepReport};
use proptest::test_runner::{Config as Settings, RngAlgorithm, TestError, TestRng, TestRunner};

use crate::budget::{number, seeds};
use crate::devices::ndarray;
use mutation::{Mutation, What, mutated, mutations};

const CASES: u64 = 500;

/// The seed of `DPGES_FUZZ_SEED`.
fn seed() -> u64 {
    number("DPGES_FUZZ_SEED").unwrap_or(0)
}

/// Makes one case, the same for the same seed and number.
fn runner(number: u64) -> TestRunner {
    let mut bytes = [0; 32];
    bytes[..8].copy_from_slice(&seed().to_le_bytes());
    bytes[8..16].copy_from_slice(&number.to_le_bytes());
    let settings = Settings { cases: 1, failure_persistence: None, ..Settings::default() };
    TestRunner::new_with_rng(settings, TestRng::from_seed(RngAlgorithm::ChaCha, &bytes))
}

/// Calls `read` with changed contents of `files`. Errors contain `named`.
fn fuzz<E: ToString>(what: &str, named: &str, files: &[Vec<u8>], read: impl Fn(usize, &[u8]) -> Result<(), E>) {
    let (cases, readable, slowest) = (Cell::new(0u64), Cell::new(0u64), Cell::new(Duration::ZERO));
    let one = |(file, changes): (usize, Vec<Mutation>)| {
        let bytes = mutated(&files[file], &changes);
        let start = Instant::now();
        let found = read(file, &bytes).map_err(|error| error.to_string());
        slowest.set(slowest.get().max(start.elapsed()));
        cases.set(cases.get() + 1);
        readable.set(readable.get() + u64::from(found.is_ok()));
        assert!(found.as_ref().err().is_none_or(|error| !error.is_empty() && error.contains(named)), "{found:?}");
        Ok(())
    };
    for case in seeds(CASES) {
        let result = runner(case).run(&(0..files.len(), mutations()), one);
        if let Err(TestError::Fail(reason, (file, changes))) = result {
            panic!("{what}: file {file} after {changes:?}: {reason}");
        }
    }
    println!("{what}: {} cases, {} readable, slowest {:?}", cases.get(), readable.get(), slowest.get());
    assert!(readable.get() > 0, "{what}: no case can be read, so that nothing behind the first check is reached");
}

fn scene(model: ColourModel, environment: bool) -> SceneData {
    let (mut scene, _) = random(3, &Recipe { surfels: 3, gaussians: 4, model, ..Recipe::default() }).into_scene();
    scene.info.background = [0.0, 0.5, 1.0];
    if model.opacity_len() > 0 {
        (scene.info.rendering, scene.info.weighted_sum) = (Rendering::Summed, Some(WeightedSum::default()));
    }
    scene.environment = environment.then(|| EnvironmentData::neutral(1));
    scene
}

#[test]
fn scene_files() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("scene.safetensors");
    let models = [
        (ColourModel::SphericalBeta { lobes: 2 }, true),
        (ColourModel::SphericalBeta { lobes: 0 }, false),
        (ColourModel::SphericalHarmonics { degree: 1 }, false),
        (ColourModel::HarmonicsAndOpacity { degree: 1 }, false),
    ];
    let plain = models.map(|(model, environment)| {
        scene(model, environment).save(&path).unwrap();
        fs::read(&path).unwrap()
    });
    let compressed =
        models.map(|(model, environment)| scene(model, environment).to_compressed(&Quality::MEDIUM, &path).unwrap());
    for (what, files) in [("scene files", &plain), ("compressed scene files", &compressed)] {
        fuzz(what, "a stranger's file", files, |_, bytes| {
            let scene = SceneData::from_bytes(bytes, "a stranger's file")?;
            scene.save(&path).expect("what is read is whole");
            Ok::<_, dpges_core::Error>(())
        });
    }
}

/// A copy of a dataset of the corpus, whose `names` are changed and read again.
fn datasets(what: &str, corpus: &str, names: &[&str]) {
    let folder = tempfile::tempdir().unwrap();
    copy(&Path::new(env!("CARGO_MANIFEST_DIR")).join("corpus").join(corpus), folder.path());
    let paths: Vec<PathBuf> = names.iter().map(|name| folder.path().join(name)).collect();
    let files: Vec<Vec<u8>> = paths.iter().map(|path| fs::read(path).unwrap()).collect();
    let options = LoadOptions { test_every: 2, max_resolution: MaxResolution(64), ..LoadOptions::default() };
    load(folder.path(), &options).unwrap();
    fuzz(what, "", &files, |file, bytes| {
        fs::write(&paths[file], bytes).unwrap();
        let result = load(folder.path(), &options);
        fs::write(&paths[file], &files[file]).unwrap();
        result.map(|dataset| {
            let views = dataset.train.iter().chain(&dataset.test);
            views.for_each(|view| view.camera.validate().expect("cameras can be rendered from"));
            assert!(dataset.points.positions.iter().flatten().all(|p| p.is_finite()), "points are finite");
        })
    });
}

fn copy(from: &Path, to: &Path) {
    fs::create_dir_all(to).unwrap();
    for entry in fs::read_dir(from).unwrap() {
        let path = entry.unwrap().path();
        let target = to.join(path.file_name().unwrap());
        if path.is_dir() {
            copy(&path, &target);
        } else {
            fs::copy(&path, &target).unwrap();
        }
    }
}

#[test]
fn colmap_binaries() {
    datasets("COLMAP binaries", "colmap", &["sparse/0/cameras.bin", "sparse/0/images.bin", "sparse/0/points3D.bin"]);
}

#[test]
fn colmap_texts() {
    let names = ["sparse/0/cameras.txt", "sparse/0/images.txt", "sparse/0/points3D.txt"];
    datasets("COLMAP texts", "colmap_opencv", &names);
}

#[test]
fn transforms() {
    datasets("transforms.json of nerfstudio", "nerfstudio", &["transforms.json"]);
    datasets("transforms.json of Blender", "blender", &["transforms_train.json", "transforms_test.json"]);
}

#[test]
fn point_clouds() {
    datasets("PLY", "nerfstudio", &["points.ply"]);
}

#[test]
fn pictures() {
    datasets("pictures", "blender", &["train/1.png"]);
}

#[test]
fn configurations() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("config.toml");
    let files = [Config::default().to_toml().into_bytes(), b"[train]\nsteps = 3\n[model]\nlayers = 2\n".to_vec()];
    fuzz("configurations", "", &files, |_, bytes| {
        fs::write(&path, bytes).unwrap();
        Config::resolve(None, Some(&path), &[]).map(|config| {
            fs::write(&path, config.to_toml()).unwrap();
            assert_eq!(Config::resolve(None, Some(&path), &[]).expect("what is accepted is valid"), config);
        })
    });
}

fn dataset() -> Dataset {
    builtin(&BuiltinOptions { width: 8, height: 8, train_views: 2, test_views: 1, points: 40, ..Default::default() })
}

/// The folder of a run of two steps.
fn run_folder(path: &Path) -> RunFolder {
    let config = Config::with(&["train.steps=2", "refine.budget=40", "init.max_points=30"]).unwrap();
    let run = Run::new(config, dataset(), ndarray()).unwrap();
    let mut run = run.write_to(RunFolder::new(path), Origin::new("builtin", "cpu")).unwrap();
    run.train(&mut |_: &StepReport| {}).unwrap();
    run.folder().unwrap().clone()
}

#[test]
fn checkpoints() {
    let folder = tempfile::tempdir().unwrap();
    let run = run_folder(folder.path());
    let file = fs::read(run.checkpoint()).unwrap();
    fuzz("checkpoints", "checkpoint.safetensors", &[file], |_, bytes| {
        fs::write(run.checkpoint(), bytes).unwrap();
        // what does not fit the rest of the run is found when it goes on
        SavedRun::open(run.clone()).map(|saved| drop(Run::resume(saved, dataset(), ndarray())))
    });
}

#[test]
fn files_cut_anywhere_are_refused_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let run = run_folder(folder.path());
    let (checkpoint, path) = (fs::read(run.checkpoint()).unwrap(), folder.path().join("cut.safetensors"));
    scene(ColourModel::SphericalBeta { lobes: 2 }, true).save(&path).unwrap();
    let scene = fs::read(&path).unwrap();
    for end in 0..scene.len() {
        let error = SceneData::from_bytes(&scene[..end], "cut").unwrap_err().to_string();
        assert!(error.contains("cut"), "{end} bytes: {error}");
    }
    // every byte of the header, and then some
    for end in (0..4000).chain((4000..checkpoint.len()).step_by(97)).take_while(|&end| end < checkpoint.len()) {
        fs::write(run.checkpoint(), &checkpoint[..end]).unwrap();
        let error = SavedRun::open(run.clone()).err().unwrap_or_else(|| panic!("{end} bytes are read")).to_string();
        assert!(error.contains("checkpoint.safetensors"), "{end} bytes: {error}");
    }
}

#[test]
fn changes_do_what_they_say() {
    let bytes = b"abc 12.5, def".to_vec();
    for (at, what, expected) in [
        (3, What::Truncate, &b"abc"[..]),
        (0, What::Flip(0), b"`bc 12.5, def"),
        (1, What::Number("-1".into()), b"abc -1, def"),
        (0, What::Remove(4), b"12.5, def"),
        (13, What::Insert(vec![b'!']), b"abc 12.5, def!"),
        (0, What::Integer(4, 1), b"\x01\0\0\x0012.5, def"),
    ] {
        assert_eq!(mutated(&bytes, &[Mutation { at, what }]), expected);
    }
    assert_eq!(mutated(&[], &[Mutation { at: 7, what: What::Flip(1) }]), b"");
}
