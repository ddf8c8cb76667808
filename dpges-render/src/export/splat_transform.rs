//! Files are read and written by a program that is not ours: SplatTransform of PlayCanvas, 2.7.1.
//!
//! ```sh
//! npm install --prefix target/splat-transform @playcanvas/splat-transform@2.7.1
//! export DPGES_SPLAT_TRANSFORM="$PWD/target/splat-transform/node_modules/.bin/splat-transform"
//! cargo test -p dpges-render --features export --lib splat_transform -- --ignored
//! ```

use std::process::Command;

use dpges_core::scene::SceneData;

use super::cloud::tests::sample;
use super::sog::to_sog;
use super::spz::{SpzVersion, to_spz};
use super::{Coordinates, SplatCloud, open, to_ply};

/// The splats of file `output` that the program makes of a file `input` of `bytes`, as we read it.
fn converted(input: &str, bytes: &[u8], output: &str, options: &[&str]) -> SceneData {
    let program = std::env::var("DPGES_SPLAT_TRANSFORM").expect("DPGES_SPLAT_TRANSFORM names the program");
    let folder = tempfile::tempdir().unwrap();
    let [input, output] = [input, output].map(|name| folder.path().join(name));
    std::fs::write(&input, bytes).unwrap();
    let result = Command::new(program).args(options).arg("--quiet").arg(&input).arg(&output).output().unwrap();
    assert!(result.status.success(), "{}: {}", input.display(), String::from_utf8_lossy(&result.stderr));
    open(&output).unwrap().scene
}

/// Largest differences of positions, log-scales, opacities, base colours, and higher coefficients. The program may order
/// splats anew, and the sample has none with the same x.
fn differences(found: &SceneData, expected: &SplatCloud) -> [f32; 5] {
    let expected = expected.to_scene();
    let columns = |scene: &SceneData| {
        let order = |scene: &SceneData| {
            let mut rows: Vec<usize> = (0..scene.gaussians.len()).collect();
            rows.sort_by(|&a, &b| scene.gaussians.positions[3 * a].total_cmp(&scene.gaussians.positions[3 * b]));
            rows
        };
        let sorted = scene.gaussians.select(&order(scene));
        [sorted.positions, sorted.log_scales, sorted.opacities, sorted.colour.base, sorted.colour.detail]
    };
    let (found, expected) = (columns(found), columns(&expected));
    std::array::from_fn(|at| {
        assert_eq!(found[at].len(), expected[at].len(), "column {at}");
        found[at].iter().zip(&expected[at]).map(|(a, b)| (a - b).abs()).fold(0.0, f32::max)
    })
}

#[test]
#[ignore = "needs the npm package @playcanvas/splat-transform, see the head of its file"]
fn it_reads_what_we_write_and_we_read_what_it_writes() {
    let steps = [1e-5, 0.04, 0.003, 0.02, 0.07];
    // 40 splats: 120 scales and base colours have an entry each, and 40 sets of harmonics share 32
    let pictures = [2e-4, 1e-3, 0.003, 1e-3, 0.2];
    for degree in [0, 3] {
        let mut cloud = sample(40, degree);
        cloud.info.up = None;
        let ply = to_ply(&cloud, Coordinates::Scene);
        let spz = |version| to_spz(&cloud, version).unwrap();
        for (input, bytes, output, options, largest) in [
            ("scene.ply", &ply, "scene.out.ply", &[][..], [1e-5; 5]),
            ("scene.ply", &ply, "scene.glb", &[], [1e-5; 5]),
            ("scene.ply", &ply, "scene.compressed.ply", &[], [0.005, 0.01, 0.003, 0.02, 0.02]),
            ("scene.ply", &ply, "scene.spz", &["--spz-version", "3"], steps),
            ("scene.ply", &ply, "scene.spz", &["--spz-version", "4"], steps),
            ("scene.ply", &ply, "scene.sog", &["--gpu", "cpu"], pictures),
            ("scene.sog", &to_sog(&cloud).unwrap(), "scene.ply", &[], pictures),
            ("scene.spz", &spz(SpzVersion::Three), "scene.ply", &[], steps),
            ("scene.spz", &spz(SpzVersion::Four), "scene.ply", &[], steps),
        ] {
            let found = differences(&converted(input, bytes, output, options), &cloud);
            println!("{input} to {output} {options:?}, degree {degree}: {found:?}");
            assert!(found.iter().zip(largest).all(|(difference, largest)| *difference < largest), "{found:?}");
        }
    }
}
