//! The golden files are what `reference/make_golden.py` and `reference/make_students.py` write.
//!
//! The test needs Python with the packages of `reference/requirements.txt`. `DPGES_PYTHON` names the interpreter;
//! without it `python3` is tried. Where packages are missing the test is ignored, and fails with
//! `DPGES_REQUIRE_PYTHON=1`.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::Command;

use dpges_core::testing::compare::relative_l2;
use libtest_mimic::Trial;
use safetensors::{Dtype, SafeTensors};

use crate::timing::trial;

/// Rounding differs from one machine to another; conditioning magnifies it, most for discs that are seen edge-on.
const TOLERANCE: f64 = 1e-10;

pub fn trials() -> Vec<Trial> {
    let python = python();
    let required = std::env::var("DPGES_REQUIRE_PYTHON").is_ok_and(|value| value == "1");
    if let Err(reason) = &python {
        eprintln!("the golden files cannot be compared with their generator: {reason}");
    }
    let trial = |(name, generator, committed)| {
        trial(name, "Python", &python, required, move |python| {
            the_files_are_what_the_generator_writes(&python, generator, committed);
            Ok(())
        })
    };
    let tests = [
        ("reference::the_golden_files_are_what_the_generator_writes", "make_golden.py", "golden"),
        ("reference::the_students_are_what_the_generator_writes", "make_students.py", "golden_students"),
    ];
    tests.map(trial).into()
}

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("reference")
}

/// An interpreter with the packages that the generator imports.
fn python() -> Result<String, String> {
    let python = std::env::var("DPGES_PYTHON").unwrap_or_else(|_| "python3".to_owned());
    let output = Command::new(&python).args(["-c", "import autograd, mpmath, numpy, safetensors"]).output();
    let advice = format!("{}, or DPGES_PYTHON names another interpreter", folder().join("README.md").display());
    match output {
        Ok(output) if output.status.success() => Ok(python),
        Ok(output) => {
            let text = String::from_utf8_lossy(&output.stderr);
            Err(format!("`{python}`: {}; see {advice}", text.trim().lines().last().unwrap_or("it failed")))
        }
        Err(error) => Err(format!("`{python}`: {error}; see {advice}")),
    }
}

/// Shape and values of every tensor, and the metadata as text.
type Content = (BTreeMap<String, (Vec<usize>, Vec<f64>)>, BTreeMap<String, String>);

fn read(path: &Path) -> Content {
    let bytes = std::fs::read(path).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    let file = SafeTensors::deserialize(&bytes).unwrap();
    let (_, header) = SafeTensors::read_metadata(&bytes).unwrap();
    let values = |dtype, data: &[u8]| -> Vec<f64> {
        match dtype {
            Dtype::F64 => data.as_chunks::<8>().0.iter().map(|bytes| f64::from_le_bytes(*bytes)).collect(),
            Dtype::I32 => data.as_chunks::<4>().0.iter().map(|bytes| i32::from_le_bytes(*bytes).into()).collect(),
            other => panic!("{}: {other:?}", path.display()),
        }
    };
    let tensor = |(name, view): (&str, safetensors::tensor::TensorView<'_>)| {
        (name.to_owned(), (view.shape().to_vec(), values(view.dtype(), view.data())))
    };
    let metadata = header.metadata().clone().unwrap_or_default();
    (file.iter().map(tensor).collect(), metadata.into_iter().collect())
}

fn the_files_are_what_the_generator_writes(python: &str, generator: &str, committed: &str) {
    let made = tempfile::tempdir().unwrap();
    let output = Command::new(python).arg(folder().join(generator)).arg(made.path()).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let names = |folder: &Path| -> Vec<PathBuf> {
        let (mut names, mut folders) = (Vec::new(), vec![PathBuf::new()]);
        while let Some(part) = folders.pop() {
            for entry in std::fs::read_dir(folder.join(&part)).unwrap().map(Result::unwrap) {
                let of = if entry.path().is_dir() { &mut folders } else { &mut names };
                of.push(part.join(entry.file_name()));
            }
        }
        names.sort();
        names
    };
    let committed = Path::new(env!("CARGO_MANIFEST_DIR")).join(committed);
    assert_eq!(names(made.path()), names(&committed));
    for name in names(&committed) {
        let ((expected, metadata), (found, found_metadata)) =
            (read(&committed.join(&name)), read(&made.path().join(&name)));
        assert_eq!(found_metadata, metadata, "{name:?}");
        assert!(found.keys().eq(expected.keys()), "{name:?}: other tensors");
        for ((tensor, (shape, values)), (found_shape, found_values)) in expected.iter().zip(found.values()) {
            assert_eq!(found_shape, shape, "{name:?}: {tensor}");
            let distance = relative_l2(found_values, values);
            assert!(distance <= TOLERANCE, "{name:?}: {tensor} is off by {distance:.1e}");
        }
    }
}
