mod lens;

use burn::tensor::Tensor;
use glam::DVec3;

use super::{Layers, PeelOptions, peel};
use crate::camera::Camera;
use crate::footprint::surfel::cpu::{Disc, MIN_FACING, Parameters};
use crate::math::{CameraOf, M3, V3, add, apply, column, dot, rotation, scale, sub};
use crate::ops::fixtures::{self, SURFEL_NAMES, SURFEL_WIDTHS, check_rows, constant, leaves_of, surfel_rows, wide};
use crate::scene::peeling::ORDER;
use crate::scene::{Colour, ColourModel, Footprint, Peeling, Surfels};
use crate::testing::golden::values;
use crate::testing::random::Random;
use crate::testing::scenes::{self, Recipe};
use crate::tiles::PixelRect;

/// A surfel in camera space, as the specification has it.
struct Dense {
    centre: V3<f64>,
    axes: [V3<f64>; 3],
    scales: [f64; 2],
}

/// Depth, index and opacity.
type Fragment = (f64, usize, f64);

impl Dense {
    fn new(camera: &CameraOf<f64>, p: &Parameters) -> Self {
        let world: M3<f64> = rotation(p.quaternion);
        let axes = [0, 1, 2].map(|j| apply(&camera.rotation, column(&world, j)));
        Self { centre: camera.transform(p.position), axes, scales: p.log_scales.map(f64::exp) }
    }

    /// Depth and opacity at a point of the image, if there is a fragment.
    fn fragment(&self, camera: &CameraOf<f64>, options: &PeelOptions, x: f64, y: f64) -> Option<(f64, f64)> {
        let at = [(x - camera.cx) / camera.fx, (y - camera.cy) / camera.fy];
        let ray = match &camera.lens {
            None => [at[0], at[1], 1.0],
            Some(lens) => lens.ray(at)?,
        };
        let facing = dot(ray, self.axes[2]);
        let depth = dot(self.axes[2], self.centre) / facing;
        let hit = sub(scale(ray, depth), self.centre);
        let [u, v] = [0, 1].map(|i| dot(hit, self.axes[i]) / self.scales[i]);
        let squared = u * u + v * v;
        let (end, core) = (options.footprint.squared_radius(options.modulation), 2.0 * options.modulation.ln());
        let inside = squared < end;
        let alpha = match options.peeling {
            Peeling::Continuous if core < end => ((end - squared) / (end - core)).min(1.0),
            Peeling::Continuous => 1.0,
            Peeling::Nearest | Peeling::Literal => (options.modulation * (-0.5 * squared).exp()).min(1.0),
        };
        (facing.abs() > MIN_FACING && depth > camera.near && inside).then_some((depth, alpha))
    }

    /// Point of the boundary at `angle`, camera axes.
    fn boundary(&self, radius: f64, angle: f64) -> V3<f64> {
        let along_u = scale(self.axes[0], radius * self.scales[0] * angle.cos());
        let along_v = scale(self.axes[1], radius * self.scales[1] * angle.sin());
        add(self.centre, add(along_u, along_v))
    }
}

/// Positions, quaternions and log-scales, row-major; margins.
#[derive(Clone)]
struct Flat([Vec<f64>; 3], Vec<f64>);

impl Flat {
    fn random(seed: u64, recipe: &Recipe) -> (Self, Camera) {
        let scene = scenes::random(seed, recipe);
        (Self(surfel_rows(&scene.surfels), wide(&scene.surfels.margins)), scene.camera)
    }

    fn of(surfels: &[Parameters]) -> Self {
        let rows = [
            surfels.iter().flat_map(|s| s.position).collect(),
            surfels.iter().flat_map(|s| s.quaternion).collect(),
            surfels.iter().flat_map(|s| s.log_scales).collect(),
        ];
        Self(rows, (0..surfels.len()).map(|i| 0.5 * (i % 4) as f64).collect())
    }

    fn len(&self) -> usize {
        self.0[0].len() / 3
    }

