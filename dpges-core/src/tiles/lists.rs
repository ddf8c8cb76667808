//! Tile lists whose lengths nothing waits for.
//!
//! Only a GPU knows how many (primitive, tile) pairs a view has. Elsewhere the host waits for their number, so that buffers are
//! as long as the lists; the GPU has nothing to do until the host goes on. Within [`defer_readback`] buffers have the
//! room that earlier lists suggest, and the lengths are looked at last.

use std::cell::RefCell;

/// Waits for the length of a list, and says whether the list had room.
type Pending = Box<dyn FnOnce() -> bool>;

thread_local! {
    /// Postponed reads of this thread; `None` where the host waits for every length.
    static PENDING: RefCell<Option<Vec<Pending>>> = const { RefCell::new(None) };
}

/// Lengths are postponed as long as it lives; then as before.
struct Scope(Option<Vec<Pending>>);

impl Drop for Scope {
    fn drop(&mut self) {
        PENDING.set(self.0.take());
    }
}

/// Returns what `work` returns, which launches operations or a backward pass on this thread, and waits for the lengths of
/// their tile lists only when it has launched all of them. A list without room lacks entries: then what `work` has returned
/// is dropped and it is called again, and this time every length is waited for. Either way the result is, to the bit, the
/// one it would have had outside.
///
/// `work` may thus be called twice, and must be idempotent: the second call must not see the first one. On a CPU it is
/// called once: lists in host memory always have room.
pub fn defer_readback<T>(mut work: impl FnMut() -> T) -> T {
    let scope = Scope(PENDING.replace(Some(Vec::new())));
    let result = work();
    let postponed = PENDING.take().unwrap_or_default();
    drop(scope);
    // all are asked, since each says how much room the next list of its kind needs
    let without_room = postponed.into_iter().map(|pending| pending()).filter(|had_room| !had_room).count();
    if without_room == 0 {
        return result;
    }
    drop(result);
    work()
}

/// Whether lengths are to be [postponed](postpone) on this thread.
#[cfg(any(test, feature = "gpu"))]
pub(crate) fn is_deferred() -> bool {
    PENDING.with_borrow(Option::is_some)
}

/// Has [`defer_readback`] call `pending` when everything is launched. It waits for the length of a list, and returns
/// whether the list had room.
#[cfg(any(test, feature = "gpu"))]
pub(crate) fn postpone(pending: impl FnOnce() -> bool + 'static) {
    PENDING.with_borrow_mut(|all| {
        all.as_mut().expect("lengths are postponed within `defer_readback`").push(Box::new(pending))
    });
}

#[cfg(test)]
mod tests {
    use std::cell::Cell;
    use std::panic::{AssertUnwindSafe, catch_unwind};
    use std::rc::Rc;

    use super::*;

    /// Work with a list for each of `rooms`, which says how often lengths were waited for and whether it was deferred.
    fn work(rooms: &[bool], asked: &Rc<Cell<usize>>) -> bool {
        let deferred = is_deferred();
        for &had_room in rooms.iter().filter(|_| deferred) {
            let asked = asked.clone();
            postpone(move || {
                asked.set(asked.get() + 1);
                had_room
            });
        }
        deferred
    }

    #[test]
    fn work_is_done_again_and_waits_if_a_list_had_no_room() {
        let cases: [(&[bool], usize); 4] = [(&[], 1), (&[true, true], 1), (&[false, true], 2), (&[true, false], 2)];
        for (rooms, calls) in cases {
            let (asked, mut found) = (Rc::default(), Vec::new());
            defer_readback(|| found.push(work(rooms, &asked)));
            assert_eq!(found, [true, false][..calls], "{rooms:?}");
            assert_eq!(asked.get(), rooms.len(), "{rooms:?}");
            assert!(!is_deferred());
        }
    }

    #[test]
    fn what_the_first_call_made_is_gone_before_the_second() {
        let alive = Rc::new(());
        let counts = Rc::new(RefCell::new(Vec::new()));
        let kept = defer_readback(|| {
            counts.borrow_mut().push(Rc::strong_count(&alive));
            work(&[false], &Rc::default());
            alive.clone()
        });
        assert_eq!((counts.borrow().as_slice(), Rc::strong_count(&kept)), (&[1, 1][..], 2));
    }

    #[test]
    fn each_settles_its_own() {
        let [outer, inner] = [Rc::default(), Rc::default()];
        let mut calls = [0, 0];
        defer_readback(|| {
            calls[0] += 1;
            work(&[true], &outer);
            defer_readback(|| {
                calls[1] += 1;
                work(&[calls[1] == 2], &inner);
            });
            assert_eq!((outer.get(), is_deferred()), (0, true));
        });
        // the second call of the inner work is deferred in the outer one
        assert_eq!((calls, outer.get(), inner.get()), ([1, 2], 1, 2));
    }

    #[test]
    fn a_panic_ends_it() {
        let asked = Rc::default();
        let panicked = catch_unwind(AssertUnwindSafe(|| {
            defer_readback(|| {
                work(&[true], &asked);
                panic!("{}", "some work");
            });
        }));
        assert!(panicked.is_err() && !is_deferred());
        assert_eq!(asked.get(), 0);
    }
}
