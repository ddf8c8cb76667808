//! Reading a texture back: a picture that a test or a screenshot can use, where a canvas gives none.

use std::cell::RefCell;
use std::rc::Rc;

use js_sys::Promise;
use wasm_bindgen::prelude::*;
use wasm_bindgen_futures::JsFuture;
use wgpu::{Buffer, CommandEncoder, Device, Texture, TextureFormat};

const BYTES_PER_PIXEL: u32 = 4;
/// Between two looks at whether the device has finished, ms.
const WAIT_MS: f64 = 2.0;

#[wasm_bindgen]
extern "C" {
    #[wasm_bindgen(js_name = setTimeout)]
    fn set_timeout(callback: &js_sys::Function, delay_ms: f64) -> JsValue;
}

/// A copy of a texture on its way to the host.
pub struct Copy {
    buffer: Buffer,
    width: u32,
    height: u32,
    bytes_per_row: u32,
    format: TextureFormat,
}

impl Copy {
    /// Records the copy of `texture`, which has four bytes per pixel.
    pub fn record(device: &Device, encoder: &mut CommandEncoder, texture: &Texture) -> Self {
        let size = texture.size();
        let bytes_per_row = (BYTES_PER_PIXEL * size.width).next_multiple_of(wgpu::COPY_BYTES_PER_ROW_ALIGNMENT);
        let buffer = device.create_buffer(&wgpu::BufferDescriptor {
            label: Some("pixels"),
            size: u64::from(bytes_per_row) * u64::from(size.height),
            usage: wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::MAP_READ,
            mapped_at_creation: false,
        });
        let layout =
            wgpu::TexelCopyBufferLayout { offset: 0, bytes_per_row: Some(bytes_per_row), rows_per_image: None };
        let to = wgpu::TexelCopyBufferInfo { buffer: &buffer, layout };
        encoder.copy_texture_to_buffer(texture.as_image_copy(), to, size);
        Self { buffer, width: size.width, height: size.height, bytes_per_row, format: texture.format() }
    }

    /// The pixels [height, width, 4] as red, green, blue, opacity, once the recorded commands have run on `device`.
    pub async fn pixels(self, device: Device) -> Result<Vec<u8>, String> {
        let mapped = Rc::new(RefCell::new(None));
        let result = mapped.clone();
        self.buffer.map_async(wgpu::MapMode::Read, .., move |outcome| *result.borrow_mut() = Some(outcome));
        // The browser maps between two tasks, and WebGL2 only when it is polled.
        while mapped.borrow().is_none() {
            device.poll(wgpu::PollType::Poll).map_err(|error| error.to_string())?;
            pause().await;
        }
        let outcome = mapped.borrow_mut().take().expect("waited for above");
        outcome.map_err(|_| "the picture could not be read back from the graphics device".to_owned())?;
        let view = self.buffer.get_mapped_range(..).map_err(|error| error.to_string())?;
        let row_bytes = (BYTES_PER_PIXEL * self.width) as usize;
        let rows = view.chunks_exact(self.bytes_per_row as usize).take(self.height as usize);
        let mut pixels: Vec<u8> = rows.flat_map(|row| &row[..row_bytes]).copied().collect();
        if self.format == TextureFormat::Bgra8Unorm {
            pixels.chunks_exact_mut(BYTES_PER_PIXEL as usize).for_each(|pixel| pixel.swap(0, 2));
        }
        Ok(pixels)
    }
}

async fn pause() {
    let timer = Promise::new(&mut |resolve, _| {
        set_timeout(&resolve, WAIT_MS);
    });
    JsFuture::from(timer).await.expect("a timer does not fail");
}