    fn surfel(&self, i: usize) -> Parameters {
        Parameters {
            position: self.0[0][3 * i..3 * i + 3].try_into().unwrap(),
            quaternion: self.0[1][4 * i..4 * i + 4].try_into().unwrap(),
            log_scales: self.0[2][2 * i..2 * i + 2].try_into().unwrap(),
        }
    }

    fn leaves(&self) -> [Tensor<2>; 3] {
        leaves_of(&self.0, SURFEL_WIDTHS, self.len())
    }

    fn peel(&self, camera: &Camera, options: &PeelOptions) -> Layers {
        peeled(&self.leaves(), &self.1, camera, options)
    }

    /// The layers by sorting every fragment of every pixel; [K, H, W].
    fn peel_densely(&self, camera: &Camera, options: &PeelOptions) -> Vec<Option<Fragment>> {
        let (plane, of) = (camera.width * camera.height, CameraOf::new(camera));
        let surfels: Vec<Dense> = (0..self.len()).map(|i| Dense::new(&of, &self.surfel(i))).collect();
        let mut out = vec![None; options.layer_count * plane];
        for at in 0..plane {
            let (x, y) = ((at % camera.width) as f64 + 0.5, (at / camera.width) as f64 + 0.5);
            let fragment = |(id, surfel): (usize, &Dense)| {
                surfel.fragment(&of, options, x, y).map(|(depth, alpha)| (depth, id, alpha))
            };
            let mut fragments: Vec<Fragment> = surfels.iter().enumerate().filter_map(fragment).collect();
            fragments.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
            let core = fragments.iter().position(|fragment| fragment.2 >= 1.0);
            if options.peeling == Peeling::Continuous {
                let core = core.map(|core| fragments.remove(core));
                let end = core.map_or(f64::INFINITY, |core| core.0 + ORDER * self.1[core.1]);
                fragments.retain(|fragment| fragment.0 <= end);
                fragments.truncate(options.layer_count - 1);
                fragments.extend(core);
                fragments.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
            } else {
                fragments.truncate(core.map_or(options.layer_count, |core| options.layer_count.min(core + 1)));
            }
            for (k, fragment) in fragments.into_iter().enumerate() {
                out[k * plane + at] = Some(fragment);
            }
        }
        out
    }
}

fn peeled(rows: &[Tensor<2>; 3], margins: &[f64], camera: &Camera, options: &PeelOptions) -> Layers {
    let [positions, quaternions, log_scales] = rows.each_ref().map(Tensor::clone);
    let count = margins.len();
    let none = |width: usize| constant(&vec![0.0; count * width], [count, width]);
    let colour = Colour::new(ColourModel::SphericalBeta { lobes: 0 }, none(3), none(0));
    let surfels = Surfels { positions, quaternions, log_scales, colour, margins: constant(margins, [count, 1]) };
    peel(&surfels, camera, options).unwrap()
}

fn ids_of(layers: &Layers) -> Vec<i64> {
    layers.ids.clone().into_data().iter::<i64>().collect()
}

fn assert_same(layers: &Layers, expected: &[Option<Fragment>]) {
    let (ids, alpha, depth) = (ids_of(layers), values(&layers.alpha), values(&layers.depth));
    assert_eq!(ids.len(), expected.len());
    for (at, expected) in expected.iter().enumerate() {
        match expected {
            None => assert_eq!((ids[at], alpha[at], depth[at]), (-1, 0.0, f64::INFINITY), "at {at}"),
            Some((d, id, a)) => {
                assert_eq!(ids[at], *id as i64, "at {at}");
                approx::assert_relative_eq!(depth[at], *d, max_relative = 1e-9);
                approx::assert_relative_eq!(alpha[at], *a, max_relative = 1e-7);
            }
        }
    }
}

fn options(layer_count: usize, modulation: f64, footprint: Footprint) -> PeelOptions {
    PeelOptions { layer_count, modulation, footprint, peeling: Peeling::Continuous }
}

