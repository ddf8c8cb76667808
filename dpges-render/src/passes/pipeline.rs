//! Pipelines from few words: what passes have in common.

use wgpu::TextureSampleType::{Float, Uint};

use super::DEPTH_FORMAT;

/// A texture that a pass loads texels of.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Texture {
    Float,
    Uint,
}

/// Makes pipelines.
#[derive(Debug)]
pub(crate) struct Kit<'a> {
    pub device: &'a wgpu::Device,
    /// Group 0: the frame.
    pub frame: &'a wgpu::BindGroupLayout,
}

/// How fragments meet the depth buffer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Depth {
    None,
    /// The nearest stays. The first drawn wins a tie.
    Nearest,
    /// Written without a test.
    Write,
    /// Tested, not written.
    Test,
}

/// One pipeline of a pass.
#[derive(Debug)]
pub(crate) struct Stage<'a> {
    pub label: &'a str,
    pub vertex: &'a str,
    pub fragment: &'a str,
    pub targets: &'a [(wgpu::TextureFormat, Option<wgpu::BlendState>)],
    /// Whether colours are written.
    pub writes: bool,
    pub depth: Depth,
    /// A strip of two triangles rather than one triangle.
    pub quads: bool,
}

/// Sums.
pub(crate) const ADDITIVE: wgpu::BlendState = {
    let sum = wgpu::BlendComponent {
        src_factor: wgpu::BlendFactor::One,
        dst_factor: wgpu::BlendFactor::One,
        operation: wgpu::BlendOperation::Add,
    };
    wgpu::BlendState { color: sum, alpha: sum }
};

impl Kit<'_> {
    pub fn shader(&self, label: &str, source: &'static str) -> wgpu::ShaderModule {
        let source = wgpu::ShaderSource::Wgsl(source.into());
        self.device.create_shader_module(wgpu::ShaderModuleDescriptor { label: Some(label), source })
    }

    /// Layout of group 1: `textures` in the order of their bindings.
    pub fn textures(&self, label: &str, textures: &[Texture]) -> wgpu::BindGroupLayout {
        let entry = |(binding, texture): (usize, &Texture)| wgpu::BindGroupLayoutEntry {
            binding: binding as u32,
            visibility: wgpu::ShaderStages::VERTEX_FRAGMENT,
            ty: wgpu::BindingType::Texture {
                sample_type: if *texture == Texture::Float { Float { filterable: false } } else { Uint },
                view_dimension: wgpu::TextureViewDimension::D2,
                multisampled: false,
            },
            count: None,
        };
        let entries: Vec<_> = textures.iter().enumerate().map(entry).collect();
        self.device.create_bind_group_layout(&wgpu::BindGroupLayoutDescriptor { label: Some(label), entries: &entries })
    }

    pub fn pipeline(
        &self,
        shader: &wgpu::ShaderModule,
        textures: &wgpu::BindGroupLayout,
        stage: &Stage,
    ) -> wgpu::RenderPipeline {
        let layout = self.device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label: Some(stage.label),
            bind_group_layouts: &[Some(self.frame), Some(textures)],
            immediate_size: 0,
        });
        let write_mask = if stage.writes { wgpu::ColorWrites::ALL } else { wgpu::ColorWrites::empty() };
        let target = |&(format, blend): &_| Some(wgpu::ColorTargetState { format, blend, write_mask });
        let targets: Vec<_> = stage.targets.iter().map(target).collect();
        let depth_state = |depth_write_enabled, depth_compare| wgpu::DepthStencilState {
            format: DEPTH_FORMAT,
            depth_write_enabled: Some(depth_write_enabled),
            depth_compare: Some(depth_compare),
            stencil: wgpu::StencilState::default(),
            bias: wgpu::DepthBiasState::default(),
        };
        let depth_stencil = match stage.depth {
            Depth::None => None,
            Depth::Nearest => Some(depth_state(true, wgpu::CompareFunction::Greater)),
            Depth::Write => Some(depth_state(true, wgpu::CompareFunction::Always)),
            Depth::Test => Some(depth_state(false, wgpu::CompareFunction::Greater)),
        };
        let topology =
            if stage.quads { wgpu::PrimitiveTopology::TriangleStrip } else { wgpu::PrimitiveTopology::TriangleList };
        self.device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
            label: Some(stage.label),
            layout: Some(&layout),
            vertex: wgpu::VertexState {
                module: shader,
                entry_point: Some(stage.vertex),
                compilation_options: wgpu::PipelineCompilationOptions::default(),
                buffers: &[],
            },
            primitive: wgpu::PrimitiveState { topology, ..wgpu::PrimitiveState::default() },
            depth_stencil,
            multisample: wgpu::MultisampleState::default(),
            fragment: Some(wgpu::FragmentState {
                module: shader,
                entry_point: Some(stage.fragment),
                compilation_options: wgpu::PipelineCompilationOptions::default(),
                targets: &targets,
            }),
            multiview_mask: None,
            cache: None,
        })
    }
}

/// Group 1: `views` in the order of their bindings.
pub(crate) fn textures_group(
    device: &wgpu::Device,
    layout: &wgpu::BindGroupLayout,
    views: &[&wgpu::TextureView],
) -> wgpu::BindGroup {
    let resources = views.iter().map(|view| wgpu::BindingResource::TextureView(view));
    let entries: Vec<_> =
        (0..).zip(resources).map(|(binding, resource)| wgpu::BindGroupEntry { binding, resource }).collect();
    device.create_bind_group(&wgpu::BindGroupDescriptor { label: None, layout, entries: &entries })
}
