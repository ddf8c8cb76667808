//! Capacity of the tile lists of a device: a bound that grows.
//!
//! Only the device knows the length of all lists, and waiting for it would stall the queue. Buffers are
//! therefore allocated from a bound, and the length is read back in the background. The result is correct
//! even if a list does not fit: the kernel then visits all primitives. The bound rises before the next launch.

use std::collections::HashMap;
use std::future::Future;
use std::pin::Pin;
use std::sync::{LazyLock, Mutex};
use std::task::{Context, Poll, Waker};

use burn_cubecl::tensor::CubeTensor;

type Length = Pin<Box<dyn Future<Output = Option<usize>> + Send>>;

/// Whose lists: those of surfels and of Gaussians have different lengths.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) enum ListKind {
    Surfels,
    Gaussians,
}

#[derive(Default)]
struct Bound {
    entries: usize,
    /// The length of an earlier launch, and its capacity.
    pending: Option<(Length, usize)>,
}

static BOUNDS: LazyLock<Mutex<HashMap<(String, ListKind), Bound>>> = LazyLock::new(Mutex::default);
#[cfg(any(test, feature = "testing"))]
static CEILING: std::sync::atomic::AtomicUsize = std::sync::atomic::AtomicUsize::new(usize::MAX);

/// Initial entries for each primitive and for each tile.
const PER_PRIMITIVE: usize = 4;
const PER_TILE: usize = 64;

/// Caps the capacity in this process, to test lists that overflow.
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

/// Entries to allocate.
pub(crate) fn entries(beside: &CubeTensor, kind: ListKind, primitives: usize, tiles: usize) -> usize {
    let mut bounds = BOUNDS.lock().expect("no holder panics");
    let bound = bounds.entry(key(beside, kind)).or_default();
    bound.collect();
    bound.entries = bound.entries.max(PER_PRIMITIVE * primitives + PER_TILE * tiles);
    let largest = beside.client.properties().memory.max_page_size as usize / size_of::<u32>();
    bound.entries.min(ceiling()).min(largest).max(1)
}

/// Learns, as soon as it can be read, the `length` [1] of lists that had `capacity`.
pub(crate) fn observe(length: &CubeTensor, kind: ListKind, capacity: usize) {
    let mut bounds = BOUNDS.lock().expect("no holder panics");
    let bound = bounds.entry(key(length, kind)).or_default();
    if bound.pending.is_some() {
        return;
    }
    let (client, handle) = (length.client.clone(), length.handle.clone());
    let mut length: Length = Box::pin(async move {
        let bytes = client.read_async(vec![handle]).await.ok()?.pop()?;
        Some(bytemuck::pod_read_unaligned::<u32>(bytes.get(..4)?) as usize)
    });
    // a future starts when it is first polled
    match poll(&mut length) {
        Poll::Ready(length) => bound.learn(length, capacity),
        Poll::Pending => bound.pending = Some((length, capacity)),
    }
}

fn poll(length: &mut Length) -> Poll<Option<usize>> {
    length.as_mut().poll(&mut Context::from_waker(Waker::noop()))
}

impl Bound {
    /// Raises the bound if the length of an earlier launch has arrived.
    fn collect(&mut self) {
        let Some((length, capacity)) = &mut self.pending else { return };
        if let Poll::Ready(length) = poll(length) {
            let capacity = *capacity;
            self.learn(length, capacity);
            self.pending = None;
        }
    }

    fn learn(&mut self, length: Option<usize>, capacity: usize) {
        let Some(length) = length else { return };
        if length > capacity {
            tracing::warn!(
                "{length} entries of tile lists exceeded a capacity of {capacity}: \
                 this image took longer to render, and the capacity grows for the next"
            );
        }
        self.entries = self.entries.max(length + length / 4);
    }
}
