//! Kinds of pixels, by the layers that were peeled there.

/// Depths of neighbouring pixels that differ by more belong to different surfaces, relative to the smaller one. A plane
/// that a picture of 128 px across 52° shows at an angle of less than 80° stays below it.
pub const DEPTH_JUMP: f32 = 0.05;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PixelKind {
    /// The nearest layer is not opaque, and an opaque layer follows.
    Rim,
    /// No layer is opaque, or a neighbour shows another surface.
    Silhouette,
    /// The nearest layer is opaque.
    Inside,
    /// There is no layer.
    Uncovered,
}

impl PixelKind {
    pub const ALL: [Self; 4] = [Self::Inside, Self::Rim, Self::Silhouette, Self::Uncovered];

    pub fn name(self) -> &'static str {
        match self {
            Self::Rim => "rim",
            Self::Silhouette => "silhouette",
            Self::Inside => "inside",
            Self::Uncovered => "uncovered",
        }
    }
}

/// [H × W] kinds of the pixels of a view with layers of `alpha` and `depth` [K, H, W], as
/// [`peel`](fn@dpges_core::ops::peel::peel) returns them.
pub fn kinds(alpha: &[f32], depth: &[f32], width: usize, height: usize) -> Vec<PixelKind> {
    let area = width * height;
    let layers = |pixel: usize| (pixel..depth.len()).step_by(area).take_while(|&layer| depth[layer].is_finite());
    let opaque = |pixel: usize| layers(pixel).find(|&layer| alpha[layer] >= 1.0);
    let surface: Vec<f32> = (0..area)
        .map(|pixel| opaque(pixel).or_else(|| layers(pixel).next()).map_or(f32::INFINITY, |layer| depth[layer]))
        .collect();
    let kind = |pixel: usize| match (layers(pixel).next(), opaque(pixel)) {
        (None, _) => PixelKind::Uncovered,
        (Some(_), None) => PixelKind::Silhouette,
        (Some(_), Some(_)) if is_at_edge(&surface, width, pixel) => PixelKind::Silhouette,
        (Some(nearest), Some(opaque)) if nearest == opaque => PixelKind::Inside,
        (Some(_), Some(_)) => PixelKind::Rim,
    };
    (0..area).map(kind).collect()
}

/// Whether the `depth` [H × W] of a pixel differs from that of a neighbour by a jump. Depths that are not finite are
/// unknown, and differ from none.
pub fn is_at_edge(depth: &[f32], width: usize, pixel: usize) -> bool {
    let own = depth[pixel];
    neighbours(depth.len(), width, pixel).any(|at| is_jump(own, depth[at]) || is_jump(depth[at], own))
}

/// Likewise, and the neighbour is farther away.
pub fn is_before_edge(depth: &[f32], width: usize, pixel: usize) -> bool {
    neighbours(depth.len(), width, pixel).any(|at| is_jump(depth[pixel], depth[at]))
}

fn is_jump(near: f32, far: f32) -> bool {
    near.is_finite() && far.is_finite() && far - near > DEPTH_JUMP * near
}

/// The up to four pixels beside one of a picture with this `area`.
fn neighbours(area: usize, width: usize, pixel: usize) -> impl Iterator<Item = usize> {
    let x = pixel % width;
    let left = (x > 0).then(|| pixel - 1);
    let right = (x + 1 < width).then(|| pixel + 1);
    let above = pixel.checked_sub(width);
    let below = (pixel + width < area).then(|| pixel + width);
    [left, right, above, below].into_iter().flatten()
}

#[cfg(test)]
mod tests {
    use super::*;

    const NONE: f32 = f32::INFINITY;

    #[test]
    fn the_nearest_layer_and_an_opaque_one_behind_it_decide() {
        // opaque; a rim before an opaque layer; two rims; a rim alone; nothing
        let alpha = [1.0, 0.4, 0.4, 0.9, 0.0, 0.0, 1.0, 0.7, 0.0, 0.0];
        let depth = [2.0, 2.0, 2.0, 2.0, NONE, NONE, 2.05, 2.05, NONE, NONE];
        let (inside, rim) = (PixelKind::Inside, PixelKind::Rim);
        let (silhouette, uncovered) = (PixelKind::Silhouette, PixelKind::Uncovered);
        assert_eq!(kinds(&alpha, &depth, 5, 1), [inside, rim, silhouette, silhouette, uncovered]);
        assert_eq!(kinds(&alpha, &depth, 1, 5), [inside, rim, silhouette, silhouette, uncovered]);
    }

    #[test]
    fn both_sides_of_a_jump_are_silhouettes_and_what_is_uncovered_is_none() {
        let depth = [2.0, 2.05, 3.0, 3.1, NONE, 9.0];
        let kinds = kinds(&[1.0; 6], &depth, 6, 1);
        let (inside, silhouette) = (PixelKind::Inside, PixelKind::Silhouette);
        assert_eq!(kinds, [inside, silhouette, silhouette, inside, PixelKind::Uncovered, inside]);
    }

    #[test]
    fn the_surface_behind_a_rim_is_what_jumps() {
        // a rim far before one surface
        let kinds = kinds(&[1.0, 0.5, 0.0, 1.0], &[2.0, 1.0, NONE, 2.0], 2, 1);
        assert_eq!(kinds, [PixelKind::Inside, PixelKind::Rim]);
    }

    #[test]
    fn a_picture_without_layers_is_uncovered() {
        assert_eq!(kinds(&[], &[], 3, 1), [PixelKind::Uncovered; 3]);
    }

    #[test]
    fn edges_have_a_near_and_a_far_side_in_rows_and_columns_but_do_not_wrap() {
        // 3 × 2
        let depth = [1.0, 1.0, 5.0, 1.0, 5.0, 5.0];
        let at: Vec<bool> = (0..6).map(|pixel| is_at_edge(&depth, 3, pixel)).collect();
        let before: Vec<bool> = (0..6).map(|pixel| is_before_edge(&depth, 3, pixel)).collect();
        assert_eq!(at, [false, true, true, true, true, false]);
        assert_eq!(before, [false, true, false, true, false, false]);
    }
}
