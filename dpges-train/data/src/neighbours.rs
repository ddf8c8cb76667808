//! Exact nearest neighbours among points. The result does not depend on the machine.

use kiddo::{ImmutableKdTree, SquaredEuclidean};
use rayon::prelude::*;
use std::num::NonZero;

/// Least spacing over the median of all (3DGS: 3.2e-4 world units).
const MIN_SPACING: f32 = 0.01;

/// A neighbour: its row, and its squared distance in world units².
pub type Neighbour = (u32, f32);

/// The `count` nearest other points of every point, nearest first, ties by row. The point itself is excluded by its
/// row, so a duplicate of it is a neighbour at distance 0.
///
/// A point has fewer than `count` neighbours if there are not that many. Points that are not finite have no neighbours
/// and are neighbours of no point.
pub fn nearest(positions: &[[f32; 3]], count: usize) -> Vec<Vec<Neighbour>> {
    let sites = Sites::new(positions);
    positions.par_iter().enumerate().map(|(row, &query)| sites.nearest(query, count, Some(row as u32))).collect()
}

/// The `count` nearest of `positions` for every query, nearest first, ties by row; otherwise as [`nearest`].
pub fn nearest_to(queries: &[[f32; 3]], positions: &[[f32; 3]], count: usize) -> Vec<Vec<Neighbour>> {
    let sites = Sites::new(positions);
    queries.par_iter().map(|&query| sites.nearest(query, count, None)).collect()
}

/// Root of the mean squared distance to the 3 nearest other points, world units, at least a hundredth of its median; `None` for a
/// point alone, or one of points that are all at one place.
pub fn spacing(positions: &[[f32; 3]]) -> Vec<Option<f32>> {
    let mean = |near: &Vec<(u32, f32)>| near.iter().map(|&(_, d)| d).sum::<f32>() / near.len() as f32;
    let own = |near: Vec<(u32, f32)>| (!near.is_empty()).then(|| mean(&near).sqrt());
    let spacing: Vec<Option<f32>> = nearest(positions, 3).into_iter().map(own).collect();
    let mut sorted: Vec<f32> = spacing.iter().flatten().copied().filter(|&spacing| spacing > 0.0).collect();
    sorted.sort_by(f32::total_cmp);
    let Some(median) = sorted.get(sorted.len() / 2) else { return vec![None; spacing.len()] };
    spacing.into_iter().map(|spacing| Some(spacing?.max(MIN_SPACING * median))).collect()
}

/// [N × 3] numbers as points.
///
/// # Panics
/// If the number of numbers is not a multiple of 3.
pub fn as_points(rows: &[f32]) -> &[[f32; 3]] {
    let (points, rest) = rows.as_chunks::<3>();
    assert!(rest.is_empty(), "{} numbers are no rows of 3", rows.len());
    points
}

/// Distinct finite positions, each with the rows at this position. A tree over them stays balanced and fast if many
/// points coincide.
#[derive(Default)]
pub struct Sites {
    tree: Option<ImmutableKdTree<f32, 3>>,
    positions: Vec<[f32; 3]>,
    /// Rows grouped by site, ascending within it.
    rows: Vec<u32>,
    /// Start of each site's group in `rows`, and the end of the last.
    starts: Vec<usize>,
}

impl Sites {
    /// Those of `positions` that are finite.
    pub fn new(positions: &[[f32; 3]]) -> Self {
        let finite = |row: &u32| positions[*row as usize].iter().all(|x| x.is_finite());
        let mut rows: Vec<u32> = (0..positions.len() as u32).filter(finite).collect();
        // Adding zero turns -0 into 0, so that equal points have equal bits.
        let place = |row: u32| positions[row as usize].map(|x| x + 0.0);
        let order = |a: &u32, b: &u32| {
            let (p, q) = (place(*a), place(*b));
            p[0].total_cmp(&q[0]).then(p[1].total_cmp(&q[1])).then(p[2].total_cmp(&q[2])).then(a.cmp(b))
        };
        rows.par_sort_unstable_by(order);

        let (mut distinct, mut starts) = (Vec::new(), Vec::new());
        for (at, &row) in rows.iter().enumerate() {
            if distinct.last() != Some(&place(row)) {
                distinct.push(place(row));
                starts.push(at);
            }
        }
        starts.push(rows.len());
        let tree = (!distinct.is_empty())
            .then(|| ImmutableKdTree::new_from_slice(&distinct).expect("distinct points, fewer than 2^32 of them"));
        Self { tree, positions: distinct, rows, starts }
    }

    /// Squared distance of `query` to the nearest position, in the unit of the positions squared; infinite if there is none.
    pub fn squared_distance(&self, query: [f32; 3]) -> f32 {
        self.nearest(query, 1, None).first().map_or(f32::INFINITY, |&(_, squared)| squared)
    }

