//! Blocks by content: the block with the most points is halved at their median, until none has too many.

use dpges_train::dataset::block::Bounds;

/// Most points of a block (BlockGaussian, `configs/rubble.yaml`).
pub const MOST_POINTS: usize = 300_000;
/// A block is trained this much beyond its core on each side that is not open, relative to its size (BlockGaussian).
pub const GROWTH: f32 = 0.05;
/// Points of a block that are looked at to find its size, at most.
const SAMPLED: usize = 4096;
/// Share of them beyond its size at each end: points far from all others say little of it.
const BEYOND: f32 = 0.05;

/// When splitting ends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Limit {
    /// At this many blocks.
    Blocks(usize),
    /// When no block has more points.
    Points(usize),
}

/// A part of the world and the points in it.
#[derive(Clone, Debug, PartialEq)]
pub struct Part {
    /// Where its primitives are kept. Cores have nothing in common and nothing between them; outer ones are open.
    pub core: Bounds,
    /// Where it is trained.
    pub grown: Bounds,
    /// Number of points in the core.
    pub points: usize,
}

/// Splits the world by `points` `[n]`, world units. Fewer parts than asked for if points cannot be told apart.
pub fn split(points: &[[f32; 3]], limit: Limit) -> Vec<Part> {
    let mut order: Vec<u32> = (0..points.len() as u32).collect();
    let mut parts = vec![(Bounds::ALL, &mut order[..])];
    let is_enough = |parts: &[(Bounds, &mut [u32])], largest: usize| match limit {
        Limit::Blocks(count) => parts.len() >= count,
        Limit::Points(most) => largest <= most,
    };
    // parts whose points are all at one place stay
    let mut whole = Vec::new();
    while let Some(at) = (0..parts.len()).max_by_key(|&at| (parts[at].1.len(), std::cmp::Reverse(at))) {
        if is_enough(&parts, parts[at].1.len()) || whole.len() + parts.len() >= points.len() {
            break;
        }
        let (bounds, rows) = parts.remove(at);
        let size = size(points, rows);
        let mut axes = [0, 1, 2];
        axes.sort_by(|&a, &b| size[b].total_cmp(&size[a]));
        match axes.into_iter().find_map(|axis| median_cut(points, rows, axis).map(|cut| (axis, cut))) {
            Some((axis, (place, below))) => {
                let (low, high) = rows.split_at_mut(below);
                let [of_low, of_high] = bounds.split(axis, place);
                parts.splice(at..at, [(of_low, low), (of_high, high)]);
            }
            None => whole.push((bounds, rows)),
        }
    }
    parts.extend(whole);
    let part = |(core, rows): (Bounds, &mut [u32])| {
        let grown = core.grown(size(points, rows).map(|size| GROWTH * size));
        Part { core, grown, points: rows.len() }
    };
    parts.into_iter().map(part).collect()
}

/// Brings the `rows` below the median of `axis` to the front. Returns the median and their number; `None` if there are none.
fn median_cut(points: &[[f32; 3]], rows: &mut [u32], axis: usize) -> Option<(f32, usize)> {
    let value = |row: u32| points[row as usize][axis];
    let middle = rows.len() / 2;
    let (_, &mut median, _) = rows.select_nth_unstable_by(middle, |&a, &b| value(a).total_cmp(&value(b)));
    let mut place = value(median);
    if rows[..middle].iter().all(|&row| value(row) >= place) {
        // nothing is below: cut above it
        place = rows.iter().map(|&row| value(row)).filter(|&at| at > place).min_by(f32::total_cmp)?;
    }
    let mut below = 0;
    for at in 0..rows.len() {
        if value(rows[at]) < place {
            rows.swap(below, at);
            below += 1;
        }
    }
    Some((place, below))
}

/// Distance of the 5th and the 95th percentile of the points in `rows` along each axis, of a sample of many.
fn size(points: &[[f32; 3]], rows: &[u32]) -> [f32; 3] {
    std::array::from_fn(|axis| {
        let sampled = rows.iter().step_by(rows.len().div_ceil(SAMPLED).max(1));
        let [least, most] = percentiles(sampled.map(|&row| points[row as usize][axis]).collect(), BEYOND);
        most - least
    })
}

/// The values that a share `beyond` of all lies below, and above; zero without values.
pub(super) fn percentiles(mut values: Vec<f32>, beyond: f32) -> [f32; 2] {
    values.sort_unstable_by(f32::total_cmp);
    let Some(last) = values.len().checked_sub(1) else { return [0.0; 2] };
    [beyond, 1.0 - beyond].map(|share| values[(share * last as f32).round() as usize])
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;

    /// A street along x with a tower at its end, and points far away.
    fn street(count: usize) -> Vec<[f32; 3]> {
        let mut rng = ChaCha8Rng::seed_from_u64(4);
        let mut draw = |from: f32, to: f32| from + (to - from) * rng.random::<f32>();
        let mut points: Vec<[f32; 3]> = (0..count)
            .map(|row| match row % 4 {
                0 => [draw(95.0, 100.0), draw(-30.0, 0.0), draw(0.0, 5.0)],
                _ => [draw(0.0, 100.0), draw(-1.0, 0.0), draw(0.0, 10.0)],
            })
            .collect();
        points.extend([[1e5, 3.0, 0.0], [0.0, -2e4, 7.0]]);
        points
    }

    #[test]
    fn every_point_is_in_one_core_and_no_block_has_too_many() {
        let points = street(5000);
        for limit in [Limit::Points(400), Limit::Blocks(5), Limit::Blocks(1), Limit::Points(10_000)] {
            let parts = split(&points, limit);
            match limit {
                Limit::Points(most) => assert!(parts.iter().all(|part| part.points <= most), "{limit:?}"),
                Limit::Blocks(count) => assert_eq!(parts.len(), count),
            }
            let mut counts = vec![0; parts.len()];
            for &point in &points {
                let of: Vec<usize> = (0..parts.len()).filter(|&at| parts[at].core.contains(point)).collect();
                assert_eq!(of.len(), 1, "{point:?} is in {of:?}");
                assert!(parts[of[0]].grown.contains(point));
                counts[of[0]] += 1;
            }
            assert_eq!(counts, parts.iter().map(|part| part.points).collect::<Vec<_>>());
        }
    }

    #[test]
    fn the_first_cut_is_across_the_longest_axis_and_blocks_overlap_by_a_twentieth_of_their_size() {
        let parts = split(&street(4000), Limit::Blocks(2));
        let (Some(end), Some(begin)) = (parts[0].core.max[0], parts[1].core.min[0]) else { panic!("{parts:?}") };
        assert!(end == begin && (50.0..80.0).contains(&end), "{end}");
        assert_eq!((parts[0].core.min, parts[1].core.max), ([None; 3], [None; 3]));
        let reach = parts[0].grown.max[0].unwrap() - end;
        assert!((0.04 * end..0.06 * end).contains(&reach), "{reach} of {end}");
    }

    #[test]
    fn points_at_one_place_stay_together() {
        let parts = split(&[[1.0, 2.0, 3.0]; 9], Limit::Points(2));
        assert_eq!((parts.len(), parts[0].points), (1, 9));
        let mut two_places = vec![[0.0; 3]; 5];
        two_places.push([1.0, 0.0, 0.0]);
        let counts: Vec<usize> = split(&two_places, Limit::Blocks(4)).iter().map(|part| part.points).collect();
        assert_eq!(counts, [5, 1]);
    }
}
