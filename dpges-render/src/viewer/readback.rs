//! Textures as bytes.

use crate::Rgb8Image;

/// The colours of an 8-bit RGBA `texture`. Waits for the GPU; black if its device is lost.
pub fn read_texture(device: &wgpu::Device, queue: &wgpu::Queue, texture: &wgpu::Texture) -> Rgb8Image {
    let (width, height) = (texture.width(), texture.height());
    let row_bytes = (4 * width).next_multiple_of(wgpu::COPY_BYTES_PER_ROW_ALIGNMENT);
    let buffer = device.create_buffer(&wgpu::BufferDescriptor {
        label: Some("picture"),
        size: u64::from(row_bytes) * u64::from(height),
        usage: wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::MAP_READ,
        mapped_at_creation: false,
    });
    let mut encoder = device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
    let layout = wgpu::TexelCopyBufferLayout { offset: 0, bytes_per_row: Some(row_bytes), rows_per_image: None };
    encoder.copy_texture_to_buffer(
        texture.as_image_copy(),
        wgpu::TexelCopyBufferInfo { buffer: &buffer, layout },
        texture.size(),
    );
    queue.submit([encoder.finish()]);
    let (sender, mapped) = std::sync::mpsc::channel();
    // nobody listens if waiting failed
    buffer.slice(..).map_async(wgpu::MapMode::Read, move |result| drop(sender.send(result)));
    let waited = device.poll(wgpu::PollType::wait_indefinitely());
    let (width, height) = (width as usize, height as usize);
    let black = || Rgb8Image { width, height, bytes: vec![0; 3 * width * height] };
    if waited.is_err() || !matches!(mapped.try_recv(), Ok(Ok(()))) {
        return black();
    }
    let Ok(rows) = buffer.slice(..).get_mapped_range() else { return black() };
    let pixels = rows.chunks_exact(row_bytes as usize).flat_map(|row| row[..4 * width].chunks_exact(4));
    Rgb8Image::from_pixels(width, height, pixels.map(|pixel| [pixel[0], pixel[1], pixel[2]]))
}