fn axis_camera(width: usize, height: usize) -> Camera {
    let (cx, cy) = (0.45 * width as f64, 0.55 * height as f64);
    Camera { fx: 30.0, fy: 34.0, cx, cy, width, height, ..fixtures::axis_camera() }
}

/// Discs of every kind: ordinary, tiny, huge, edge-on, across the near plane, behind it.
fn every_kind(count: usize) -> Vec<Parameters> {
    let mut random = Random::new(3);
    (0..count)
        .map(|i| {
            let (near, far, small, large) = match i % 6 {
                0 => (1.0, 6.0, 0.05, 0.8),
                1 => (1.0, 6.0, 1e-6, 1e-2),
                2 => (0.5, 6.0, 10.0, 1e5),
                3 => (0.5, 4.0, 0.05, 0.5),
                4 => (-0.5, 0.7, 0.05, 2.0),
                _ => (-6.0, 0.1, 0.01, 3.0),
            };
            let depth: f64 = random.between(near, far);
            let position = [random.normal() * depth.abs(), random.normal() * depth.abs(), depth];
            let mut quaternion: [f64; 4] = std::array::from_fn(|_| random.normal());
            if i % 6 == 3 {
                // the normal across the line of sight, to within a millionth
                let towards = DVec3::from(position).normalize();
                let normal = towards.any_orthonormal_vector() + towards * 1e-6 * random.normal();
                let q = glam::DQuat::from_rotation_arc(DVec3::Z, normal.normalize());
                quaternion = [q.w, q.x, q.y, q.z];
            }
            let (low, high) = (f64::ln(small), f64::ln(large));
            Parameters { position, quaternion, log_scales: std::array::from_fn(|_| random.between(low, high)) }
        })
        .collect()
}

/// Fragments of each kind of discs, all within the reach of their disc.
fn fragments_within_reach(name: &str, camera: &Camera, options: &PeelOptions, count: usize) -> [usize; 6] {
    let of = CameraOf::new(camera);
    let squared_radius = options.footprint.squared_radius(options.modulation);
    let mut fragments = [0; 6];
    for (i, surfel) in every_kind(count).iter().enumerate() {
        let rect = Disc::new(&of, surfel).reach(&of, squared_radius);
        let dense = Dense::new(&of, surfel);
        for (x, y) in (0..30).flat_map(|y| (0..40).map(move |x| (x, y))) {
            if dense.fragment(&of, options, f64::from(x) + 0.5, f64::from(y) + 0.5).is_some() {
                fragments[i % 6] += 1;
                let inside = (rect.x0..rect.x1).contains(&x) && (rect.y0..rect.y1).contains(&y);
                assert!(inside, "{name}: pixel ({x}, {y}) of surfel {i} {surfel:?} is outside {rect:?}");
            }
        }
    }
    fragments
}

#[test]
fn no_fragment_lies_outside_the_reach_of_its_disc() {
    for footprint in [Footprint::Kernel, Footprint::Opacity] {
        let options = options(1, 30.0, footprint);
        let fragments = fragments_within_reach("pinhole", &axis_camera(40, 30), &options, 3000);
        assert!([0, 2, 4].iter().all(|&kind| fragments[kind] > 1000), "{fragments:?}");
    }
}

