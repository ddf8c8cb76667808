//! `cargo bench -p dpges-benches --features viewers --bench viewers -- [SCENE CAMERAS]`: frames per second of the
//! real-time renderer, of a sorted 3DGS viewer (the crate wgpu-3dgs-viewer) at the same number of primitives, and of the
//! renderer that is trained with, on the same adapter in the same run. Without a scene file and its cameras
//! (`cameras.json` of 3DGS) it is the scene of the other benchmarks.

use std::path::PathBuf;
use std::time::Instant;

use burn::tensor::{Device, DeviceType};
use clap::Parser;
use dpges_benches::sized;
use dpges_core::camera::Camera;
use dpges_core::scene::SceneData;
use dpges_core::testing::scenes::realistic;
use dpges_render::export::flatten;
use dpges_render::frame_times::{FrameTimes, Rounds, frame_times};
use dpges_render::{CameraPath, Headless, PICTURE_FORMAT, RenderOptions};
use wgpu_3dgs_viewer::core::Gaussian;
use wgpu_3dgs_viewer::core::glam::camera::rh::proj::directx::perspective;
use wgpu_3dgs_viewer::core::glam::{Mat4, Quat, U8Vec4, UVec2, Vec3, Vec4};
use wgpu_3dgs_viewer::{CameraPod, CameraTrait, DefaultGaussianPod, Viewer};

#[derive(Parser)]
struct Arguments {
    /// A scene file and its cameras, or neither
    files: Vec<PathBuf>,
    #[arg(long, default_value_t = 10_000)]
    surfels: usize,
    #[arg(long, default_value_t = 100_000)]
    gaussians: usize,
    #[arg(long, default_value_t = 640)]
    width: usize,
    #[arg(long, default_value_t = 360)]
    height: usize,
    #[arg(long, default_value_t = 10)]
    rounds: usize,
    /// Given by `cargo bench`
    #[arg(long, hide = true)]
    bench: bool,
}

impl Arguments {
    fn scene(&self) -> (SceneData, Vec<Camera>) {
        match self.files.as_slice() {
            [] => {
                let (scene, camera) = realistic(self.surfels, self.gaussians, self.width, self.height, 1).into_scene();
                (scene, vec![camera])
            }
            [scene, cameras] => {
                let scene = SceneData::load(scene).expect("a scene file");
                let path = CameraPath::load(cameras, scene.info.near).expect("cameras");
                let keys = path.keys().iter().map(|camera| sized(camera, self.width, self.height));
                (scene, keys.collect())
            }
            _ => panic!("name a scene file and its cameras, or nothing"),
        }
    }
}

/// A camera as the other viewer wants it.
struct Lens<'a>(&'a Camera);

impl CameraTrait for Lens<'_> {
    fn view(&self) -> Mat4 {
        let pose = self.0.camera_from_world;
        // y up, z backwards
        let row = |index: usize, sign: f64| {
            let row = pose.rotation.row(index) * sign;
            Vec4::new(row.x as f32, row.y as f32, row.z as f32, (pose.translation[index] * sign) as f32)
        };
        Mat4::from_cols(row(0, 1.0), row(1, -1.0), row(2, -1.0), Vec4::W).transpose()
    }

    fn projection(&self, aspect_ratio: f32) -> Mat4 {
        let half_height = 0.5 * self.0.height as f64 / self.0.fy;
        perspective(2.0 * half_height.atan() as f32, aspect_ratio, self.0.near as f32, 1e4)
    }
}

/// The scene as sorted splats with harmonics of degree 3.
fn splats(scene: &SceneData) -> Vec<Gaussian> {
    let cloud = flatten(scene, 3).expect("a scene with primitives");
    let byte = |value: f32| (value.clamp(0.0, 1.0) * 255.0).round() as u8;
    let splat = |row: usize| {
        let [w, x, y, z] = cloud.quaternions[row];
        let harmonics = cloud.harmonics_of(row);
        let [r, g, b] = harmonics[0].map(|k| byte(0.5 + Gaussian::SH0_TO_LINEAR_FACTOR * k));
        Gaussian {
            rot: Quat::from_xyzw(x, y, z, w),
            pos: cloud.positions[row].into(),
            color: U8Vec4::new(r, g, b, byte(cloud.opacities[row])),
            sh: std::array::from_fn(|at| Vec3::from_array(harmonics[at + 1])),
            scale: Vec3::from_array(cloud.log_scales[row].map(f32::exp)),
        }
    };
    (0..cloud.len()).map(splat).collect()
}

