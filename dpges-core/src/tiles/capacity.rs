//! Errors for buffers that are too small: they are typed, although Burn's interface for operations has no place for
//! errors.

use std::cell::Cell;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};

use crate::error::{Error, Result};

thread_local! {
    static IS_WITHIN: Cell<bool> = const { Cell::new(false) };
}

/// Returns what `work` returns, which launches operations or a backward pass. The functions of [`ops`](crate::ops) and
/// [`render`](mod@crate::render) return the same error by themselves; a backward pass, which Burn runs, cannot:
/// `within_capacity(|| loss.backward())`.
///
/// Nothing is printed and the device goes on to work. Where panics end the program (`panic = "abort"`), so does this.
///
/// # Errors
/// [`Error::Capacity`] if something that `work` needs is larger than a buffer of the device, or has more entries than its
/// kernels can count.
pub fn within_capacity<T>(work: impl FnOnce() -> T) -> Result<T> {
    let before = IS_WITHIN.replace(true);
    let result = catch_unwind(AssertUnwindSafe(work));
    // restored, not cleared: calls may be nested
    IS_WITHIN.set(before);
    result.map_err(|payload| payload.downcast::<Error>().map_or_else(|other| resume_unwind(other), |error| *error))
}

/// Ends the work that [`within_capacity`] does on this thread.
///
/// # Panics
/// With the message of `error` if it does none.
pub(crate) fn exceed(error: Error) -> ! {
    // `resume_unwind` calls no panic hook, which would print a message for an error that the caller handles
    if cfg!(panic = "unwind") && IS_WITHIN.get() {
        resume_unwind(Box::new(error));
    }
    panic!("{error}")
}

/// The error of tile lists with too many entries: of `primitives` primitives, with `entries` entries of 32 bits or, if the
/// number of entries has reached the largest that can be counted, more.
pub(crate) fn too_many_entries(primitives: usize, entries: u64, largest: u64) -> Error {
    let or_more = if entries == u64::from(u32::MAX) { " or more" } else { "" };
    let what = format!("the list of the {entries}{or_more} tiles that the {primitives} primitives of this view touch");
    Error::Capacity { what, needed: entries * size_of::<u32>() as u64, largest }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fail() {
        exceed(too_many_entries(7, 100, 40))
    }

    fn message(work: impl FnOnce()) -> String {
        *catch_unwind(AssertUnwindSafe(work)).unwrap_err().downcast::<String>().expect("a message")
    }

    #[test]
    fn what_is_too_large_is_an_error_within_and_a_message_outside() {
        let expected = "the list of the 100 tiles that the 7 primitives of this view touch takes 400 bytes, and a buffer \
                        has at most 40: render smaller images or fewer primitives";
        let found = within_capacity(fail).unwrap_err();
        assert!(matches!(found, Error::Capacity { needed: 400, largest: 40, .. }), "{found:?}");
        assert_eq!(found.to_string(), expected);
        assert_eq!(message(fail), expected);
        assert_eq!(within_capacity(|| 3).unwrap(), 3);
    }

    #[test]
    fn the_innermost_returns_it_and_other_panics_go_on() {
        let nested = within_capacity(|| (within_capacity(fail).is_err(), within_capacity(|| 1).unwrap()));
        assert_eq!(nested.unwrap(), (true, 1));
        // what comes after an inner one is still within the outer
        assert!(within_capacity(|| (within_capacity(|| ()).unwrap(), fail())).is_err());
        assert_eq!(message(|| drop(within_capacity(|| panic!("{}", "other")))), "other");
    }

    #[test]
    fn sums_that_may_have_been_larger_say_so() {
        let error = too_many_entries(2, u64::from(u32::MAX), 1 << 33);
        assert!(error.to_string().contains("4294967295 or more tiles"), "{error}");
    }
}
