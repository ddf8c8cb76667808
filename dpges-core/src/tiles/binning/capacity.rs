//! Room for the (primitive, tile) pairs of a view.
//!
//! Only the device knows how many pairs there are. The kernel that writes them is launched with the room that earlier
//! lists suggest. Then the host waits for their number, and what did not fit is written again; or, within
//! [`defer_readback`](crate::tiles::lists::defer_readback), it goes on with all of the room and looks at the
//! number when everything is launched.

use std::collections::HashMap;
use std::sync::{LazyLock, Mutex};

use burn::backend::TensorMetadata;
use burn::tensor::TensorData;
use burn_cubecl::tensor::CubeTensor;

use crate::backend::readback::Readback;
use crate::counters::transfers::{download, wait};
use crate::gpu::launch::largest_buffer;
use crate::tiles::capacity::{exceed, too_many_entries};
use crate::tiles::lists::{is_deferred, postpone};

/// The kind of a list: lists of surfels, discs, Gaussians and Gaussians that rays meet have different lengths.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) enum ListKind {
    Surfels,
    Discs,
    Gaussians,
    Whitened,
}

/// The lists of one kind on one device.
type Lists = (String, ListKind);

/// Entries to expect, by the lists so far.
static EXPECTED: LazyLock<Mutex<HashMap<Lists, usize>>> = LazyLock::new(Mutex::default);
#[cfg(any(test, feature = "testing"))]
static CEILING: std::sync::atomic::AtomicUsize = std::sync::atomic::AtomicUsize::new(usize::MAX);

/// Initial entries for each primitive and for each tile.
const PER_PRIMITIVE: usize = 4;
const PER_TILE: usize = 64;
/// Entries beside a quarter of those to expect that there is more room for: a quarter of a short list is little.
const SPARE: usize = 1024;
/// With every shorter list, entries to expect become fewer by one in so many: half are left after about 350 lists. Views of a
/// scene take turns, and a list without room costs more than the sort of a longer one.
const SHRINK: usize = 512;
/// Most entries on any device: kernels count them, and the units that write them, in 32 bits.
const MOST: usize = 1 << 31;

/// Caps the room of the first attempt in this process, to test lists that do not fit.
#[cfg(any(test, feature = "testing"))]
pub fn cap_lists(entries: usize) {
    CEILING.store(entries, std::sync::atomic::Ordering::Relaxed);
}

fn ceiling() -> usize {
    #[cfg(any(test, feature = "testing"))]
    return CEILING.load(std::sync::atomic::Ordering::Relaxed);
    #[cfg(not(any(test, feature = "testing")))]
    usize::MAX
}

/// Most entries of a list on the device of `beside`.
fn most(beside: &CubeTensor) -> usize {
    (largest_buffer(beside) / size_of::<u32>()).min(MOST)
}

/// Entries that there is room for at first, if so many are `expected` of so many primitives and tiles. Where nothing waits
/// for the length, all of the room is sorted, and no more is taken than is likely to be needed.
fn room(expected: Option<usize>, primitives: usize, tiles: usize, deferred: bool) -> usize {
    let initial = PER_PRIMITIVE * primitives + PER_TILE * tiles;
    match expected.map(|entries| entries + entries / 4 + SPARE) {
        Some(room) if deferred => room,
        Some(room) => room.max(initial),
        None => initial,
    }
}

/// Entries to expect after a list of `entries`, if so many were `expected` before it.
fn expected_after(expected: Option<usize>, entries: usize) -> usize {
    entries.max(expected.map_or(0, |expected| expected - expected.div_ceil(SHRINK)))
}

fn expected(lists: &Lists) -> Option<usize> {
    EXPECTED.lock().expect("no holder panics").get(lists).copied()
}

/// Takes note of a list of `entries`, for which there was `room`. Returns whether it had room.
fn observe(lists: Lists, entries: usize, room: usize) -> bool {
    let had_room = entries <= room;
    if !had_room {
        tracing::debug!("{entries} entries of tile lists exceeded the {room} expected, and are written again");
    }
    let mut expected = EXPECTED.lock().expect("no holder panics");
    let before = expected.get(&lists).copied();
    expected.insert(lists, expected_after(before, entries));
    had_room
}

