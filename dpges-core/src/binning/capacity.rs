//! Room for the (primitive, tile) pairs of a view.
//!
//! Only the device knows how many pairs there are. The kernel that writes them is launched with the room that earlier
//! launches suggest, and only then the host waits for their number, so that the device has work meanwhile. Pairs that
//! did not fit are written again.

use std::collections::HashMap;
use std::sync::{LazyLock, Mutex};

use burn::backend::TensorMetadata;
use burn::tensor::TensorData;
use burn_cubecl::tensor::CubeTensor;

use crate::capacity::{exceed, too_many_entries};
use crate::counters::transfers::{download, wait};
use crate::gpu::launch::largest_buffer;

/// Whose lists: those of surfels and of Gaussians have different lengths.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) enum ListKind {
    Surfels,
    Gaussians,
}

/// Entries that sufficed so far.
static SUFFICED: LazyLock<Mutex<HashMap<(String, ListKind), usize>>> = LazyLock::new(Mutex::default);
#[cfg(any(test, feature = "testing"))]
static CEILING: std::sync::atomic::AtomicUsize = std::sync::atomic::AtomicUsize::new(usize::MAX);

/// Initial entries for each primitive and for each tile.
const PER_PRIMITIVE: usize = 4;
const PER_TILE: usize = 64;
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

fn key(beside: &CubeTensor, kind: ListKind) -> (String, ListKind) {
    (format!("{:?}", beside.device), kind)
}

/// Most entries of a list on the device of `beside`.
fn most(beside: &CubeTensor) -> usize {
    (largest_buffer(beside) / size_of::<u32>()).min(MOST)
}

/// Entries to begin with.
fn guess(beside: &CubeTensor, kind: ListKind, primitives: usize, tiles: usize) -> usize {
    let mut sufficed = SUFFICED.lock().expect("no holder panics");
    let entries = sufficed.entry(key(beside, kind)).or_default();
    *entries = (*entries).max(PER_PRIMITIVE * primitives + PER_TILE * tiles);
    (*entries).min(ceiling()).min(most(beside)).max(1)
}

/// Calls `write` with room for some entries and, if there are more, again with room for all, and returns what the last
/// call made, and the number of entries: the last of `starts` [primitives + 1].
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
    let end = starts.handle.clone().offset_start((primitives * size_of::<u32>()) as u64);
    let length = starts.client.read_async(vec![end]);
    let room = guess(starts, kind, primitives, tiles);
    let written = write(room);
    starts.client.flush().expect("the device accepts work");
    let bytes = wait(|| cubecl::future::block_on(length)).expect("the device answers").remove(0);
    let entries = bytemuck::pod_read_unaligned::<u32>(&bytes[..size_of::<u32>()]);
    download(TensorData::new(vec![entries], [1]));
    let entries = entries as usize;
    if entries <= room {
        return (written, entries);
    }
    let most = most(starts);
    if entries > most {
        // sums that exceed 32 bits are the largest number
        exceed(too_many_entries(primitives, entries as u64, (most * size_of::<u32>()) as u64));
    }
    tracing::debug!("{entries} entries of tile lists exceeded the {room} expected, and are written again");
    SUFFICED.lock().expect("no holder panics").insert(key(starts, kind), entries + entries / 4);
    drop(written);
    (write(entries), entries)
}
