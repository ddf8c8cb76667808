//! Scenes at the extremes of what parameters and cameras can be, made from a seed.

use glam::{DMat3, DQuat, DVec3, Vec3};

use super::random::Random;
use super::scenes::{Recipe, TestScene, random};
use crate::ops::peel::PeelOptions;
use crate::scene::{ColourModel, Footprint, Peeling};

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Hazard {
    /// Scales from e⁻³⁰ world units.
    TinyScales,
    /// Scales up to e²⁰ world units.
    HugeScales,
    /// One scale 10⁶ times another.
    Needles,
    /// Zero, denormal and huge quaternions.
    Quaternions,
    /// Opacities 0, 1e-30, 1e6 and below 0.
    Opacities,
    /// Discs whose normal is perpendicular to the ray to their centre, exactly or nearly.
    EdgeOn,
    /// Discs whose plane holds the centre of the camera, and Gaussians around it.
    AroundCamera,
    /// Centres at the near plane, and within rounding before and behind it.
    AtNearPlane,
    Behind,
    /// A world 10⁻⁶ units across.
    SmallWorld,
    /// A world 10⁷ units across.
    LargeWorld,
    /// A world of a few units, up to 10⁷ units from the origin.
    FarFromOrigin,
    /// A horizontal field of view of 0.1°.
    NarrowView,
    /// A horizontal field of view of 179°.
    WideView,
    OffCentre,
    /// An image of 1 × N, N × 1 or 1 × 1 px.
    ThinImage,
    /// No primitives of one kind or of both, or one.
    Nearly0,
    OnePoint,
    OneDepth,
    /// Lobes with sharpness parameters of ±30.
    SharpLobes,
    PolarLobes,
    /// Surfels that are opaque everywhere, or transparent everywhere.
    Steep,
    /// One surfel 10⁶ times as large as the mean.
    OneHuge,
}

impl Hazard {
    pub const ALL: [Self; 23] = [
        Self::TinyScales,
        Self::HugeScales,
        Self::Needles,
        Self::Quaternions,
        Self::Opacities,
        Self::EdgeOn,
        Self::AroundCamera,
        Self::AtNearPlane,
        Self::Behind,
        Self::SmallWorld,
        Self::LargeWorld,
        Self::FarFromOrigin,
        Self::NarrowView,
        Self::WideView,
        Self::OffCentre,
        Self::ThinImage,
        Self::Nearly0,
        Self::OnePoint,
        Self::OneDepth,
        Self::SharpLobes,
        Self::PolarLobes,
        Self::Steep,
        Self::OneHuge,
    ];

    /// Whether rounding decides: what is there at all (centres at the near plane, positions that f32 holds to a unit), in
    /// which order it is blended (one depth), or gradients that vanish but for rounding (scales far beyond the world).
    pub fn is_decided_by_rounding(self) -> bool {
        matches!(self, Self::AtNearPlane | Self::FarFromOrigin | Self::OnePoint | Self::OneDepth | Self::HugeScales)
    }
}

#[derive(Clone, Debug)]
pub struct Extreme {
    pub seed: u64,
    /// Sorted; empty for an ordinary scene.
    pub hazards: Vec<Hazard>,
    pub scene: TestScene,
    pub peel: PeelOptions,
    /// Half the size of the world, world units.
    pub extent: f64,
}

/// Edge of the largest random image, px.
const LARGEST_EDGE_PX: usize = 24;

/// The extreme scene of a seed, with up to three hazards.
pub fn extreme(seed: u64) -> Extreme {
    let mut random = Random::new(seed ^ 0x5eed);
    let count = random.below(4);
    let mut hazards: Vec<Hazard> = (0..count).map(|_| Hazard::ALL[random.below(Hazard::ALL.len())]).collect();
    hazards.sort_unstable();
    hazards.dedup();
    with_hazards(seed, hazards, &mut random)
}

pub fn extreme_of(hazard: Hazard, seed: u64) -> Extreme {
    with_hazards(seed, vec![hazard], &mut Random::new(seed ^ 0x5eed))
}

