//! Published datasets: cells, tables, jobs.

use std::path::Path;

use serde_json::{Value, json};

use super::{bytes, dpges, fails, folder, json, ok};
#[cfg(unix)]
use super::{start, wait_until};

/// Longest side of the photographs, px.
const SIDE: u32 = 24;
const VIEWS: usize = 10;

/// A camera of a ring at height 0 that looks at the origin: columns of its rotation to the world with axes right, down and
/// forward, and its position.
fn camera(index: usize) -> ([[f64; 3]; 3], [f64; 3]) {
    let angle = index as f64 * std::f64::consts::TAU / VIEWS as f64;
    let (sin, cos) = angle.sin_cos();
    ([[-sin, cos, 0.0], [0.0, 0.0, -1.0], [-cos, -sin, 0.0]], [3.0 * cos, 3.0 * sin, 0.0])
}

/// Photograph of a ball of radius 1 around the origin that is red in the north and green in the east, before black.
fn photograph(index: usize) -> image::RgbaImage {
    let ([right, down, forward], centre) = camera(index);
    image::RgbaImage::from_fn(SIDE, SIDE, |x, y| {
        let offset = |pixel: u32| (f64::from(pixel) + 0.5) / f64::from(SIDE) - 0.5;
        let direction: Vec<f64> = (0..3).map(|a| forward[a] + offset(x) * right[a] + offset(y) * down[a]).collect();
        let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
        let (a, b, c) = (dot(&direction, &direction), dot(&direction, &centre), dot(&centre, &centre) - 1.0);
        let root = b * b - a * c;
        if root <= 0.0 {
            return image::Rgba([0, 0, 0, 0]);
        }
        let distance = (-b - root.sqrt()) / a;
        let shade = |axis: usize| (255.0 * (0.5 + 0.5 * (centre[axis] + distance * direction[axis]))) as u8;
        image::Rgba([shade(2), shade(0), 90, 255])
    })
}

/// A scene of COLMAP with `folder` of photographs.
fn write_colmap(path: &Path, folder: &str) {
    let (sparse, images) = (path.join("sparse/0"), path.join(folder));
    std::fs::create_dir_all(&sparse).unwrap();
    std::fs::create_dir_all(&images).unwrap();
    let half = f64::from(SIDE) / 2.0;
    std::fs::write(sparse.join("cameras.txt"), format!("1 PINHOLE {SIDE} {SIDE} {SIDE} {SIDE} {half} {half}\n"))
        .unwrap();
    let mut poses = String::new();
    for index in 0..VIEWS {
        let (axes, centre) = camera(index);
        let dot = |axis: [f64; 3]| -(0..3).map(|a| axis[a] * centre[a]).sum::<f64>();
        let [x, y, z] = axes.map(dot);
        let [qw, qx, qy, qz] = quaternion(axes);
        poses += &format!("{} {qw} {qx} {qy} {qz} {x} {y} {z} 1 v{index}.png\n\n", index + 1);
        let opaque = image::DynamicImage::from(photograph(index)).into_rgb8();
        opaque.save(images.join(format!("v{index}.png"))).unwrap();
    }
    std::fs::write(sparse.join("images.txt"), poses).unwrap();
    let point = |index: u32| {
        let (height, turn) = (f64::from(index) / 50.0 - 0.99, f64::from(index) * 2.4);
        let radius = (1.0 - height * height).sqrt();
        format!("{} {} {} {height} 99 99 90 0.1\n", index + 1, radius * turn.cos(), radius * turn.sin())
    };
    std::fs::write(sparse.join("points3D.txt"), (0..100).map(point).collect::<String>()).unwrap();
}

/// Of the rotation from the world whose rows are `rows`.
fn quaternion(rows: [[f64; 3]; 3]) -> [f64; 4] {
    let [[a, b, c], [d, e, f], [g, h, i]] = rows;
    let squares = [1.0 + a + e + i, 1.0 + a - e - i, 1.0 - a + e - i, 1.0 - a - e + i];
    let half = |index: usize| 0.5 * squares[index].max(0.0).sqrt();
    let [w, x, y, z] = [half(0), half(1), half(2), half(3)];
    let (x, y, z) = (x.copysign(h - f), y.copysign(c - g), z.copysign(d - b));
    if w > 1e-6 { [w, x, y, z] } else { [0.0, x, y.copysign(x * (b + d)), z.copysign(x * (c + g))] }
}

