//! Points on the surfaces that several views agree about, from the depths that trained Gaussians have in these views.
//!
//! A point is evidence for a surface if the picture of its view is opaque there and of one depth, if at least
//! [`FusionRule::min_views`] other views have that depth where they see it, and if no more than half as many look through
//! it. Leaves, sky and floaters have no such points.

use std::sync::Arc;

use dpges_core::Result;
use dpges_core::camera::Camera;
use glam::Vec3;
use rayon::prelude::*;

use crate::dataset::PointCloud;
use crate::views::exposure::Seen;

/// Views that a point is checked in: those whose cameras are nearest to its own.
pub const CHECKED_VIEWS: usize = 24;

/// Views of trained Gaussians, and their photographs: both are made when they are asked for.
pub struct DepthViews<'a> {
    pub cameras: Vec<&'a Camera>,
    /// [H × W] depth, world units; not positive where the picture is not opaque and of one depth, or does not count.
    pub depth: &'a dyn Fn(usize) -> Result<Arc<Vec<f32>>>,
    pub photograph: &'a dyn Fn(usize) -> Result<Seen<'a>>,
}

/// A camera, and what it sees.
struct DepthView<'a> {
    camera: &'a Camera,
    depth: Arc<Vec<f32>>,
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
///
/// # Errors
/// [`dpges_core::Error`] if a view cannot be rendered, or its photograph not be read.
pub fn surface_points(views: &DepthViews<'_>, stride_px: usize, rule: FusionRule) -> Result<PointCloud> {
    let mut cloud = PointCloud::default();
    let view_at = |index: usize| Ok(DepthView { camera: views.cameras[index], depth: (views.depth)(index)? });
    for index in 0..views.cameras.len() {
        let (view, photograph) = (view_at(index)?, (views.photograph)(index)?);
        let others = nearest_views(&views.cameras, index).into_iter().map(|other| Ok((other, view_at(other)?)));
        let others = others.collect::<Result<Vec<_>>>()?;
        let covered = covered(&view, &cloud.positions, stride_px, rule);
        let (columns, rows) = squares(view.camera, stride_px);
        let found: Vec<_> = (0..columns * rows)
            .into_par_iter()
            .filter(|&square| !covered[square])
            .filter_map(|square| {
                let pixel = |at: usize, size: usize| (at * stride_px + stride_px / 2).min(size - 1);
                let x = pixel(square % columns, view.camera.width);
                let y = pixel(square / columns, view.camera.height);
                let (position, seen_by) = surface_point(index, &view, &others, [x, y], rule)?;
                Some((position, photograph.colour(y * view.camera.width + x), seen_by))
            })
            .collect();
        for (position, colour, seen_by) in found {
            cloud.positions.push(position);
            cloud.colours.push(colour);
            cloud.seen_by.push(seen_by);
        }
    }
    Ok(cloud)
}

/// Columns and rows of squares.
fn squares(camera: &Camera, stride_px: usize) -> (usize, usize) {
    (camera.width.div_ceil(stride_px), camera.height.div_ceil(stride_px))
}