fn with_hazards(seed: u64, hazards: Vec<Hazard>, random: &mut Random) -> Extreme {
    let recipe = recipe(&hazards, random);
    let mut scene = self::random(seed, &recipe);
    let modulation = [10.0, 30.0, 255.0][random.below(3)];
    let footprint = if random.below(2) == 0 { Footprint::Kernel } else { Footprint::Opacity };
    let peeling = if random.below(2) == 0 { Peeling::Continuous } else { Peeling::Nearest };
    let mut peel = PeelOptions { layer_count: 1 + random.below(4), modulation, footprint, peeling };
    for &hazard in &hazards {
        apply(hazard, &mut scene, &mut peel, recipe.extent, random);
    }
    Extreme { seed, hazards, scene, peel, extent: recipe.extent }
}

/// The parameters that have to be known before there are primitives.
fn recipe(hazards: &[Hazard], random: &mut Random) -> Recipe {
    let model = match random.below(3) {
        0 => ColourModel::SphericalHarmonics { degree: 3 },
        _ => ColourModel::SphericalBeta { lobes: 2 },
    };
    let edge = |random: &mut Random| 1 + random.below(LARGEST_EDGE_PX);
    let mut recipe = Recipe {
        surfels: 1 + random.below(10),
        gaussians: 1 + random.below(14),
        model,
        extent: 1.0,
        width: edge(random),
        height: edge(random),
    };
    for hazard in hazards {
        match hazard {
            Hazard::SmallWorld => recipe.extent = 10f64.powf(random.between(-6.0, -3.0)),
            Hazard::LargeWorld => recipe.extent = 10f64.powf(random.between(4.0, 7.0)),
            Hazard::ThinImage => match random.below(3) {
                0 => recipe.width = 1,
                1 => recipe.height = 1,
                _ => (recipe.width, recipe.height) = (1, 1),
            },
            Hazard::Nearly0 => {
                (recipe.surfels, recipe.gaussians) = [(0, 0), (0, 5), (5, 0), (1, 1), (0, 1), (1, 0)][random.below(6)];
            }
            Hazard::SharpLobes | Hazard::PolarLobes => recipe.model = ColourModel::SphericalBeta { lobes: 2 },
            _ => {}
        }
    }
    recipe
}

fn apply(hazard: Hazard, scene: &mut TestScene, peel: &mut PeelOptions, extent: f64, random: &mut Random) {
    match hazard {
        Hazard::TinyScales => log_scales(scene, random, |random| random.between(-30.0, -8.0)),
        Hazard::HugeScales => log_scales(scene, random, |random| random.between(3.0, 20.0)),
        Hazard::Needles => needles(scene, random),
        Hazard::Quaternions => quaternions(scene, random),
        Hazard::Opacities => scene.gaussians.opacities.iter_mut().for_each(|opacity| {
            *opacity = [0.0, -0.0, 1e-30, 1e-40, 1e6, 1e6, -1.0, -1e6, 1.0, 1.0 / 255.0][random.below(10)];
        }),
        Hazard::EdgeOn => edge_on(scene, random),
        Hazard::AroundCamera => around_camera(scene, random),
        Hazard::AtNearPlane => at_near_plane(scene, random),
        Hazard::Behind => move_each(scene, random, |scene, at, random| {
            let pose = scene.camera.camera_from_world;
            let forward = pose.rotation.transpose() * DVec3::Z;
            (random.below(2) == 0).then(|| at - forward * 2.0 * (scene.camera.depth(at).abs() + extent))
        }),
        Hazard::FarFromOrigin => far_from_origin(scene, random),
        Hazard::NarrowView => field_of_view(scene, 0.1f64.to_radians()),
        Hazard::WideView => field_of_view(scene, 179f64.to_radians()),
        Hazard::OffCentre => {
            scene.camera.cx = random.between(-3.0, 4.0) * scene.camera.width as f64;
            scene.camera.cy = random.between(-3.0, 4.0) * scene.camera.height as f64;
        }
        Hazard::OnePoint => {
            let place = scene.surfels.positions.first_chunk().or(scene.gaussians.positions.first_chunk());
            let place = place.copied().unwrap_or([0.0f32; 3]).map(f64::from);
            move_each(scene, random, |_, _, _| Some(DVec3::from_array(place)));
        }
        Hazard::OneDepth => {
            let camera = scene.camera;
            let forward = camera.camera_from_world.rotation.transpose() * DVec3::Z;
            move_each(scene, random, |_, at, _| Some(at - forward * (camera.depth(at) - 2.0 * extent)));
        }
        Hazard::SharpLobes => lobes(scene, random, |lobe, random| lobe[5] = [30.0, -30.0, 25.0][random.below(3)]),
        Hazard::PolarLobes => lobes(scene, random, |lobe, random| {
            lobe[3] = [0.0, std::f32::consts::PI, -0.0][random.below(3)];
        }),
        Hazard::Steep => peel.modulation = [1e-6, 1.0, 1e6, 1e30][random.below(4)],
        Hazard::OneHuge => {
            let log_scales = &mut scene.surfels.log_scales;
            if let Some(first) = log_scales.first_chunk_mut::<2>() {
                *first = [first[0] + 1e6f32.ln(); 2];
            }
        }
        // in the recipe
        Hazard::SmallWorld | Hazard::LargeWorld | Hazard::ThinImage | Hazard::Nearly0 => {}
    }
}

