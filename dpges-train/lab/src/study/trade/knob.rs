//! Knobs of drawing a trained scene.
//!
//! A new knob is a variant of [`Change`], a line in [`Change::all`] for the values that are tried, and an arm where it
//! acts: in [`apply`] if it makes another scene, in `bench.rs` if it changes how that scene is drawn.

use std::fmt;

use dpges_core::camera::Camera;
use dpges_core::scene::{Footprint, Quality, Rendering, SceneData};
use dpges_render::MAX_LAYERS;
use dpges_train::eval::simplify::{Contributions, detail_of, with_detail};

/// All knobs by name: those of rendering, then those that only training has. `layers`, `detail` and `resolution` are
/// turned in both.
pub const KNOBS: [&str; 12] = [
    "layers",
    "footprint",
    "modulation",
    "detail",
    "primitives",
    "resolution",
    "sums",
    "compression",
    "budget",
    "colour",
    "method",
    "steps",
];

/// One knob at one of its values.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Change {
    /// K, peeled layers.
    Layers(usize),
    /// Where surfels end.
    Footprint(Footprint),
    /// Factor on w, the steepness of rims.
    Modulation(f64),
    /// Lobes of a colour, or degree of its harmonics.
    Detail(usize),
    /// Share of the primitives that are kept, in per cent: those that contribute most.
    Primitives(u32),
    /// Sides of the drawn picture, in per cent of those of the shown one.
    Resolution(u32),
    /// Gaussians are summed in 16 bits instead of 32.
    HalfSums,
    /// The scene file is compressed, with a level of [`Quality::LEVELS`].
    Compression(usize),
}

impl Change {
    /// Every value of every knob that changes `scene`, knob by knob. 16-bit sums are a choice only where the device
    /// `sums_floats`.
    pub fn all(scene: &SceneData, sums_floats: bool) -> Vec<Self> {
        let info = &scene.info;
        let mut all = Vec::new();
        if info.rendering == Rendering::Peeled {
            let trained = info.layer_count.min(MAX_LAYERS);
            all.extend((1..=MAX_LAYERS).filter(|&layers| layers != trained).map(Self::Layers));
            let footprints = [Footprint::Kernel, Footprint::Opacity];
            all.extend(footprints.into_iter().filter(|&other| other != info.footprint).map(Self::Footprint));
            all.extend([0.5, 2.0, 4.0].map(Self::Modulation));
        }
        all.extend((0..detail_of(info.colour_model)).rev().map(Self::Detail));
        all.extend([75, 50, 25].map(Self::Primitives));
        all.extend([75, 50, 25].map(Self::Resolution));
        all.extend(sums_floats.then_some(Self::HalfSums));
        if info.rendering != Rendering::Students {
            all.extend((0..Quality::LEVELS.len()).map(Self::Compression));
        }
        all
    }

    /// The name of the knob.
    pub fn knob(self) -> &'static str {
        match self {
            Self::Layers(_) => "layers",
            Self::Footprint(_) => "footprint",
            Self::Modulation(_) => "modulation",
            Self::Detail(_) => "detail",
            Self::Primitives(_) => "primitives",
            Self::Resolution(_) => "resolution",
            Self::HalfSums => "sums",
            Self::Compression(_) => "compression",
        }
    }
}

impl fmt::Display for Change {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}=", self.knob())?;
        match self {
            Self::Layers(value) | Self::Detail(value) => write!(f, "{value}"),
            Self::Footprint(Footprint::Kernel) => f.write_str("kernel"),
            Self::Footprint(Footprint::Opacity) => f.write_str("opacity"),
            Self::Modulation(factor) => write!(f, "{factor}w"),
            Self::Primitives(percent) | Self::Resolution(percent) => write!(f, "{percent}%"),
            Self::HalfSums => f.write_str("16bit"),
            Self::Compression(level) => f.write_str(Quality::LEVELS[*level].0),
        }
    }
}

/// The label of a row with these changes.
pub fn label(changes: &[Change]) -> String {
    match changes {
        [] => AS_TRAINED.to_owned(),
        _ => changes.iter().map(Change::to_string).collect::<Vec<_>>().join(" + "),
    }
}

/// The row without any change.
pub const AS_TRAINED: &str = "as trained";

