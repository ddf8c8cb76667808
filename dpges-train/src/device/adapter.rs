//! The graphics adapters that wgpu finds on this machine, and what each can do.

use std::fmt;
use std::sync::OnceLock;

use burn::backend::WgpuDeviceKind;
use burn::tensor::{Device, read_sync};
use burn_wgpu::graphics::AutoGraphicsApi;
use burn_wgpu::{RuntimeOptions, WgpuBackend, WgpuDevice, WgpuSetup, try_init_setup, wgpu};
use serde::Serialize;

use super::DeviceError;
use super::adapter_name::{AdapterName, Api, Kind};

/// Requirements of the kernels: no more than WebGPU guarantees.
const LEAST_WORKGROUP_BYTES: u32 = 16 << 10;
const LEAST_WORKGROUP_INVOCATIONS: u32 = 256;
const LEAST_STORAGE_BUFFERS: u32 = 8;

/// One adapter on one graphics API; a GPU that two APIs reach is two adapters.
#[derive(Clone, Debug, Serialize)]
pub struct Adapter {
    /// Place in [`adapters`].
    pub number: usize,
    pub name: String,
    pub kind: Kind,
    pub api: Api,
    pub driver: String,
    pub driver_info: String,
    /// Whether it has compute shaders.
    pub compute: bool,
    /// Largest part of a buffer that a kernel sees.
    pub storage_binding_bytes: u64,
    pub buffer_bytes: u64,
    pub storage_buffers_per_stage: u32,
    pub workgroup_bytes: u32,
    pub workgroup_invocations: u32,
    /// Least and most invocations of a subgroup; `None` where there are no subgroups.
    pub subgroup_sizes: Option<[u32; 2]>,
    /// Whether the adapter adds f32 atomically. Otherwise a loop of compare-and-swap does.
    pub f32_atomic_add: bool,
    /// Place among the adapters of the same API and kind.
    #[serde(skip)]
    place: usize,
    /// Its wgpu objects, or the reason why it could not be started, once that was tried.
    #[serde(skip)]
    started: OnceLock<Result<WgpuSetup, String>>,
}

/// All adapters, in the order of [`Api::ALL`]. The process looks for them once.
pub fn adapters() -> &'static [Adapter] {
    // The instance stays: Vulkan's loader does not bear one that goes while another comes.
    static FOUND: OnceLock<(wgpu::Instance, Vec<Adapter>)> = OnceLock::new();
    let (_, adapters) = FOUND.get_or_init(|| {
        let instance = wgpu::Instance::new(wgpu::InstanceDescriptor {
            backends: Api::ALL.into_iter().map(|api| wgpu::Backends::from(wgpu_backend(api))).collect(),
            ..wgpu::InstanceDescriptor::new_without_display_handle()
        });
        let adapters = find(&instance);
        (instance, adapters)
    });
    adapters
}

fn find(instance: &wgpu::Instance) -> Vec<Adapter> {
    let mut adapters: Vec<Adapter> = Vec::new();
    for api in Api::ALL {
        for found in read_sync(instance.enumerate_adapters(wgpu_backend(api).into())) {
            let kind = match found.get_info().device_type {
                wgpu::DeviceType::DiscreteGpu => Kind::Discrete,
                wgpu::DeviceType::IntegratedGpu => Kind::Integrated,
                wgpu::DeviceType::VirtualGpu => Kind::Virtual,
                wgpu::DeviceType::Other => Kind::Other,
                wgpu::DeviceType::Cpu => Kind::Software,
            };
            let place = adapters.iter().filter(|other| (other.api, other.kind) == (api, kind)).count();
            // Burn reaches one software adapter of an API: the first.
            if kind != Kind::Software || place == 0 {
                adapters.push(describe(&found, adapters.len(), api, kind, place));
            }
        }
    }
    adapters
}

fn describe(adapter: &wgpu::Adapter, number: usize, api: Api, kind: Kind, place: usize) -> Adapter {
    let (info, limits, features) = (adapter.get_info(), adapter.limits(), adapter.features());
    let subgroup_sizes = [info.subgroup_min_size, info.subgroup_max_size];
    Adapter {
        number,
        name: info.name,
        kind,
        api,
        driver: info.driver,
        driver_info: info.driver_info,
        compute: adapter.get_downlevel_capabilities().flags.contains(wgpu::DownlevelFlags::COMPUTE_SHADERS),
        storage_binding_bytes: limits.max_storage_buffer_binding_size,
        buffer_bytes: limits.max_buffer_size,
        storage_buffers_per_stage: limits.max_storage_buffers_per_shader_stage,
        workgroup_bytes: limits.max_compute_workgroup_storage_size,
        workgroup_invocations: limits.max_compute_invocations_per_workgroup,
        subgroup_sizes: features.contains(wgpu::Features::SUBGROUP).then_some(subgroup_sizes),
        f32_atomic_add: features.contains(wgpu::Features::SHADER_FLOAT32_ATOMIC),
        place,
        started: OnceLock::new(),
    }
}

