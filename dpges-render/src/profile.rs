//! Times of passes, measured by the GPU.

use wgpu_profiler::{GpuProfiler, GpuProfilerQuery, GpuProfilerSettings};

use crate::error::{RenderError, Result};

const NAMES: [&str; 7] = ["colours", "project", "peel", "resolve", "splat", "sorted", "present"];

/// The time of a pass of one frame; that of the peels is their sum.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PassTime {
    pub name: &'static str,
    pub milliseconds: f64,
}

pub(crate) struct Profile {
    profiler: Option<GpuProfiler>,
    last: Vec<PassTime>,
}

impl std::fmt::Debug for Profile {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("Profile").field("measures", &self.profiler.is_some()).field("last", &self.last).finish()
    }
}

impl Profile {
    pub fn new(device: &wgpu::Device) -> Result<Self> {
        let measures = device.features().contains(wgpu::Features::TIMESTAMP_QUERY);
        let settings = GpuProfilerSettings { enable_debug_groups: false, ..GpuProfilerSettings::default() };
        let create = || GpuProfiler::new(device, settings).map_err(|error| RenderError::Device(error.to_string()));
        Ok(Self { profiler: measures.then(create).transpose()?, last: Vec::new() })
    }

    pub fn begin(&self, name: &'static str, encoder: &mut wgpu::CommandEncoder) -> Option<GpuProfilerQuery> {
        self.profiler.as_ref().map(|profiler| profiler.begin_pass_query(name, encoder))
    }

    pub fn end(&self, encoder: &mut wgpu::CommandEncoder, query: Option<GpuProfilerQuery>) {
        if let (Some(profiler), Some(query)) = (&self.profiler, query) {
            profiler.end_query(encoder, query);
        }
    }

    pub fn resolve(&mut self, encoder: &mut wgpu::CommandEncoder) {
        if let Some(profiler) = &mut self.profiler {
            profiler.resolve_queries(encoder);
        }
    }

    /// After the frame was submitted: takes the times of the frames that are finished.
    pub fn finish_frame(&mut self, queue: &wgpu::Queue) {
        let Some(profiler) = &mut self.profiler else { return };
        // a frame that was recorded and never submitted has queries that cannot be closed: nothing is measured then
        if profiler.end_frame().is_err() {
            return;
        }
        while let Some(results) = profiler.process_finished_frame(queue.get_timestamp_period()) {
            let sum = |name: &str| {
                let of = results.iter().filter(|result| result.label == name).filter_map(|result| result.time.as_ref());
                let times: Vec<f64> = of.map(|time| time.end - time.start).collect();
                (!times.is_empty()).then(|| times.iter().sum::<f64>())
            };
            self.last = NAMES
                .iter()
                .filter_map(|name| sum(name).map(|seconds| PassTime { name, milliseconds: 1e3 * seconds }))
                .collect();
        }
    }

    pub fn times(&self) -> Option<&[PassTime]> {
        (!self.last.is_empty()).then_some(&self.last)
    }
}
