//! Cells as processes of their own, one on each device at a time.

use std::collections::VecDeque;
use std::ffi::OsString;
use std::fs::OpenOptions;
use std::process::{Command, Stdio};
use std::sync::Mutex;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::Instant;

use dpges_train::device::DeviceRequest;
use dpges_train::run::child::FOR_ANOTHER;

use super::super::{Result, StudyError};
use super::{Benchmark, LOG, Planned, Request};

/// Lines of the log of a failed cell that are repeated.
const LAST_LINES: usize = 3;

impl Benchmark {
    /// Arguments of the program for one cell on `device`.
    fn arguments(&self, planned: &Planned, device: &str) -> Vec<OsString> {
        let mut arguments = self.common_arguments();
        arguments.extend([format!("--devices={device}"), format!("--cell={}", planned.name())].map(OsString::from));
        arguments
    }

    /// Arguments of the program that all cells have in common, and the tables.
    pub(super) fn common_arguments(&self) -> Vec<OsString> {
        let mut arguments: Vec<OsString> = ["benchmark", "--data"].map(OsString::from).into();
        let Request { data, out, protocol, lpips, .. } = &self.request;
        arguments.extend([data.into(), OsString::from("--out"), out.into()]);
        let lpips = lpips.iter().map(|choice| format!("--lpips={choice}"));
        arguments.extend(protocol.arguments().into_iter().chain(lpips).map(OsString::from));
        arguments
    }

    /// Trains and measures all cells that are not done, one on each of `devices` at a time, until `interrupted`.
    ///
    /// # Errors
    /// [`StudyError::Cells`] if some failed; the others go on. [`StudyError::Interrupted`]. [`StudyError::OtherRun`] if a folder holds another run, before
    /// anything is trained.
    pub fn run(&self, devices: &[DeviceRequest], interrupted: &AtomicBool) -> Result<()> {
        let devices: Vec<String> = devices.iter().map(ToString::to_string).collect();
        self.planned.iter().try_for_each(|planned| self.cell(planned).map(drop))?;
        let queue = VecDeque::from(self.open());
        let (all, left) = (self.planned.len(), queue.len());
        tracing::info!("{all} cells, {} of them already finished, on {}", all - left, devices.join(", "));
        let program = std::env::current_exe()?;
        let (queue, failed) = (Mutex::new(queue), Mutex::new(Vec::new()));
        let next = || queue.lock().expect("no thread panics with it").pop_front();
        let work = |device: &str| {
            while let Some(planned) = next().filter(|_| !interrupted.load(Ordering::SeqCst)) {
                let mut command = Command::new(&program);
                command.args(self.arguments(planned, device));
                let result = self.work(planned, device, command);
                if let Some(reason) = result.err().filter(|_| !interrupted.load(Ordering::SeqCst)) {
                    let failure = format!("{}: {reason}", planned.name());
                    tracing::error!("{failure}");
                    failed.lock().expect("no thread panics with it").push(failure);
                }
            }
        };
        std::thread::scope(|scope| {
            devices.iter().for_each(|device| _ = scope.spawn(|| work(device)));
        });
        if interrupted.load(Ordering::SeqCst) {
            return Err(StudyError::Interrupted);
        }
        let failed = failed.into_inner().expect("no thread panics with it");
        if failed.is_empty() {
            return Ok(());
        }
        Err(StudyError::Cells { failed: failed.len(), all, reasons: failed.join("\n") })
    }

    /// Waits for `command`, which works on a cell.
    fn work(&self, planned: &Planned, device: &str, mut command: Command) -> Result<(), String> {
        let (name, start) = (planned.name(), Instant::now());
        let folder = self.folder(planned);
        let path = folder.join(LOG);
        let unusable = |error: std::io::Error| format!("{}: {error}", path.display());
        std::fs::create_dir_all(&folder).map_err(unusable)?;
        let log = OpenOptions::new().create(true).append(true).open(&path).map_err(unusable)?;
        tracing::info!("{name}: on {device}; messages are in {}", path.display());
        let again = log.try_clone().map_err(unusable)?;
        command.env(FOR_ANOTHER, "1").stdin(Stdio::piped()).stdout(again).stderr(log);
        // its standard input closes when this process ends, however that comes
        let status = command.spawn().and_then(|mut child| {
            let _held = child.stdin.take();
            child.wait()
        });
        let status = status.map_err(|error| format!("{} cannot be run: {error}", command.get_program().display()))?;
        if !status.success() {
            return Err(format!("{status}: {}", last_lines(&std::fs::read_to_string(&path).unwrap_or_default())));
        }
        let minutes = start.elapsed().as_secs_f64() / 60.0;
        let psnr = self.row(planned).and_then(|row| row.get("psnr"));
        tracing::info!("{name}: {:.2} dB after {minutes:.1} min", psnr.unwrap_or(f64::NAN));
        Ok(())
    }
}

fn last_lines(log: &str) -> String {
    let lines: Vec<&str> = log.lines().map(str::trim).filter(|line| !line.is_empty()).collect();
    lines[lines.len().saturating_sub(LAST_LINES)..].join(" ")
}

#[cfg(test)]
mod tests {
    use super::super::protocol::Protocol;
    use super::super::tests::{benchmark, data};
    use super::*;

    #[test]
    fn a_process_gets_its_cell_its_device_and_the_protocol() {
        let data = data();
        let all = benchmark(data.path(), &["mcmc"], Protocol::default());
        let arguments = all.arguments(&all.planned()[0], "wgpu:1");
        let text: Vec<&str> = arguments.iter().map(|argument| argument.to_str().unwrap()).collect();
        let (data, out) = (all.request.data.to_str().unwrap(), all.request.out.to_str().unwrap());
        let expected = [
            "benchmark",
            "--data",
            data,
            "--out",
            out,
            "--steps-scale=1",
            "--seeds=1",
            "--lpips=none",
            "--devices=wgpu:1",
            "--cell=mipnerf360/garden/mcmc/seed_0",
        ];
        assert_eq!(text, expected);
    }

    #[cfg(unix)]
    #[test]
    fn failures_say_what_the_log_ends_with() {
        let data = data();
        let all = benchmark(data.path(), &["mcmc"], Protocol::default());
        let planned = &all.planned()[0];
        let shell = |script: &str| {
            let mut command = Command::new("sh");
            command.args(["-c", script]);
            all.work(planned, "cpu", command)
        };
        let reason = shell("echo first; echo; echo 'no memory' >&2; echo help; exit 3").unwrap_err();
        assert!(reason.ends_with("3: first no memory help"), "{reason}");
        assert_eq!(shell(&format!("test -n \"${FOR_ANOTHER}\"")), Ok(()));
        let absent = all.work(planned, "cpu", Command::new("/absent")).unwrap_err();
        assert!(absent.contains("/absent cannot be run"), "{absent}");
        let log = std::fs::read_to_string(all.folder(planned).join(LOG)).unwrap();
        assert!(log.starts_with("first\n\nno memory\n"), "{log}");
    }
}
