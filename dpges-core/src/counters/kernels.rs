//! Launches of kernels, dpges' own and Burn's, their times and the memory of their device.
//!
//! CubeCL tells one observer of the process about every launch. So only one of these functions can work at a time, and
//! what other threads launch meanwhile counts, too.

use std::collections::BTreeMap;
use std::sync::atomic::{AtomicU64, Ordering};
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use burn::backend::DispatchDevice;
use burn::tensor::{Device, read_sync};
use cubecl::client::Client;
use cubecl::logging::{Duration, LaunchObservation, LaunchObserver, ProfileDuration, TimingMethod, TimingRequest};
use cubecl::{MemoryScope, MemoryUsage};

use super::{DeviceMemory, KernelTime, Launches};

/// Calls `work` and counts what it launches.
pub fn count_launches<T>(work: impl FnOnce() -> T) -> (T, Launches) {
    let counter = Arc::new(Counter::default());
    let result = observed(counter.clone(), work);
    let mut launches = Launches::new();
    for (&kernel, &count) in lock(&counter.0).iter() {
        *launches.entry(kernel_name(kernel)).or_default() += count;
    }
    (result, launches)
}

/// Calls `work` and measures what it launches, the longest first; `None` where the adapter has no timestamps, or none came.
/// Every kernel is handed to the device by itself, so that the work takes longer than it would; the kernels do not.
pub fn time_kernels<T>(work: impl FnOnce() -> T) -> (T, Option<Vec<KernelTime>>) {
    let timer = Arc::new(Timer::default());
    let result = observed(timer.clone(), work);
    let mut times: BTreeMap<String, (usize, f64)> = BTreeMap::new();
    for (kernel, measured) in std::mem::take(&mut *lock(&timer.0)) {
        let duration = match measured {
            Measured::NotYet(profile) if profile.timing_method() == TimingMethod::Device => {
                read_sync(profile.resolve()).map(|ticks| ticks.duration())
            }
            Measured::Is(duration, TimingMethod::Device) => Some(duration),
            Measured::NotYet(_) | Measured::Is(_, TimingMethod::System) => return (result, None),
        };
        if let Some(duration) = duration {
            let (launches, milliseconds) = times.entry(kernel_name(kernel)).or_default();
            *launches += 1;
            *milliseconds += 1e3 * duration.as_secs_f64();
        }
    }
    let named = |(kernel, (launches, milliseconds))| KernelTime { kernel, launches, milliseconds };
    let mut times: Vec<KernelTime> = times.into_iter().map(named).collect();
    times.sort_by(|a, b| b.milliseconds.total_cmp(&a.milliseconds));
    (result, (!times.is_empty()).then_some(times))
}

/// Calls `work` and looks at the memory of `device` before each of its launches, which slows it down; `None` if `device`
/// is no GPU.
pub fn watch_memory<T>(device: &Device, work: impl FnOnce() -> T) -> (T, Option<DeviceMemory>) {
    let Some(client) = client(device) else { return (work(), None) };
    let alive_bytes = usage(&client).bytes_in_use;
    let gauge = Arc::new(Gauge { client, peak: AtomicU64::new(alive_bytes) });
    let result = observed(gauge.clone(), work);
    let (peak_bytes, reserved_bytes) = (gauge.peak.load(Ordering::Relaxed), usage(&gauge.client).bytes_reserved);
    (result, Some(DeviceMemory { alive_bytes, peak_bytes, reserved_bytes }))
}

/// The module and name of a kernel from the name of its type: `ops::splat::cube::splat_kernel::SplatKernel<…>` of a crate
/// becomes `crate::splat::splat_kernel`.
pub fn kernel_name(type_name: &str) -> String {
    let path = type_name.split('<').next().unwrap_or(type_name);
    let mut parts: Vec<&str> = path.split("::").collect();
    if parts.len() > 1 {
        // the type, which is named after the function
        parts.pop();
    }
    parts.retain(|part| !["ops", "cube", "kernel"].contains(part));
    parts.dedup();
    parts.join("::")
}

#[derive(Default)]
struct Counter(Mutex<BTreeMap<&'static str, usize>>);

impl LaunchObserver for Counter {
    fn launched(&self, kernel: &'static str) {
        *lock(&self.0).entry(kernel).or_default() += 1;
    }
}

enum Measured {
    /// Read after all work, so that nothing waits meanwhile.
    NotYet(ProfileDuration),
    Is(Duration, TimingMethod),
}

#[derive(Default)]
struct Timer(Mutex<Vec<(&'static str, Measured)>>);

impl LaunchObserver for Timer {
    fn launched(&self, _: &'static str) {}

    fn timing(&self) -> TimingRequest {
        TimingRequest::Deferred
    }

    fn profiled(&self, kernel: &'static str, profile: ProfileDuration) {
        lock(&self.0).push((kernel, Measured::NotYet(profile)));
    }

    /// Where the logger of CubeCL is on, which reads the measurements itself.
    fn timed(&self, kernel: &'static str, duration: Duration, method: TimingMethod) {
        lock(&self.0).push((kernel, Measured::Is(duration, method)));
    }
}

struct Gauge {
    client: Client,
    peak: AtomicU64,
}

impl LaunchObserver for Gauge {
    fn launched(&self, _: &'static str) {
        self.peak.fetch_max(usage(&self.client).bytes_in_use, Ordering::Relaxed);
    }
}

fn observed<T>(observer: Arc<dyn LaunchObserver>, work: impl FnOnce() -> T) -> T {
    let _observation = LaunchObservation::new(observer);
    work()
}

fn usage(client: &Client) -> MemoryUsage {
    client.memory_report(MemoryScope::Device).usage()
}

fn client(device: &Device) -> Option<Client> {
    match device.as_dispatch().clone().inner() {
        DispatchDevice::Cube(device) => Some(device.client()),
        _ => None,
    }
}

fn lock<T>(values: &Mutex<T>) -> MutexGuard<'_, T> {
    values.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn kernels_are_named_after_their_module_and_function() {
        let names = [
            ("dpges_core::ops::splat::cube::splat_kernel::SplatKernel", "dpges_core::splat::splat_kernel"),
            (
                "burn_cubecl::kernel::unary_numeric::unary_numeric::UnaryNumeric<f32, a::B<c>>",
                "burn_cubecl::unary_numeric",
            ),
            ("Lone", "Lone"),
        ];
        for (type_name, name) in names {
            assert_eq!(kernel_name(type_name), name);
        }
    }

    #[cfg(any(feature = "ndarray", feature = "flex"))]
    #[test]
    fn a_cpu_has_no_memory_of_its_own() {
        assert_eq!(watch_memory(&crate::backend::device::cpu(), || 3), (3, None));
    }
}
