//! `--device auto`: a hardware GPU that passes a short check, or else the CPU.

use std::fmt;
use std::str::FromStr;

use burn::tensor::Device;
use serde::{Deserialize, Serialize};

use super::{DeviceError, DeviceName};

/// The values of `--device`: `auto`, or a [`DeviceName`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum DeviceRequest {
    #[default]
    Auto,
    Named(DeviceName),
}

/// The device that `auto` stands for on this machine.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Selection {
    #[serde(with = "name_as_text")]
    pub device: DeviceName,
    /// Why, as the rest of a sentence: "since …".
    pub reason: String,
}

impl DeviceRequest {
    /// The device itself, without autodiff; `auto` by [`select`].
    ///
    /// # Errors
    /// [`DeviceError`] if there is no such device, or it cannot be opened.
    pub fn open(self) -> Result<Device, DeviceError> {
        match self {
            Self::Auto => select()?.device.open(),
            Self::Named(name) => name.open(),
        }
    }
}

impl fmt::Display for DeviceRequest {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Auto => f.write_str("auto"),
            Self::Named(name) => name.fmt(f),
        }
    }
}

impl FromStr for DeviceRequest {
    type Err = String;

    fn from_str(text: &str) -> Result<Self, String> {
        if text == "auto" { Ok(Self::Auto) } else { text.parse().map(Self::Named) }
    }
}

impl From<DeviceName> for DeviceRequest {
    fn from(name: DeviceName) -> Self {
        Self::Named(name)
    }
}

/// Looks at the graphics adapters of this machine, best first, and takes the first that is a hardware GPU and passes
/// the check: one golden case forward and backward, in at most [`CHECK_LIMIT`](check::CHECK_LIMIT). Takes the CPU where
/// there is none.
///
/// The check runs on a thread of its own, which is left behind if the adapter hangs. An adapter whose driver ends the
/// process ends this one: the program `dpges` therefore calls this function in a child process.
#[cfg(feature = "gpu")]
pub fn select() -> Result<Selection, DeviceError> {
    check::select_from(super::adapter::adapters(), |name| check::within(check::CHECK_LIMIT, move || check::run(name)))
}

/// The CPU: this build has no GPUs.
#[cfg(not(feature = "gpu"))]
pub fn select() -> Result<Selection, DeviceError> {
    cpu("this build leaves GPUs out".to_owned())
}

/// The CPU, and why.
///
/// # Errors
/// [`DeviceError::NoCpu`] if the build has no CPU backend.
pub fn cpu(reason: String) -> Result<Selection, DeviceError> {
    match ["cpu", "cpu-ndarray"].into_iter().find_map(|name| name.parse().ok()) {
        Some(device) => Ok(Selection { device, reason }),
        None => Err(DeviceError::NoCpu { reason }),
    }
}

/// A device by the name that `--device` accepts.
mod name_as_text {
    use serde::{Deserialize, Deserializer, Serializer, de::Error};

    use super::DeviceName;

    pub fn serialize<S: Serializer>(name: &DeviceName, serializer: S) -> Result<S::Ok, S::Error> {
        serializer.collect_str(name)
    }

    pub fn deserialize<'de, D: Deserializer<'de>>(deserializer: D) -> Result<DeviceName, D::Error> {
        String::deserialize(deserializer)?.parse().map_err(D::Error::custom)
    }
}

/// Which adapters may be chosen, and how each is checked.
#[cfg(feature = "gpu")]
pub mod check {
    use std::any::Any;
    use std::sync::mpsc::{RecvTimeoutError, channel};
    use std::time::{Duration, Instant};

    use super::super::adapter::Adapter;
    use super::super::adapter_name::{AdapterName, Kind};
    use super::super::selftest::CASES;
    use super::{DeviceError, DeviceName, Selection, cpu};

    /// Longest time that the check of one adapter may take. The check itself takes about two seconds on a GPU, nearly
    /// all of which its driver spends compiling kernels; a slow machine that compiles them for the first time needs
    /// more.
    pub const CHECK_LIMIT: Duration = Duration::from_secs(10);

    /// The first hardware GPU of `adapters`, best kind first, that passes `check`, or else the CPU. `check` returns how
    /// long it took, or what is wrong with the adapter.
    ///
    /// # Errors
    /// [`DeviceError::NoCpu`] if there is no such GPU and the build has no CPU backend.
    pub fn select_from(
        adapters: &[Adapter],
        mut check: impl FnMut(DeviceName) -> Result<Duration, String>,
    ) -> Result<Selection, DeviceError> {
        let (mut hardware, software): (Vec<&Adapter>, Vec<&Adapter>) =
            adapters.iter().partition(|adapter| adapter.kind != Kind::Software);
        hardware.sort_by_key(|adapter| (adapter.kind, adapter.number));
        let mut rejected = Vec::new();
        for adapter in hardware {
            let device = DeviceName::Gpu(AdapterName::Number(adapter.number));
            match adapter.shortcoming().map_or_else(|| check(device), Err) {
                Ok(time) => {
                    let reason = format!("{adapter} passed a check of {:.1} s", time.as_secs_f64());
                    return Ok(Selection { device, reason });
                }
                Err(problem) => rejected.push(format!("{adapter}: {problem}")),
            }
        }
        cpu(match (rejected.as_slice(), software.first()) {
            ([], None) => "no GPU was found".to_owned(),
            ([], Some(driver)) => format!("no hardware GPU was found ({} is a software driver)", driver.name),
            (rejected, _) => format!("no GPU is fit for use ({})", rejected.join("; ")),
        })
    }