fn wgpu_backend(api: Api) -> wgpu::Backend {
    match api {
        Api::Metal => wgpu::Backend::Metal,
        Api::Vulkan => wgpu::Backend::Vulkan,
        Api::Dx12 => wgpu::Backend::Dx12,
        Api::Gl => wgpu::Backend::Gl,
    }
}

impl Adapter {
    /// Why the kernels cannot run on the adapter; `None` if they can.
    pub fn shortcoming(&self) -> Option<String> {
        if !self.compute {
            return Some("it has no compute shaders".to_owned());
        }
        let needs = [
            ("bytes of workgroup memory", self.workgroup_bytes, LEAST_WORKGROUP_BYTES),
            ("invocations per workgroup", self.workgroup_invocations, LEAST_WORKGROUP_INVOCATIONS),
            ("storage buffers per stage", self.storage_buffers_per_stage, LEAST_STORAGE_BUFFERS),
        ];
        let (what, has, least) = needs.into_iter().find(|(_, has, least)| has < least)?;
        Some(format!("it has {has} {what}, at least {least} are needed"))
    }

    /// All that is known of it, for people.
    pub fn lines(&self) -> Vec<String> {
        let Self { name, kind, api, driver, driver_info, workgroup_invocations, storage_buffers_per_stage, .. } = self;
        let mib = |bytes: u64| bytes >> 20;
        let subgroups = match self.subgroup_sizes {
            Some([least, most]) => format!("subgroups of {least} to {most}"),
            None => "no subgroups".to_owned(),
        };
        let atomics = if self.f32_atomic_add { "native" } else { "by compare-and-swap" };
        vec![
            name.clone(),
            format!("{kind}, {api}, driver {driver} {driver_info}"),
            format!(
                "storage binding {} MiB, buffer {} MiB, {storage_buffers_per_stage} storage buffers per stage",
                mib(self.storage_binding_bytes),
                mib(self.buffer_bytes)
            ),
            format!(
                "workgroup memory {} KiB, {workgroup_invocations} invocations, {subgroups}, f32 atomic add {atomics}",
                self.workgroup_bytes >> 10
            ),
            self.shortcoming().map_or_else(|| "suitable".to_owned(), |reason| format!("not suitable: {reason}")),
        ]
    }

    /// Burn's device on this adapter, without autodiff; started if it is not yet.
    ///
    /// # Errors
    /// [`DeviceError::Refused`] with what the driver says.
    pub fn open(&self) -> Result<Device, DeviceError> {
        let kind = match self.kind {
            Kind::Discrete => WgpuDeviceKind::DiscreteGpu(self.place),
            Kind::Integrated => WgpuDeviceKind::IntegratedGpu(self.place),
            Kind::Virtual => WgpuDeviceKind::VirtualGpu(self.place),
            Kind::Other => WgpuDeviceKind::Other(self.place),
            Kind::Software => WgpuDeviceKind::Cpu,
        };
        let device = WgpuDevice::new(kind).on(match self.api {
            Api::Metal => WgpuBackend::Metal,
            Api::Vulkan => WgpuBackend::Vulkan,
            Api::Dx12 => WgpuBackend::Dx12,
            Api::Gl => WgpuBackend::Gl,
        });
        let start = || {
            let setup = RuntimeOptions::try_default().and_then(|opts| try_init_setup::<AutoGraphicsApi>(&device, opts));
            setup.map_err(|error| error.to_string())
        };
        match self.started.get_or_init(start) {
            Ok(_) => Ok(Device::new(device)),
            Err(reason) => Err(DeviceError::Refused { adapter: self.to_string(), reason: reason.clone() }),
        }
    }

    /// The wgpu objects of the adapter that [`open`](Self::open) has started, for drawing on Burn's device.
    pub fn setup(&self) -> Option<&WgpuSetup> {
        self.started.get()?.as_ref().ok()
    }
}

/// Name, kind and API.
impl fmt::Display for Adapter {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} ({}, {})", self.name, self.kind, self.api)
    }
}

