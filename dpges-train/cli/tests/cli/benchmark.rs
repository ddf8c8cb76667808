//! Published datasets: cells, tables, jobs.

use std::path::Path;

use dpges_core::camera::CameraFromWorld;
use glam::{DQuat, DVec3};
use serde_json::{Value, json};

use super::{assert_contains, bytes, content, fails, folder, json, ok};
#[cfg(unix)]
use super::{both, kill, start, wait_until};

/// Longest side of the photographs, px.
const SIDE: u32 = 24;
const VIEWS: usize = 10;

/// A camera of a ring at height 0 that looks at the origin.
fn pose(index: usize) -> (DVec3, CameraFromWorld) {
    let angle = index as f64 * std::f64::consts::TAU / VIEWS as f64;
    let eye = 3.0 * DVec3::new(angle.cos(), angle.sin(), 0.0);
    (eye, CameraFromWorld::look_at(eye, DVec3::ZERO, DVec3::Z))
}

/// Photograph of a ball of radius 1 around the origin that is red in the north and green in the east, before black.
fn photograph(index: usize) -> image::RgbaImage {
    let (centre, pose) = pose(index);
    image::RgbaImage::from_fn(SIDE, SIDE, |x, y| {
        let offset = |pixel: u32| (f64::from(pixel) + 0.5) / f64::from(SIDE) - 0.5;
        let direction = pose.rotation.transpose() * DVec3::new(offset(x), offset(y), 1.0);
        let (a, b, c) = (direction.length_squared(), direction.dot(centre), centre.length_squared() - 1.0);
        let root = b * b - a * c;
        if root <= 0.0 {
            return image::Rgba([0, 0, 0, 0]);
        }
        let place = centre + direction * ((-b - root.sqrt()) / a);
        let shade = |coordinate: f64| (255.0 * (0.5 + 0.5 * coordinate)) as u8;
        image::Rgba([shade(place.z), shade(place.x), 90, 255])
    })
}

