//! The first content of a window, and the report of a failed device.

use std::path::PathBuf;
use std::sync::{Arc, Mutex, PoisonError};

use eframe::egui_wgpu::RenderState;

use super::live::LiveScene;
use super::loading::Opened;
use super::views::DatasetViews;

pub enum Start {
    Page,
    /// A scene file or the folder of a run, which is read while the window is there already.
    Open(PathBuf),
    Scene {
        name: String,
        opened: Box<Opened>,
    },
    /// A scene in training, and the views it is trained on.
    Live(LiveScene, Option<DatasetViews>),
}

/// Why the device failed, once it has.
#[derive(Clone, Default)]
pub struct DeviceFailure(Arc<Mutex<Option<String>>>);

impl DeviceFailure {
    pub fn set(&self, reason: String) {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(reason);
    }

    pub fn reason(&self) -> Option<String> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).clone()
    }

    /// Learns of the failure of a device that nobody else watches.
    pub fn watch(&self, state: &RenderState, wake: impl Fn() + Send + Sync + Clone + 'static) {
        let (lost, woken) = (self.clone(), wake.clone());
        state.device.set_device_lost_callback(move |reason, message| {
            if reason != wgpu::DeviceLostReason::Destroyed {
                lost.set(format!("it was lost: {message}"));
                woken();
            }
        });
        let failed = self.clone();
        state.device.on_uncaptured_error(Arc::new(move |error: wgpu::Error| {
            failed.set(error.to_string());
            wake();
        }));
    }
}