/// A scene of NeRF-Synthetic.
fn write_blender(path: &Path) {
    for (name, first, last) in [("train", 0, VIEWS - 2), ("test", VIEWS - 2, VIEWS)] {
        std::fs::create_dir_all(path.join(name)).unwrap();
        let frame = |index: usize| {
            photograph(index).save(path.join(format!("{name}/r_{index}.png"))).unwrap();
            let ([right, down, forward], centre) = camera(index);
            let row = |a: usize| json!([right[a], -down[a], -forward[a], centre[a]]);
            json!({ "file_path": format!("./{name}/r_{index}"), "transform_matrix": [row(0), row(1), row(2), [0, 0, 0, 1]] })
        };
        let frames: Vec<Value> = (first..last).map(frame).collect();
        let transforms = json!({ "camera_angle_x": 2.0 * 0.5f64.atan(), "frames": frames });
        std::fs::write(path.join(format!("transforms_{name}.json")), transforms.to_string()).unwrap();
    }
}

/// One scene of each dataset in its layout.
fn write_data(data: &Path) {
    write_colmap(&data.join("360_v2/garden"), "images_4");
    write_colmap(&data.join("tandt/truck"), "images");
    write_colmap(&data.join("db/playroom"), "images");
    write_blender(&data.join("nerf_synthetic/lego"));
}

const BENCHMARK: [&str; 7] = [
    "benchmark",
    "--data=data",
    "--out=out",
    "--devices=cpu,cpu",
    "--lpips=none",
    "--steps-scale=0.0004",
    "--max-resolution=16",
];

const METHODS: &str = "--methods=mcmc,dpges";

const CELLS: [&str; 8] = [
    "mipnerf360/garden/mcmc/seed_0",
    "mipnerf360/garden/dpges/seed_0",
    "tanks-and-temples/truck/mcmc/seed_0",
    "tanks-and-temples/truck/dpges/seed_0",
    "deep-blending/playroom/mcmc/seed_0",
    "deep-blending/playroom/dpges/seed_0",
    "nerf-synthetic/lego/mcmc/seed_0",
    "nerf-synthetic/lego/dpges/seed_0",
];