/// Some or all log-scales of either kind.
fn log_scales(scene: &mut TestScene, random: &mut Random, draw: impl Fn(&mut Random) -> f64) {
    let share = [1.0, 0.3][random.below(2)];
    for values in [&mut scene.surfels.log_scales, &mut scene.gaussians.log_scales] {
        for value in values.iter_mut() {
            if random.unit() < share {
                *value = draw(random) as f32;
            }
        }
    }
}

fn needles(scene: &mut TestScene, random: &mut Random) {
    let ratio = 1e6f32.ln();
    for (values, width) in [(&mut scene.surfels.log_scales, 2), (&mut scene.gaussians.log_scales, 3)] {
        for row in values.chunks_mut(width) {
            let thin = random.below(width);
            let up = random.unit() as f32;
            row.iter_mut().for_each(|scale| *scale += up * ratio);
            row[thin] = row[(thin + 1) % width] - ratio;
        }
    }
}

fn quaternions(scene: &mut TestScene, random: &mut Random) {
    for values in [&mut scene.surfels.quaternions, &mut scene.gaussians.quaternions] {
        for quaternion in values.chunks_mut(4) {
            let length = [0.0, 1e-45, 1e-40, 1e-30, 1e-13, 1e-12, 1e-6, 1e10, 1e20, 1e37][random.below(10)];
            quaternion.iter_mut().for_each(|part| *part *= length);
        }
    }
}

fn edge_on(scene: &mut TestScene, random: &mut Random) {
    let eye = scene.camera.centre();
    for (position, quaternion) in scene.surfels.positions.chunks_mut(3).zip(scene.surfels.quaternions.chunks_mut(4)) {
        let ray = (Vec3::from_slice(position).as_dvec3() - eye).normalize_or(DVec3::Z);
        let normal = ray.any_orthonormal_vector();
        let tilt = [0.0, 0.0, 1e-12, 1e-8, 1e-6, 1e-4, 1e-2][random.below(7)];
        let normal = (normal + tilt * ray).normalize();
        let tangent = normal.any_orthonormal_vector();
        let rotation = DQuat::from_mat3(&DMat3::from_cols(tangent, normal.cross(tangent), normal));
        quaternion.copy_from_slice(&[rotation.w, rotation.x, rotation.y, rotation.z].map(|part| part as f32));
    }
}

/// Moves each centre to what `to` says for it.
fn move_each(scene: &mut TestScene, random: &mut Random, to: impl Fn(&TestScene, DVec3, &mut Random) -> Option<DVec3>) {
    let before = scene.clone();
    for values in [&mut scene.surfels.positions, &mut scene.gaussians.positions] {
        for position in values.chunks_mut(3) {
            if let Some(to) = to(&before, Vec3::from_slice(position).as_dvec3(), random) {
                position.copy_from_slice(&to.as_vec3().to_array());
            }
        }
    }
}

/// Centres within a disc's own plane from the camera, and Gaussians at the camera itself.
fn around_camera(scene: &mut TestScene, random: &mut Random) {
    let eye = scene.camera.centre();
    let rows = scene.surfels.positions.chunks_mut(3).zip(scene.surfels.quaternions.chunks(4));
    for (position, quaternion) in rows {
        let [x, y, z, w] = [1, 2, 3, 0].map(|i| f64::from(quaternion[i]));
        let rotation = DQuat::from_xyzw(x, y, z, w);
        let rotation = if rotation.length_squared() > 1e-20 { rotation.normalize() } else { DQuat::IDENTITY };
        let within = rotation * DVec3::new(random.between(-1.0, 1.0), random.between(-1.0, 1.0), 0.0);
        let at = eye + within * [0.0, 1e-6, 0.1, 1.0][random.below(4)];
        position.copy_from_slice(&at.as_vec3().to_array());
    }
    for position in scene.gaussians.positions.chunks_mut(3) {
        if random.below(2) == 0 {
            let aside = DVec3::new(random.normal(), random.normal(), random.normal());
            let at = eye + aside * [0.0, 1e-9, 1e-3][random.below(3)];
            position.copy_from_slice(&at.as_vec3().to_array());
        }
    }
}

