//! The renderer: a scene on a device, drawn into a view of a texture.

mod paged;

use std::iter::once;
use std::ops::Range;
use std::slice::from_ref;

use dpges_core::camera::Camera;
use dpges_core::scene::{BlendOrder, Peeling, Rendering, SceneData, SceneInfo};
use wgpu::util::DeviceExt;

use crate::error::{RenderError, Result};
use crate::groups::Groups;
use crate::image::Rgb8Image;
use crate::options::{DepthSource, Display, Precision, RenderOptions};
use crate::order::back_to_front;
use crate::passes::{DRAWN_FORMATS, Fading, Frame, Kit, ORDER_FORMAT, Passes, textures_group};
use crate::percentile::{DEPTH_PERCENTILES, percentiles};
use crate::profile::{PassTime, Profile};
use crate::scene::{Fades, Grid, PackedCell, Places, SceneTextures, write};
use crate::targets::{PerPrimitive, Targets};
use crate::texture::{size, texels, texture};

/// Draws one scene at a time. Works on any device of wgpu, with the limits of WebGL2.
#[derive(Debug)]
pub struct RasterRenderer {
    device: wgpu::Device,
    queue: wgpu::Queue,
    format: wgpu::TextureFormat,
    sums: wgpu::TextureFormat,
    depths: DepthSource,
    frame_layout: wgpu::BindGroupLayout,
    passes: Passes,
    fading: Fading,
    profile: Profile,
    scene: Option<Uploaded>,
    targets: Option<Targets>,
    groups: Option<Groups>,
    /// Near plane of the last frame, and how its layers were peeled; `None` of a scene without.
    last: Option<(f64, Peeling)>,
}

#[derive(Debug)]
struct Uploaded {
    textures: SceneTextures,
    per_primitive: PerPrimitive,
    /// Positions of Gaussians that are blended in an order; empty if none is needed.
    positions: Vec<[f32; 3]>,
    drawn: Places,
    fades: Option<Fades>,
}

/// The target of a pass, before its pipeline is set.
type Attachment<'a> = (&'a wgpu::TextureView, wgpu::LoadOp<wgpu::Color>);

/// Whether scenes of this kind are drawn at all.
///
/// # Errors
/// [`RenderError::NotDrawn`] for Student's t kernels and for weighted sums.
pub fn check_drawn(info: &SceneInfo) -> Result<()> {
    match info.rendering {
        Rendering::Students => Err(RenderError::NotDrawn("Student's t kernels (SSS)")),
        Rendering::Summed => Err(RenderError::NotDrawn("weighted sums (sort-free Gaussians)")),
        Rendering::Peeled | Rendering::Ellipsoids | Rendering::Discs => Ok(()),
    }
}

/// Whether scenes of this kind are drawn as they were trained. Others are sorted by the centres of their Gaussians.
///
/// # Errors
/// [`RenderError::NotDrawn`] as [`check_drawn`], and for Gaussians that are sorted for each pixel or met by rays.
pub fn check_drawn_as_trained(info: &SceneInfo) -> Result<()> {
    check_drawn(info)?;
    match info.blend_order {
        BlendOrder::Centres => Ok(()),
        BlendOrder::Rays => Err(RenderError::NotDrawn("Gaussians that are sorted for each pixel (StopThePop)")),
        BlendOrder::Whitened(_) => Err(RenderError::NotDrawn("Gaussians that rays meet without a projection (HTGS)")),
    }
}

