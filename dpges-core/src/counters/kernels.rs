//! Launches of kernels, dpges' own and Burn's, their times and the memory of their device.
//!
//! CubeCL tells one observer of the process about every launch: only one piece of work can be observed at a time, and what
//! other threads launch meanwhile counts, too.

use std::collections::BTreeMap;
use std::sync::{Arc, Mutex, PoisonError};

use burn::backend::DispatchDevice;
use burn::tensor::{Device, read_sync};
use cubecl::client::Client;
use cubecl::logging::{Duration, LaunchObservation, LaunchObserver, ProfileDuration, TimingMethod, TimingRequest};
use cubecl::{MemoryScope, MemoryUsage};

use super::{DeviceMemory, GpuWork, KernelWork};

/// Calls `work` and observes its launches; `None` if `device` is no GPU. Every kernel is handed to the device by itself, so that
/// the work takes longer than it would; the kernels do not.
pub fn observe<T>(device: &Device, work: impl FnOnce() -> T) -> (T, Option<GpuWork>) {
    let DispatchDevice::Cube(device) = device.as_dispatch().clone().inner() else { return (work(), None) };
    let client = device.client();
    let alive_bytes = usage(&client).bytes_in_use;
    let seen = Mutex::new(Seen { peak_bytes: alive_bytes, ..Seen::default() });
    let observer = Arc::new(Observer { client, seen });
    let observation = LaunchObservation::new(observer.clone());
    let result = work();
    drop(observation);
    let seen = observer.take();
    let mut kernels: BTreeMap<String, KernelWork> = BTreeMap::new();
    for (kernel, launches) in seen.launches {
        kernels.entry(kernel_name(kernel)).or_default().launches += launches;
    }
    for (kernel, profile) in seen.profiles.into_iter().filter(|(_, it)| it.timing_method() == TimingMethod::Device) {
        let Some(ticks) = read_sync(profile.resolve()) else { continue };
        let milliseconds = &mut kernels.entry(kernel_name(kernel)).or_default().milliseconds;
        *milliseconds = Some(milliseconds.unwrap_or(0.0) + 1e3 * ticks.duration().as_secs_f64());
    }
    let reserved_bytes = usage(&observer.client).bytes_reserved;
    let memory = DeviceMemory { alive_bytes, peak_bytes: seen.peak_bytes, reserved_bytes };
    (result, Some(GpuWork { kernels, memory }))
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

struct Observer {
    client: Client,
    seen: Mutex<Seen>,
}

#[derive(Default)]
struct Seen {
    launches: BTreeMap<&'static str, usize>,
    /// Read after all work, so that nothing waits meanwhile.
    profiles: Vec<(&'static str, ProfileDuration)>,
    peak_bytes: u64,
}

impl Observer {
    fn note(&self, note: impl FnOnce(&mut Seen)) {
        note(&mut self.seen.lock().unwrap_or_else(PoisonError::into_inner));
    }

    fn take(&self) -> Seen {
        std::mem::take(&mut self.seen.lock().unwrap_or_else(PoisonError::into_inner))
    }
}

impl LaunchObserver for Observer {
    fn launched(&self, kernel: &'static str) {
        let bytes = usage(&self.client).bytes_in_use;
        self.note(|seen| {
            *seen.launches.entry(kernel).or_default() += 1;
            seen.peak_bytes = seen.peak_bytes.max(bytes);
        });
    }

    fn timing(&self) -> TimingRequest {
        TimingRequest::Deferred
    }

    fn profiled(&self, kernel: &'static str, profile: ProfileDuration) {
        self.note(|seen| seen.profiles.push((kernel, profile)));
    }

    // where CubeCL's own logger reads the measurements, it prints them
    fn timed(&self, _: &'static str, _: Duration, _: TimingMethod) {}
}

fn usage(client: &Client) -> MemoryUsage {
    client.memory_report(MemoryScope::Device).usage()
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
    fn nothing_is_observed_on_a_cpu() {
        assert_eq!(observe(&crate::backend::device::cpu(), || 3), (3, None));
    }
}