#[test]
fn reach_is_tight_to_a_hundred_thousandth_of_a_pixel() {
    const MAGNIFIED: f64 = 1e5;
    let camera = axis_camera(40, 30).resized(40 * MAGNIFIED as usize, 30 * MAGNIFIED as usize);
    let of = CameraOf::new(&camera);
    let squared_radius = Footprint::Kernel.squared_radius(30.0);
    let radius = squared_radius.sqrt();
    let mut compared = 0;
    for surfel in every_kind(1200).iter().filter(|s| s.log_scales.iter().all(|s| *s < 1.0)) {
        let dense = Dense::new(&of, surfel);
        let boundary: Vec<V3<f64>> =
            (0..40_000).map(|i| dense.boundary(radius, f64::from(i) * std::f64::consts::TAU / 40_000.0)).collect();
        if boundary.iter().any(|p| p[2] < 1.1 * of.near) {
            continue;
        }
        let range = |axis: usize, focal: f64, principal: f64| {
            let px = boundary.iter().map(|p| p[axis] / p[2] * focal + principal);
            px.fold([f64::INFINITY, f64::NEG_INFINITY], |r, v| [r[0].min(v), r[1].max(v)])
        };
        let ([x0, x1], [y0, y1]) = (range(0, of.fx, of.cx), range(1, of.fy, of.cy));
        let expected = PixelRect::covering([x0, x1, y0, y1], camera.width, camera.height);
        let found = Disc::new(&of, surfel).reach(&of, squared_radius);
        if expected.is_empty() || found.is_empty() {
            let sides = |r: &PixelRect| (r.x1 - r.x0).min(r.y1 - r.y0);
            assert!(sides(&expected) <= 2 && sides(&found) <= 2, "{surfel:?}: {found:?}, expected {expected:?}");
            continue;
        }
        let sides = |r: &PixelRect| [r.x0, r.x1, r.y0, r.y1].map(i64::from);
        let apart = sides(&found).iter().zip(sides(&expected)).map(|(a, b)| (a - b).abs()).max().unwrap();
        assert!(apart <= 2, "{surfel:?}: {found:?}, expected {expected:?}");
        compared += 1;
    }
    assert!(compared > 50, "{compared}");
}

#[test]
fn peeling_equals_sorting_all_fragments() {
    let (mut deepest, mut others) = (0, 0);
    for layers in 1..=8 {
        for (seed, footprint) in [(1, Footprint::Kernel), (2, Footprint::Opacity)] {
            for modulation in [30.0, 0.8] {
                let recipe = Recipe { surfels: 40, gaussians: 0, ..Recipe::default() };
                let (surfels, camera) = Flat::random(seed + 10 * layers as u64, &recipe);
                let continuous = options(layers, modulation, footprint);
                let expected = surfels.peel_densely(&camera, &continuous);
                assert_same(&surfels.peel(&camera, &continuous), &expected);
                let nearest = PeelOptions { peeling: Peeling::Nearest, ..continuous };
                let expected_nearest = surfels.peel_densely(&camera, &nearest);
                let last = &expected_nearest[(layers - 1) * camera.width * camera.height..];
                deepest = if last.iter().any(Option::is_some) { layers } else { deepest };
                let id = |fragment: &Option<Fragment>| fragment.map(|fragment| fragment.1);
                others += expected.iter().zip(&expected_nearest).filter(|(a, b)| id(a) != id(b)).count();
                assert_same(&surfels.peel(&camera, &nearest), &expected_nearest);
            }
        }
    }
    assert_eq!(deepest, 8);
    assert!(others > 100, "{others}");
}

#[test]
fn peeling_equals_sorting_for_discs_of_every_kind_and_images_of_every_size() {
    for (width, height) in [(1, 1), (40, 30), (16, 16), (17, 1), (33, 47)] {
        let camera = axis_camera(width, height);
        let surfels = Flat::of(&every_kind(240));
        let options = options(4, 30.0, Footprint::Kernel);
        let (layers, expected) = (surfels.peel(&camera, &options), surfels.peel_densely(&camera, &options));
        // an edge-on disc magnifies rounding: only ids and the fragments' presence are exact
        assert_eq!(ids_of(&layers), expected.iter().map(|f| f.map_or(-1, |f| f.1 as i64)).collect::<Vec<_>>());
    }
}

#[test]
fn nothing_peels_to_nothing() {
    let layers = Flat::of(&[]).peel(&axis_camera(19, 5), &options(3, 30.0, Footprint::Kernel));
    assert_same(&layers, &[None; 3 * 19 * 5]);
    let unseen = Flat::of(&every_kind(12)).peel(&axis_camera(19, 5), &options(2, 1e-3, Footprint::Opacity));
    assert_same(&unseen, &[None; 2 * 19 * 5]);
}

