//! A scene as one cloud of splats.
//!
//! No sorted cloud can express what peeling and order-free Gaussians draw, so this is an approximation. It has three
//! parts, in the order of what they cost:
//!
//! **Which Gaussians are seen.** A Gaussian less than the margin ε behind a surfel counts as in front of it. A renderer
//! that sorts centres hides it. Nothing in a cloud can say otherwise.
//!
//! **Gaussians.** A lone Gaussian of weight α over a colour C_s gives `(C_s + α c) / (1 + α)`, which is an opacity of
//! `α' = α / (1 + α)` blended over C_s, exactly. Its footprint `o g / (1 + o g)`, with kernel g, is flatter than a
//! kernel: the splat has the opacity of its peak, `o' = o / (1 + o)`, and scales larger by
//! `√(ln(1 + o) (1 + o) / o)`, so that it covers as much in sum over the plane. Where many overlap, sorted blending lets
//! the nearest weigh more than their order-free mean does.
//!
//! **Surfels.** A surfel's opacity `min(1, w G)` is 1 up to the radius `√(2 ln w)` σ. The splat is as opaque as splats
//! can be, [`LARGEST_OPACITY`], its disc is scaled so that this radius is [`OPAQUE_RADIUS_SIGMAS`] of its standard
//! deviations, and it is as thick as a thousandth of its smaller scale. Covering as much as the surfel would ask for a
//! larger scale (2.07 instead of 1.30 at w = 30), but that hides more of the Gaussians within the margin, and the
//! picture loses more: 2.0 dB at the built-in scene.
//!
//! Colours become spherical harmonics (exactly, if they are; else see the module `harmonics`). Discs and ellipsoids of a
//! scene that is blended already stay what they are.

use dpges_core::scene::{BlendOrder, ColourModel, GaussianData, Rendering, SceneData, SceneInfo};

use super::cloud::SplatCloud;
use super::error::ExportError;
use super::harmonics::{MAX_DEGREE, coefficient_count, coefficients};
use crate::scene::unit_quaternion;

/// Rasterisers cap opacity here (3DGS), and its logit stays finite.
pub const LARGEST_OPACITY: f32 = 0.99;
/// Splats below this opacity are nowhere drawn; they are left out (3DGS).
pub const SMALLEST_OPACITY: f32 = 1.0 / 255.0;
/// Radius of the opaque part of a surfel in standard deviations of its splat; at its rim the splat's opacity is e^−2.
pub const OPAQUE_RADIUS_SIGMAS: f64 = 2.0;
/// Thickness of a surfel's splat relative to its smaller scale.
const THICKNESS: f64 = 1e-3;

/// Makes a cloud of splats with harmonics of `degree` of a scene. The surfels come first, then the Gaussians, without
/// those too transparent to be drawn.
///
/// # Errors
/// [`ExportError::Degree`] if `degree` is above 3, [`ExportError::Kernel`] for Student's t kernels, [`ExportError::Summed`] for
/// weighted sums, [`ExportError::Empty`] if nothing of the scene can be drawn.
pub fn flatten(scene: &SceneData, degree: usize) -> Result<SplatCloud, ExportError> {
    if degree > MAX_DEGREE {
        return Err(ExportError::Degree { found: degree });
    }
    match scene.info.rendering {
        Rendering::Students => return Err(ExportError::Kernel),
        Rendering::Summed => return Err(ExportError::Summed),
        Rendering::Peeled | Rendering::Ellipsoids | Rendering::Discs => {}
    }
    let count = scene.surfels.len() + scene.gaussians.len();
    let harmonics = Vec::with_capacity(3 * coefficient_count(degree) * count);
    let info = SceneInfo {
        colour_model: ColourModel::SphericalHarmonics { degree },
        rendering: Rendering::Ellipsoids,
        blend_order: BlendOrder::Centres,
        ..scene.info.clone()
    };
    let mut cloud = SplatCloud { degree, harmonics, info, ..SplatCloud::default() };
    let sigma = (2.0 * scene.info.modulation.max(1.0).ln()).sqrt() / OPAQUE_RADIUS_SIGMAS;
    let widen = sigma.ln() as f32;
    for (row, scales) in scene.surfels.log_scales.as_chunks::<2>().0.iter().enumerate() {
        let thin = scales[0].min(scales[1]) + THICKNESS.ln() as f32;
        let surfels = &scene.surfels;
        cloud.push(Splat {
            position: row_of(&surfels.positions, row),
            quaternion: row_of(&surfels.quaternions, row),
            log_scales: [scales[0] + widen, scales[1] + widen, thin],
            opacity: LARGEST_OPACITY,
            harmonics: coefficients(&surfels.colour, row),
        });
    }
    for row in 0..scene.gaussians.len() {
        let splat = gaussian(&scene.gaussians, row, scene.info.rendering);
        if splat.opacity >= SMALLEST_OPACITY {
            cloud.push(splat);
        }
    }
    if cloud.is_empty() { Err(ExportError::Empty { gaussians: scene.gaussians.len() }) } else { Ok(cloud) }
}

/// One row of a cloud; its quaternion need not have unit length.
struct Splat {
    position: [f32; 3],
    quaternion: [f32; 4],
    log_scales: [f32; 3],
    opacity: f32,
    harmonics: super::harmonics::Coefficients,
}

impl SplatCloud {
    fn push(&mut self, splat: Splat) {
        self.positions.push(splat.position);
        self.quaternions.push(unit_quaternion(splat.quaternion).map(|component| component as f32));
        self.log_scales.push(splat.log_scales);
        self.opacities.push(splat.opacity);
        let kept = &splat.harmonics[..coefficient_count(self.degree)];
        self.harmonics.extend(kept.as_flattened().iter().map(|&k| k as f32));
    }
}

