//! The cost of a step as a report: in JSON and in words.

use dpges_core::camera::Camera;
use dpges_core::counters::transfers::Transfers;
use dpges_core::counters::{DeviceMemory, KernelTime};
use dpges_core::ranks::sent_bytes;
use serde::Serialize;

use super::{GpuCost, List, StepCost, StepTimes};
use crate::device::{DeviceError, DeviceName};

const MEGABYTE: f64 = 1e6;
/// Rates of networks.
const GIGABITS: [f64; 3] = [10.0, 25.0, 100.0];

/// The measurements of a step and their conditions: the content of the file of `dpges bench step --json`.
#[derive(Serialize)]
pub struct Report {
    scene: String,
    /// As --device takes it.
    device: String,
    adapter: String,
    hardware: Hardware,
    /// Quantities without a measurement, with reasons, a sentence each.
    not_measured: Vec<String>,
    camera: Pinhole,
    /// Of which this is one: it has all surfels, and its share of the Gaussians.
    ranks: usize,
    /// Bytes that it sends to the others in a step.
    sent_bytes: usize,
    #[serde(flatten)]
    pub cost: StepCost,
}

/// The camera of the first view, px and world units.
#[derive(Serialize)]
struct Pinhole {
    camera_from_world: [[f64; 4]; 3],
    fx: f64,
    fy: f64,
    cx: f64,
    cy: f64,
    near: f64,
}