/// A disc of unit scales that faces the camera, its centre `offset` beside the optical axis.
fn facing_disc(depth: f64, offset: f64) -> Parameters {
    Parameters { position: [offset, 0.0, depth], quaternion: [1.0, 0.0, 0.0, 0.0], log_scales: [0.0, 0.0] }
}

/// Ids of the layers of a pixel that looks along the axis.
fn ids_on_axis(surfels: &[Parameters], margin: f64, layer_count: usize, peeling: Peeling) -> Vec<i64> {
    let options = PeelOptions { peeling, ..options(layer_count, 30.0, Footprint::Kernel) };
    let surfels = Flat(Flat::of(surfels).0, vec![margin; surfels.len()]);
    ids_of(&surfels.peel(&axis_camera(1, 1), &options))
}

/// Opacity 1 within 2.6 σ, a rim from there to 3.33 σ.
fn rim(depth: f64) -> Parameters {
    facing_disc(depth, 3.0)
}

fn opaque(depth: f64) -> Parameters {
    facing_disc(depth, 0.1)
}

#[test]
fn ties_in_depth_are_broken_by_index_and_nothing_lies_behind_an_opaque_fragment() {
    let ids = |surfels: &[Parameters], layers: usize| ids_on_axis(surfels, 0.3, layers, Peeling::Nearest);
    assert_eq!(ids(&[rim(2.0), rim(2.0), rim(1.0), rim(2.0)], 4), [2, 0, 1, 3]);
    assert_eq!(ids(&[rim(2.0), rim(2.0), rim(1.0), rim(2.0)], 2), [2, 0]);
    assert_eq!(ids(&[rim(3.0), opaque(2.0), rim(1.0), opaque(2.0)], 4), [2, 1, -1, -1]);
    assert_eq!(ids(&[opaque(2.0), rim(2.0)], 2), [0, -1]);
    assert_eq!(ids(&[rim(2.0), opaque(2.0)], 2), [0, 1]);
    assert_eq!(ids(&[rim(4.0), rim(3.0), rim(2.0), rim(1.0)], 3), [3, 2, 1]);
}

#[test]
fn the_nearest_core_is_a_layer_and_the_others_end_a_little_behind_it() {
    let three_rims = [rim(3.0), opaque(5.0), rim(1.0), opaque(4.0), rim(2.0), opaque(4.0)];
    let ids = |margin: f64, layers: usize| ids_on_axis(&three_rims, margin, layers, Peeling::Continuous);
    assert_eq!(ids(0.0, 1), [3]);
    assert_eq!(ids(0.0, 2), [2, 3]);
    assert_eq!(ids(0.0, 3), [2, 4, 3]);
    assert_eq!(ids(0.0, 4), [2, 4, 0, 3]);
    // at the same depth, and no further
    assert_eq!(ids(0.0, 6), [2, 4, 0, 3, 5, -1]);
    assert_eq!(ids(9.9, 6), [2, 4, 0, 3, 5, -1]);
    assert_eq!(ids(10.1, 6), [2, 4, 0, 3, 5, 1]);
    // a core that comes first, and one that takes its place later
    let two_cores = [opaque(2.0), rim(2.0), opaque(1.5), rim(1.0)];
    assert_eq!(ids_on_axis(&two_cores, 0.0, 4, Peeling::Continuous), [3, 2, -1, -1]);
    assert_eq!(ids_on_axis(&two_cores, 6.0, 4, Peeling::Continuous), [3, 2, 0, 1]);
    assert_eq!(ids_on_axis(&two_cores, 6.0, 3, Peeling::Continuous), [3, 2, 0]);
    // without a core its place stays empty
    assert_eq!(ids_on_axis(&[rim(4.0), rim(3.0), rim(2.0), rim(1.0)], 0.0, 3, Peeling::Continuous), [3, 2, -1]);
}

