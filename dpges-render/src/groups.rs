//! Bind groups of a scene that is drawn into targets.

use crate::passes::{Passes, textures_group};
use crate::scene::{Fades, SceneTextures};
use crate::targets::{PerPrimitive, Targets};

#[derive(Debug)]
pub(crate) struct Groups {
    pub colours: wgpu::BindGroup,
    pub project: wgpu::BindGroup,
    /// While the cores are drawn.
    pub core: wgpu::BindGroup,
    /// That of layer k has layer k − 1 as the previous one.
    pub peel: Vec<wgpu::BindGroup>,
    pub resolve: wgpu::BindGroup,
    pub splat: wgpu::BindGroup,
    pub present: wgpu::BindGroup,
}

impl Groups {
    pub fn new(
        device: &wgpu::Device,
        passes: &Passes,
        scene: &SceneTextures,
        per_primitive: &PerPrimitive,
        targets: &Targets,
        fades: Option<&Fades>,
    ) -> Self {
        let group = |layout, views: &[&wgpu::TextureView]| textures_group(device, layout, views);
        let (surfels, gaussians, layers) = (&scene.surfels, &scene.gaussians, &targets.layers);
        let coloured = if scene.is_peeled() { surfels } else { gaussians };
        // the first layer has no previous one, and its pipeline reads none: any other texture of the format will do
        let previous = |k: usize| &layers[(k + layers.len() - 1) % layers.len()].nearest;
        let [of_surfels, of_gaussians] = [0, 1].map(|kind: usize| fades.map(|fades| &fades.views[kind]));
        let peel_after = |previous, cores| {
            let views = [&surfels.places, &surfels.forms, previous, cores];
            group(&passes.peel.layout, &views.into_iter().chain(of_surfels).collect::<Vec<_>>())
        };
        let peel = |k| peel_after(previous(k), &targets.cores);
        let mut resolve = vec![&surfels.places, &per_primitive.colours, &targets.cores];
        resolve.extend(layers.iter().map(|layer| &layer.nearest));
        resolve.extend(layers.iter().map(|layer| &layer.opacity));
        let mut present = vec![&targets.surfels, &targets.sums, &layers[0].opacity];
        present.extend(layers.iter().map(|layer| &layer.nearest));
        present.extend([&targets.cores, &surfels.forms]);
        let splat = [&per_primitive.firsts, &per_primitive.seconds, &targets.intervals, &targets.throughs];
        Self {
            colours: group(&passes.colours.layout, &[&coloured.places, &coloured.colours]),
            project: group(&passes.project.layout, &[&gaussians.places, &gaussians.forms, &gaussians.colours]),
            core: peel_after(&layers[0].nearest, &layers[0].nearest),
            peel: (0..layers.len()).map(peel).collect(),
            resolve: group(&passes.resolve.layout, &resolve),
            splat: group(&passes.splat.layout, &splat.into_iter().chain(of_gaussians).collect::<Vec<_>>()),
            present: group(&passes.present.layout, &present),
        }
    }
}
