//! Every golden case, on both CPU backends in both element types, and on a GPU.
//!
//! `DPGES_GOLDEN_DIR` names another folder whose `*.safetensors` are all checked too.

use std::collections::HashMap;
use std::path::{Path, PathBuf};

use burn::tensor::{DType, Device};
use dpges_core::testing::golden::{Deviation, GoldenCase};

use crate::devices::flex;

const TOLERANCE_F64: f64 = 1e-9;
/// Beside what rounding the inputs to f32 causes.
const TOLERANCE_F32: f64 = 2e-4;

fn cases_in(folder: &Path) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).unwrap_or_else(|e| panic!("{}: {e}", folder.display()));
    let mut cases: Vec<PathBuf> = entries
        .map(|entry| entry.unwrap().path())
        .filter(|p| p.extension().is_some_and(|e| e == "safetensors"))
        .collect();
    cases.sort();
    assert!(!cases.is_empty(), "{} holds no *.safetensors", folder.display());
    cases
}

fn own_cases() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("golden")
}

/// Cases that are blended in the order of each pixel's own ray.
fn by_rays() -> PathBuf {
    own_cases().join("stopthepop")
}

/// Cases of Gaussians that rays meet without a projection.
fn whitened() -> PathBuf {
    own_cases().join("htgs")
}

/// Cases of weighted sums.
fn summed() -> PathBuf {
    own_cases().join("summed")
}

/// How cases are compared, and the fewest tensors of one.
const PEELED: (Compare, usize) = (GoldenCase::compare, 41);
const BY_RAYS: (Compare, usize) = (GoldenCase::compare_by_rays, 9);
const WHITENED: (Compare, usize) = (GoldenCase::compare_whitened, 9);
/// Image, alpha, and the gradients of eight attributes and of what is common.
const SUMMED: (Compare, usize) = (GoldenCase::compare_summed, 11);

fn load(path: &Path) -> GoldenCase {
    GoldenCase::load(path).unwrap()
}

/// Compares a case on a device in an element type.
type Compare = fn(&GoldenCase, &Device, DType) -> Vec<Deviation>;

/// How far each tensor may be from its golden values.
fn tolerances(path: &Path, device: &Device, dtype: DType, compare: Compare) -> HashMap<String, f64> {
    let of = |d: Deviation| (d.tensor, if d.is_id { 0.0 } else { TOLERANCE_F64 });
    if dtype == DType::F64 {
        return compare(&load(path), device, DType::F64).into_iter().map(of).collect();
    }
    let rounded = compare(&load(path).rounded_to_f32(), &flex(), DType::F64);
    rounded.into_iter().map(|d| (d.tensor, d.distance + if d.is_id { 0.0 } else { TOLERANCE_F32 })).collect()
}

fn check_folder(folder: &Path, device: &Device, dtype: DType, (compare, least): (Compare, usize)) {
    let mut failures = Vec::new();
    for path in cases_in(folder) {
        let deviations = compare(&load(&path), device, dtype);
        assert!(deviations.len() >= least, "{}: only {} tensors compared", path.display(), deviations.len());
        let worst = deviations.iter().map(|d| d.distance).fold(0.0, f64::max);
        println!("{} {dtype:?}: {} tensors, worst {worst:.2e}", path.display(), deviations.len());
        let tolerances = tolerances(&path, device, dtype, compare);
        let too_far = deviations.into_iter().filter(|d| d.distance > tolerances[&d.tensor] || d.distance.is_nan());
        failures.extend(too_far.map(|d| format!("{}: {} is off by {:.3e}", path.display(), d.tensor, d.distance)));
    }
    assert!(failures.is_empty(), "{}", failures.join("\n"));
}

pub fn check_all(device: &Device, dtype: DType) {
    check_folder(&own_cases(), device, dtype, PEELED);
    check_folder(&by_rays(), device, dtype, BY_RAYS);
    check_folder(&whitened(), device, dtype, WHITENED);
    check_folder(&summed(), device, dtype, SUMMED);
    if let Some(folder) = std::env::var_os("DPGES_GOLDEN_DIR") {
        check_folder(Path::new(&folder), device, dtype, PEELED);
    }
}

#[test]
fn ndarray_f64() {
    check_all(&crate::devices::ndarray(), DType::F64);
}

#[test]
fn ndarray_f32() {
    check_all(&crate::devices::ndarray(), DType::F32);
}

#[test]
fn flex_f64() {
    check_all(&flex(), DType::F64);
}

#[test]
fn flex_f32() {
    check_all(&flex(), DType::F32);
}

#[test]
fn rounding_the_inputs_does_not_excuse_much() {
    for (folder, (compare, _)) in [(own_cases(), PEELED), (by_rays(), BY_RAYS), (whitened(), WHITENED)] {
        for path in cases_in(&folder) {
            for (tensor, tolerance) in tolerances(&path, &flex(), DType::F32, compare) {
                assert!(tolerance < 1e-3, "{}: {tensor} may be off by {tolerance:.1e}", path.display());
            }
        }
    }
}

/// The comparison is worth something only if it fails where it should.
#[test]
fn a_wrong_expectation_is_reported_and_only_that() {
    let path = own_cases().join("basic.safetensors");
    let names: Vec<String> = load(&path).expected().map(str::to_owned).collect();
    assert!(names.len() > 40, "{}", names.len());
    let mut compared = 0;
    // margins have no gradient; ids and depth are compared together
    let apart = |name: &&String| [".margins", ".ids", "layers.depth"].iter().all(|end| !name.ends_with(end));
    for name in names.iter().filter(apart) {
        let deviations = load(&path).perturbed(name, 1.001).compare(&flex(), DType::F64);
        let far: Vec<&str> =
            deviations.iter().filter(|d| d.distance > TOLERANCE_F64).map(|d| d.tensor.as_str()).collect();
        assert_eq!(far, [name.as_str()]);
        compared += 1;
    }
    assert!(compared > 40, "{compared}");
    let ids = load(&path).perturbed("out.layers.ids", 2.0).compare(&flex(), DType::F64);
    let differing = ids.iter().find(|d| d.is_id).unwrap().distance;
    assert!(differing > 100.0, "{differing} pixels");
    let depth = load(&path).perturbed("out.layers.depth", 1.001).compare(&flex(), DType::F64);
    assert!(depth.iter().any(|d| d.tensor == "out.layers.depth" && d.distance > TOLERANCE_F64));
}

#[test]
fn a_wrong_expectation_of_what_is_blended_or_summed_is_reported_and_only_that() {
    for (folder, name, (compare, least)) in
        [(by_rays(), "few", BY_RAYS), (whitened(), "few", WHITENED), (summed(), "exp", SUMMED)]
    {
        let path = folder.join(name).with_extension("safetensors");
        let names: Vec<String> = load(&path).expected().map(str::to_owned).collect();
        for name in &names {
            let deviations = compare(&load(&path).perturbed(name, 1.001), &flex(), DType::F64);
            let far: Vec<&str> =
                deviations.iter().filter(|d| d.distance > TOLERANCE_F64).map(|d| d.tensor.as_str()).collect();
            assert_eq!(far, [name.as_str()]);
        }
        assert_eq!(names.len(), least);
    }
}
