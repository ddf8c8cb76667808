//! Signals that ask a run to stop.

use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// True from the first Ctrl-C, SIGTERM or SIGHUP on; the second ends the process. A SIGHUP that whoever started the program has
/// it ignore, as `nohup` does, stays ignored. Call it once in a process.
///
/// # Errors
/// If signals are watched already.
pub fn watch() -> Result<Arc<AtomicBool>, ctrlc::Error> {
    let interrupted = Arc::new(AtomicBool::new(false));
    let flag = Arc::clone(&interrupted);
    #[cfg(unix)]
    let hangs_up = !is_ignored(libc::SIGHUP);
    ctrlc::set_handler(move || {
        if flag.swap(true, Ordering::SeqCst) {
            std::process::exit(1);
        }
        tracing::warn!("finishing this step and saving; Ctrl-C again aborts at once");
    })?;
    #[cfg(unix)]
    if !hangs_up {
        // SAFETY: no function is called by the signal
        unsafe { libc::signal(libc::SIGHUP, libc::SIG_IGN) };
    }
    Ok(interrupted)
}

#[cfg(unix)]
fn is_ignored(signal: libc::c_int) -> bool {
    // SAFETY: it is only asked, into a structure of numbers
    unsafe {
        let mut current: libc::sigaction = std::mem::zeroed();
        libc::sigaction(signal, std::ptr::null(), &mut current) == 0 && current.sa_sigaction == libc::SIG_IGN
    }
}
