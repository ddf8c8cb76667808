//! Pipelines from few words: what passes have in common.

use std::borrow::Cow;

use super::DEPTH_FORMAT;

/// Types of the texels that passes load.
pub(crate) const FLOAT: wgpu::TextureSampleType = wgpu::TextureSampleType::Float { filterable: false };
pub(crate) const UINT: wgpu::TextureSampleType = wgpu::TextureSampleType::Uint;

#[derive(Debug)]
pub(crate) struct Kit<'a> {
    pub device: &'a wgpu::Device,
    /// Group 0: the frame.
    pub frame: &'a wgpu::BindGroupLayout,
}

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

type Target = (wgpu::TextureFormat, Option<wgpu::BlendState>);

#[derive(Clone, Copy, Debug)]
pub(crate) struct Stage<'a> {
    pub vertex: &'a str,
    pub fragment: &'a str,
    pub targets: &'a [Target],
    /// Whether colours are written.
    pub writes: bool,
    pub depth: Depth,
    /// A strip of two triangles rather than one triangle.
    pub quads: bool,
}

impl<'a> Stage<'a> {
    /// Draws `targets` all over, by the entry points `vertex` and `fragment`.
    pub const fn over(targets: &'a [Target]) -> Self {
        Self { vertex: "vertex", fragment: "fragment", targets, writes: true, depth: Depth::None, quads: false }
    }
}

/// The shader of a pass, of which its pipelines are made.
pub(crate) struct Program<'a> {
    kit: &'a Kit<'a>,
    label: &'static str,
    shader: wgpu::ShaderModule,
    /// Group 1: textures in the order of their bindings.
    pub layout: wgpu::BindGroupLayout,
}

#[derive(Debug)]
pub(crate) struct Pass {
    pub layout: wgpu::BindGroupLayout,
    pub pipeline: wgpu::RenderPipeline,
}

pub(crate) const ADDITIVE: wgpu::BlendState = {
    let sum = wgpu::BlendComponent {
        src_factor: wgpu::BlendFactor::One,
        dst_factor: wgpu::BlendFactor::One,
        operation: wgpu::BlendOperation::Add,
    };
    wgpu::BlendState { color: sum, alpha: sum }
};

impl Kit<'_> {
    /// The program of `source`, which loads texels of `textures`.
    pub fn program(
        &self,
        label: &'static str,
        source: impl Into<Cow<'static, str>>,
        textures: &[wgpu::TextureSampleType],
    ) -> Program<'_> {
        let source = wgpu::ShaderSource::Wgsl(source.into());
        let entry = |(binding, &sample_type)| wgpu::BindGroupLayoutEntry {
            binding,
            visibility: wgpu::ShaderStages::VERTEX_FRAGMENT,
            ty: wgpu::BindingType::Texture {
                sample_type,
                view_dimension: wgpu::TextureViewDimension::D2,
                multisampled: false,
            },
            count: None,
        };
        let entries: Vec<_> = (0..).zip(textures).map(entry).collect();
        let layout = wgpu::BindGroupLayoutDescriptor { label: Some(label), entries: &entries };
        Program {
            kit: self,
            label,
            shader: self.device.create_shader_module(wgpu::ShaderModuleDescriptor { label: Some(label), source }),
            layout: self.device.create_bind_group_layout(&layout),
        }
    }

    pub fn pass(
        &self,
        label: &'static str,
        source: &'static str,
        textures: &[wgpu::TextureSampleType],
        stage: &Stage,
    ) -> Pass {
        let program = self.program(label, source, textures);
        Pass { pipeline: program.pipeline(stage), layout: program.layout }
    }
}

impl Program<'_> {
    pub fn pipeline(&self, stage: &Stage) -> wgpu::RenderPipeline {
        let Self { kit: Kit { device, frame }, label, shader, layout } = self;
        let layout = device.create_pipeline_layout(&wgpu::PipelineLayoutDescriptor {
            label: Some(label),
            bind_group_layouts: &[Some(frame), Some(layout)],
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
        device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
            label: Some(label),
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
