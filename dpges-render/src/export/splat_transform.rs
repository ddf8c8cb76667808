//! Files are read by a program that is not ours: SplatTransform of PlayCanvas, 2.7.1. It shows splats in the axes of
//! PLY files, from which SPZ differs by half a turn about x.
//!
//! ```sh
//! npm install --prefix target/splat-transform @playcanvas/splat-transform@2.7.1
//! export DPGES_SPLAT_TRANSFORM="$PWD/target/splat-transform/node_modules/.bin/splat-transform"
//! cargo test -p dpges-render --features export --lib splat_transform -- --ignored
//! ```

use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::process::Command;

use glam::{Mat3, Quat};

use super::cloud::tests::sample;
use super::glb::{floats, parts};
use super::spz::{SpzVersion, to_spz};
use super::{SplatCloud, UpAxis, to_glb, to_ply};

fn convert(input: &Path, output: &Path) {
    let program = std::env::var("DPGES_SPLAT_TRANSFORM").expect("DPGES_SPLAT_TRANSFORM names the program");
    let result = Command::new(program).args(["--quiet", "--overwrite"]).arg(input).arg(output).output().unwrap();
    assert!(result.status.success(), "{}: {}", input.display(), String::from_utf8_lossy(&result.stderr));
}

fn table(path: &Path) -> HashMap<String, Vec<f32>> {
    let text = std::fs::read_to_string(path).unwrap();
    let mut lines = text.lines();
    let names: Vec<&str> = lines.next().unwrap().split(',').collect();
    let mut columns: HashMap<String, Vec<f32>> = names.iter().map(|&name| (name.to_owned(), Vec::new())).collect();
    for line in lines {
        for (name, value) in names.iter().zip(line.split(',')) {
            columns.get_mut(*name).unwrap().push(value.parse().unwrap());
        }
    }
    columns
}

/// Largest differences between a table and `cloud`: of positions, log-scales, opacities, base colours, higher
/// coefficients, and of the cosine between axes from 1.
fn differences(columns: &HashMap<String, Vec<f32>>, cloud: &SplatCloud) -> [f32; 6] {
    let rest = cloud.harmonics_len() / 3 - 1;
    let mut largest = [0.0f32; 6];
    for (row, &position) in cloud.positions.iter().enumerate() {
        let value = |name: &str| columns[name][row];
        let mut differ = |of: usize, found: f32, expected: f32| {
            largest[of] = largest[of].max((found - expected).abs());
        };
        let harmonics = cloud.harmonics_of(row);
        for axis in 0..3 {
            differ(0, value(["x", "y", "z"][axis]), position[axis]);
            differ(1, value(&format!("scale_{axis}")), cloud.log_scales[row][axis]);
            differ(3, value(&format!("f_dc_{axis}")), harmonics[0][axis]);
            for (index, coefficient) in harmonics[1..].iter().enumerate() {
                differ(4, value(&format!("f_rest_{}", axis * rest + index)), coefficient[axis]);
            }
        }
        differ(2, 1.0 / (1.0 + (-value("opacity")).exp()), cloud.opacities[row]);
        // an axis of an ellipsoid has no sign
        let found = axes(std::array::from_fn(|i| value(&format!("rot_{i}"))));
        let expected = axes(cloud.quaternions[row]);
        (0..3).for_each(|axis| differ(5, found.col(axis).dot(expected.col(axis)).abs(), 1.0));
    }
    largest
}

fn axes([w, x, y, z]: [f32; 4]) -> Mat3 {
    Mat3::from_quat(Quat::from_xyzw(x, y, z, w).normalize())
}

/// The file `output` that the program makes of a file `input` of `bytes`, and the folder of both.
fn converted(input: &str, bytes: &[u8], output: &str) -> (tempfile::TempDir, PathBuf) {
    let folder = tempfile::tempdir().unwrap();
    let [input, output] = [input, output].map(|name| folder.path().join(name));
    std::fs::write(&input, bytes).unwrap();
    convert(&input, &output);
    (folder, output)
}

#[test]
#[ignore = "needs the npm package @playcanvas/splat-transform, see the head of its file"]
fn it_reads_our_ply_exactly_and_our_spz_within_the_steps_of_the_format() {
    let steps = [1e-5, 0.04, 0.003, 0.02, 0.07, 1e-5];
    for degree in [0, 3] {
        let cloud = sample(40, degree);
        let spz = |version| to_spz(&cloud, UpAxis::MinusY, version).unwrap();
        for (input, bytes, largest) in [
            ("scene.ply", to_ply(&cloud, UpAxis::MinusY), [1e-5; 6]),
            ("scene.spz", spz(SpzVersion::Three), steps),
            ("scene.spz", spz(SpzVersion::Four), steps),
        ] {
            let (_folder, output) = converted(input, &bytes, "scene.csv");
            let found = differences(&table(&output), &cloud);
            println!("{input}, degree {degree}: {found:?}");
            assert!(found.iter().zip(largest).all(|(difference, largest)| *difference < largest), "{found:?}");
        }
    }
}

#[test]
#[ignore = "needs the npm package @playcanvas/splat-transform, see the head of its file"]
fn our_glb_has_the_attributes_of_its_glb() {
    let cloud = sample(40, 2);
    let (_folder, output) = converted("scene.ply", &to_ply(&cloud, UpAxis::MinusY), "scene.glb");
    let (theirs, ours) = (std::fs::read(&output).unwrap(), to_glb(&cloud, UpAxis::MinusY).unwrap());
    let ([theirs, ours], mut largest) = ([parts(&theirs), parts(&ours)], 0.0f32);
    let primitive = |(document, _): &(serde_json::Value, &[u8])| document["meshes"][0]["primitives"][0].clone();
    let [their_primitive, our_primitive] = [&theirs, &ours].map(primitive);
    assert_eq!(their_primitive["extensions"], our_primitive["extensions"]);
    let names = our_primitive["attributes"].as_object().unwrap();
    assert!(names.keys().eq(their_primitive["attributes"].as_object().unwrap().keys()));
    for name in names.keys().filter(|name| !name.starts_with("COLOR") && !name.ends_with("ROTATION")) {
        let values = |(document, binary): &(serde_json::Value, &[u8]), primitive: &serde_json::Value| {
            floats(document, binary, &primitive["attributes"][name])
        };
        let (theirs, ours) = (values(&theirs, &their_primitive), values(&ours, &our_primitive));
        assert_eq!(theirs.len(), ours.len(), "{name}");
        let difference = theirs.iter().zip(&ours).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max);
        println!("GLB, {name}: {difference}");
        largest = largest.max(difference);
    }
    assert!(largest < 1e-5, "{largest}");
}
