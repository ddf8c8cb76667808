//! How long the tile lists of a device may become: an upper bound that grows.
//!
//! The length of all lists together is known only on the device. Waiting for it would stall the
//! queue, so buffers are made from a bound, and the true length is read back in the background. A
//! tile whose list does not fit is still right: its kernel then goes over all primitives. The bound
//! is raised before the next launch.

use std::collections::HashMap;
use std::future::Future;
use std::pin::Pin;
use std::sync::{LazyLock, Mutex};
use std::task::{Context, Poll, Waker};

use burn_cubecl::tensor::CubeTensor;

type Length = Pin<Box<dyn Future<Output = Option<usize>> + Send>>;

/// Which lists: of surfels and of Gaussians differ in length.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(crate) enum ListKind {
    Surfels,
    Gaussians,
}

#[derive(Default)]
struct Bound {
    entries: usize,
    /// Of the last launch, with the capacity it had.
    pending: Option<(Length, usize)>,
}

static BOUNDS: LazyLock<Mutex<HashMap<(String, ListKind), Bound>>> = LazyLock::new(Mutex::default);
#[cfg(any(test, feature = "testing"))]
static CEILING: std::sync::atomic::AtomicUsize = std::sync::atomic::AtomicUsize::new(usize::MAX);

/// Entries of a list at first, for each primitive and for each tile.
const PER_PRIMITIVE: usize = 4;
const PER_TILE: usize = 64;

/// Caps every list from now on, to test what happens when they overflow.
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

/// Entries to make room for.
pub(crate) fn entries(beside: &CubeTensor, kind: ListKind, primitives: usize, tiles: usize) -> usize {
    let mut bounds = BOUNDS.lock().expect("no holder panics");
    let bound = bounds.entry(key(beside, kind)).or_default();
    bound.collect();
    bound.entries = bound.entries.max(PER_PRIMITIVE * primitives + PER_TILE * tiles);
    let largest = beside.client.properties().memory.max_page_size as usize / size_of::<u32>();
    bound.entries.min(ceiling()).min(largest).max(1)
}

/// Takes note of the length [1] that lists made with `capacity` turned out to need.
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
    // a future begins when it is first polled
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
                "tile lists of {length} entries did not fit the {capacity} there was room for: \
                 that picture took longer, and the next will have room"
            );
        }
        self.entries = self.entries.max(length + length / 4);
    }
}
