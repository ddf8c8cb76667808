//! The allocator of the program, and its end where memory is short: nothing can go on without.

use std::alloc::{GlobalAlloc, Layout};
use std::fmt::Display;
use std::io::Write;

use mimalloc::MiMalloc;

/// Words of the system for too little memory, in panics of libraries that could not start a thread or map a file.
const SHORT: [&str; 4] =
    ["Resource temporarily unavailable", "Cannot allocate memory", "memory allocation", "failed to spawn thread"];

/// A training step allocates and frees images of tens of megabytes; the system's allocator returns each to the kernel,
/// which costs a quarter of the step in page faults and interrupts between cores.
pub struct Allocator;

// SAFETY: MiMalloc does it all; what it cannot do ends the program
unsafe impl GlobalAlloc for Allocator {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        there(unsafe { MiMalloc.alloc(layout) }, layout.size())
    }

    unsafe fn alloc_zeroed(&self, layout: Layout) -> *mut u8 {
        there(unsafe { MiMalloc.alloc_zeroed(layout) }, layout.size())
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        unsafe { MiMalloc.dealloc(pointer, layout) }
    }

    unsafe fn realloc(&self, pointer: *mut u8, layout: Layout, size: usize) -> *mut u8 {
        there(unsafe { MiMalloc.realloc(pointer, layout, size) }, size)
    }
}

fn there(pointer: *mut u8, bytes: usize) -> *mut u8 {
    if pointer.is_null() {
        end(format_args!("{bytes} bytes more could not be had"));
    }
    pointer
}

/// Says so without taking memory.
fn end(reason: impl Display) -> ! {
    let _ = writeln!(
        std::io::stderr(),
        "  × there is too little memory: {reason}\n  help: smaller pictures (--max-resolution, --size of pictures to draw), fewer primitives (--budget) and less \
         room for photographs (--set data.memory=100MB) need less; a run goes on from its last checkpoint with --resume"
    );
    #[cfg(unix)]
    // SAFETY: nothing of this program comes after it
    unsafe {
        libc::_exit(1)
    }
    #[cfg(not(unix))]
    std::process::exit(1)
}

/// Makes panics for want of memory end as what they are.
pub fn explain_failures() {
    let other = std::panic::take_hook();
    std::panic::set_hook(Box::new(move |panic| {
        let text = panic.payload_as_str().unwrap_or_default();
        if SHORT.iter().any(|words| text.contains(words)) {
            end(text);
        }
        other(panic);
    }));
}
