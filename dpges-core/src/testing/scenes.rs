//! Scenes made from a seed: small ones for tests, realistic ones for benchmarks.

use burn::tensor::{DType, Device};
use glam::{DMat3, DQuat, DVec2, DVec3};

use super::random::Random;
use crate::camera::{Camera, CameraFromWorld};
use crate::scene::schema::{Attribute, Columns};
use crate::scene::{
    ColourData, ColourModel, GaussianData, Gaussians, Rendering, SceneData, SceneInfo, SurfelData, Surfels, WeightedSum,
};

#[derive(Clone, Debug)]
pub struct TestScene {
    pub surfels: SurfelData,
    pub gaussians: GaussianData,
    pub camera: Camera,
}

impl TestScene {
    pub fn tensors(&self, device: &Device, dtype: DType) -> (Surfels, Gaussians) {
        (Surfels::from_data(&self.surfels, device, dtype), Gaussians::from_data(&self.gaussians, device, dtype))
    }

    /// The scene by itself, with the default model and the near plane of its camera, and the camera.
    pub fn into_scene(self) -> (SceneData, Camera) {
        let Self { surfels, gaussians, camera } = self;
        let info = SceneInfo { colour_model: gaussians.model(), near: camera.near, ..SceneInfo::default() };
        (SceneData { info, surfels, gaussians, environment: None }, camera)
    }

    /// Every attribute that learns as a leaf of a tape; `device` has one.
    pub fn leaves(&self, device: &Device, dtype: DType) -> (Surfels, Gaussians) {
        let (surfels, gaussians) = self.tensors(device, dtype);
        (surfels.require_grad(), gaussians.require_grad())
    }
}

#[derive(Clone, Copy, Debug)]
pub struct Recipe {
    pub surfels: usize,
    pub gaussians: usize,
    pub model: ColourModel,
    /// Half the edge of the cube that surfels are placed in, world units.
    pub extent: f64,
    pub width: usize,
    pub height: usize,
}

impl Default for Recipe {
    fn default() -> Self {
        let model = ColourModel::SphericalBeta { lobes: 2 };
        Self { surfels: 12, gaussians: 20, model, extent: 1.0, width: 37, height: 22 }
    }
}

fn push<const W: usize>(rows: &mut Vec<f32>, values: [f64; W]) {
    rows.extend(values.map(|v| v as f32));
}

fn push_colour(colour: &mut ColourData, random: &mut Random) {
    let model = colour.model;
    push::<3>(&mut colour.base, std::array::from_fn(|_| random.between(-1.5, 1.5)));
    match model {
        ColourModel::SphericalBeta { lobes } => (0..lobes).for_each(|_| {
            push::<3>(&mut colour.detail, std::array::from_fn(|_| random.between(-0.3, 0.5)));
            push(&mut colour.detail, [random.between(0.0, 3.1), random.between(-3.1, 3.1), random.between(-1.0, 1.0)]);
        }),
        ColourModel::SphericalHarmonics { .. } | ColourModel::HarmonicsAndOpacity { .. } => {
            (0..model.detail_len()).for_each(|_| push(&mut colour.detail, [random.between(-0.4, 0.4)]));
        }
    }
}

/// Harmonics of an opacity, which are mostly positive; nothing under models without.
fn push_opacity_factor(gaussians: &mut GaussianData, random: &mut Random) {
    let count = gaussians.model().opacity_len();
    if count > 0 {
        push(&mut gaussians.opacity_base, [random.between(0.5, 5.0)]);
        (1..count).for_each(|_| push(&mut gaussians.opacity_detail, [random.between(-0.6, 0.6)]));
    }
}

