//! Which device a command runs on, and the line that says so.

use std::io::{BufRead, BufReader};
use std::process::{Command, Stdio};
use std::sync::mpsc::channel;
use std::time::Duration;

use dpges_train::device::{DeviceName, DeviceRequest, Selection, auto};

use super::{Failure, Result};

/// Longest time to look for a GPU: to find the adapters and to check one, with another 10 s for a second one.
const LIMIT: Duration = Duration::from_secs(25);

/// The device that is asked for; says which and why.
pub fn select(request: DeviceRequest) -> Result<DeviceName> {
    match request {
        DeviceRequest::Auto => {
            let Selection { device, reason } = automatic()?;
            tracing::info!("device: {device}, since {reason}");
            Ok(device)
        }
        DeviceRequest::Named(device) => {
            let description = device.describe()?;
            tracing::info!("device: {device} ({description}), as --device says");
            Ok(device)
        }
    }
}

/// As [`select`] for a run that goes on: the device it was started on, unless another one is asked for.
pub fn select_again(request: Option<DeviceRequest>, started_on: &str) -> Result<DeviceName> {
    if let Some(request) = request {
        return select(request);
    }
    let device: DeviceName = started_on.parse().map_err(Failure::Usage)?;
    let description = device.describe()?;
    tracing::info!("device: {device} ({description}), as before");
    Ok(device)
}

/// What `auto` stands for. Drivers are tried in a child process, so that one that hangs or crashes does no harm.
pub fn automatic() -> Result<Selection> {
    match in_child() {
        Ok(selection) => Ok(selection),
        Err(problem) => Ok(auto::cpu(problem)?),
    }
}

fn in_child() -> Result<Selection, String> {
    let not_started = |error: std::io::Error| format!("the check of GPUs could not be started: {error}");
    let mut child = Command::new(std::env::current_exe().map_err(not_started)?)
        .args(["devices", "--auto", "--json"])
        .stdin(Stdio::null())
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .map_err(not_started)?;
    let (sender, receiver) = channel();
    let output = child.stdout.take().expect("it is piped");
    std::thread::spawn(move || {
        let mut line = String::new();
        let read = BufReader::new(output).read_line(&mut line);
        // Fails if nobody waits any more.
        let _ = sender.send(read.map(|_| line));
    });
    let answer = receiver.recv_timeout(LIMIT);
    if matches!(&answer, Ok(Ok(line)) if line.is_empty()) {
        let status = child.wait().map_err(not_started)?;
        return Err(format!("the check of GPUs ended with {status}"));
    }
    let _ = child.kill();
    // On a thread of its own: a process that hangs in a driver may not end.
    std::thread::spawn(move || child.wait());
    match answer {
        Ok(Ok(line)) => {
            serde_json::from_str(&line).map_err(|error| format!("the check of GPUs is unreadable: {error}"))
        }
        Ok(Err(error)) => Err(format!("the check of GPUs is unreadable: {error}")),
        Err(_) => Err(format!("looking for a GPU took longer than {} s", LIMIT.as_secs())),
    }
}
