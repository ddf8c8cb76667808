//! `mpirun dpges train`, with the feature `mpi`: several processes on this machine.

use std::path::Path;
use std::process::{Child, Command, Output, Stdio};
use std::time::{Duration, Instant};

const TINY: [&str; 9] = [
    "--device=cpu",
    "--max-resolution=32",
    "--steps=60",
    "--set=init.max_points=400",
    "--set=train.evaluate_every=0",
    "--set=train.checkpoint_every=10",
    "--set=train.exposure=on",
    "--budget=1500",
    "--seed=3",
];

/// `dpges` as `count` ranks in `folder`.
fn ranks(folder: &Path, count: usize, args: &[&str]) -> Command {
    let mut command = Command::new("mpirun");
    command.args(["--allow-run-as-root", "--oversubscribe", "--mca", "btl", "self,vader", "-n", &count.to_string()]);
    command.arg(env!("CARGO_BIN_EXE_dpges")).args(args).current_dir(folder);
    command
}

fn train(folder: &Path, count: usize, args: &[&str]) -> Output {
    let output = ranks(folder, count, &[&["train"], args].concat()).output().expect("Open MPI has mpirun");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    output
}

fn begin(folder: &Path, count: usize, args: &[&str]) -> Child {
    let mut command = ranks(folder, count, &[&["train"], args].concat());
    command.stdout(Stdio::null()).stderr(Stdio::piped()).spawn().expect("Open MPI has mpirun")
}

fn psnr(run: &Path) -> f64 {
    let report: serde_json::Value = serde_json::from_slice(&std::fs::read(run.join("eval.json")).unwrap()).unwrap();
    report["psnr"].as_f64().unwrap()
}

/// The process that is rank number `rank` of `job`.
fn process_of(job: &Child, rank: usize) -> Option<u32> {
    let wanted = format!("OMPI_COMM_WORLD_RANK={rank}");
    let parent = format!("PPid:\t{}\n", job.id());
    let processes = std::fs::read_dir("/proc").ok()?.flatten();
    let mut ids = processes.filter_map(|process| process.file_name().to_str()?.parse::<u32>().ok());
    ids.find(|id| {
        let read = |file: &str| std::fs::read(format!("/proc/{id}/{file}")).unwrap_or_default();
        String::from_utf8_lossy(&read("status")).contains(&parent)
            && read("environ").split(|&byte| byte == 0).any(|variable| variable == wanted.as_bytes())
    })
}

#[test]
fn ranks_train_one_scene_and_give_the_same_bytes_again() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    for (run, count) in [("one", 1), ("two", 2), ("again", 2)] {
        let output = train(at, count, &[&["--out", run], &TINY[..]].concat());
        let said = String::from_utf8(output.stdout).unwrap();
        assert_eq!(said.matches("held-out PSNR").count(), 1, "{said}");
    }
    let scene = |run: &str| std::fs::read(at.join(run).join("scene.safetensors")).unwrap();
    assert!(scene("two") == scene("again"));
    let [one, two] = ["one", "two"].map(|run| psnr(&at.join(run)));
    assert!((one - two).abs() < 0.5, "{one} dB by one, {two} dB by two");
}

#[test]
fn a_rank_that_is_killed_ends_the_job_and_any_number_goes_on() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    for (killed, resumed) in [(1, 3), (0, 1)] {
        let run = format!("killed_{killed}");
        let longer = [&["--out", run.as_str()], &TINY[..], &["--steps=2000"]].concat();
        let mut job = begin(at, 2, &longer);
        let start = Instant::now();
        while !at.join(&run).join("checkpoint.json").is_file() {
            assert!(start.elapsed() < Duration::from_secs(120), "there is no checkpoint");
            std::thread::sleep(Duration::from_millis(20));
        }
        let process = process_of(&job, killed).expect("it is running");
        assert!(Command::new("kill").args(["-9", &process.to_string()]).status().unwrap().success());
        assert!(!job.wait().unwrap().success());
        let mut said = String::new();
        std::io::Read::read_to_string(&mut job.stderr.take().unwrap(), &mut said).unwrap();
        assert!(said.contains(&format!("process rank {killed}")) && said.contains("signal 9"), "{said}");
        let mut job = begin(at, resumed, &["--out", &run, "--resume"]);
        let files = |count: usize| {
            let names = std::fs::read_dir(at.join(&run)).unwrap().map(|entry| entry.unwrap().file_name());
            let part = format!("_of_{count}.safetensors");
            let single = at.join(&run).join("checkpoint.safetensors").is_file();
            if count == 1 { single } else { names.into_iter().any(|name| name.to_string_lossy().ends_with(&part)) }
        };
        let start = Instant::now();
        while !files(resumed) {
            assert!(start.elapsed() < Duration::from_secs(120), "{resumed} ranks save nothing");
            std::thread::sleep(Duration::from_millis(20));
        }
        job.kill().unwrap();
        job.wait().unwrap();
    }
}

#[test]
fn a_rank_that_fails_says_which_it_is() {
    let folder = tempfile::tempdir().unwrap();
    let job = begin(folder.path(), 2, &["--target", "5min"]);
    let output = job.wait_with_output().unwrap();
    let said = String::from_utf8(output.stderr).unwrap();
    assert!(!output.status.success() && said.contains("of 2: --target is for one process alone"), "{said}");
}