impl From<&Camera> for Pinhole {
    fn from(camera: &Camera) -> Self {
        let Camera { camera_from_world: pose, fx, fy, cx, cy, near, .. } = *camera;
        let row = |i: usize| {
            let axes = pose.rotation.row(i);
            [axes.x, axes.y, axes.z, pose.translation[i]]
        };
        Self { camera_from_world: [row(0), row(1), row(2)], fx, fy, cx, cy, near }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
enum Hardware {
    Cpu,
    Gpu,
    /// A driver that emulates a GPU on the CPU.
    Software,
}

impl Report {
    /// The report of a step of `scene` on `device`, from `camera` and others. Alone; see [`of_ranks`](Self::of_ranks).
    ///
    /// # Errors
    /// [`DeviceError`] if the device is not there.
    pub fn new(scene: String, device: DeviceName, camera: &Camera, cost: StepCost) -> Result<Self, DeviceError> {
        let adapter = device.describe()?;
        let mut not_measured = Vec::new();
        let hardware = if device.is_cpu() {
            not_measured.push("launches, transfers and memory of a GPU: this is the CPU, which has none".to_owned());
            Hardware::Cpu
        } else if device.is_software() {
            not_measured.push(format!(
                "times of a GPU: {adapter} emulates one on the CPU, and only its counts are those of a GPU"
            ));
            Hardware::Software
        } else {
            Hardware::Gpu
        };
        if cost.gpu.as_ref().is_some_and(|gpu| gpu.kernel_times.is_none()) {
            not_measured.push(format!("times of kernels: {adapter} has no timestamps"));
        }
        if cost.lists.gaussians.is_none() {
            not_measured.push("tile lists: those of discs are not counted".to_owned());
        }
        let (device, camera) = (device.to_string(), camera.into());
        Ok(Self { scene, device, adapter, hardware, not_measured, camera, ranks: 1, sent_bytes: 0, cost })
    }

    /// The same of a step of one of `ranks`, which join so many `numbers`.
    #[must_use]
    pub fn of_ranks(self, ranks: usize, numbers: usize) -> Self {
        Self { ranks, sent_bytes: sent_bytes(numbers, ranks), ..self }
    }

    /// The measurement, in a line.
    pub fn title(&self) -> String {
        let StepCost { stage, surfels, gaussians, views, width, height, .. } = &self.cost;
        let plural = if *views == 1 { "view" } else { "views" };
        format!(
            "{stage} step, {surfels} surfels, {gaussians} Gaussians, {views} {plural} of {width}x{height} px, on {}\n",
            self.adapter
        )
    }

    /// Names and values, for people.
    pub fn rows(&self) -> Vec<(&'static str, String)> {
        let StepCost { time: StepTimes { steps, median_ms, p95_ms }, lists, gpu, .. } = &self.cost;
        let mut rows = vec![("step", format!("median {median_ms:.2} ms, p95 {p95_ms:.2} ms, of {steps}"))];
        rows.extend((self.ranks > 1).then(|| ("sent", self.sent())));
        rows.extend(self.cost.process_peak_bytes.map(|bytes| ("process", format!("peak {}", megabytes(bytes)))));
        rows.extend(lists.surfels.map(|list| ("surfel lists", of_list(&list))));
        rows.extend(lists.gaussians.map(|list| ("Gaussian lists", of_list(&list))));
        rows.extend(gpu.iter().flat_map(of_gpu));
        rows.extend(self.not_measured.iter().map(|what| ("not measured", what.clone())));
        rows
    }

    /// The bytes that a rank sends, and the least time that networks take for them.
    fn sent(&self) -> String {
        let times = GIGABITS.map(|rate| format!("{:.1} ms at {rate} Gb/s", 8e-6 * self.sent_bytes as f64 / rate));
        let megabytes = megabytes(self.sent_bytes as u64);
        format!("{megabytes} a step by each of {} ranks: at least {}", self.ranks, times.join(", "))
    }

    /// A table of the kernels of a GPU; empty without one.
    pub fn kernels(&self) -> String {
        self.cost.gpu.as_ref().map(kernel_table).unwrap_or_default()
    }
}

fn megabytes(bytes: u64) -> String {
    format!("{:.2} MB", bytes as f64 / MEGABYTE)
}

fn of_list(list: &List) -> String {
    let share = list.inside_share.map_or("no pairs".to_owned(), |share| {
        format!("{:.1} % of {:.2} million pairs inside", 100.0 * share, list.work.evaluated_pairs as f64 / 1e6)
    });
    format!("{} entries in {} tiles, at most {}, {share}", list.work.entries, list.work.tiles, list.work.longest)
}

fn of_gpu(gpu: &GpuCost) -> [(&'static str, String); 3] {
    let Transfers { uploads, uploaded_bytes, downloads, downloaded_bytes, waits } = gpu.transfers;
    let DeviceMemory { alive_bytes, peak_bytes, reserved_bytes } = gpu.memory;
    [
        ("launches", format!("{} of {} kernels", gpu.launches, gpu.launches_by_kernel.len())),
        (
            "transfers",
            format!("up {uploads}: {uploaded_bytes} B, down {downloads}: {downloaded_bytes} B, {waits} waited for"),
        ),
        (
            "memory",
            format!(
                "alive {}, peak {}, reserved {}",
                megabytes(alive_bytes),
                megabytes(peak_bytes),
                megabytes(reserved_bytes)
            ),
        ),
    ]
}

/// Kernels with their launches, the longest first, or those that are launched most where no times are known.
fn kernel_table(gpu: &GpuCost) -> String {
    if let Some(times) = &gpu.kernel_times {
        let all: f64 = times.iter().map(|kernel| kernel.milliseconds).sum();
        let line = |KernelTime { kernel, launches, milliseconds }: &KernelTime| {
            format!("{launches:8}  {milliseconds:9.3}  {:5.1}  {kernel}\n", 100.0 * milliseconds / all)
        };
        return "launches         ms      %  kernel\n".to_owned() + &times.iter().map(line).collect::<String>();
    }
    let mut kernels: Vec<_> = gpu.launches_by_kernel.iter().collect();
    kernels.sort_by_key(|(_, launches)| std::cmp::Reverse(**launches));
    let line = |(kernel, launches): (&String, &usize)| format!("{launches:8}  {kernel}\n");
    "launches  kernel\n".to_owned() + &kernels.into_iter().map(line).collect::<String>()
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use dpges_core::camera::CameraFromWorld;
    use dpges_core::counters::Launches;
    use dpges_core::tiles::work::TileWork;
    use glam::DVec3;
    use serde_json::Value;

    use super::*;
    use crate::run::fixtures;
    use crate::run::step_cost::Lists;

    /// A report in which nothing is missing.
    fn report() -> Report {
        let work = TileWork { tiles: 6, entries: 20, longest: 7, evaluated_pairs: 5120, inside_pairs: 1280 };
        let list = Some(List::from(work));
        let time = KernelTime { kernel: "a::splat".into(), launches: 2, milliseconds: 0.5 };
        let gpu = GpuCost {
            launches: 3,
            launches_by_kernel: Launches::from([("a::splat".to_owned(), 2), ("a::peel".to_owned(), 1)]),
            transfers: Transfers { uploads: 1, uploaded_bytes: 1920, downloads: 1, downloaded_bytes: 28, waits: 1 },
            memory: DeviceMemory { alive_bytes: 1, peak_bytes: 2_500_000, reserved_bytes: 3 },
            kernel_times: Some(vec![time]),
        };
        let cost = StepCost {
            stage: "joint".into(),
            surfels: 1,
            gaussians: 2,
            views: 1,
            width: 48,
            height: 32,
            time: StepTimes { steps: 3, median_ms: 1.25, p95_ms: 2.5 },
            process_peak_bytes: Some(9),
            lists: Lists { surfels: list, gaussians: list },
            gpu: Some(gpu),
        };
        Report {
            scene: "realistic".into(),
            device: "wgpu".into(),
            adapter: "a GPU".into(),
            hardware: Hardware::Gpu,
            not_measured: Vec::new(),
            camera: (&camera()).into(),
            ranks: 1,
            sent_bytes: 0,
            cost,
        }
    }

    fn camera() -> Camera {
        let camera_from_world = CameraFromWorld::look_at(DVec3::new(0.0, -2.0, 0.0), DVec3::ZERO, DVec3::Z);
        Camera { fy: 41.0, ..fixtures::camera(camera_from_world, 40.0, [48, 32]) }
    }

    #[test]
    fn the_camera_is_written_row_by_row() {
        let Pinhole { camera_from_world: rows, .. } = (&camera()).into();
        // the origin lies ahead of it
        assert_eq!(rows.map(|[.., t]| t.round()), [0.0, 0.0, 2.0]);
        let point = [1.0, 0.0, 3.0];
        let (x, y, depth) = camera().project(DVec3::from_array(point)).unwrap();
        let [a, b, c] = rows.map(|[x, y, z, t]| x * point[0] + y * point[1] + z * point[2] + t);
        assert!((40.0 * a / c + 24.0 - x).abs() < 1e-9 && (41.0 * b / c + 16.0 - y).abs() < 1e-9);
        assert!((c - depth).abs() < 1e-9);
    }

    /// Keys of all objects, but those that are names of kernels.
    fn keys(value: &Value, found: &mut BTreeSet<String>) {
        match value {
            Value::Object(object) => {
                for (key, value) in object {
                    found.insert(key.clone());
                    if key != "launches_by_kernel" {
                        keys(value, found);
                    }
                }
            }
            Value::Array(values) => values.iter().for_each(|value| keys(value, found)),
            _ => {}
        }
    }

    #[test]
    fn every_key_is_documented() {
        let mut found = BTreeSet::new();
        keys(&serde_json::to_value(report()).unwrap(), &mut found);
        assert!(found.len() > 30, "{found:?}");
        let document = include_str!("../../../docs/guide/measure.md");
        for key in found {
            assert!(document.contains(&format!("`{key}`")), "docs/guide/measure.md says nothing of `{key}`");
        }
    }

    #[test]
    fn the_table_shows_times_counts_and_kernels() {
        let mut report = report();
        let text = format!("{}{:?}{}", report.title(), report.rows(), report.kernels());
        for part in ["joint step, 1 surfels, 2 Gaussians, 1 view of 48x32 px, on a GPU", "median 1.25 ms, p95 2.50 ms"]
        {
            assert!(text.contains(part), "{text}");
        }
        for part in ["3 of 2 kernels", "1920 B", "peak 2.50 MB", "25.0 % of 0.01 million pairs", "100.0  a::splat"] {
            assert!(text.contains(part), "{text}");
        }
        assert!(!text.contains("ranks"), "{text}");
        report = report.of_ranks(2, 12 * 48 * 32);
        // 48 bytes for each of 48 × 32 px
        let sent = "0.07 MB a step by each of 2 ranks: at least 0.1 ms at 10 Gb/s";
        assert!(format!("{:?}", report.rows()).contains(sent), "{:?}", report.rows());
        report.cost.gpu.as_mut().unwrap().kernel_times = None;
        assert_eq!(report.kernels(), "launches  kernel\n       2  a::splat\n       1  a::peel\n");
    }

    #[test]
    fn what_a_cpu_cannot_measure_is_said() {
        let mut cost = report().cost;
        cost.gpu = None;
        let report = Report::new("realistic".into(), "cpu".parse().unwrap(), &camera(), cost).unwrap();
        assert_eq!(report.hardware, Hardware::Cpu);
        assert_eq!((report.not_measured.len(), report.rows().last().unwrap().0), (1, "not measured"));
    }
}