/// A photograph in `images.txt` of COLMAP.
pub fn colmap_image(index: usize, pose: &CameraFromWorld, name: &str) -> String {
    let (q, t) = (DQuat::from_mat3(&pose.rotation), pose.translation);
    format!("{} {} {} {} {} {} {} {} 1 {name}\n\n", index + 1, q.w, q.x, q.y, q.z, t.x, t.y, t.z)
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
        poses += &colmap_image(index, &pose(index).1, &format!("v{index}.png"));
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

/// A scene of NeRF-Synthetic.
fn write_blender(path: &Path) {
    for (name, first, last) in [("train", 0, VIEWS - 2), ("test", VIEWS - 2, VIEWS)] {
        std::fs::create_dir_all(path.join(name)).unwrap();
        let frame = |index: usize| {
            photograph(index).save(path.join(format!("{name}/r_{index}.png"))).unwrap();
            let (centre, pose) = pose(index);
            // y up, z backwards
            let axes = pose.rotation.transpose();
            let row = |a: usize| json!([axes.x_axis[a], -axes.y_axis[a], -axes.z_axis[a], centre[a]]);
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

const SCENES: [&str; 4] =
    ["mipnerf360/garden", "tanks-and-temples/truck", "deep-blending/playroom", "nerf-synthetic/lego"];

#[cfg(unix)]
#[test]
fn cells_that_were_killed_go_on_and_the_tables_have_all_of_them() {
    let at = &folder();
    write_data(&at.join("data"));
    let run = |cell: &str| at.join("out/runs").join(cell);
    let command = [&BENCHMARK[..], &["--methods=mcmc,dpges"]].concat();
    let all = SCENES.map(|scene| ["mcmc", "dpges"].map(|method| format!("{scene}/{method}/seed_0"))).concat();
    let cells: Vec<&str> = all.iter().map(String::as_str).collect();

    // killed while a cell has a checkpoint; the processes of its cells end with it, unless they have just finished
    let is_begun =
        |cell: &&str| run(cell).join("checkpoint.safetensors").is_file() && !run(cell).join("eval.json").is_file();
    let killed = loop {
        let child = start(at, &command);
        wait_until(|| cells.iter().any(|cell| run(cell).join("row.json").is_file()));
        wait_until(|| cells.iter().any(is_begun));
        kill(child);
        std::thread::sleep(std::time::Duration::from_millis(500));
        if let Some(cell) = cells.iter().copied().find(is_begun) {
            break cell;
        }
    };
    let finished: Vec<&str> = cells.iter().copied().filter(|cell| run(cell).join("row.json").is_file()).collect();
    let logs: Vec<Vec<u8>> = finished.iter().map(|cell| bytes(run(cell).join("metrics.jsonl"))).collect();
    assert!(!finished.is_empty() && finished.len() < cells.len(), "{finished:?}");
    assert!(!at.join("out/tables.md").exists());

    let (printed, messages) = both(at, &command);
    let count = format!("8 cells, {} of them already finished", finished.len());
    assert!(messages.contains(&count), "{count}: {messages}");
    for (cell, log) in finished.iter().zip(logs) {
        assert!(bytes(run(cell).join("metrics.jsonl")) == log, "{cell} is not trained again");
    }
    let log = content(run(killed).join("log.txt"));
    assert!(log.contains("resuming after step"), "{killed} goes on: {log}");

    let study = json(at.join("out/benchmark.json"));
    let rows = study["rows"].as_array().unwrap();
    assert_eq!(rows.len(), cells.len());
    for cell in cells {
        let parts: Vec<&str> = cell.split('/').collect();
        let scene = format!("{}/{}", parts[0], parts[1]);
        let row = rows.iter().find(|row| row["scene"] == *scene && row["label"] == parts[2]).unwrap();
        assert_eq!(row["folder"], format!("runs/{cell}"));
        assert_eq!((&row["psnr"], &row["longest_px"]), (&json(run(cell).join("eval.json"))["psnr"], &16.into()));
        assert!(row["training_seconds"].as_f64().unwrap() > 0.0, "{row}");
        // so few steps leave no surface that two frames see, so that there may be no FLIP_1
        let log = content(run(cell).join("log.txt"));
        assert!(log.contains("measuring popping"), "{log}");
    }
    let read = |name: &str| content(at.join("out").join(name));
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
    let script = content(at.join("jobs/cells.sbatch"));
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
    let at = &folder();
    write_data(&at.join("data"));
    std::fs::write(at.join("data/tandt/truck/images/v3.png"), "no picture").unwrap();
    let args = [&BENCHMARK[..], &["--methods=mcmc", "--datasets=tanks-and-temples,deep-blending"]].concat();
    let message = fails(at, 1, &args);
    assert_contains(&message, &["1 of 2 cells failed", "tanks-and-temples/truck/mcmc/seed_0: ", "v3.png"]);
    let study = json(at.join("out/benchmark.json"));
    assert_eq!((study["rows"].as_array().unwrap().len(), &study["rows"][0]["label"]), (1, &"mcmc".into()));
    assert_eq!(study["not_run"], json!(["tanks-and-temples/truck/mcmc/seed_0"]));
    let other = fails(at, 1, &[&args[..], &["--steps-scale=0.01"]].concat());
    assert!(other.contains("benchmark.json holds other measurements: `steps_scale` is 0.0004, not 0.01"), "{other}");
}

#[test]
fn what_is_not_there_is_named_with_what_is() {
    let at = &folder();
    write_data(&at.join("data"));
    let refused = |more: &[&str]| fails(at, 1, &[&BENCHMARK[..], more].concat());
    let no_scene = refused(&["--scenes=bicycle"]);
    assert_contains(&no_scene, &["`bicycle` of mipnerf360 is not there", "there are garden"]);
    let no_dataset = refused(&["--data=data/tandt", "--datasets=nerf-synthetic"]);
    assert_contains(&no_dataset, &["none of the datasets nerf-synthetic", "there are truck"]);
    assert!(!at.join("out").exists());
}