fn sorted_viewer(headless: &Headless, scene: &SceneData, cameras: &[Camera], rounds: Rounds) -> FrameTimes {
    let (device, queue) = (headless.device(), headless.queue());
    let mut viewer = Viewer::<DefaultGaussianPod>::new(device, PICTURE_FORMAT, &splats(scene)).expect("a viewer");
    let mut times = Vec::new();
    let mut last = None;
    for round in 0..rounds.warm_up + rounds.counted {
        for camera in cameras {
            let (width, height) = (camera.width as u32, camera.height as u32);
            let target = device.create_texture(&wgpu::TextureDescriptor {
                label: None,
                size: wgpu::Extent3d { width, height, depth_or_array_layers: 1 },
                mip_level_count: 1,
                sample_count: 1,
                dimension: wgpu::TextureDimension::D2,
                format: PICTURE_FORMAT,
                usage: wgpu::TextureUsages::RENDER_ATTACHMENT | wgpu::TextureUsages::COPY_SRC,
                view_formats: &[],
            });
            let start = Instant::now();
            viewer.update_camera_with_pod(queue, &CameraPod::new(&Lens(camera), UVec2::new(width, height)));
            let mut encoder = device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
            viewer.render(&mut encoder, &target.create_view(&wgpu::TextureViewDescriptor::default()));
            queue.submit([encoder.finish()]);
            device.poll(wgpu::PollType::wait_indefinitely()).expect("the device answers");
            if round >= rounds.warm_up {
                times.push(1e3 * start.elapsed().as_secs_f64());
            }
            last = Some(target);
        }
    }
    let last = last.expect("a camera");
    let (lit, pixels) = (lit_pixels(headless, &last), cameras.last().map_or(0, |camera| camera.width * camera.height));
    assert!(lit > 0, "the sorted viewer draws nothing: its times mean nothing");
    println!("sorted viewer: {lit} of {pixels} pixels of the last frame are not black");
    FrameTimes::new(times, Vec::new())
}

/// How many pixels of `texture` are not black.
fn lit_pixels(headless: &Headless, texture: &wgpu::Texture) -> usize {
    let (device, queue) = (headless.device(), headless.queue());
    let row = (4 * texture.width()).next_multiple_of(wgpu::COPY_BYTES_PER_ROW_ALIGNMENT);
    let host = device.create_buffer(&wgpu::BufferDescriptor {
        label: None,
        size: u64::from(row * texture.height()),
        usage: wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST,
        mapped_at_creation: false,
    });
    let mut encoder = device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
    let layout = wgpu::TexelCopyBufferLayout { offset: 0, bytes_per_row: Some(row), rows_per_image: None };
    let target = wgpu::TexelCopyBufferInfo { buffer: &host, layout };
    encoder.copy_texture_to_buffer(texture.as_image_copy(), target, texture.size());
    queue.submit([encoder.finish()]);
    host.slice(..).map_async(wgpu::MapMode::Read, |result| result.expect("mapped"));
    device.poll(wgpu::PollType::wait_indefinitely()).expect("the device answers");
    let bytes = host.slice(..).get_mapped_range().expect("mapped");
    bytes.chunks_exact(4).filter(|pixel| pixel[..3].iter().any(|&byte| byte > 0)).count()
}

/// Kernels of the training renderer on the same adapter.
fn compute(scene: &SceneData, cameras: &[Camera], rounds: Rounds) -> Option<FrameTimes> {
    let device: Device = Device::enumerate(DeviceType::Wgpu).into_iter().next()?;
    let renderer = dpges_train::eval::rendered::Renderer::new(scene, &device);
    let mut times = Vec::new();
    for round in 0..rounds.warm_up + rounds.counted {
        for camera in cameras {
            let start = Instant::now();
            let render = renderer.render(camera).expect("a valid camera");
            device.sync().expect("the device runs");
            drop(render);
            if round >= rounds.warm_up {
                times.push(1e3 * start.elapsed().as_secs_f64());
            }
        }
    }
    Some(FrameTimes::new(times, Vec::new()))
}

fn main() {
    let arguments = Arguments::parse();
    let (scene, cameras) = arguments.scene();
    let headless = Headless::new().expect("a graphics adapter");
    let rounds = Rounds { warm_up: 2, counted: arguments.rounds };
    println!(
        "{}: {} surfels, {} Gaussians, {} x {} px, {} cameras, {} rounds",
        headless.adapter_name(),
        scene.surfels.len(),
        scene.gaussians.len(),
        cameras[0].width,
        cameras[0].height,
        cameras.len(),
        arguments.rounds
    );
    let mut renderer = headless.renderer().expect("a renderer");
    renderer.upload(&scene).expect("a scene that fits");
    let mut own = None;
    for layers in 1..=4 {
        let options = RenderOptions { layer_count: layers, ..RenderOptions::from(&scene.info) };
        let times = frame_times(&headless, &mut renderer, &cameras, &options, rounds).expect("frames");
        let passes = times.passes.iter().map(|pass| format!("{} {:.0} %", pass.name, 100.0 * pass.share));
        println!(
            "raster, K = {layers}: {:.2} frames/s, p50 {:.2} ms, p99 {:.2} ms; {}",
            times.frames_per_second,
            times.p50_ms,
            times.p99_ms,
            passes.collect::<Vec<_>>().join(", ")
        );
        if layers == scene.info.layer_count {
            own = Some(times.p50_ms);
        }
    }
    let own = own.expect("a scene of at most four layers");
    let others = [
        ("sorted viewer (wgpu-3dgs-viewer)", Some(sorted_viewer(&headless, &scene, &cameras, rounds))),
        ("compute kernels (training renderer)", compute(&scene, &cameras, rounds)),
    ];
    for (name, times) in others {
        let Some(times) = times else { continue };
        let FrameTimes { frames_per_second, p50_ms, p99_ms, .. } = times;
        println!(
            "{name}: {frames_per_second:.2} frames/s, p50 {p50_ms:.2} ms, p99 {p99_ms:.2} ms; raster is {:.2} x as fast",
            p50_ms / own
        );
    }
}
