//! Points on the surfaces that several views agree about, from the depths that trained Gaussians have in these views.
//!
//! A point is evidence for a surface if the picture of its view is opaque there and of one depth, if at least
//! [`FusionRule::min_views`] other views have that depth where they see it, and if no more than half as many look through
//! it. What is no surface (leaves, sky, floaters) has no such points.

use dpges_core::camera::Camera;
use glam::Vec3;
use rayon::prelude::*;

use crate::dataset::PointCloud;

/// Views that a point is checked in: those whose cameras are nearest to its own.
const CHECKED_VIEWS: usize = 24;

/// What trained Gaussians look like in a view.
pub struct DepthView<'a> {
    pub camera: &'a Camera,
    /// [H × W] camera-space z, world units; not positive where the picture is not opaque and of one depth.
    pub depth: Vec<f32>,
    /// [3 × H × W] of the photograph.
    pub photograph: &'a [f32],
}

/// When a depth is a surface.
#[derive(Clone, Copy, Debug)]
pub struct FusionRule {
    /// Largest difference of depths that agree, relative to the depth.
    pub tolerance: f64,
    /// Fewest other views that agree.
    pub min_views: usize,
}

/// Surface points, about one per `stride_px` × `stride_px` square of a view, and at most one in any of them: views take
/// only what earlier ones do not show. With the views that saw each.
pub fn surface_points(views: &[DepthView<'_>], stride_px: usize, rule: FusionRule) -> PointCloud {
    let mut cloud = PointCloud::default();
    for (index, view) in views.iter().enumerate() {
        let neighbours = nearest_views(views, index);
        let covered = covered(view, &cloud.positions, stride_px, rule);
        let (columns, rows) = squares(view.camera, stride_px);
        let found: Vec<_> = (0..columns * rows)
            .into_par_iter()
            .filter(|&square| !covered[square])
            .filter_map(|square| {
                let pixel = |at: usize, size: usize| (at * stride_px + stride_px / 2).min(size - 1);
                let x = pixel(square % columns, view.camera.width);
                let y = pixel(square / columns, view.camera.height);
                surface_point(views, index, &neighbours, [x, y], rule)
            })
            .collect();
        for (position, colour, seen_by) in found {
            cloud.positions.push(position);
            cloud.colours.push(colour);
            cloud.seen_by.push(seen_by);
        }
    }
    cloud
}

/// Columns and rows of squares.
fn squares(camera: &Camera, stride_px: usize) -> (usize, usize) {
    (camera.width.div_ceil(stride_px), camera.height.div_ceil(stride_px))
}

/// The other views, nearest first.
fn nearest_views(views: &[DepthView<'_>], index: usize) -> Vec<usize> {
    let own = views[index].camera.centre();
    let mut others: Vec<usize> = (0..views.len()).filter(|&other| other != index).collect();
    others.sort_by(|&a, &b| {
        let distance = |view: usize| views[view].camera.centre().distance_squared(own);
        distance(a).total_cmp(&distance(b)).then(a.cmp(&b))
    });
    others.truncate(CHECKED_VIEWS);
    others
}

impl DepthView<'_> {
    /// The depth at a pixel, if it is known.
    fn known_depth(&self, pixel: usize) -> Option<f64> {
        let depth = f64::from(self.depth[pixel]);
        (depth.is_finite() && depth > 0.0).then_some(depth)
    }
}

/// Which squares of a view show one of `positions`.
fn covered(view: &DepthView<'_>, positions: &[[f32; 3]], stride_px: usize, rule: FusionRule) -> Vec<bool> {
    let (columns, rows) = squares(view.camera, stride_px);
    let mut covered = vec![false; columns * rows];
    for &position in positions {
        let Some((pixel, z)) = view.camera.pixel(Vec3::from_array(position).as_dvec3()) else { continue };
        let hidden = view.known_depth(pixel).is_some_and(|depth| z > depth * (1.0 + rule.tolerance));
        if !hidden {
            let (x, y) = (pixel % view.camera.width, pixel / view.camera.width);
            covered[y / stride_px * columns + x / stride_px] = true;
        }
    }
    covered
}

type Found = ([f32; 3], [f32; 3], Vec<u32>);

/// The point at pixel (`x`, `y`) of a view if it is on a surface, its colour, and the views that agree.
fn surface_point(
    views: &[DepthView<'_>],
    index: usize,
    neighbours: &[usize],
    [x, y]: [usize; 2],
    rule: FusionRule,
) -> Option<Found> {
    let view = &views[index];
    let (width, area) = (view.camera.width, view.camera.width * view.camera.height);
    let pixel = y * width + x;
    let world = view.camera.unproject(x as f64 + 0.5, y as f64 + 0.5, view.known_depth(pixel)?);
    let mut seen_by = vec![index as u32];
    let mut looked_through = 0;
    for &other in neighbours {
        let Some((at, z)) = views[other].camera.pixel(world) else { continue };
        let Some(depth) = views[other].known_depth(at) else { continue };
        if (depth - z).abs() <= rule.tolerance * z {
            seen_by.push(other as u32);
        } else if depth > z {
            looked_through += 1;
        }
    }
    let agreeing = seen_by.len() - 1;
    seen_by.sort_unstable();
    let colour = [0, 1, 2].map(|channel| view.photograph[channel * area + pixel]);
    (agreeing >= rule.min_views && agreeing >= 2 * looked_through)
        .then(|| (world.as_vec3().to_array(), colour, seen_by))
}

#[cfg(test)]
mod tests {
    use dpges_core::camera::CameraFromWorld;
    use glam::DVec3;

    use super::*;

    const SIZE: usize = 40;
    const RULE: FusionRule = FusionRule { tolerance: 0.01, min_views: 3 };

    /// Cameras beside one another that look along z at the plane z = 0.
    fn cameras(count: usize) -> Vec<Camera> {
        let camera = |i: usize| {
            let eye = DVec3::new(0.1 * i as f64, 0.0, -4.0);
            let camera_from_world = CameraFromWorld::look_at(eye, eye + DVec3::Z, -DVec3::Y);
            Camera {
                camera_from_world,
                fx: 40.0,
                fy: 40.0,
                cx: 20.0,
                cy: 20.0,
                width: SIZE,
                height: SIZE,
                near: 0.1,
                lens: None,
            }
        };
        (0..count).map(camera).collect()
    }

    fn views<'a>(
        cameras: &'a [Camera],
        photograph: &'a [f32],
        depth: impl Fn(usize, usize) -> f32,
    ) -> Vec<DepthView<'a>> {
        let of = |(i, camera): (usize, &'a Camera)| DepthView {
            camera,
            depth: (0..SIZE * SIZE).map(|pixel| depth(i, pixel)).collect(),
            photograph,
        };
        cameras.iter().enumerate().map(of).collect()
    }

    #[test]
    fn a_plane_gets_one_point_per_square() {
        let (cameras, photograph) = (cameras(6), vec![0.25; 3 * SIZE * SIZE]);
        let found = surface_points(&views(&cameras, &photograph, |_, _| 4.0), 8, RULE);
        // 25 squares of the first view, and a few more at the border of each of the others
        assert!((25..60).contains(&found.positions.len()), "{}", found.positions.len());
        assert!(found.positions.iter().all(|position| position[2].abs() < 1e-5));
        assert!(found.seen_by.iter().all(|seen| seen.len() > 3 && seen.is_sorted()));
        assert_eq!(found.colours[0], [0.25; 3]);
    }

    #[test]
    fn what_few_views_see_or_many_look_through_is_no_surface() {
        let (cameras, photograph) = (cameras(9), vec![0.5; 3 * SIZE * SIZE]);
        let points = |depth: &dyn Fn(usize, usize) -> f32| {
            surface_points(&views(&cameras, &photograph, depth), 8, RULE).positions.len()
        };
        // the plane in the first 3, 4 and 5 of 9 views, nothing known in the others
        let known_in = |count: usize| points(&move |view, _| if view < count { 4.0 } else { 0.0 });
        assert_eq!(known_in(3), 0);
        assert!(known_in(4) > 20);
        // five views see something in front of the plane, four the plane behind it, which is hidden from nobody
        let found = surface_points(&views(&cameras, &photograph, |view, _| if view < 5 { 3.0 } else { 4.0 }), 8, RULE);
        // in the middle, which all views see, nothing is in front of the plane
        let middle: Vec<_> = found.positions.iter().filter(|position| position[0].abs() < 0.5).collect();
        assert!(!middle.is_empty() && middle.iter().all(|position| position[2].abs() < 1e-5), "{middle:?}");
        let in_front = surface_points(&views(&cameras, &photograph, |_, _| 3.0), 8, RULE);
        assert!(in_front.positions.iter().all(|position| (position[2] + 1.0).abs() < 1e-5));
        // each sees another depth
        assert_eq!(points(&|view, _| 3.0 + 0.2 * view as f32), 0);
    }

    #[test]
    fn no_views_have_no_points() {
        assert!(surface_points(&[], 4, RULE).positions.is_empty());
    }
}
