//! `auto` decided in a child process, so that a driver that hangs or crashes does no harm.

use std::io::{BufRead, BufReader};
use std::process::{Command, Stdio};
use std::sync::mpsc::channel;
use std::time::Duration;

use super::{DeviceError, Selection, choice};

/// Longest time to look for a GPU: to find the adapters and to check one, with another 10 s for a second one.
const LIMIT: Duration = Duration::from_secs(25);

/// The [`Selection`] that this program prints as JSON in another process when it is started with `arguments`; the CPU if it
/// prints none in time.
///
/// # Errors
/// [`DeviceError::NoCpu`] if the build has no CPU backend either.
pub fn select_in_child(arguments: &[&str]) -> Result<Selection, DeviceError> {
    in_child(arguments).or_else(choice::cpu)
}

fn in_child(arguments: &[&str]) -> Result<Selection, String> {
    let not_started = |error: std::io::Error| format!("the check of GPUs could not be started: {error}");
    let mut child = Command::new(std::env::current_exe().map_err(not_started)?)
        .args(arguments)
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
