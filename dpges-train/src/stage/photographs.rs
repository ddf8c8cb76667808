//! Photographs of training views that stay on a GPU.

use std::collections::HashMap;

use burn::tensor::Device;
use dpges_core::backend::device::is_gpu;
use dpges_core::losses::Target;

use super::Context;
use crate::config::Config;
use crate::dataset::Picture;
use crate::views::target::{PackedPicture, ToTarget};

/// The photographs that steps needed first, as many as there is room for. There is none on a CPU, which has nothing to upload.
#[derive(Debug)]
pub struct DevicePhotographs {
    /// The unused part of `data.device_memory`, bytes.
    room: usize,
    kept: HashMap<usize, PackedPicture>,
}

impl DevicePhotographs {
    /// Room for the photographs of a run on `device`.
    pub fn new(config: &Config, device: &Device) -> Self {
        let room = if is_gpu(device) { config.data.device_memory.bytes() } else { 0 };
        Self { room, kept: HashMap::new() }
    }

    /// Brings the `picture` of a training view to `device`, where it stays if there is room.
    fn add(&mut self, view: usize, picture: &Picture, device: &Device) -> Target {
        match self.room.checked_sub(PackedPicture::size_bytes(picture)) {
            Some(left) => {
                self.room = left;
                let packed = PackedPicture::new(picture, device);
                let target = packed.target();
                self.kept.insert(view, packed);
                target
            }
            None => picture.target(device),
        }
    }
}

impl Context {
    /// The photograph of the training view with this index on the tape, and which of its pixels count.
    pub fn target(&mut self, view: usize) -> dpges_core::Result<Target> {
        if let Some(kept) = self.photographs.kept.get(&view) {
            return Ok(kept.target());
        }
        let (picture, tape) = (self.dataset.train[view].picture()?, self.tape());
        Ok(self.photographs.add(view, &picture, &tape))
    }

    /// Whether the photograph of the training view with this index is on a GPU.
    pub fn has_on_device(&self, view: usize) -> bool {
        self.photographs.kept.contains_key(&view)
    }
}

#[cfg(test)]
mod tests {
    use dpges_core::counters::transfers::transfers;

    use super::*;
    use crate::run::fixtures::{config, device};

    #[test]
    fn photographs_stay_while_there_is_room() {
        let picture = |grey: u8| Picture { width: 4, height: 3, bytes: vec![grey; 36], alpha: None, counted: None };
        let device = device();
        // on a CPU the same kernels, but no room
        assert_eq!(DevicePhotographs::new(&config(&[]), &device).room, 0);
        let mut photographs = DevicePhotographs { room: 80, kept: HashMap::new() };
        for view in [7, 3, 5] {
            let before = transfers();
            photographs.add(view, &picture(view as u8), &device);
            assert_eq!(transfers().since(before).uploads, 1);
        }
        assert_eq!([3, 5, 7].map(|view| photographs.kept.contains_key(&view)), [true, false, true]);
        assert_eq!(photographs.room, 8);
        let before = transfers();
        let found = photographs.kept[&3].target().image.into_data().iter::<f32>().collect::<Vec<_>>();
        assert_eq!((transfers().since(before).uploads, found), (0, vec![3.0 / 255.0; 36]));
    }
}