impl AdapterName {
    /// The adapter that is meant, of all `adapters`.
    ///
    /// # Errors
    /// [`DeviceError`] if there is none, or the kernels do not run on it.
    pub fn pick(self, adapters: &[Adapter]) -> Result<&Adapter, DeviceError> {
        if adapters.is_empty() {
            return Err(DeviceError::NoAdapter { asked: self });
        }
        let of_kind = |kind: Kind| adapters.iter().filter(move |adapter| adapter.kind == kind);
        let meant: Vec<&Adapter> = match self {
            Self::Best => adapters.iter().collect(),
            Self::Number(number) => adapters.get(number).into_iter().collect(),
            Self::OfKind(kind) => of_kind(kind).collect(),
            Self::NumberOfKind(kind, number) => of_kind(kind).nth(number).into_iter().collect(),
            Self::OfApi(api) => adapters.iter().filter(|adapter| adapter.api == api).collect(),
        };
        let suitable = meant.iter().copied().filter(|adapter| adapter.shortcoming().is_none());
        if let Some(best) = suitable.min_by_key(|adapter| (adapter.kind, adapter.number)) {
            return Ok(best);
        }
        let unsuitable = meant.first().and_then(|adapter| Some((adapter.to_string(), adapter.shortcoming()?)));
        Err(match unsuitable {
            Some((adapter, shortcoming)) => DeviceError::Unsuitable { asked: self, adapter, shortcoming },
            None => {
                let names = adapters.iter().map(|adapter| format!("wgpu:{} {adapter}", adapter.number));
                DeviceError::NoMatch { asked: self, found: names.collect::<Vec<_>>().join(", ") }
            }
        })
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;

    /// A machine that reaches its discrete GPU badly.
    fn machine() -> Vec<Adapter> {
        adapters(&[
            (Kind::Software, Api::Vulkan, 1024),
            (Kind::Integrated, Api::Vulkan, 256),
            (Kind::Integrated, Api::Gl, 256),
            (Kind::Discrete, Api::Gl, 128),
        ])
    }

    /// Adapters named by their numbers, with as many invocations per workgroup.
    pub fn adapters(machine: &[(Kind, Api, u32)]) -> Vec<Adapter> {
        let adapter = |(number, &(kind, api, workgroup_invocations))| Adapter {
            number,
            name: format!("GPU {number}"),
            kind,
            api,
            driver: String::new(),
            driver_info: String::new(),
            compute: true,
            storage_binding_bytes: 128 << 20,
            buffer_bytes: 256 << 20,
            storage_buffers_per_stage: LEAST_STORAGE_BUFFERS,
            workgroup_bytes: LEAST_WORKGROUP_BYTES,
            workgroup_invocations,
            subgroup_sizes: None,
            f32_atomic_add: false,
            place: 0,
            started: OnceLock::new(),
        };
        machine.iter().enumerate().map(adapter).collect()
    }

    fn pick(name: &str, adapters: &[Adapter]) -> Result<usize, String> {
        let name = AdapterName::parse(name).unwrap();
        name.pick(adapters).map(|adapter| adapter.number).map_err(|error| error.to_string())
    }

    #[test]
    fn the_best_suitable_adapter_is_picked() {
        let machine = machine();
        let expected = [("wgpu", 1), ("wgpu:2", 2), ("integrated", 1), ("integrated:1", 2), ("software", 0), ("gl", 2)];
        for (name, number) in expected {
            assert_eq!(pick(name, &machine), Ok(number), "{name}");
        }
    }

    #[test]
    fn what_is_not_there_or_not_enough_is_said() {
        let machine = machine();
        for name in ["discrete", "discrete:0", "wgpu:3"] {
            let error = pick(name, &machine).unwrap_err();
            let parts = [name, "GPU 3", "128 invocations per workgroup, at least 256"];
            assert!(parts.iter().all(|part| error.contains(part)), "{error}");
        }
        for name in ["virtual", "integrated:2", "wgpu:4", "metal"] {
            let error = pick(name, &machine).unwrap_err();
            assert!(error.contains(name) && error.contains("wgpu:1 GPU 1 (integrated, vulkan)"), "{error}");
        }
        let error = pick("wgpu", &[]).unwrap_err();
        assert!(error.contains("mesa-vulkan-drivers") && error.contains("`--device cpu`"), "{error}");
        let without_compute = Adapter { compute: false, ..machine[0].clone() };
        assert!(without_compute.shortcoming().unwrap().contains("compute shaders"));
    }
}