impl RasterRenderer {
    /// A renderer into views of `format`. A device without [`wgpu::Features::FLOAT32_BLENDABLE`] can do
    /// [`Precision::Half`] only.
    ///
    /// # Errors
    /// [`RenderError::Device`] if the device lacks what `precision` needs.
    pub fn new(
        device: &wgpu::Device,
        queue: &wgpu::Queue,
        format: wgpu::TextureFormat,
        precision: Precision,
        depths: DepthSource,
    ) -> Result<Self> {
        let sums = match precision {
            Precision::Float => wgpu::TextureFormat::Rgba32Float,
            Precision::Half => wgpu::TextureFormat::Rgba16Float,
        };
        if precision == Precision::Float && Self::best_precision(device) != Precision::Float {
            return Err(RenderError::Device("it cannot blend 32-bit floats: use half precision".to_owned()));
        }
        let frame_layout = device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor {
            label: Some("frame"),
            entries: &[wgpu::BindGroupLayoutEntry {
                binding: 0,
                visibility: wgpu::ShaderStages::VERTEX_FRAGMENT,
                ty: wgpu::BindingType::Buffer {
                    ty: wgpu::BufferBindingType::Uniform,
                    has_dynamic_offset: false,
                    min_binding_size: None,
                },
                count: None,
            }],
        });
        let fading = Fading::Whole;
        let passes = Passes::new(&Kit { device, frame: &frame_layout }, sums, format, depths, fading);
        Ok(Self {
            device: device.clone(),
            queue: queue.clone(),
            format,
            sums,
            depths,
            frame_layout,
            passes,
            fading,
            profile: Profile::new(device)?,
            scene: None,
            targets: None,
            groups: None,
            last: None,
        })
    }

    /// The highest precision that `device` can do.
    pub fn best_precision(device: &wgpu::Device) -> Precision {
        if device.features().contains(wgpu::Features::FLOAT32_BLENDABLE) { Precision::Float } else { Precision::Half }
    }

    /// [`DepthSource::Computed`] for drivers that emulate a GPU. A GPU moves corners to steps of
    /// 1/256 px, and saves much of the work by the depths that it interpolates.
    pub fn best_depths(device: &wgpu::Device) -> DepthSource {
        let info = device.adapter_info();
        // in browsers its name is all there is
        let named = [&info.name, &info.driver].iter().any(|name| name.to_lowercase().contains("swiftshader"));
        if info.device_type == wgpu::DeviceType::Cpu || named { DepthSource::Computed } else { DepthSource::Rasterised }
    }

    /// Features of `adapter` that a device should be created with: blending of 32-bit floats, timestamps. None is
    /// needed.
    pub fn required_features(adapter: &wgpu::Adapter) -> wgpu::Features {
        adapter.features() & (wgpu::Features::FLOAT32_BLENDABLE | wgpu::Features::TIMESTAMP_QUERY)
    }

    /// Whether `adapter` can draw into the formats that the renderer needs between passes.
    ///
    /// # Errors
    /// [`RenderError::Adapter`] naming the first format that it cannot.
    pub fn check_adapter(adapter: &wgpu::Adapter) -> Result<()> {
        let draws = |&format: &wgpu::TextureFormat| {
            let usages = adapter.get_texture_format_features(format).allowed_usages;
            usages.contains(wgpu::TextureUsages::RENDER_ATTACHMENT | wgpu::TextureUsages::TEXTURE_BINDING)
        };
        match DRAWN_FORMATS.iter().find(|format| !draws(format)) {
            Some(format) => Err(RenderError::Adapter {
                adapter: adapter.get_info().name,
                reason: format!("it cannot draw into textures of format {format:?}"),
            }),
            None => Ok(()),
        }
    }

    /// Takes `scene` in place of what was there.
    ///
    /// # Errors
    /// [`RenderError::NotDrawn`] for Student's t kernels and for weighted sums, [`RenderError::TooMany`] if it does not fit into
    /// textures of this device, [`RenderError::Input`] if its environment is of no degree; what was there stays.
    pub fn upload(&mut self, scene: &SceneData) -> Result<()> {
        check_drawn(&scene.info)?;
        let is_sorted = scene.info.rendering != Rendering::Peeled;
        let positions = if is_sorted { scene.gaussians.positions.as_chunks::<3>().0.to_vec() } else { Vec::new() };
        let counts = [scene.surfels.len(), scene.gaussians.len()];
        let textures = SceneTextures::with_room(&self.device, scene, counts)?;
        let drawn = counts.map(|count| once(0..count as u32).collect());
        PackedCell::new(scene).write(&self.queue, &textures, &drawn);
        self.take(textures, positions, drawn, None);
        Ok(())
    }

    fn take(&mut self, textures: SceneTextures, positions: Vec<[f32; 3]>, drawn: Places, fades: Option<Fades>) {
        let fading = if fades.is_some() { Fading::Paged } else { Fading::Whole };
        if self.fading != fading {
            let kit = Kit { device: &self.device, frame: &self.frame_layout };
            self.passes = Passes::new(&kit, self.sums, self.format, self.depths, fading);
            self.fading = fading;
        }
        let per_primitive = PerPrimitive::new(&self.device, &textures);
        self.scene = Some(Uploaded { textures, per_primitive, positions, drawn, fades });
        self.groups = None;
        self.last = None;
    }

    pub fn scene_info(&self) -> Option<&SceneInfo> {
        self.scene.as_ref().map(|scene| &scene.textures.info)
    }

    pub fn surfel_count(&self) -> usize {
        self.scene.as_ref().map_or(0, |scene| length(&scene.drawn[0]))
    }

    pub fn gaussian_count(&self) -> usize {
        self.scene.as_ref().map_or(0, |scene| length(&scene.drawn[1]))
    }

    /// Records a picture from `camera` into the upper left of `target`, `camera.width` × `camera.height` px. Submit the
    /// encoder, then call [`finish_frame`](Self::finish_frame).
    ///
    /// # Errors
    /// [`RenderError::Input`] for a camera or an option out of range and for a camera with a lens, [`RenderError::PictureTooLarge`],
    /// [`RenderError::NoScene`], [`RenderError::Display`].
    pub fn render(
        &mut self,
        encoder: &mut wgpu::CommandEncoder,
        target: &wgpu::TextureView,
        camera: &Camera,
        options: &RenderOptions,
    ) -> Result<()> {
        self.check(camera)?;
        options.validate()?;
        let rendering = self.scene.as_ref().ok_or(RenderError::NoScene)?.textures.info.rendering;
        use Display::{Gaussians, Image, Overdraw, Transmittance};
        if rendering != Rendering::Peeled && !matches!(options.display, Image | Gaussians | Transmittance | Overdraw) {
            return Err(RenderError::Display { display: options.display, rendering });
        }
        self.prepare(camera.width as u32, camera.height as u32);
        let frame = self.frame_group(camera, options);
        if rendering == Rendering::Peeled {
            self.peeled(encoder, &frame, options);
        } else {
            self.sorted(encoder, &frame, camera, options);
        }
        self.present(encoder, &frame, target, camera, options.display);
        self.profile.resolve(encoder);
        self.last = (rendering == Rendering::Peeled).then_some((camera.near, options.peeling));
        Ok(())
    }

    fn check(&self, camera: &Camera) -> Result<()> {
        camera.validate()?;
        camera.require_pinhole()?;
        let side_px = self.device.limits().max_texture_dimension_2d;
        if camera.width.max(camera.height) > side_px as usize {
            return Err(RenderError::PictureTooLarge { width: camera.width, height: camera.height, side_px });
        }
        Ok(())
    }

    /// Records a picture as [`render`](Self::render) does, and submits it.
    pub fn submit(&mut self, target: &wgpu::TextureView, camera: &Camera, options: &RenderOptions) -> Result<()> {
        let mut encoder = self.device.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        self.render(&mut encoder, target, camera, options)?;
        self.queue.submit([encoder.finish()]);
        Ok(())
    }

    /// The texels of a picture, row by row. Waits for the GPU, which browsers do not allow.
    ///
    /// # Errors
    /// The errors of [`render`](Self::render); [`RenderError::Device`] if it cannot be read back.
    pub fn texels(&mut self, camera: &Camera, options: &RenderOptions) -> Result<Vec<u8>> {
        self.check(camera)?;
        let size = size(camera.width as u32, camera.height as u32);
        let usage = wgpu::TextureUsages::RENDER_ATTACHMENT | wgpu::TextureUsages::COPY_SRC;
        let target = texture(&self.device, size, self.format, usage);
        self.submit(&target, camera, options)?;
        self.finish_frame();
        let failed = || RenderError::Device("the picture could not be read back".to_owned());
        texels(&self.device, &self.queue, target.texture(), wgpu::Origin3d::ZERO, size).ok_or_else(failed)
    }

    /// A picture, of a renderer into four bytes: red, green, blue, opacity. Waits as [`texels`](Self::texels) does.
    pub fn picture(&mut self, camera: &Camera, options: &RenderOptions) -> Result<Rgb8Image> {
        let texels = self.texels(camera, options)?;
        let pixels = texels.as_chunks::<4>().0.iter().map(|&[red, green, blue, _]| [red, green, blue]);
        Ok(Rgb8Image::from_pixels(camera.width, camera.height, pixels))
    }

    /// After the submission of what [`render`](Self::render) recorded: takes the times of finished frames.
    pub fn finish_frame(&mut self) {
        self.profile.finish_frame(&self.queue);
    }

    /// Times of the last frame that the GPU has finished; `None` on a device without timestamps.
    pub fn pass_times(&self) -> Option<&[PassTime]> {
        self.profile.times()
    }

    /// Depth (camera-space z, world units) of the nearest surfel at a pixel of the last frame; `None` where there is
    /// none. Waits for the GPU, which browsers do not allow.
    pub fn depth_at(&self, x_px: u32, y_px: u32) -> Option<f64> {
        let targets = self.targets.as_ref()?;
        let (near, peeling) = self.last?;
        if x_px >= targets.size.width || y_px >= targets.size.height {
            return None;
        }
        let origin = wgpu::Origin3d { x: x_px, y: y_px, z: 0 };
        // cores are not among the layers that were peeled
        let cores = peeling.is_continuous().then_some(&targets.cores);
        let depths = [Some(&targets.layers[0].nearest), cores].into_iter().flatten().filter_map(|layer| {
            let bytes = texels(&self.device, &self.queue, layer.texture(), origin, size(1, 1))?;
            let words: &[u32] = bytemuck::cast_slice(&bytes);
            let depth = near / f64::from(f32::from_bits(words[0]));
            (words[1] != u32::MAX && depth.is_finite()).then_some(depth)
        });
        depths.reduce(f64::min)
    }

    /// Depths [height, width] of the last frame: of the first surfel behind which no more than half of the light passes, world
    /// units; 0 where there is none. `None` of scenes without layers. Waits as [`depth_at`](Self::depth_at) does.
    pub fn median_depths(&self) -> Option<Vec<f32>> {
        let targets = self.targets.as_ref()?;
        let (near, peeling) = self.last?;
        let read = |view: &wgpu::TextureView| {
            texels(&self.device, &self.queue, view.texture(), wgpu::Origin3d::ZERO, targets.size)
        };
        // 1 / depth of what is nearest there; 0 where nothing is
        let inverses = |view: &wgpu::TextureView| -> Option<Vec<f32>> {
            let texels = read(view)?;
            let of_texel = |texel: &[u8; 8]| match texel {
                [.., u8::MAX, u8::MAX, u8::MAX, u8::MAX] => 0.0,
                &[a, b, c, d, ..] => f32::from_le_bytes([a, b, c, d]),
            };
            Some(texels.as_chunks::<8>().0.iter().map(of_texel).collect())
        };
        let area = (targets.size.width * targets.size.height) as usize;
        // cores are not among the layers that were peeled, some of which lie behind them
        let cores = if peeling.is_continuous() { inverses(&targets.cores)? } else { vec![0.0; area] };
        let (mut depths, mut passing) = (vec![0.0; area], vec![1.0; area]);
        for layer in &targets.layers {
            let (nearest, opacity) = (inverses(&layer.nearest)?, read(&layer.opacity)?);
            for (pixel, (&inverse, opacity)) in nearest.iter().zip(opacity.as_chunks::<2>().0).enumerate() {
                if passing[pixel] > 0.5 && inverse > cores[pixel] {
                    passing[pixel] *= 1.0 - half::f16::from_le_bytes(*opacity).to_f32();
                    depths[pixel] = if passing[pixel] <= 0.5 { near as f32 / inverse } else { 0.0 };
                }
            }
        }
        let through =
            depths.iter_mut().zip(passing).zip(cores).filter(|((_, passing), core)| *passing > 0.5 && *core > 0.0);
        through.for_each(|((depth, _), core)| *depth = near as f32 / core);
        Some(depths)
    }

    fn prepare(&mut self, width: u32, height: u32) {
        if self.targets.as_ref().is_none_or(|targets| targets.size != size(width, height)) {
            self.targets = Some(Targets::new(&self.device, width, height, self.sums));
            self.groups = None;
        }
        if let (None, Some(targets), Some(scene)) = (&self.groups, &self.targets, &self.scene) {
            let fades = scene.fades.as_ref();
            let (textures, per_primitive) = (&scene.textures, &scene.per_primitive);
            self.groups = Some(Groups::new(&self.device, &self.passes, textures, per_primitive, targets, fades));
        }
    }

    fn frame_group(&self, camera: &Camera, options: &RenderOptions) -> wgpu::BindGroup {
        let (scene, _, _) = self.prepared();
        let depths =
            if options.display == Display::Depth { depth_range(&scene.textures.sample, camera) } else { [0.0; 2] };
        let frame = Frame::new(&scene.textures, camera, options, depths, self.format.is_srgb());
        let buffer = self.device.create_buffer_init(&wgpu::util::BufferInitDescriptor {
            label: Some("frame"),
            contents: bytemuck::bytes_of(&frame),
            usage: wgpu::BufferUsages::UNIFORM,
        });
        self.device.create_bind_group(&wgpu::BindGroupDescriptor {
            label: Some("frame"),
            layout: &self.frame_layout,
            entries: &[wgpu::BindGroupEntry { binding: 0, resource: buffer.as_entire_binding() }],
        })
    }

    fn prepared(&self) -> (&Uploaded, &Targets, &Groups) {
        match (&self.scene, &self.targets, &self.groups) {
            (Some(scene), Some(targets), Some(groups)) => (scene, targets, groups),
            _ => unreachable!("`prepare` made them"),
        }
    }

    fn peeled(&self, encoder: &mut wgpu::CommandEncoder, frame: &wgpu::BindGroup, options: &RenderOptions) {
        let (scene, targets, groups) = self.prepared();
        let (passes, per_primitive) = (&self.passes, &scene.per_primitive);
        let visible = options.footprint.squared_radius(options.modulation) > 0.0;
        let surfels = if visible { &scene.drawn[0][..] } else { &[] };
        let gaussians = &scene.drawn[1][..];
        let whole = |pass: &mut wgpu::RenderPass, grid: Grid, drawn: &[Range<u32>]| {
            let rows = drawn.iter().map(|range| range.end).max().unwrap_or(0).div_ceil(1 << grid.log2_width);
            pass.set_scissor_rect(0, 0, 1 << grid.log2_width, rows);
        };
        let counting = options.display == Display::Overdraw;
        let (zero, nothing) = (wgpu::LoadOp::Clear(wgpu::Color::TRANSPARENT), wgpu::LoadOp::Clear(NOTHING));

        if length(surfels) > 0 {
            let attachments = &[(&per_primitive.colours, zero)];
            self.pass(encoder, "colours", attachments, None, |pass| {
                whole(pass, scene.textures.surfels.grid, surfels);
                draw(pass, &passes.colours.pipeline, [frame, &groups.colours], 3, ONCE);
            });
        }
        if length(gaussians) > 0 {
            let attachments = &[(&per_primitive.firsts, zero), (&per_primitive.seconds, zero)];
            self.pass(encoder, "project", attachments, None, |pass| {
                whole(pass, scene.textures.gaussians.grid, gaussians);
                draw(pass, &passes.project.pipeline, [frame, &groups.project], 3, ONCE);
            });
        }
        if options.peeling.is_continuous() {
            let (attachments, depth) = (&[(&targets.cores, nothing)], Some((&targets.depth, true)));
            self.pass(encoder, "peel", attachments, depth, |pass| {
                if length(surfels) > 0 {
                    draw(pass, &passes.peel.core, [frame, &groups.core], 4, surfels);
                }
            });
        }
        for (k, layer) in targets.layers.iter().enumerate() {
            // layers that are not asked for say that nothing is there
            let asked = k < options.peels();
            let attachments = &[(&layer.nearest, nothing), (&layer.opacity, zero)];
            let depth = Some((&targets.depth, true));
            self.pass(encoder, "peel", attachments, depth, |pass| {
                if asked && length(surfels) > 0 {
                    let groups = [frame, &groups.peel[k]];
                    let (before, pipeline) = passes.peel.of(k, options);
                    if let Some(before) = before {
                        draw(pass, before, groups, 3, ONCE);
                    }
                    draw(pass, pipeline, groups, 4, surfels);
                }
            });
        }
        let attachments = &[(&targets.surfels, zero), (&targets.intervals, zero), (&targets.throughs, zero)];
        self.pass(encoder, "resolve", attachments, Some((&targets.depth, true)), |pass| {
            draw(pass, &passes.resolve.pipeline, [frame, &groups.resolve], 3, ONCE);
        });
        if counting {
            self.pass(encoder, "splat", &[(&targets.sums, zero)], None, |pass| {
                draw(pass, &passes.peel.count, [frame, &groups.peel[0]], 4, surfels);
            });
        }
        let sums = if counting { wgpu::LoadOp::Load } else { zero };
        self.pass(encoder, "splat", &[(&targets.sums, sums)], Some((&targets.depth, false)), |pass| {
            let pipeline = if counting { &passes.splat.count } else { passes.splat.of(options) };
            draw(pass, pipeline, [frame, &groups.splat], 4, gaussians);
        });
    }

    fn sorted(
        &self,
        encoder: &mut wgpu::CommandEncoder,
        frame: &wgpu::BindGroup,
        camera: &Camera,
        options: &RenderOptions,
    ) {
        let (scene, targets, groups) = self.prepared();
        let (passes, per_primitive, gaussians) = (&self.passes, &scene.per_primitive, &scene.textures.gaussians);
        let zero = wgpu::LoadOp::Clear(wgpu::Color::TRANSPARENT);
        let discs = scene.textures.info.rendering == Rendering::Discs;
        if discs {
            self.pass(encoder, "colours", &[(&per_primitive.colours, zero)], None, |pass| {
                draw(pass, &passes.colours.pipeline, [frame, &groups.colours], 3, ONCE);
            });
        } else {
            let attachments = &[(&per_primitive.firsts, zero), (&per_primitive.seconds, zero)];
            self.pass(encoder, "project", attachments, None, |pass| {
                draw(pass, &passes.project.pipeline, [frame, &groups.project], 3, ONCE);
            });
        }
        let order = back_to_front(&scene.positions, camera);
        let list = gaussians.grid.texture(&self.device, ORDER_FORMAT);
        write(&self.queue, &list, gaussians.grid, 0, &order);
        let PerPrimitive { colours, firsts, seconds } = per_primitive;
        let views = [&list, firsts, seconds, &gaussians.places, &gaussians.forms, colours];
        let group = textures_group(&self.device, &passes.sorted.layout, &views);
        let pipeline = match (discs, options.display == Display::Overdraw) {
            (true, false) => &passes.sorted.discs,
            (false, false) => &passes.sorted.ellipses,
            (true, true) => &passes.sorted.count_discs,
            (false, true) => &passes.sorted.count_ellipses,
        };
        self.pass(encoder, "sorted", &[(&targets.sums, zero)], None, |pass| {
            draw(pass, pipeline, [frame, &group], 4, from_ref(&(0..order.len() as u32)));
        });
    }

    fn present(
        &self,
        encoder: &mut wgpu::CommandEncoder,
        frame: &wgpu::BindGroup,
        target: &wgpu::TextureView,
        camera: &Camera,
        display: Display,
    ) {
        let (scene, _, groups) = self.prepared();
        let present = &self.passes.present;
        let pipeline = match (scene.textures.is_peeled(), display) {
            (true, Display::Image) => &present.image,
            (true, _) => &present.peeled,
            (false, _) => &present.blended,
        };
        self.pass(encoder, "present", &[(target, wgpu::LoadOp::Load)], None, |pass| {
            pass.set_viewport(0.0, 0.0, camera.width as f32, camera.height as f32, 0.0, 1.0);
            draw(pass, pipeline, [frame, &groups.present], 3, ONCE);
        });
    }

    /// Records one pass. With a depth buffer that is cleared, or only tested.
    fn pass(
        &self,
        encoder: &mut wgpu::CommandEncoder,
        name: &'static str,
        attachments: &[Attachment],
        depth: Option<(&wgpu::TextureView, bool)>,
        draw: impl FnOnce(&mut wgpu::RenderPass),
    ) {
        let mut colours = Vec::with_capacity(attachments.len());
        for &(view, load) in attachments {
            let ops = wgpu::Operations { load, store: wgpu::StoreOp::Store };
            colours.push(Some(wgpu::RenderPassColorAttachment { view, depth_slice: None, resolve_target: None, ops }));
        }
        let cleared = wgpu::Operations { load: wgpu::LoadOp::Clear(0.0), store: wgpu::StoreOp::Store };
        let query = self.profile.begin(name, encoder);
        let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
            label: Some(name),
            color_attachments: &colours,
            depth_stencil_attachment: depth.map(|(view, clears)| wgpu::RenderPassDepthStencilAttachment {
                view,
                depth_ops: clears.then_some(cleared),
                stencil_ops: None,
            }),
            timestamp_writes: query.as_ref().and_then(|query| query.render_pass_timestamp_writes()),
            occlusion_query_set: None,
            multiview_mask: None,
        });
        draw(&mut pass);
        drop(pass);
        self.profile.end(encoder, query);
    }
}

/// A layer where nothing is, as the clear value of its texture.
const NOTHING: wgpu::Color = {
    let all = u32::MAX as f64;
    wgpu::Color { r: 0.0, g: all, b: 0.0, a: 0.0 }
};

const ONCE: &[Range<u32>] = &[Range { start: 0, end: 1 }];

fn draw(
    pass: &mut wgpu::RenderPass,
    pipeline: &wgpu::RenderPipeline,
    groups: [&wgpu::BindGroup; 2],
    vertices: u32,
    instances: &[Range<u32>],
) {
    pass.set_pipeline(pipeline);
    pass.set_bind_group(0, groups[0], &[]);
    pass.set_bind_group(1, groups[1], &[]);
    for range in instances {
        pass.draw(0..vertices, range.clone());
    }
}

fn length(ranges: &[Range<u32>]) -> usize {
    ranges.iter().map(Range::len).sum()
}

fn depth_range(positions: &[[f32; 3]], camera: &Camera) -> [f64; 2] {
    let depths = positions.iter().map(|position| camera.depth(position.map(f64::from).into()));
    percentiles(depths.filter(|&depth| depth > camera.near).collect(), DEPTH_PERCENTILES).unwrap_or([0.0, 1.0])
}