fn gaussian(gaussians: &GaussianData, row: usize, rendering: Rendering) -> Splat {
    let (stored, mut log_scales) = (gaussians.opacities[row].max(0.0), row_of::<3>(&gaussians.log_scales, row));
    let opacity = match rendering {
        Rendering::Peeled => {
            let (opacity, widen) = order_free(f64::from(stored));
            log_scales = log_scales.map(|scale| scale + widen as f32);
            opacity as f32
        }
        // the others are refused
        Rendering::Ellipsoids | Rendering::Students | Rendering::Summed => stored,
        Rendering::Discs => {
            log_scales[2] = log_scales[0].min(log_scales[1]) + THICKNESS.ln() as f32;
            stored
        }
    };
    Splat {
        position: row_of(&gaussians.positions, row),
        quaternion: row_of(&gaussians.quaternions, row),
        log_scales,
        opacity: opacity.min(LARGEST_OPACITY),
        harmonics: coefficients(&gaussians.colour, row),
    }
}

/// Opacity, and logarithm of the factor of the scales, of the splat of an order-free Gaussian of opacity `o`.
fn order_free(o: f64) -> (f64, f64) {
    if o < f64::MIN_POSITIVE {
        return (0.0, 0.0);
    }
    (o / (1.0 + o), 0.5 * (o.ln_1p() * (1.0 + o) / o).ln())
}

/// Row `row` of `values` [N, W].
fn row_of<const W: usize>(values: &[f32], row: usize) -> [f32; W] {
    values.as_chunks::<W>().0[row]
}

#[cfg(test)]
mod tests {
    use dpges_core::scene::SurfelData;

    use super::*;

    /// Two surfels and three Gaussians, the last of which is not there.
    fn scene(rendering: Rendering) -> SceneData {
        let model = ColourModel::SphericalBeta { lobes: 2 };
        let count = if rendering == Rendering::Peeled { 2 } else { 0 };
        let mut surfels = SurfelData::neutral(model, count);
        surfels.log_scales = vec![-2.0, -3.0, -1.0, -1.5][..2 * count].to_vec();
        let mut gaussians = GaussianData::neutral(model, 3);
        gaussians.opacities = vec![1.0, 2.5, -0.3];
        gaussians.quaternions[..4].copy_from_slice(&[0.0, 3.0, 0.0, 4.0]);
        let info = SceneInfo { colour_model: model, rendering, ..SceneInfo::default() };
        SceneData { info, surfels, gaussians, environment: None }
    }

    #[test]
    fn a_lone_gaussian_weighs_as_much_in_sorted_blending() {
        for o in [1e-9, 0.01, 0.5, 1.0, 3.0, 50.0f64] {
            let (opacity, widen) = order_free(o);
            // over black: C = o c / (1 + o)
            assert!((opacity - o / (1.0 + o)).abs() < 1e-15);
            // ∫ o g / (1 + o g) over the plane, in units of 2π σ², by the midpoint rule over g = exp(−r² / 2)
            let steps = 200_000;
            let covered: f64 = (0..steps)
                .map(|i| (f64::from(i) + 0.5) / f64::from(steps))
                .map(|g| o / (1.0 + o * g) / f64::from(steps))
                .sum();
            let splat = opacity * (2.0 * widen).exp();
            assert!((splat / covered - 1.0).abs() < 1e-6, "{o}: {splat} {covered}");
        }
        assert_eq!(order_free(0.0), (0.0, 0.0));
    }

    #[test]
    fn surfels_are_thin_and_gaussians_that_are_not_drawn_are_left_out() {
        let cloud = flatten(&scene(Rendering::Peeled), 3).unwrap();
        assert_eq!((cloud.len(), cloud.harmonics.len()), (4, 4 * 48));
        assert_eq!(cloud.opacities[..2], [LARGEST_OPACITY; 2]);
        let [u, v, thin] = cloud.log_scales[0];
        let sigma = (2.0 * 30f32.ln()).sqrt() / 2.0;
        assert!((u + 2.0 - sigma.ln()).abs() < 1e-6 && (v + 3.0 - sigma.ln()).abs() < 1e-6);
        assert!((thin - (-3.0 - 1000f32.ln())).abs() < 1e-5);
        assert_eq!(cloud.opacities[2], 0.5);
        assert_eq!(cloud.quaternions[2], [0.0, 0.6, 0.0, 0.8]);
    }

    #[test]
    fn blended_scenes_stay_what_they_are() {
        let ellipsoids = flatten(&scene(Rendering::Ellipsoids), 0).unwrap();
        assert_eq!((ellipsoids.len(), ellipsoids.opacities[1]), (2, LARGEST_OPACITY));
        assert_eq!(ellipsoids.log_scales[0], [0.0; 3]);
        let discs = flatten(&scene(Rendering::Discs), 0).unwrap();
        assert!(discs.log_scales[0][0] == 0.0 && discs.log_scales[0][2] < -6.0);
        // a cloud is a scene of ellipsoids: flattened again, it is the same
        assert_eq!(flatten(&ellipsoids.to_scene(), 0).unwrap().log_scales, ellipsoids.log_scales);
    }

    #[test]
    fn what_cannot_be_flattened_is_named() {
        assert!(matches!(flatten(&scene(Rendering::Students), 0), Err(ExportError::Kernel)));
        let mut empty = scene(Rendering::Ellipsoids);
        empty.gaussians.opacities.fill(0.0);
        assert!(flatten(&empty, 1).unwrap_err().to_string().contains("3 Gaussians"));
        assert!(flatten(&empty, 4).unwrap_err().to_string().contains("degree 4"));
        assert!(flatten(&scene(Rendering::Summed), 1).unwrap_err().to_string().contains("summed in any order"));
    }
}