#[test]
fn opacity_falls_to_0_at_the_end_of_a_surfel_and_is_1_in_its_core() {
    let alpha = |offset: f64, peeling: Peeling| {
        let options = PeelOptions { peeling, ..options(2, 30.0, Footprint::Kernel) };
        let camera = Camera { cx: 0.5, cy: 0.5, ..axis_camera(1, 1) };
        values(&Flat::of(&[facing_disc(2.0, offset)]).peel(&camera, &options).alpha)[0]
    };
    let (core, end) = ((2.0 * 30f64.ln()).sqrt(), (2.0 * 255f64.ln()).sqrt());
    let middle = (0.5 * (core * core + end * end)).sqrt();
    for (offset, continuous, nearest) in [
        (core - 1e-3, 1.0, 1.0),
        (middle, 0.5, 30.0 * (-0.5 * middle * middle).exp()),
        (end - 1e-6, 0.0, 30.0 / 255.0),
        (end + 1e-3, 0.0, 0.0),
    ] {
        approx::assert_abs_diff_eq!(alpha(offset, Peeling::Continuous), continuous, epsilon = 1e-5);
        approx::assert_abs_diff_eq!(alpha(offset, Peeling::Nearest), nearest, epsilon = 1e-5);
    }
}

#[test]
fn a_zero_quaternion_is_the_identity_and_gets_no_gradient() {
    let mut surfels = [facing_disc(2.0, 3.0), facing_disc(2.5, 2.9)];
    let (camera, options) = (axis_camera(20, 9), options(3, 0.9, Footprint::Opacity));
    let expected = Flat::of(&surfels).peel_densely(&camera, &options);
    surfels[1].quaternion = [0.0; 4];
    let leaves = Flat::of(&surfels).leaves();
    let margins = Flat::of(&surfels).1;
    let layers = peeled(&leaves, &margins, &camera, &options);
    assert_same(&layers, &expected);
    let gradient = values(&leaves[1].grad(&layers.alpha.sum().backward()).unwrap());
    assert!(gradient[..4].iter().any(|g| g.abs() > 1e-3) && gradient[4..].iter().all(|g| *g == 0.0), "{gradient:?}");
}

/// Compares the gradients of both outputs, and of both together, with central differences.
fn check_gradients(name: &str, surfels: &Flat, camera: &Camera, options: &PeelOptions, seed: u64) {
    let weights = fixtures::weights(seed, [3, camera.height, camera.width]);
    for [of_alpha, of_depth] in [[1.0, 0.0], [0.0, 1.0], [1.0, 0.5]] {
        check_rows(
            &format!("{name}: {of_alpha}, {of_depth}"),
            SURFEL_NAMES,
            &surfels.0,
            SURFEL_WIDTHS,
            1e-6,
            |leaves| {
                let layers = peeled(leaves, &surfels.1, camera, options);
                // a missing layer counts 0
                let depth = layers.depth.mask_fill(layers.ids.lower_elem(0), 0.0);
                let of = |output: Tensor<3>, factor: f64| (output * weights.clone()).sum() * factor;
                match [of_alpha, of_depth] {
                    [_, 0.0] => of(layers.alpha, of_alpha),
                    [0.0, _] => of(depth, of_depth),
                    _ => of(layers.alpha, of_alpha) + of(depth, of_depth),
                }
            },
        );
    }
}

#[test]
fn gradients_of_alpha_and_depth_are_central_differences() {
    let model = ColourModel::SphericalBeta { lobes: 0 };
    for (seed, modulation, footprint) in
        [(5, 0.8, Footprint::Opacity), (6, 30.0, Footprint::Kernel), (7, 1.5, Footprint::Opacity)]
    {
        let recipe = Recipe { surfels: 7, gaussians: 0, model, width: 21, height: 18, ..Recipe::default() };
        let (surfels, camera) = Flat::random(seed, &recipe);
        for peeling in [Peeling::Continuous, Peeling::Nearest] {
            let options = PeelOptions { peeling, ..options(3, modulation, footprint) };
            check_gradients(&format!("{peeling}, w = {modulation}"), &surfels, &camera, &options, seed);
        }
    }
}
