//! The passes of a frame, in their order. The WGSL of each stands beside it; `frame`, `harmonics`, `colour`, `behind`,
//! `ellipse` and `layer` hold what several share; `depth_rasterised` and `depth_computed`, `fade_whole` and `fade_paged` what
//! differs between them.
//!
//! | pass | reads | writes |
//! |---|---|---|
//! | [`colours`] | packed surfels | colour of every surfel from this camera |
//! | [`project`] | packed Gaussians | ellipse and colour of every Gaussian |
//! | [`peel`], once if peeling is continuous | surfels | core: nearest opaque fragment, by the depth test |
//! | [`peel`], once for each other layer | surfels, previous layer, core | nearest fragment behind the one and up to the other |
//! | [`resolve`] | layers | C_s; tests of Gaussians and transmittances; the depth that hides |
//! | [`splat`] | ellipses, tests | sums of weighted colours and weights, additively |
//! | [`sorted`] | ellipses or discs, an order | blended colours: scenes that are not peeled |
//! | [`present`] | C_s, sums | the picture |

mod colours;
mod frame;
mod peel;
mod pipeline;
mod present;
mod project;
mod resolve;
mod sorted;
mod splat;

pub(crate) use frame::Frame;
use pipeline::{FLOAT, UINT};
pub(crate) use pipeline::{Kit, textures_group};

use crate::options::DepthSource;

/// Whether all primitives are drawn as they are, or each by the factor of its page.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Fading {
    Whole,
    Paged,
}

impl Fading {
    fn shader(self) -> &'static str {
        match self {
            Self::Whole => include_str!("fade_whole.wgsl"),
            Self::Paged => include_str!("fade_paged.wgsl"),
        }
    }

    /// The textures of a pass, and that of the factors behind them.
    fn with_factors(self, textures: &[wgpu::TextureSampleType]) -> Vec<wgpu::TextureSampleType> {
        let factors = (self == Self::Paged).then_some(FLOAT);
        textures.iter().copied().chain(factors).collect()
    }
}

/// Format of depth buffers: near / z, so that floats are dense where scenes are far.
pub(crate) const DEPTH_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Depth32Float;
/// near / z as bits, index of the surfel.
pub(crate) const LAYER_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Rg32Uint;
pub(crate) const OPACITY_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::R16Float;
pub(crate) const COLOUR_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Rgba16Float;
pub(crate) const RECORD_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Rgba32Uint;
/// 32-bit floats as bits: every device can draw into integers, not every one into 32-bit floats.
pub(crate) const INTERVAL_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Rgba32Uint;
pub(crate) const THROUGH_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Rg32Uint;
pub(crate) const ORDER_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::R32Uint;

/// Formats of textures that are drawn into and read, apart from sums.
pub(crate) const DRAWN_FORMATS: [wgpu::TextureFormat; 6] =
    [LAYER_FORMAT, OPACITY_FORMAT, COLOUR_FORMAT, RECORD_FORMAT, INTERVAL_FORMAT, THROUGH_FORMAT];

#[derive(Debug)]
pub(crate) struct Passes {
    pub colours: pipeline::Pass,
    pub project: pipeline::Pass,
    pub peel: peel::PeelPass,
    pub resolve: pipeline::Pass,
    pub splat: splat::SplatPass,
    pub sorted: sorted::SortedPass,
    pub present: present::PresentPass,
}

impl Passes {
    /// Sums of Gaussians in textures of format `sums`, pictures in those of `format`.
    pub fn new(
        kit: &Kit,
        sums: wgpu::TextureFormat,
        format: wgpu::TextureFormat,
        depths: DepthSource,
        fading: Fading,
    ) -> Self {
        Self {
            colours: colours::pass(kit),
            project: project::pass(kit),
            peel: peel::PeelPass::new(kit, sums, depths, fading),
            resolve: resolve::pass(kit),
            splat: splat::SplatPass::new(kit, sums, fading),
            sorted: sorted::SortedPass::new(kit, sums),
            present: present::PresentPass::new(kit, format),
        }
    }
}

#[cfg(test)]
mod tests {
    /// Every shader is valid for every device: halves are unpacked, which WebGL2 can do, and no more is asked for.
    #[test]
    fn shaders_are_valid() {
        use super::{DepthSource, Fading};
        use wgpu::naga::{front::wgsl, valid};
        let fixed = [
            ("colours", super::colours::SHADER),
            ("project", super::project::SHADER),
            ("resolve", super::resolve::SHADER),
            ("sorted", super::sorted::SHADER),
            ("present", super::present::SHADER),
        ];
        let mut shaders = fixed.map(|(name, source)| (name.to_owned(), source.to_owned())).to_vec();
        for fading in [Fading::Whole, Fading::Paged] {
            shaders.push((format!("splat, {fading:?}"), super::splat::shader(fading)));
            for depths in [DepthSource::Rasterised, DepthSource::Computed] {
                shaders.push((format!("peel, {depths:?}, {fading:?}"), super::peel::shader(depths, fading)));
            }
        }
        let capabilities = valid::Capabilities::SHADER_FLOAT16_IN_FLOAT32;
        for (name, source) in shaders {
            let module = wgsl::parse_str(&source).unwrap_or_else(|error| panic!("{}", error.emit_to_string(&source)));
            let mut validator = valid::Validator::new(valid::ValidationFlags::all(), capabilities);
            validator.validate(&module).unwrap_or_else(|error| panic!("{name}: {error:?}"));
        }
    }
}