/// `scene` with those of `changes` that make another scene of it. `contributions` are those of `scene`, and
/// `cameras` where it is seen from.
///
/// # Panics
/// If primitives are left out without contributions.
pub fn apply(
    scene: &SceneData,
    changes: &[Change],
    contributions: Option<&Contributions>,
    cameras: &[Camera],
) -> SceneData {
    let mut scene = scene.clone();
    let centres: Vec<[f64; 3]> = cameras.iter().map(|camera| camera.centre().to_array()).collect();
    for &change in changes {
        match change {
            Change::Layers(layers) => scene.info.layer_count = layers,
            Change::Footprint(footprint) => scene.info.footprint = footprint,
            Change::Modulation(factor) => scene.info.modulation *= factor,
            Change::Detail(most) => scene = with_detail(&scene, most, &centres),
            Change::Primitives(percent) => {
                let contributions = contributions.expect("they are measured where primitives are left out");
                scene = contributions.keep_heaviest(&scene, f64::from(percent) / 100.0);
            }
            Change::Resolution(_) | Change::HalfSums | Change::Compression(_) => {}
        }
    }
    scene
}

#[cfg(test)]
pub mod tests {
    use dpges_core::scene::{ColourModel, SceneInfo};
    use dpges_core::testing::scenes::{Recipe, random};

    use super::*;

    /// A scene of 4 surfels and 8 Gaussians, and what they contribute.
    pub fn scene() -> (SceneData, Contributions) {
        let (scene, _) = random(5, &Recipe { surfels: 4, gaussians: 8, ..Recipe::default() }).into_scene();
        let weights = |count: usize, first: usize| (0..count).map(|row| (first + row) as f64).collect();
        (scene, Contributions { surfels: weights(4, 100), gaussians: weights(8, 0) })
    }

    #[test]
    fn every_knob_that_a_scene_has_is_tried_at_values_other_than_its_own() {
        let (scene, _) = scene();
        let labels: Vec<String> = Change::all(&scene, true).iter().map(Change::to_string).collect();
        let expected = "layers=1 layers=2 layers=3 layers=4 footprint=opacity modulation=0.5w modulation=2w modulation=4w \
                        detail=1 detail=0 primitives=75% primitives=50% primitives=25% \
                        resolution=75% resolution=50% resolution=25% sums=16bit";
        let levels = Quality::LEVELS.iter().map(|(name, _)| format!("compression={name}"));
        assert_eq!(labels, expected.split(' ').map(str::to_owned).chain(levels).collect::<Vec<_>>());
        assert!(Change::all(&scene, true).iter().all(|change| KNOBS.contains(&change.knob())));
        assert!(!Change::all(&scene, false).contains(&Change::HalfSums));
        let mut blended = scene;
        blended.info.rendering = Rendering::Ellipsoids;
        blended.info.colour_model = ColourModel::SphericalHarmonics { degree: 1 };
        assert_eq!(Change::all(&blended, false)[..2], [Change::Detail(0), Change::Primitives(75)]);
    }

    #[test]
    fn changes_act_on_the_scene_and_on_nothing_else() {
        let (scene, contributions) = scene();
        let changed = |changes: &[Change]| apply(&scene, changes, Some(&contributions), &[]);
        assert_eq!(changed(&[]), scene);
        assert_eq!(changed(&[Change::HalfSums, Change::Resolution(50), Change::Compression(0)]), scene);
        let found = changed(&[Change::Layers(1), Change::Modulation(2.0), Change::Footprint(Footprint::Opacity)]);
        let info = SceneInfo { layer_count: 1, modulation: 60.0, footprint: Footprint::Opacity, ..scene.info.clone() };
        assert_eq!(found, SceneData { info, ..scene.clone() });
        // 6 of 12: all surfels, and the two last Gaussians
        let half = changed(&[Change::Detail(1), Change::Primitives(50)]);
        assert_eq!((half.surfels.len(), half.gaussians.len()), (4, 2));
        assert_eq!(half.gaussians.positions, scene.gaussians.positions[3 * 6..]);
        assert_eq!(half.info.colour_model, ColourModel::SphericalBeta { lobes: 1 });
        assert_eq!(label(&[Change::Layers(1), Change::Primitives(50)]), "layers=1 + primitives=50%");
        assert_eq!(label(&[]), AS_TRAINED);
    }
}
