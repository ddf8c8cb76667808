//! A small ray-traced scene: photographs and points to train on, exact depth and normals to test against.

mod room;

use std::f64::consts::TAU;

use dpges_core::camera::{Camera, CameraFromWorld, Distortion, Lens, Projection};
use glam::{DVec2, DVec3, Vec3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

use self::room::{Hit, trace};
use super::check::median;
use super::image::panorama;
use super::image::picture::linear;
use super::world::mean_and_extent;
use super::{Dataset, DepthKind, DepthMap, Format, Notices, Picture, PointCloud, View};

/// Near plane, world units.
const NEAR: f64 = 0.01;
const FIELD_OF_VIEW: f64 = 0.9;
const TARGET: DVec3 = DVec3::new(0.0, 0.0, 0.3);
/// Rotates successive views around the scene by the golden angle, so that any number of them covers it.
const GOLDEN_ANGLE: f64 = 2.399_963_229_728_653;
/// Largest distance of a point from its surface, world units.
const POINT_NOISE: f64 = 0.003;
/// Angle that the fisheye lens sees across the picture, radians: 170°.
const FISHEYE_ANGLE: f64 = 170.0 / 360.0 * TAU;
/// Coefficients of the radius of the fisheye lens (`OPENCV_FISHEYE`).
const FISHEYE: [f64; 6] = [0.03, -0.008, 0.001, 0.0, 0.0, 0.0];
/// A view sees a surface point if the traced depth agrees with the depth of the point to this relative error.
const VISIBILITY_TOLERANCE: f64 = 1e-6;

#[derive(Clone, Debug, PartialEq)]
pub struct BuiltinOptions {
    pub width: usize,
    pub height: usize,
    pub train_views: usize,
    pub test_views: usize,
    pub points: usize,
    /// Colour is the mean over a grid of this many rays by as many per pixel; at least 1.
    pub supersampling: usize,
    /// Largest change of exposure of a view, up or down, stops of linear light.
    pub exposure_stops: f64,
    /// Root-mean-square rotation of training cameras from where they took their photographs, degrees. The mean of their
    /// rotation vectors is 0.
    pub pose_degrees: f64,
    /// Root-mean-square translation of training cameras, extents.
    pub pose_extents: f64,
    /// Depth maps of the training views: exact, but for their steps. Relative ones are scaled and shifted from view to
    /// view.
    pub depth: Option<DepthKind>,
    /// Seed of the points, of the exposures and of what is wrong with poses. Cameras do not depend on it otherwise.
    pub seed: u64,
    /// Whether the photographs are taken through a fisheye lens that sees 170° across the picture.
    pub fisheye: bool,
}

impl Default for BuiltinOptions {
    fn default() -> Self {
        Self {
            width: 96,
            height: 96,
            train_views: 24,
            test_views: 6,
            points: 2000,
            supersampling: 3,
            exposure_stops: 0.0,
            pose_degrees: 0.0,
            pose_extents: 0.0,
            depth: None,
            seed: 1,
            fisheye: false,
        }
    }
}

impl BuiltinOptions {
    /// With `changes` to the photographs and cameras, for tests of what corrects them: any of `lens=fisheye`,
    /// `exposure_stops=0.5` (0 to 4), `pose_degrees=0.2` (0 to 10) and `pose_extents=0.005` (0 to 0.1), with commas in between.
    ///
    /// # Errors
    /// A sentence that names the change that is none.
    pub fn altered(mut self, changes: &str) -> Result<Self, String> {
        for change in changes.split(',').filter(|change| !change.is_empty()) {
            let named = match change.split_once('=') {
                Some(("lens", "fisheye")) => {
                    self.fisheye = true;
                    continue;
                }
                Some(("exposure_stops", stops)) => Some((&mut self.exposure_stops, 4.0, stops)),
                Some(("pose_degrees", degrees)) => Some((&mut self.pose_degrees, 10.0, degrees)),
                Some(("pose_extents", extents)) => Some((&mut self.pose_extents, 0.1, extents)),
                _ => None,
            };
            let number = |text: &str, most: f64| text.parse().ok().filter(|number| (0.0..=most).contains(number));
            let Some((option, value)) = named.and_then(|(option, most, text)| Some((option, number(text, most)?)))
            else {
                return Err(format!(
                    "the built-in scene has no change `{change}`: there are lens=fisheye, exposure_stops=0.5 (up to 4), \
                     pose_degrees=0.2 (up to 10) and pose_extents=0.005 (up to 0.1)"
                ));
            };
            *option = value;
        }
        Ok(self)
    }
}

/// A furnished room seen from a dome of cameras. The same options give the same dataset on every machine. The near
/// plane is at 0.01, a world unit is a metre, and pictures have no alpha.
pub fn builtin(options: &BuiltinOptions) -> Dataset {
    let mut exposures = ChaCha8Rng::seed_from_u64(options.seed);
    exposures.set_stream(1);
    let mut views = |name: &str, count: usize, phase: f64, depth: Option<DepthKind>| -> Vec<View> {
        let changes: Vec<f64> =
            (0..count).map(|_| options.exposure_stops * exposures.random_range(-1.0..=1.0)).collect();
        (0..count)
            .into_par_iter()
            .map(|index| {
                let camera = dome_camera(options, index, count, phase);
                let photograph = photograph(&camera, options.supersampling, changes[index]).into();
                let of_kind = |kind| DepthMap::from_depths(kind, &builtin_geometry(&camera).0);
                View { name: format!("{name}_{index:03}"), camera, photograph, depth: depth.map(of_kind), face: None }
            })
            .collect()
    };
    let mut train = views("train", options.train_views, 0.0, options.depth);
    let centres: Vec<DVec3> = train.iter().map(|view| view.camera.centre()).collect();
    let (_, extent) = mean_and_extent(&centres);
    let points = surface_points(&train, options);
    let shown_by: Vec<Camera> = train.iter().map(|view| view.camera).collect();
    misplace(&mut train, options, extent);
    Dataset {
        reprojection_px: reprojection_px(&points, &train, &shown_by),
        points,
        test: views("test", options.test_views, 0.5, None),
        validation: Vec::new(),
        train,
        offset: DVec3::ZERO,
        extent,
        background: [0.0; 3],
        format: Format::Builtin,
        near: NEAR,
        notices: Notices::default(),
        spare_memory: usize::MAX,
    }
}

/// Median over `train` of the median distance of points from where `shown_by`, the cameras of the photographs, show them, px.
fn reprojection_px(points: &PointCloud, train: &[View], shown_by: &[Camera]) -> Option<f64> {
    let seen = points.seen_by.by_view(train.len());
    let of_view = |index: usize| {
        let distances = seen[index].iter().filter_map(|&point| {
            let world = Vec3::from_array(points.positions[point as usize]).as_dvec3();
            let [(x, y, _), (shown_x, shown_y, _)] =
                [train[index].camera.project(world)?, shown_by[index].project(world)?];
            Some((x - shown_x).hypot(y - shown_y))
        });
        median(distances)
    };
    median((0..train.len()).filter_map(of_view))
}

/// Puts the cameras of `views` where they did not take their photographs, as `options` ask for in a scene of `extent`.
fn misplace(views: &mut [View], options: &BuiltinOptions, extent: f64) {
    let mut rng = ChaCha8Rng::seed_from_u64(options.seed);
    rng.set_stream(2);
    let mut vectors = |size: f64| -> Vec<DVec3> {
        let count = views.len() as f64;
        let mut random = || DVec3::from_array(std::array::from_fn(|_| rng.random_range(-1.0..=1.0)));
        let vectors: Vec<DVec3> = views.iter().map(|_| random()).collect();
        let mean = vectors.iter().sum::<DVec3>() / count;
        let square = vectors.iter().map(|vector| (*vector - mean).length_squared()).sum::<f64>() / count;
        // one view has nothing but its mean
        let factor = if square > 0.0 { size / square.sqrt() } else { 0.0 };
        vectors.into_iter().map(|vector| factor * (vector - mean)).collect()
    };
    let (turns, shifts) = (vectors(options.pose_degrees.to_radians()), vectors(options.pose_extents * extent));
    for ((view, turn), shift) in views.iter_mut().zip(turns).zip(shifts) {
        // a camera that stays where it is keeps its pose to the bit
        if [turn, shift] != [DVec3::ZERO; 2] {
            view.camera.camera_from_world = view.camera.camera_from_world.moved(turn, shift);
        }
    }
}

/// Depth [height, width] (world units) and world normal [3, height, width] (unit, towards the camera)
/// at the pixel centres of `camera`, which must stand inside the room |x|, |y| < 3, 0 < z < 3, outside its furniture.
pub fn builtin_geometry(camera: &Camera) -> (Vec<f32>, Vec<f32>) {
    let pixels = camera.width * camera.height;
    let mut depth = vec![0.0; pixels];
    let mut normal = vec![0.0; 3 * pixels];
    for pixel in 0..pixels {
        let (x, y) = (pixel % camera.width, pixel / camera.width);
        let hit = hit(camera, x as f64 + 0.5, y as f64 + 0.5);
        depth[pixel] = hit.distance as f32;
        for axis in 0..3 {
            normal[axis * pixels + pixel] = hit.normal[axis] as f32;
        }
    }
    (depth, normal)
}

/// Camera `index` of `count` on a dome around the furniture; `phase` shifts a set of views between those of another.
fn dome_camera(options: &BuiltinOptions, index: usize, count: usize, phase: f64) -> Camera {
    let height = (index as f64 + 0.5) / count as f64;
    let azimuth = index as f64 * GOLDEN_ANGLE + phase * TAU / 3.0;
    let elevation = 0.25 + 0.75 * height;
    let direction = DVec3::new(elevation.cos() * azimuth.cos(), elevation.cos() * azimuth.sin(), elevation.sin());
    let camera_from_world = CameraFromWorld::look_at(TARGET + 2.3 * direction, TARGET, DVec3::Z);
    let lens = options
        .fisheye
        .then(|| Lens::new(Distortion { numerator: FISHEYE, ..Distortion::new(Projection::Equidistant) }));
    let half = lens.map_or((0.5 * FIELD_OF_VIEW).tan(), |lens| lens.radial(0.5 * FISHEYE_ANGLE));
    let focal = 0.5 * options.width as f64 / half;
    Camera { lens, ..Camera::pinhole(camera_from_world, focal, [options.width, options.height], NEAR) }
}

/// The surface at position (x, y), px. The ray's direction has depth 1, so its distances are depths.
fn hit(camera: &Camera, x: f64, y: f64) -> Hit {
    let eye = camera.centre();
    trace(eye, camera.unproject(x, y, 1.0) - eye)
}

/// What `camera`, which stands where [`builtin_geometry`] allows, photographs: colours are the mean over a grid of `supersampling` by as
/// many rays per pixel, the exposure is changed by `stops` of linear light.
pub fn photograph(camera: &Camera, supersampling: usize, stops: f64) -> Picture {
    let (width, height) = (camera.width, camera.height);
    let pixels = width * height;
    let eye = camera.centre();
    let step = 1.0 / supersampling as f64;
    let mut planes = vec![0.0; 3 * pixels];
    for pixel in 0..pixels {
        let mut sum = DVec3::ZERO;
        for sample in 0..supersampling * supersampling {
            let x = (pixel % width) as f64 + ((sample % supersampling) as f64 + 0.5) * step;
            let y = (pixel / width) as f64 + ((sample / supersampling) as f64 + 0.5) * step;
            sum += hit(camera, x, y).colour(eye);
        }
        for channel in 0..3 {
            planes[channel * pixels + pixel] = exposed(sum[channel] * step * step, stops) as f32;
        }
    }
    Picture::from_planes(&planes, width, height)
}

/// The panorama of `width` by half as many px of a camera with a `pose`, likewise, and [height × width] the distances of what it
/// shows, world units.
pub fn builtin_panorama(pose: &CameraFromWorld, width: usize, supersampling: usize) -> (Picture, Vec<f32>) {
    let (height, samples) = (width / 2, supersampling * supersampling);
    let (eye, world_from_camera) = (pose.centre(), pose.rotation.transpose());
    let hit = |pixel: usize, x: f64, y: f64| {
        let at = DVec2::new(((pixel % width) as f64 + x) / width as f64, ((pixel / width) as f64 + y) / height as f64);
        trace(eye, world_from_camera * panorama::direction(at))
    };
    let colour = |pixel: usize| -> DVec3 {
        let share = |at: usize| (at as f64 + 0.5) / supersampling as f64;
        let of = |sample: usize| hit(pixel, share(sample % supersampling), share(sample / supersampling)).colour(eye);
        (0..samples).map(of).sum::<DVec3>() / samples as f64
    };
    let colours: Vec<DVec3> = (0..width * height).into_par_iter().map(colour).collect();
    let planes: Vec<f32> =
        (0..3).flat_map(|channel| colours.iter().map(move |colour| colour[channel] as f32)).collect();
    let distances = (0..width * height).map(|pixel| hit(pixel, 0.5, 0.5).distance as f32).collect();
    (Picture::from_planes(&planes, width, height), distances)
}

/// A display-referred value of a photograph with an exposure changed by `stops` of linear light, which clips at 1.
fn exposed(value: f64, stops: f64) -> f64 {
    if stops == 0.0 {
        return value;
    }
    let light = (linear(value) * stops.exp2()).min(1.0);
    if light <= 0.003_130_8 { 12.92 * light } else { 1.055 * light.powf(1.0 / 2.4) - 0.055 }
}

/// The ends of rays through random positions of random training views, as structure from motion might find them.
fn surface_points(train: &[View], options: &BuiltinOptions) -> PointCloud {
    let mut rng = ChaCha8Rng::seed_from_u64(options.seed);
    let mut points = PointCloud::default();
    if train.is_empty() {
        return points;
    }
    for _ in 0..options.points {
        let camera = &train[rng.random_range(0..train.len())].camera;
        let hit = hit(camera, rng.random::<f64>() * camera.width as f64, rng.random::<f64>() * camera.height as f64);
        let noise = DVec3::from_array(std::array::from_fn(|_| rng.random_range(-POINT_NOISE..=POINT_NOISE)));
        let seen_by = (0..).zip(train).filter(|(_, view)| sees(&view.camera, hit.position)).map(|(index, _)| index);
        points.positions.push((hit.position + noise).as_vec3().to_array());
        points.colours.push(hit.diffuse().as_vec3().to_array());
        points.seen_by.push(seen_by);
    }
    points
}

fn sees(camera: &Camera, position: DVec3) -> bool {
    camera.project(position).is_some_and(|(x, y, depth)| {
        let in_picture = (0.0..camera.width as f64).contains(&x) && (0.0..camera.height as f64).contains(&y);
        in_picture && (hit(camera, x, y).distance / depth - 1.0).abs() < VISIBILITY_TOLERANCE
    })
}

#[cfg(test)]
mod tests {
    use glam::DQuat;

    use super::*;

    #[test]
    fn changes_are_named_and_others_refused() {
        let changed = BuiltinOptions::default().altered("lens=fisheye,pose_degrees=0.2,exposure_stops=4").unwrap();
        assert_eq!((changed.fisheye, changed.pose_degrees, changed.exposure_stops), (true, 0.2, 4.0));
        assert_eq!(BuiltinOptions::default().altered(""), Ok(BuiltinOptions::default()));
        for change in ["lens=wide", "exposure_stops=4.1", "pose_extents=-1", "pose_degrees=nan", "fisheye"] {
            let error = BuiltinOptions::default().altered(change).unwrap_err();
            assert!(error.contains(&format!("`{change}`")), "{error}");
        }
    }

    #[test]
    fn it_is_what_the_options_say_and_always_the_same() {
        let data = builtin(&BuiltinOptions::default());
        assert_eq!((data.train.len(), data.test.len(), data.points.positions.len()), (24, 6, 2000));
        assert_eq!((data.format, data.near, data.offset), (Format::Builtin, 0.01, DVec3::ZERO));
        assert!(data.extent > 1.5 && data.extent < 3.0, "{}", data.extent);
        for view in data.train.iter().chain(&data.test) {
            view.camera.validate().unwrap();
            let picture = view.picture().unwrap();
            assert_eq!((view.camera.width, picture.height, picture.bytes.len()), (96, 96, 3 * 96 * 96));
            assert!(view.photograph.is_kept());
        }
        let again = builtin(&BuiltinOptions::default());
        assert_eq!(data.points, again.points);
        for (a, b) in data.train.iter().zip(&again.train) {
            assert!(a.picture().unwrap() == b.picture().unwrap() && a.camera == b.camera, "{}", a.name);
        }
    }

    /// Mean difference of the colours of points, and of other points, from those of the pixels that see them, and the number of
    /// observations.
    fn colour_differences(data: &Dataset) -> [f32; 3] {
        let pictures: Vec<_> = data.train.iter().map(|view| view.picture().unwrap()).collect();
        let (mut sum, mut shuffled, mut observations) = (0.0, 0.0, 0.0);
        let count = data.points.positions.len();
        for (index, views) in data.points.seen_by.iter().enumerate() {
            let position = DVec3::from_array(data.points.positions[index].map(f64::from));
            for &view in views {
                let (camera, picture) = (&data.train[view as usize].camera, &pictures[view as usize]);
                let (x, y, _) = camera.project(position).unwrap();
                let rgb = picture.rgb((x as usize).min(camera.width - 1), (y as usize).min(camera.height - 1));
                let difference = |colour: [f32; 3]| (0..3).map(|c| (rgb[c] - colour[c]).abs() / 3.0).sum::<f32>();
                sum += difference(data.points.colours[index]);
                shuffled += difference(data.points.colours[(index + 977) % count]);
                observations += 1.0;
            }
        }
        [sum / observations, shuffled / observations, observations]
    }

    #[test]
    fn points_have_the_colour_of_the_pixels_that_see_them() {
        let data = builtin(&BuiltinOptions::default());
        assert!(data.points.seen_by.iter().all(|views| !views.is_empty()), "each was sampled in a view");
        let [mean, shuffled, observations] = colour_differences(&data);
        assert!(mean < 0.06 && shuffled > 3.0 * mean, "{mean} {shuffled} over {observations}");
    }

    #[test]
    fn depth_and_normals_lie_on_the_surfaces() {
        let data = builtin(&BuiltinOptions { points: 0, ..Default::default() });
        let camera = data.train[5].camera;
        let (depth, normal) = builtin_geometry(&camera);
        let pixels = 96 * 96;
        let world = |pixel: usize, dx: f64, dy: f64| {
            let (x, y) = ((pixel % 96) as f64 + 0.5, (pixel / 96) as f64 + 0.5);
            camera.unproject(x + dx, y + dy, f64::from(depth[pixel]))
        };
        let mut on_floor = 0;
        for pixel in 0..pixels {
            let normal = DVec3::from_array(std::array::from_fn(|axis| f64::from(normal[axis * pixels + pixel])));
            assert!((normal.length() - 1.0).abs() < 1e-6);
            assert!(normal.dot(world(pixel, 0.0, 0.0) - camera.centre()) < 0.0, "normals face the camera");
            if world(pixel, 0.0, 0.0).z.abs() < 1e-5 {
                assert_eq!(normal, DVec3::Z);
                on_floor += 1;
            }
        }
        assert!(on_floor > 1000, "{on_floor}");
    }

    #[test]
    fn exposures_change_brightness_alone_and_by_no_more_than_asked() {
        assert!((exposed(0.3, 0.0) - 0.3).abs() < 1e-12);
        // half of the linear light of 0.5 is 0.107, that of 0.3608
        assert!((exposed(0.5, -1.0) - 0.3608).abs() < 1e-3, "{}", exposed(0.5, -1.0));
        assert!((exposed(exposed(0.5, -1.0), 1.0) - 0.5).abs() < 1e-6);
        assert!((exposed(0.95, 2.0) - 1.0).abs() < 1e-12);
        let options = BuiltinOptions { width: 24, height: 24, ..Default::default() };
        let plain = builtin(&options);
        let changed = builtin(&BuiltinOptions { exposure_stops: 0.5, ..options });
        assert_eq!(plain.points, changed.points);
        let pairs = || plain.train.iter().chain(&plain.test).zip(changed.train.iter().chain(&changed.test));
        let brightness = |view: &View| f64::from(view.picture().unwrap().planes().iter().sum::<f32>());
        let ratios: Vec<f64> = pairs().map(|(a, b)| brightness(b) / brightness(a)).collect();
        let (low, high) =
            ratios.iter().fold((f64::MAX, 0.0f64), |(low, high), &ratio| (low.min(ratio), high.max(ratio)));
        // half a stop is a factor of about 1.17 in display-referred values
        assert!(low > 0.8 && low < 0.95 && high > 1.05 && high < 1.25, "{low} to {high}");
        assert!(pairs().all(|(a, b)| a.camera == b.camera && a.name == b.name));
    }

    #[test]
    fn misplaced_cameras_are_as_wrong_as_asked_around_where_they_took_their_photographs() {
        let options =
            BuiltinOptions { width: 8, height: 8, train_views: 7, test_views: 2, points: 50, ..Default::default() };
        let right = builtin(&options);
        let wrong = builtin(&BuiltinOptions { pose_degrees: 0.2, pose_extents: 0.005, ..options });
        assert_eq!((&right.points, right.extent), (&wrong.points, wrong.extent));
        assert!(right.test.iter().zip(&wrong.test).all(|(a, b)| a.camera == b.camera));
        let (extent, mut turns, mut shifts) = (wrong.extent, Vec::new(), Vec::new());
        for (right, wrong) in right.train.iter().zip(&wrong.train) {
            assert_eq!(right.picture().unwrap(), wrong.picture().unwrap());
            let (a, b) = (&right.camera.camera_from_world, &wrong.camera.camera_from_world);
            turns.push(DQuat::from_mat3(&(b.rotation.transpose() * a.rotation)).to_scaled_axis());
            shifts.push(b.centre() - a.centre());
        }
        let mean = |vectors: &[DVec3]| (vectors.iter().sum::<DVec3>() / vectors.len() as f64).length();
        let size = |vectors: &[DVec3]| {
            (vectors.iter().map(|vector| vector.length_squared()).sum::<f64>() / vectors.len() as f64).sqrt()
        };
        assert!(mean(&turns) < 1e-9, "{}", mean(&turns));
        assert!((size(&turns).to_degrees() - 0.2).abs() < 1e-6, "{}", size(&turns).to_degrees());
        assert!(mean(&shifts) < 1e-9, "{}", mean(&shifts));
        assert!((size(&shifts) / extent - 0.005).abs() < 1e-9, "{}", size(&shifts));
    }

    #[test]
    fn a_fisheye_sees_170_degrees_across_its_picture() {
        let size = 64;
        let options = BuiltinOptions { width: size, height: size, fisheye: true, points: 300, ..Default::default() };
        let data = builtin(&options);
        let camera = data.train[3].camera;
        camera.validate().unwrap();
        assert_eq!(camera.shown_pixels(), None);
        let [left, right] = [0.0, size as f64].map(|x| camera.ray(x, 0.5 * size as f64).unwrap());
        assert!((left.angle_between(right).to_degrees() - 170.0).abs() < 1e-6);
        let [mean, shuffled, observations] = colour_differences(&data);
        let differ = mean < 0.1 && shuffled > 2.0 * mean;
        assert!(observations > 1000.0 && differ, "{mean} {shuffled} of {observations}");
        let straight = data.train[3].undistorted().unwrap().unwrap();
        assert!(straight.camera.lens.is_none() && straight.picture().unwrap() != data.train[3].picture().unwrap());
    }

    #[test]
    fn highlights_depend_on_the_view_and_are_mild() {
        let data = builtin(&BuiltinOptions::default());
        let ball_top = trace(DVec3::new(0.5, 0.45, 2.5), -DVec3::Z);
        let colours: Vec<DVec3> = data.train.iter().map(|view| ball_top.colour(view.camera.centre())).collect();
        let spread = colours.iter().map(|colour| (*colour - colours[0]).length()).fold(0.0, f64::max);
        assert!(spread > 0.02 && spread < 0.5, "{spread}");
    }
}