/// The number of entries on its way, or the message of the device.
type Length = Readback<Result<u32, String>>;

/// Begins to read the number of entries, the last of `starts` [primitives + 1].
fn begin_readback(starts: &CubeTensor) -> Length {
    let before_last = (starts.shape()[0] - 1) * size_of::<u32>();
    let (client, end) = (starts.client.clone(), starts.handle.clone().offset_start(before_last as u64));
    Readback::begin(async move {
        let bytes = client.read_async(vec![end]).await.map_err(|error| error.to_string())?.remove(0);
        Ok(bytemuck::pod_read_unaligned(&bytes[..size_of::<u32>()]))
    })
}

/// Reads a length, counted as a download.
fn downloaded(length: Length) -> usize {
    let entries = length.arrived().expect("the device answers");
    download(TensorData::new(vec![entries], [1]));
    entries as usize
}

/// Calls `write` with room for some entries and, if there are more, again with room for all, and returns what the last
/// call made, and the number of entries: the last of `starts` [primitives + 1].
///
/// Within [`defer_readback`](crate::tiles::lists::defer_readback) it calls `write` once and returns the room in
/// place of the number; `write` has to fill what is left of it with entries of no tile.
///
/// [Exceeds](exceed) the capacity if a list of all entries is larger than the largest buffer of the device, or has more
/// than 2³¹.
pub(crate) fn with_room<T>(
    starts: &CubeTensor,
    kind: ListKind,
    tiles: usize,
    mut write: impl FnMut(usize) -> T,
) -> (T, usize) {
    let primitives = starts.shape()[0] - 1;
    let lists: Lists = (format!("{:?}", starts.device), kind);
    // asked for before the list is launched, so that the answer does not wait for the list as well
    let length = begin_readback(starts);
    let (most, deferred) = (most(starts), is_deferred());
    let room = room(expected(&lists), primitives, tiles, deferred).min(ceiling()).min(most).max(1);
    let written = write(room);
    if deferred {
        postpone(move || {
            let entries = downloaded(length);
            // what no buffer holds is refused when it is tried again
            entries <= most && observe(lists, entries, room)
        });
        return (written, room);
    }
    // the device writes the list while the host waits for its length
    starts.client.flush().expect("the device accepts work");
    let entries = wait(|| downloaded(length));
    if entries > most {
        // sums that exceed 32 bits are the largest number
        exceed(too_many_entries(primitives, entries as u64, (most * size_of::<u32>()) as u64));
    }
    if observe(lists, entries, room) {
        return (written, entries);
    }
    // the short list is free before the long one is allocated
    drop(written);
    (write(entries), entries)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn room_is_close_to_what_lists_needed_so_far() {
        assert_eq!(room(None, 100, 10, true), 1040);
        assert_eq!(room(Some(8000), 100_000, 10, true), 11_024);
        assert_eq!(room(Some(0), 100, 10, true), SPARE);
        // what is not sorted may be as much as at first
        assert_eq!(room(Some(8000), 100_000, 10, false), 400_640);
        assert_eq!(room(Some(8000), 100, 10, false), 11_024);
    }

    #[test]
    fn longer_lists_are_expected_at_once_and_shorter_ones_after_a_while() {
        assert_eq!(expected_after(None, 0), 0);
        assert_eq!(expected_after(None, 70), 70);
        assert_eq!(expected_after(Some(70), 900), 900);
        assert_eq!(expected_after(Some(900), 70), 898);
        let after = |lists: usize| (0..lists).fold(100_000, |expected, _| expected_after(Some(expected), 70));
        assert!((50_000..52_000).contains(&after(350)), "{}", after(350));
        // a view of the longest lists among 100 still has room
        assert!(room(Some(after(100)), 0, 0, true) > 100_000);
        assert_eq!(after(100_000), 70);
    }

    #[test]
    fn a_list_that_did_not_fit_is_expected_from_then_on() {
        let lists = ("a device of this test".to_owned(), ListKind::Discs);
        assert!(observe(lists.clone(), 40, 40));
        assert!(!observe(lists.clone(), 5000, 41));
        assert_eq!(expected(&lists), Some(5000));
        assert!(room(expected(&lists), 0, 0, true) > 5000);
    }
}
