//! Parts of the benchmarks: devices, the machine; the joint stage alone.

pub mod joint;

use burn::tensor::{Device, DeviceType};
use dpges_core::camera::Camera;

/// The CPU backends and, where there is one, the first adapter of wgpu, by name.
pub fn devices() -> Vec<(&'static str, Device)> {
    let mut devices = cpus().to_vec();
    devices.extend(Device::enumerate(DeviceType::Wgpu).iter().next().map(|device| ("wgpu", device.clone())));
    devices
}

/// The CPU backends, by name.
#[expect(deprecated, reason = "burn-ndarray is deprecated upstream and supported here")]
pub fn cpus() -> [(&'static str, Device); 2] {
    [("ndarray", Device::ndarray()), ("flex", Device::flex())]
}

/// `camera` with a picture of another size: the vertical field of view stays, and the principal point is the middle.
pub fn sized(camera: &Camera, width: usize, height: usize) -> Camera {
    let scale = height as f64 / camera.height as f64;
    let (cx, cy) = (0.5 * width as f64, 0.5 * height as f64);
    Camera { fx: camera.fx * scale, fy: camera.fy * scale, cx, cy, width, height, ..*camera }
}

/// Model of the processor and number of threads.
pub fn machine() -> String {
    let threads = std::thread::available_parallelism().map_or(1, usize::from);
    let info = std::fs::read_to_string("/proc/cpuinfo").unwrap_or_default();
    let line = |key: &str| info.lines().find(|line| line.starts_with(key)).and_then(|line| line.split(": ").nth(1));
    let of = |key: &str| line(key).unwrap_or("?").trim();
    let (model, family, number) = (of("model name"), of("cpu family"), of("model\t"));
    format!("{model} (family {family}, model {number}), {threads} threads")
}

/// A line of /proc/self/status in MiB; NaN where there is none.
pub fn resident_mib(key: &str) -> f64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find(|line| line.starts_with(key)).and_then(|line| line.split_whitespace().nth(1));
    line.and_then(|kib| kib.parse::<f64>().ok()).map_or(f64::NAN, |kib| kib / 1024.0)
}