#[cfg(unix)]
#[test]
fn cells_that_were_killed_go_on_and_the_tables_have_all_of_them() {
    let folder = folder();
    let at = folder.path();
    write_data(&at.join("data"));
    let run = |cell: &str| at.join("out/runs").join(cell);
    let command = [&BENCHMARK[..], &[METHODS]].concat();

    // killed while a cell has a checkpoint; the processes of its cells end with it, unless they have just finished
    let is_begun =
        |cell: &&str| run(cell).join("checkpoint.safetensors").is_file() && !run(cell).join("eval.json").is_file();
    let killed = loop {
        let mut child = start(at, &command);
        wait_until(|| CELLS.iter().any(|cell| run(cell).join("row.json").is_file()));
        wait_until(|| CELLS.iter().any(is_begun));
        child.kill().unwrap();
        child.wait().unwrap();
        std::thread::sleep(std::time::Duration::from_millis(500));
        if let Some(cell) = CELLS.into_iter().find(is_begun) {
            break cell;
        }
    };
    let finished: Vec<&str> = CELLS.into_iter().filter(|cell| run(cell).join("row.json").is_file()).collect();
    let logs: Vec<Vec<u8>> = finished.iter().map(|cell| bytes(run(cell).join("metrics.jsonl"))).collect();
    assert!(!finished.is_empty() && finished.len() < CELLS.len(), "{finished:?}");
    assert!(!at.join("out/tables.md").exists());

    let output = dpges(at, &command);
    let messages = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(0), "{messages}");
    let count = format!("8 cells, {} of them already finished", finished.len());
    assert!(messages.contains(&count), "{count}: {messages}");
    for (cell, log) in finished.iter().zip(logs) {
        assert!(bytes(run(cell).join("metrics.jsonl")) == log, "{cell} is not trained again");
    }
    let log = String::from_utf8(bytes(run(killed).join("log.txt"))).unwrap();
    assert!(log.contains("resuming after step"), "{killed} goes on: {log}");

    let study = json(at.join("out/benchmark.json"));
    let rows = study["rows"].as_array().unwrap();
    assert_eq!(rows.len(), CELLS.len());
    for cell in CELLS {
        let parts: Vec<&str> = cell.split('/').collect();
        let scene = format!("{}/{}", parts[0], parts[1]);
        let row = rows.iter().find(|row| row["scene"] == *scene && row["label"] == parts[2]).unwrap();
        assert_eq!(row["folder"], format!("runs/{cell}"));
        assert_eq!((&row["psnr"], &row["longest_px"]), (&json(run(cell).join("eval.json"))["psnr"], &16.into()));
        assert!(row["training_seconds"].as_f64().unwrap() > 0.0, "{row}");
        // so few steps leave no surface that two frames see, so that there may be no FLIP_1
        let log = String::from_utf8(bytes(run(cell).join("log.txt"))).unwrap();
        assert!(log.contains("measuring popping over 60 frames"), "{log}");
    }
    let printed = String::from_utf8(output.stdout).unwrap();
    let read = |name: &str| String::from_utf8(bytes(at.join("out").join(name))).unwrap();
    let (markdown, csv, latex) = (read("tables.md"), read("tables.csv"), read("tables.tex"));
    assert!(printed.contains(&markdown) && printed.contains("tables.tex"), "{printed}");
    let psnr = rows.iter().find(|row| row["scene"] == "tanks-and-temples/truck" && row["label"] == "dpges").unwrap();
    let psnr = psnr["psnr"].as_f64().unwrap();
    for (text, part) in [
        (&markdown, format!("{psnr:.2}<sup>abc</sup> (24.61)")),
        (&markdown, "0.0004 of its published steps".to_owned()),
        (&markdown, "Mip-NeRF360 PSNR: paper DP-GES, 3DGS-MCMC; found ".to_owned()),
        (&csv, format!("1,dpges,tanks-and-temples,,PSNR,{psnr},24.61,abc,1\n")),
        (&latex, format!("{psnr:.2}\\textsuperscript{{abc}} (24.61)")),
    ] {
        assert!(text.contains(&part), "{part}: {text}");
    }

    // the tables alone, and a job for an ablation
    assert_eq!(ok(at, &[&command[..], &["--tables"]].concat()), printed);
    let jobs = ok(at, &[&BENCHMARK[..], &["--methods=no-split", "--slurm=jobs"]].concat());
    assert!(jobs.contains("jobs/submit.sh") && !run("mipnerf360/garden/no-split").exists(), "{jobs}");
    assert_eq!(bytes(at.join("jobs/cells.txt")), b"mipnerf360/garden/no-split/seed_0\n");
    let script = String::from_utf8(bytes(at.join("jobs/cells.sbatch"))).unwrap();
    let job = script.lines().last().unwrap().replace("\"$cell\"", "mipnerf360/garden/no-split/seed_0");
    let status = std::process::Command::new("sh").args(["-c", &job]).current_dir(at).status().unwrap();
    assert!(status.success(), "{job}");
    let tables = ok(at, &[&BENCHMARK[..], &["--methods=no-split", "--tables"]].concat());
    let line = tables.lines().rfind(|line| line.starts_with("| no splitting")).unwrap();
    assert!(line.contains("<sup>abc</sup> (28.04)"), "{line}");
    assert!(tables.contains(&format!("{psnr:.2}<sup>abc</sup> (24.61)")), "rows of earlier commands stay: {tables}");
}

#[test]
fn a_cell_that_fails_is_named_and_the_others_go_on() {
    let folder = folder();
    let at = folder.path();
    write_data(&at.join("data"));
    std::fs::remove_file(at.join("data/tandt/truck/images/v3.png")).unwrap();
    let args = [&BENCHMARK[..], &["--methods=mcmc", "--datasets=tanks-and-temples,deep-blending"]].concat();
    let message = fails(at, 1, &args);
    for part in ["1 of 2 cells failed", "tanks-and-temples/truck/mcmc/seed_0: ", "v3.png"] {
        assert!(message.contains(part), "{part}: {message}");
    }
    let study = json(at.join("out/benchmark.json"));
    assert_eq!((study["rows"].as_array().unwrap().len(), &study["rows"][0]["label"]), (1, &"mcmc".into()));
    assert_eq!(study["not_run"], json!(["tanks-and-temples/truck/mcmc/seed_0"]));
    let other = fails(at, 1, &[&args[..], &["--steps-scale=0.01"]].concat());
    assert!(other.contains("benchmark.json holds other measurements: `steps_scale` is 0.0004, not 0.01"), "{other}");
}

#[test]
fn what_is_not_there_is_named_with_what_is() {
    let folder = folder();
    let at = folder.path();
    write_data(&at.join("data"));
    let refused = |more: &[&str]| fails(at, 1, &[&BENCHMARK[..], more].concat());
    let message = refused(&["--scenes=bicycle"]);
    assert!(
        message.contains("`bicycle` of mipnerf360 is not there") && message.contains("there are garden"),
        "{message}"
    );
    let message = refused(&["--data=data/tandt", "--datasets=nerf-synthetic"]);
    assert!(
        message.contains("none of the datasets nerf-synthetic") && message.contains("there are truck"),
        "{message}"
    );
    assert!(!at.join("out").exists());
}
