//! The cut that a camera asks for: which cells are to be replaced by their children.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use dpges_core::camera::Camera;
use dpges_core::scene::lod::{Cell, Index};
use glam::DVec3;

/// Cells are not refined whose primitives are narrower than this on the screen, px.
const LEAST_PX: f64 = 1.0;
/// A cell that is refined stays so until its primitives are smaller than the least, or than those of others, by this, and its
/// box counts as larger by as much.
const HELD: f64 = 1.25;
/// Weight of cells outside the picture: near ones are there when the camera turns, if the budget has room for them.
const OUTSIDE: f64 = 0.1;

/// The inner cells that a cut of at most `room` primitives lies below, those with the largest primitives on the screen of
/// `camera` first; with `everything`, down to level 0 however small these are. `refined` says which of them are refined now,
/// `blocked` which cannot be.
pub(super) fn refinements(
    index: &Index,
    camera: &Camera,
    room: usize,
    everything: bool,
    refined: impl Fn(usize) -> bool,
    blocked: impl Fn(usize) -> bool,
) -> Vec<usize> {
    let least = if everything { 0.0 } else { LEAST_PX };
    let eye = camera.centre();
    // the widest first, then the first; widths are not negative, so that their bits are in their order
    let candidate = |cell: usize| {
        let hold = if refined(cell) { HELD } else { 1.0 };
        let priority = hold * width_px(camera, eye, &index.cells[cell], hold);
        let may_be_refined = !index.cells[cell].children.is_empty() && priority >= least;
        may_be_refined.then(|| (priority.to_bits(), Reverse(cell)))
    };
    let mut cost = index.roots().map(|cell| index.cells[cell].primitives()).sum::<usize>();
    let mut candidates: BinaryHeap<_> = index.roots().filter_map(candidate).collect();
    let mut found = Vec::new();
    while let Some((_, Reverse(cell))) = candidates.pop() {
        let finer = cost - index.cells[cell].primitives() + children_primitives(index, cell);
        if finer > room || blocked(cell) {
            continue;
        }
        cost = finer;
        found.push(cell);
        candidates.extend(index.cells[cell].children.iter().copied().filter_map(candidate));
    }
    found
}

pub(super) fn children_primitives(index: &Index, cell: usize) -> usize {
    index.cells[cell].children.iter().map(|&child| index.cells[child].primitives()).sum()
}

/// Width of a primitive of `cell` as near to `eye` as the cell's box is, px; less if the box, made `larger`, is outside the
/// picture.
fn width_px(camera: &Camera, eye: DVec3, cell: &Cell, larger: f64) -> f64 {
    let [min, max] = [cell.min, cell.max].map(|corner| DVec3::from(corner.map(f64::from)));
    let distance = (eye.clamp(min, max) - eye).length().max(camera.near);
    let width = 2.0 * f64::from(cell.size) * camera.fx.max(camera.fy) / distance;
    if is_outside(camera, 0.5 * (min + max), 0.5 * larger * (max - min)) { OUTSIDE * width } else { width }
}

/// Whether all of the box that reaches `half` to both sides of `centre` is beyond one side of the picture, or behind the
/// camera.
fn is_outside(camera: &Camera, centre: DVec3, half: DVec3) -> bool {
    let pose = &camera.camera_from_world;
    let at = pose.rotation * centre + pose.translation;
    let Camera { fx, fy, cx, cy, width, height, near, .. } = *camera;
    let sides = [
        (DVec3::new(fx, 0.0, cx), 0.0),
        (DVec3::new(-fx, 0.0, width as f64 - cx), 0.0),
        (DVec3::new(0.0, fy, cy), 0.0),
        (DVec3::new(0.0, -fy, height as f64 - cy), 0.0),
        (DVec3::Z, near),
    ];
    // rows of the transpose turn a side into world axes
    sides.iter().any(|&(inwards, least)| {
        let reach = (pose.rotation.transpose() * inwards).abs().dot(half);
        inwards.dot(at) + reach < least
    })
}

#[cfg(test)]
mod tests {
    use super::super::fixtures::{camera, forest};
    use super::*;

    #[test]
    fn boxes_are_outside_only_where_nothing_of_them_is_seen() {
        let camera = camera([0.0, 0.0, -10.0]);
        let outside = |at: [f64; 3], half: f64| is_outside(&camera, DVec3::from(at), DVec3::splat(half));
        assert!(!outside([0.0; 3], 1.0) && !outside([4.9, 0.0, 0.0], 0.5) && !outside([0.0, 0.0, -10.0], 30.0));
        assert!(outside([0.0, 0.0, -12.0], 1.0), "behind");
        assert!(outside([8.0, 0.0, 0.0], 1.0) && outside([0.0, -8.0, 0.0], 1.0));
        assert!(!outside([8.0, 0.0, 0.0], 4.0), "it reaches into the picture");
    }

    #[test]
    fn the_nearest_and_largest_come_first_and_nothing_finer_than_a_pixel() {
        let index = forest(2, 3);
        let near = camera([0.0, 0.0, -3.0]);
        let of = |camera: &Camera, room| refinements(&index, camera, room, false, |_| false, |_| false);
        let total = |found: &[usize]| {
            let roots = index.roots().map(|cell| index.cells[cell].primitives()).sum::<usize>();
            let more = |&cell: &usize| children_primitives(&index, cell) - index.cells[cell].primitives();
            roots + found.iter().map(more).sum::<usize>()
        };
        let mut before = 0;
        for room in [200, 500, 900, 5000] {
            let found = of(&near, room);
            assert!(total(&found) <= room && found.len() >= before, "{room}: {found:?}");
            before = found.len();
        }
        let inner = index.cells.iter().filter(|cell| !cell.children.is_empty()).count();
        assert_eq!(refinements(&index, &near, usize::MAX, true, |_| false, |_| false).len(), inner);
        let far = camera([0.0, 0.0, -1e6]);
        assert!(of(&far, usize::MAX).is_empty());
        assert_eq!(refinements(&index, &far, usize::MAX, true, |_| false, |_| false).len(), inner);
    }

    #[test]
    fn a_parent_comes_before_its_children_and_blocked_cells_stay_whole() {
        let index = forest(1, 3);
        let found = refinements(&index, &camera([0.0, 0.0, -3.0]), usize::MAX, true, |_| false, |_| false);
        for (at, &cell) in found.iter().enumerate() {
            assert!(index.cells[cell].parent.is_none_or(|parent| found[..at].contains(&parent)));
        }
        let child = index.cells[0].children[0];
        let without = refinements(&index, &camera([0.0, 0.0, -3.0]), usize::MAX, true, |_| false, |cell| cell == child);
        assert!(!without.contains(&child) && without.contains(&0));
    }
}