    /// The `count` nearest positions of `query`, as by [`nearest_to`], without the row `itself`.
    pub fn nearest(&self, query: [f32; 3], count: usize, itself: Option<u32>) -> Vec<Neighbour> {
        let Some(tree) = &self.tree else { return Vec::new() };
        if count == 0 || query.iter().any(|x| !x.is_finite()) {
            return Vec::new();
        }
        let wanted = count + usize::from(itself.is_some());
        let one_more = NonZero::new(wanted + 1).expect("at least 2");
        let mut found: Vec<u32> = Vec::with_capacity(wanted + 1);
        let items = tree.query(&query).nearest_n::<SquaredEuclidean<f32>>(one_more).execute();
        // Where the last wanted site and the next are equally far, rows decide among all at that distance.
        if items.len() > wanted && items[wanted].distance <= items[wanted - 1].distance * (1.0 + 1e-6) {
            let radius = items[wanted].distance * (1.0 + 1e-5);
            let around = tree.query(&query).within::<SquaredEuclidean<f32>>(radius).execute();
            found.extend(around.iter().map(|item| item.item));
        } else {
            found.extend(items.iter().take(wanted).map(|item| item.item));
        }

        let mut neighbours: Vec<Neighbour> = Vec::with_capacity(wanted);
        for site in found {
            let site = site as usize;
            let distance = squared_distance(query, self.positions[site]);
            let members = &self.rows[self.starts[site]..self.starts[site + 1]];
            let others = members.iter().filter(|&&row| Some(row) != itself).take(count);
            neighbours.extend(others.map(|&row| (row, distance)));
        }
        neighbours.sort_unstable_by(|a, b| a.1.total_cmp(&b.1).then(a.0.cmp(&b.0)));
        neighbours.truncate(count);
        neighbours
    }
}

fn squared_distance(a: [f32; 3], b: [f32; 3]) -> f32 {
    let d = [a[0] - b[0], a[1] - b[1], a[2] - b[2]];
    d[0] * d[0] + d[1] * d[1] + d[2] * d[2]
}

#[cfg(test)]
mod tests {
    use std::time::Instant;

    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;

    fn brute_force(queries: &[[f32; 3]], positions: &[[f32; 3]], count: usize, same: bool) -> Vec<Vec<Neighbour>> {
        let of = |(row, query): (usize, &[f32; 3])| {
            let mut all: Vec<Neighbour> = (0..positions.len())
                .filter(|&other| !(same && other == row))
                .map(|other| (other as u32, squared_distance(*query, positions[other])))
                .collect();
            all.sort_by(|a, b| a.1.total_cmp(&b.1).then(a.0.cmp(&b.0)));
            all.truncate(count);
            all
        };
        queries.iter().enumerate().map(of).collect()
    }

    fn cloud(count: usize, seed: u64) -> Vec<[f32; 3]> {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        (0..count).map(|_| [0; 3].map(|_| rng.random::<f32>() * 4.0 - 2.0)).collect()
    }

    #[test]
    fn they_are_those_of_an_exhaustive_search() {
        let points = cloud(700, 1);
        assert_eq!(nearest(&points, 16), brute_force(&points, &points, 16, true));
        let queries = cloud(100, 2);
        assert_eq!(nearest_to(&queries, &points, 5), brute_force(&queries, &points, 5, false));
    }

    #[test]
    fn ties_go_to_the_smaller_row_on_grids_planes_and_duplicates() {
        let grid: Vec<[f32; 3]> =
            (0..9 * 9 * 9).map(|i| [(i % 9) as f32, (i / 9 % 9) as f32, (i / 81) as f32]).collect();
        assert_eq!(nearest(&grid, 16), brute_force(&grid, &grid, 16, true));
        let plane: Vec<[f32; 3]> = (0..1600).map(|i| [-0.5, (i % 40) as f32 * 0.1, (i / 40) as f32 * 0.1]).collect();
        assert_eq!(nearest(&plane, 3), brute_force(&plane, &plane, 3, true));
        let mut doubled = cloud(60, 3);
        doubled.extend(doubled.clone());
        doubled.extend([[0.0; 3], [-0.0; 3], [0.0; 3]]);
        assert_eq!(nearest(&doubled, 4), brute_force(&doubled, &doubled, 4, true));
    }

    #[test]
    fn few_points_have_few_neighbours() {
        assert!(nearest(&[], 16).is_empty());
        assert_eq!(nearest(&[[1.0; 3]], 16), [vec![]]);
        assert_eq!(nearest(&[[0.0; 3], [1.0, 0.0, 0.0]], 16), [vec![(1, 1.0)], vec![(0, 1.0)]]);
        assert_eq!(nearest_to(&[[0.0; 3]], &[], 3), [vec![]]);
        assert!(nearest(&cloud(10, 4), 16).iter().all(|row| row.len() == 9));
        assert!(nearest(&cloud(10, 4), 0).iter().all(Vec::is_empty));
    }

    #[test]
    fn points_that_are_not_finite_stand_aside() {
        let points = [[0.0; 3], [f32::NAN, 0.0, 0.0], [1.0, 0.0, 0.0], [f32::INFINITY; 3]];
        assert_eq!(nearest(&points, 3), [vec![(2, 1.0)], vec![], vec![(0, 1.0)], vec![]]);
    }

    #[test]
    fn many_identical_points_take_no_time() {
        let start = Instant::now();
        let found = nearest(&vec![[0.25; 3]; 100_000], 16);
        assert!(start.elapsed().as_secs() < 10);
        assert_eq!(found[0].iter().map(|n| n.0).collect::<Vec<_>>(), (1..17).collect::<Vec<_>>());
        assert_eq!(found[99_999][0], (0, 0.0));
    }

    #[test]
    fn spacing_is_the_root_of_the_mean_square_of_three_distances() {
        let positions = [[0.0; 3], [1.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 3.0], [9.0, 9.0, 9.0]];
        assert_eq!(spacing(&positions)[0], Some((14f32 / 3.0).sqrt()));
        assert_eq!(spacing(&positions[..1]), [None]);
        assert_eq!(spacing(&positions[..2]), [Some(1.0); 2]);
        assert_eq!(spacing(&[[1.0; 3]; 2]), [None; 2]);
        let twins = [[0.0; 3], [0.0; 3], [0.0; 3], [0.0; 3], [4.0, 0.0, 0.0]];
        assert_eq!(spacing(&twins), [Some(0.04), Some(0.04), Some(0.04), Some(0.04), Some(4.0)]);
        assert!(spacing(&[]).is_empty());
    }
}