/// The other views, nearest first.
fn nearest_views(cameras: &[&Camera], index: usize) -> Vec<usize> {
    let own = cameras[index].centre();
    let mut others: Vec<usize> = (0..cameras.len()).filter(|&other| other != index).collect();
    others.sort_by(|&a, &b| {
        let distance = |view: usize| cameras[view].centre().distance_squared(own);
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

/// The point at pixel (`x`, `y`) of the `view` with this `index` if it is on a surface, and the views that agree.
fn surface_point(
    index: usize,
    view: &DepthView<'_>,
    others: &[(usize, DepthView<'_>)],
    [x, y]: [usize; 2],
    rule: FusionRule,
) -> Option<([f32; 3], Vec<u32>)> {
    let pixel = y * view.camera.width + x;
    let world = view.camera.unproject(x as f64 + 0.5, y as f64 + 0.5, view.known_depth(pixel)?);
    let mut seen_by = vec![index as u32];
    let mut looked_through = 0;
    for (other, view) in others {
        let Some((at, z)) = view.camera.pixel(world) else { continue };
        let Some(depth) = view.known_depth(at) else { continue };
        if (depth - z).abs() <= rule.tolerance * z {
            seen_by.push(*other as u32);
        } else if depth > z {
            looked_through += 1;
        }
    }
    let agreeing = seen_by.len() - 1;
    (agreeing >= rule.min_views && agreeing >= 2 * looked_through).then(|| (world.as_vec3().to_array(), seen_by))
}

#[cfg(test)]
mod tests {
    use dpges_core::camera::CameraFromWorld;
    use glam::DVec3;

    use super::*;
    use crate::dataset::Picture;
    use crate::init::plane_sweep;
    use crate::views::exposure::Correction;

    const SIZE: usize = 40;
    const RULE: FusionRule = FusionRule { tolerance: 0.01, min_views: 3 };

    /// Cameras beside one another that look along z at the plane z = 0.
    fn cameras(count: usize) -> Vec<Camera> {
        let camera = |i: usize| {
            let eye = DVec3::new(0.1 * i as f64, 0.0, -4.0);
            let camera_from_world = CameraFromWorld::look_at(eye, eye + DVec3::Z, -DVec3::Y);
            Camera { camera_from_world, ..plane_sweep::tests::camera(DVec3::X, SIZE, 40.0) }
        };
        (0..count).map(camera).collect()
    }

    /// Points where cameras see `depth` of a view at a pixel, in grey photographs with this `correction`.
    fn corrected(
        cameras: &[Camera],
        depth: impl Fn(usize, usize) -> f32,
        correction: Option<&Correction>,
    ) -> PointCloud {
        let grey = Arc::new(Picture::from_planes(&vec![0.2; 3 * SIZE * SIZE], SIZE, SIZE));
        let views = DepthViews {
            cameras: cameras.iter().collect(),
            depth: &|view| Ok(Arc::new((0..SIZE * SIZE).map(|pixel| depth(view, pixel)).collect())),
            photograph: &|view| Ok(Seen { camera: &cameras[view], picture: Arc::clone(&grey), correction }),
        };
        surface_points(&views, 8, RULE).unwrap()
    }

    fn points(cameras: &[Camera], depth: impl Fn(usize, usize) -> f32) -> PointCloud {
        corrected(cameras, depth, None)
    }

    #[test]
    fn a_plane_gets_one_point_per_square() {
        let found = points(&cameras(6), |_, _| 4.0);
        // 25 squares of the first view, and a few more at the border of each of the others
        assert!((25..60).contains(&found.positions.len()), "{}", found.positions.len());
        assert!(found.positions.iter().all(|position| position[2].abs() < 1e-5));
        assert!(found.seen_by.iter().all(|seen| seen.len() > 3));
        assert_eq!(found.colours[0], [0.2; 3]);
        let twice = Correction { gain: [2.0; 3], offset: [0.0, 0.125, 0.0] };
        let undone = corrected(&cameras(6), |_, _| 4.0, Some(&twice));
        assert_eq!(undone.positions, found.positions);
        assert_eq!(undone.colours[0], [0.2 / 2.0, (0.2 - 0.125) / 2.0, 0.2 / 2.0]);
    }

    #[test]
    fn what_few_views_see_or_many_look_through_is_no_surface() {
        let cameras = cameras(9);
        let count = |depth: &dyn Fn(usize, usize) -> f32| points(&cameras, depth).positions.len();
        // the plane in the first 3, 4 and 5 of 9 views, nothing known in the others
        let known_in = |views: usize| count(&move |view, _| if view < views { 4.0 } else { 0.0 });
        assert_eq!(known_in(3), 0);
        assert!(known_in(4) > 20);
        // five views see something in front of the plane, four the plane behind it, which is hidden from nobody
        let found = points(&cameras, |view, _| if view < 5 { 3.0 } else { 4.0 });
        // in the middle, which all views see, nothing is in front of the plane
        let middle: Vec<_> = found.positions.iter().filter(|position| position[0].abs() < 0.5).collect();
        assert!(!middle.is_empty() && middle.iter().all(|position| position[2].abs() < 1e-5), "{middle:?}");
        let in_front = points(&cameras, |_, _| 3.0);
        assert!(in_front.positions.iter().all(|position| (position[2] + 1.0).abs() < 1e-5));
        // each sees another depth
        assert_eq!(count(&|view, _| 3.0 + 0.2 * view as f32), 0);
        assert!(points(&[], |_, _| 4.0).positions.is_empty());
    }
}
