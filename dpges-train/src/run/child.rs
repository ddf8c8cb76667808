//! A process that works for another one.

use std::io::Read;

/// Variable that is set for a process that ends with the one that started it, which holds the other end of its input.
pub const FOR_ANOTHER: &str = "DPGES_FOR_ANOTHER";

/// Ends this process as soon as the one that it works for has ended, if there is one: a run is trained by one process at a time.
pub fn end_with_the_other() {
    if std::env::var_os(FOR_ANOTHER).is_some() {
        std::thread::spawn(|| {
            let mut rest = Vec::new();
            let _ = std::io::stdin().read_to_end(&mut rest);
            std::process::exit(1);
        });
    }
}
