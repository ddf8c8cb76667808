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

/// Compares a case on a device in an element type.
type Compare = fn(&GoldenCase, &Device, DType) -> Vec<Deviation>;

/// The cases of a folder and how they are compared.
struct Kind {
    folder: &'static str,
    /// The case that is changed on purpose.
    changed: &'static str,
    /// Tensors of a case, at least.
    least: usize,
    compare: Compare,
}

/// Peeled; blended in the order of each pixel's own ray; Gaussians that rays meet without a projection; weighted sums.
static KINDS: [Kind; 4] = [
    Kind { folder: "", changed: "basic", least: 41, compare: GoldenCase::compare },
    Kind { folder: "stopthepop", changed: "few", least: 9, compare: GoldenCase::compare_by_rays },
    Kind { folder: "htgs", changed: "few", least: 9, compare: GoldenCase::compare_whitened },
    Kind { folder: "summed", changed: "exp", least: 11, compare: GoldenCase::compare_summed },
];

fn load(path: &Path) -> GoldenCase {
    GoldenCase::load(path).unwrap()
}

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

impl Kind {
    fn folder(&self) -> PathBuf {
        Path::new(env!("CARGO_MANIFEST_DIR")).join("golden").join(self.folder)
    }

    fn changed_case(&self) -> PathBuf {
        self.folder().join(self.changed).with_extension("safetensors")
    }

    /// How far each tensor may be from its golden values.
    fn tolerances(&self, path: &Path, device: &Device, dtype: DType) -> HashMap<String, f64> {
        let of = |d: Deviation| (d.tensor, if d.is_id { 0.0 } else { TOLERANCE_F64 });
        if dtype == DType::F64 {
            return (self.compare)(&load(path), device, DType::F64).into_iter().map(of).collect();
        }
        let rounded = (self.compare)(&load(path).rounded_to_f32(), &flex(), DType::F64);
        rounded.into_iter().map(|d| (d.tensor, d.distance + if d.is_id { 0.0 } else { TOLERANCE_F32 })).collect()
    }

    fn check_folder(&self, folder: &Path, device: &Device, dtype: DType) {
        let mut failures = Vec::new();
        for path in cases_in(folder) {
            let deviations = (self.compare)(&load(&path), device, dtype);
            assert!(deviations.len() >= self.least, "{}: only {} tensors compared", path.display(), deviations.len());
            let worst = deviations.iter().map(|d| d.distance).fold(0.0, f64::max);
            println!("{} {dtype:?}: {} tensors, worst {worst:.2e}", path.display(), deviations.len());
            let tolerances = self.tolerances(&path, device, dtype);
            let too_far = deviations.into_iter().filter(|d| d.distance > tolerances[&d.tensor] || d.distance.is_nan());
            failures.extend(too_far.map(|d| format!("{}: {} is off by {:.3e}", path.display(), d.tensor, d.distance)));
        }
        assert!(failures.is_empty(), "{}", failures.join("\n"));
    }

    /// Changes every `step`-th expectation of a case: the comparison is worth something only if it fails there, and only there.
    fn check_changed(&self, step: usize, device: &Device, dtype: DType) {
        let path = self.changed_case();
        let tolerances = self.tolerances(&path, device, dtype);
        let names: Vec<String> = load(&path).expected().map(str::to_owned).collect();
        assert!(names.len() >= self.least, "{}: {}", path.display(), names.len());
        // margins have no gradient; ids and depth are compared together
        let apart = |name: &&String| [".margins", ".ids", "layers.depth"].iter().all(|end| !name.ends_with(end));
        for name in names.iter().filter(apart).step_by(step) {
            let deviations = (self.compare)(&load(&path).perturbed(name, 1.01), device, dtype);
            let far: Vec<&str> =
                deviations.iter().filter(|d| d.distance > tolerances[&d.tensor]).map(|d| d.tensor.as_str()).collect();
            assert_eq!(far, [name.as_str()]);
        }
    }
}

pub fn check_all(device: &Device, dtype: DType) {
    for kind in &KINDS {
        kind.check_folder(&kind.folder(), device, dtype);
        kind.check_changed(usize::MAX, device, dtype);
    }
    if let Some(folder) = std::env::var_os("DPGES_GOLDEN_DIR") {
        KINDS[0].check_folder(Path::new(&folder), device, dtype);
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
    for kind in &KINDS[..3] {
        for path in cases_in(&kind.folder()) {
            for (tensor, tolerance) in kind.tolerances(&path, &flex(), DType::F32) {
                assert!(tolerance < 1e-3, "{}: {tensor} may be off by {tolerance:.1e}", path.display());
            }
        }
    }
}

#[test]
fn a_wrong_expectation_is_reported_and_only_that() {
    KINDS.iter().for_each(|kind| kind.check_changed(1, &flex(), DType::F64));
    let kind = &KINDS[0];
    let basic = |name, factor| (kind.compare)(&load(&kind.changed_case()).perturbed(name, factor), &flex(), DType::F64);
    let differing = basic("out.layers.ids", 2.0).into_iter().find(|d| d.is_id).unwrap().distance;
    assert!(differing > 100.0, "{differing} pixels");
    let depth = basic("out.layers.depth", 1.001);
    assert!(depth.iter().any(|d| d.tensor == "out.layers.depth" && d.distance > TOLERANCE_F64));
}