    /// The result of `work`, or its failure, or a timeout after `limit`, which abandons its thread.
    pub(super) fn within(
        limit: Duration,
        work: impl FnOnce() -> Result<(), String> + Send + 'static,
    ) -> Result<Duration, String> {
        let (result, results) = channel();
        let start = Instant::now();
        let worker = std::thread::spawn(move || {
            // Fails if nobody waits any more.
            let _ = result.send(work());
        });
        match results.recv_timeout(limit) {
            Ok(result) => result.map(|()| start.elapsed()),
            Err(RecvTimeoutError::Timeout) => Err(format!("its check took longer than {} s", limit.as_secs_f64())),
            Err(RecvTimeoutError::Disconnected) => Err(match worker.join() {
                Err(panic) => format!("its check failed: {}", first_line(&*panic)),
                Ok(()) => "its check failed".to_owned(),
            }),
        }
    }

    /// The quickest case of the self-test on a device.
    pub(super) fn run(device: DeviceName) -> Result<(), String> {
        let opened = device.open().map_err(|error| error.to_string())?;
        let findings = CASES[0].check(&opened);
        let wrong = findings.iter().filter(|finding| !finding.passed).count();
        if wrong == 0 { Ok(()) } else { Err(format!("it computes {wrong} of {} tensors wrongly", findings.len())) }
    }

    fn first_line(panic: &(dyn Any + Send)) -> &str {
        let text = panic.downcast_ref::<String>().map(String::as_str).or_else(|| panic.downcast_ref::<&str>().copied());
        text.and_then(|text| text.lines().next()).unwrap_or("a panic without a message")
    }
}

#[cfg(all(test, feature = "gpu", feature = "flex"))]
mod tests {
    use std::time::Duration;

    use super::super::adapter::Adapter;
    use super::super::adapter::tests::adapters;
    use super::super::adapter_name::{Api, Kind};
    use super::check::{select_from, within};
    use super::*;

    const QUICK: Duration = Duration::from_millis(700);

    /// Selects from `adapters`, of which those in `broken` fail their check; the device, the reason, what was checked.
    fn selected(adapters: &[Adapter], broken: &[&str]) -> (String, String, Vec<String>) {
        let mut checked = Vec::new();
        let check = |name: DeviceName| {
            checked.push(name.to_string());
            if broken.contains(&name.to_string().as_str()) { Err("it is broken".to_owned()) } else { Ok(QUICK) }
        };
        let Selection { device, reason } = select_from(adapters, check).unwrap();
        (device.to_string(), reason, checked)
    }

    #[test]
    fn the_best_hardware_gpu_that_passes_is_taken() {
        let machine = adapters(&[
            (Kind::Software, Api::Vulkan, 1024),
            (Kind::Integrated, Api::Vulkan, 256),
            (Kind::Discrete, Api::Gl, 128),
            (Kind::Discrete, Api::Gl, 256),
        ]);
        let (device, reason, checked) = selected(&machine, &[]);
        assert_eq!((device.as_str(), checked), ("wgpu:3", vec!["wgpu:3".to_owned()]), "unsuitable ones are not tried");
        assert_eq!(reason, "GPU 3 (discrete, gl) passed a check of 0.7 s");
        let (device, reason, checked) = selected(&machine, &["wgpu:3"]);
        assert_eq!((device.as_str(), checked), ("wgpu:1", vec!["wgpu:3".to_owned(), "wgpu:1".to_owned()]));
        assert!(reason.starts_with("GPU 1 (integrated, vulkan)"), "{reason}");
        let (device, reason, _) = selected(&machine, &["wgpu:1", "wgpu:3"]);
        assert_eq!(device, "cpu");
        let parts =
            ["no GPU is fit", "GPU 2 (discrete, gl): it has 128 invocations", "GPU 1 (integrated, vulkan): it is"];
        assert!(parts.iter().all(|part| reason.contains(part)), "{reason}");
    }

    #[test]
    fn a_software_driver_is_never_taken() {
        let (device, reason, checked) = selected(&adapters(&[(Kind::Software, Api::Vulkan, 1024)]), &[]);
        assert_eq!((device.as_str(), checked.len()), ("cpu", 0));
        assert_eq!(reason, "no hardware GPU was found (GPU 0 is a software driver)");
        assert_eq!(selected(&[], &[]).1, "no GPU was found");
    }

    #[test]
    fn a_check_that_hangs_or_panics_is_a_failure() {
        let hang = || loop {
            std::thread::sleep(Duration::from_secs(3600));
        };
        assert!(within(Duration::from_millis(20), hang).unwrap_err().contains("took longer than 0.02 s"));
        let limit = Duration::from_secs(60);
        let error = within(limit, || panic!("device lost\nstack")).unwrap_err();
        assert_eq!(error, "its check failed: device lost");
        assert_eq!(within(limit, || Err("refused".to_owned())), Err("refused".to_owned()));
        assert!(within(limit, || Ok(())).unwrap() < limit);
    }

    #[test]
    fn requests_are_read_back_and_selections_too() {
        for text in ["auto", "cpu", "wgpu:3"] {
            assert_eq!(text.parse::<DeviceRequest>().unwrap().to_string(), text);
        }
        assert_eq!(DeviceRequest::default(), DeviceRequest::Auto);
        assert!("fast".parse::<DeviceRequest>().unwrap_err().contains("auto"));
        let selection = cpu("because".to_owned()).unwrap();
        let text = serde_json::to_string(&selection).unwrap();
        assert_eq!(text, r#"{"device":"cpu","reason":"because"}"#);
        assert_eq!(serde_json::from_str::<Selection>(&text).unwrap(), selection);
    }
}