/// Surfels and Gaussians of every orientation in and around a cube, seen from a random side.
pub fn random(seed: u64, recipe: &Recipe) -> TestScene {
    let mut random = Random::new(seed);
    let (extent, model) = (recipe.extent, recipe.model);
    let (mut surfels, mut gaussians) = (SurfelData::neutral(model, 0), GaussianData::neutral(model, 0));
    for _ in 0..recipe.surfels {
        push::<3>(&mut surfels.positions, std::array::from_fn(|_| extent * random.between(-1.0, 1.0)));
        push::<4>(&mut surfels.quaternions, std::array::from_fn(|_| random.normal()));
        push::<2>(&mut surfels.log_scales, std::array::from_fn(|_| (extent * random.between(0.05, 0.4)).ln()));
        push_colour(&mut surfels.colour, &mut random);
        push(&mut surfels.margins, [extent * random.between(0.0, 0.1)]);
    }
    for _ in 0..recipe.gaussians {
        push::<3>(&mut gaussians.positions, std::array::from_fn(|_| extent * random.between(-1.4, 1.4)));
        push::<4>(&mut gaussians.quaternions, std::array::from_fn(|_| random.normal()));
        push::<3>(&mut gaussians.log_scales, std::array::from_fn(|_| (extent * random.between(0.02, 0.25)).ln()));
        push(&mut gaussians.opacities, [random.between(0.05, 1.5)]);
        push_opacity_factor(&mut gaussians, &mut random);
        push_colour(&mut gaussians.colour, &mut random);
    }
    let towards = DVec3::new(random.normal(), random.normal(), random.normal()).normalize_or(DVec3::X);
    let eye = towards * extent * random.between(2.0, 4.0);
    let target = DVec3::new(random.unit(), random.unit(), random.unit()) * 0.3 * extent;
    let up = if towards.z.abs() < 0.9 { DVec3::Z } else { DVec3::X };
    let (width, height) = (recipe.width as f64, recipe.height as f64);
    let camera_from_world = CameraFromWorld::look_at(eye, target, up);
    let [fx, fy, cx, cy] = [1.1 * width, 1.2 * width, 0.48 * width, 0.53 * height];
    let &Recipe { width, height, .. } = recipe;
    let camera = Camera { camera_from_world, fx, fy, cx, cy, width, height, near: 0.02 * extent, lens: None };
    TestScene { surfels, gaussians, camera }
}

/// A scene of so many surfels and Gaussians, whose attributes have the `number` at every place of their rows.
pub fn numbered(
    model: ColourModel,
    [surfels, gaussians]: [usize; 2],
    mut number: impl FnMut(&Attribute, usize) -> f32,
) -> SceneData {
    let mut rows = |attribute: &Attribute, count: usize| -> Vec<f32> {
        (0..count * attribute.width.under(model)).map(|at| number(attribute, at)).collect()
    };
    let mut info = SceneInfo { colour_model: model, offset: [5.25e5, -2.0, 0.125], near: 0.2, ..SceneInfo::default() };
    if model.opacity_len() > 0 {
        (info.rendering, info.weighted_sum) = (Rendering::Summed, Some(WeightedSum::default()));
    }
    SceneData {
        info,
        surfels: SurfelData::generate(model, SurfelData::ATTRIBUTES.iter().map(|a| rows(a, surfels))),
        gaussians: GaussianData::generate(model, GaussianData::ATTRIBUTES.iter().map(|a| rows(a, gaussians))),
        environment: None,
    }
}

/// The room of [`realistic`]: half its size along each axis, world units, with a ball on its floor.
const ROOM: DVec3 = DVec3::new(3.0, 4.0, 1.5);
const BALL: (DVec3, f64) = (DVec3::new(0.4, 0.8, -0.7), 0.8);

/// First point of the room seen along a ray, and the normal there.
fn hit_room(eye: DVec3, direction: DVec3) -> (DVec3, DVec3) {
    let (centre, radius) = BALL;
    let along = (centre - eye).dot(direction);
    let squared = radius * radius - ((centre - eye).length_squared() - along * along);
    if squared > 0.0 && along - squared.sqrt() > 0.0 {
        let point = eye + direction * (along - squared.sqrt());
        return (point, (point - centre) / radius);
    }
    let to_wall = |axis: usize| {
        (ROOM[axis].copysign(direction[axis]) - eye[axis])
            / if direction[axis] == 0.0 { 1e-12 } else { direction[axis] }
    };
    let axis = (0..3).min_by(|&a, &b| to_wall(a).total_cmp(&to_wall(b))).unwrap_or(0);
    (eye + direction * to_wall(axis), -DVec3::AXES[axis] * direction[axis].signum())
}