fn at_near_plane(scene: &mut TestScene, random: &mut Random) {
    let camera = scene.camera;
    move_each(scene, random, |_, at, random| {
        let forward = camera.camera_from_world.rotation.transpose() * DVec3::Z;
        let depth = camera.near * (1.0 + [0.0, 1e-7, -1e-7, 1e-3, -1e-3][random.below(5)]);
        // in the view, where it does something
        let x = random.between(-0.2, 1.2) * camera.width as f64;
        let y = random.between(-0.2, 1.2) * camera.height as f64;
        let at_plane = camera.unproject(x, y, depth);
        let aside = (random.below(4) == 0).then(|| at - forward * (camera.depth(at) - depth));
        Some(aside.unwrap_or(at_plane))
    });
}

fn far_from_origin(scene: &mut TestScene, random: &mut Random) {
    let away = DVec3::new(random.normal(), random.normal(), random.normal()).normalize_or(DVec3::X);
    let offset = away * 10f64.powf(random.between(3.0, 7.0));
    scene.camera.camera_from_world = scene.camera.camera_from_world.recentred(-offset);
    move_each(scene, random, |_, at, _| Some(at + offset));
}

fn field_of_view(scene: &mut TestScene, horizontal: f64) {
    let focal = 0.5 * scene.camera.width as f64 / (0.5 * horizontal).tan();
    (scene.camera.fx, scene.camera.fy) = (focal, focal);
}

fn lobes(scene: &mut TestScene, random: &mut Random, edit: impl Fn(&mut [f32], &mut Random)) {
    for detail in [&mut scene.surfels.colour.detail, &mut scene.gaussians.colour.detail] {
        detail.chunks_mut(6).for_each(|lobe| edit(lobe, random));
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_seed_makes_the_same_scene_again_and_every_hazard_comes_up() {
        let mut found = std::collections::BTreeSet::new();
        for seed in 0..500 {
            let made = extreme(seed);
            assert_eq!(
                (&made.hazards, &made.scene.gaussians),
                (&extreme(seed).hazards, &extreme(seed).scene.gaussians)
            );
            found.extend(made.hazards);
        }
        assert_eq!(found.into_iter().collect::<Vec<_>>(), Hazard::ALL);
    }

    #[test]
    fn parameters_of_extreme_scenes_are_finite_and_their_cameras_valid() {
        for seed in 0..500 {
            let Extreme { scene, hazards, .. } = extreme(seed);
            let checked = scene.camera.validate().and(scene.surfels.check()).and(scene.gaussians.check());
            checked.unwrap_or_else(|error| panic!("seed {seed}, {hazards:?}: {error}"));
        }
    }

    #[test]
    fn hazards_are_what_they_are_called() {
        let needle = extreme_of(Hazard::Needles, 1).scene.gaussians.log_scales;
        let spread =
            |row: &[f32]| row.iter().copied().fold(f32::MIN, f32::max) - row.iter().copied().fold(f32::MAX, f32::min);
        assert!(needle.chunks(3).all(|row| spread(row) > 13.8));
        let wide = extreme_of(Hazard::WideView, 1).scene.camera;
        assert!(((0.5 * wide.width as f64 / wide.fx).atan().to_degrees() - 89.5).abs() < 1e-9);
        let far = extreme_of(Hazard::FarFromOrigin, 1).scene;
        assert!(far.camera.centre().length() > 900.0);
        let discs = extreme_of(Hazard::AroundCamera, 2).scene;
        let nearest = |at: &[f32]| (Vec3::from_slice(at).as_dvec3() - discs.camera.centre()).length();
        assert!(discs.surfels.positions.chunks(3).all(|at| nearest(at) < 2.0));
    }
}