/// A room with a ball in it, as a trained scene would be: `surfels` cover every pixel a handful of
/// times; `gaussians` lie near the surfaces, their radii on the screen log-normal around 1.75 px
/// with a long tail; all in or just outside the view. Textured, spherical Beta with 2 lobes.
pub fn realistic(surfels: usize, gaussians: usize, width: usize, height: usize, seed: u64) -> TestScene {
    let mut random = Random::new(seed);
    let model = ColourModel::SphericalBeta { lobes: 2 };
    let (w, h) = (width as f64, height as f64);
    let eye = DVec3::new(-1.2, -3.3, 0.3);
    let focal = 0.8 * w;
    let camera_from_world = CameraFromWorld::look_at(eye, DVec3::new(0.3, 1.5, -0.3), DVec3::Z);
    let (fx, fy, cx, cy) = (focal, focal, w / 2.0, h / 2.0);
    let camera = Camera { camera_from_world, fx, fy, cx, cy, width, height, near: 0.2, lens: None };
    // a place on a surface, its normal, and how large a pixel is there
    let place = |pixel: DVec2| {
        let direction = (camera.unproject(pixel.x, pixel.y, 1.0) - eye).normalize();
        let (point, normal) = hit_room(eye, direction);
        let depth = camera.project(point).map_or(1.0, |(.., depth)| depth);
        (point, normal, depth / focal)
    };
    let in_view = |random: &mut Random| DVec2::new(random.between(-0.05, 1.05) * w, random.between(-0.05, 1.05) * h);
    let checker = |p: DVec3| if ((p * 3.0).floor().dot(DVec3::ONE)) as i64 % 2 == 0 { 1.2 } else { -0.8 };
    let mut surfel_data = SurfelData::neutral(model, 0);
    // 1.1² of the image is covered; 5 footprints of 3.33 σ over each pixel
    let spacing_px = (1.21 * w * h / surfels.max(1) as f64).sqrt();
    let sigma_px = spacing_px * (5.0 / std::f64::consts::PI).sqrt() / 3.33;
    // somewhere in its own cell of a grid, so that few pixels stay open
    let columns = ((surfels as f64 * w / h).sqrt().ceil() as usize).max(1);
    let rows = surfels.div_ceil(columns).max(1);
    for i in 0..surfels {
        let within = |cell: usize, cells: usize, unit: f64| ((cell as f64 + unit) / cells as f64) * 1.1 - 0.05;
        let (x, y) = (within(i % columns, columns, random.unit()), within(i / columns, rows, random.unit()));
        let (point, normal, pixel) = place(DVec2::new(x * w, y * h));
        // as wide as its cell seen at a slant
        let slant = normal.dot((eye - point).normalize()).abs().max(0.1).sqrt();
        let tangent = normal.any_orthonormal_vector();
        let turn = DQuat::from_axis_angle(normal, random.between(0.0, 3.1));
        let frame = DMat3::from_cols(turn * tangent, turn * normal.cross(tangent), normal);
        let tilt = DQuat::from_scaled_axis(DVec3::new(random.normal(), random.normal(), 0.0) * 0.02);
        let q = DQuat::from_mat3(&frame) * tilt;
        push(&mut surfel_data.positions, (point + normal * random.normal() * 0.2 * pixel).to_array());
        push(&mut surfel_data.quaternions, [q.w, q.x, q.y, q.z]);
        push::<2>(
            &mut surfel_data.log_scales,
            std::array::from_fn(|_| (sigma_px * pixel / slant).ln() + 0.2 * random.normal()),
        );
        push_colour(&mut surfel_data.colour, &mut random);
        let base = surfel_data.colour.base.len() - 3;
        surfel_data.colour.base[base..].iter_mut().for_each(|c| *c = 0.2 * *c + checker(point) as f32);
        push(&mut surfel_data.margins, [2.0 * pixel]);
    }
    let mut gaussian_data = GaussianData::neutral(model, 0);
    for _ in 0..gaussians {
        let (point, normal, pixel) = place(in_view(&mut random));
        let sigma = 1.75 / 3.0 * pixel * (0.8 * random.normal()).exp();
        push(&mut gaussian_data.positions, (point + normal * random.normal().abs() * 2.0 * pixel).to_array());
        push::<4>(&mut gaussian_data.quaternions, std::array::from_fn(|_| random.normal()));
        push::<3>(&mut gaussian_data.log_scales, std::array::from_fn(|_| sigma.ln() + 0.4 * random.normal()));
        push(&mut gaussian_data.opacities, [random.between(0.05, 1.2)]);
        push_colour(&mut gaussian_data.colour, &mut random);
    }
    TestScene { surfels: surfel_data, gaussians: gaussian_data, camera }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::render::{RenderOptions, render};
    use crate::testing::golden::values;

    #[test]
    fn a_seed_makes_the_same_scene_again_and_another_seed_another() {
        let recipe = Recipe::default();
        let scene = random(7, &recipe);
        assert_eq!(scene.surfels, random(7, &recipe).surfels);
        assert_ne!(scene.gaussians, random(8, &recipe).gaussians);
        assert_eq!((scene.surfels.len(), scene.gaussians.len()), (recipe.surfels, recipe.gaussians));
    }

    #[test]
    fn realistic_surfels_cover_nearly_every_pixel_and_gaussians_add_detail() {
        let scene = realistic(900, 9_000, 120, 80, 1);
        let (surfels, gaussians) = scene.tensors(&crate::testing::device(), DType::F32);
        let rendered = render(&surfels, &gaussians, &scene.camera, &RenderOptions::default()).unwrap();
        let through = values(&rendered.seen.behind_all());
        let open = through.iter().filter(|&&t| t > 0.5).count();
        assert!(open < 120 * 80 / 50, "{open} pixels show the background");
        let detailed = values(&rendered.composite.gaussian_weight).iter().filter(|&&w| w > 0.1).count();
        assert!(detailed > 120 * 80 / 2, "{detailed} pixels show Gaussians");
    }
}
