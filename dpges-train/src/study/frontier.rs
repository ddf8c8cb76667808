//! Frontiers: points for which no other is both cheaper and better.

/// Indices of the points (cost, quality) that none dominates, by ascending cost, equal ones by index. A point dominates
/// another if its cost is not higher and its quality not lower, and one of them is better; of equal points all stay. All
/// numbers are finite.
pub fn frontier(points: &[(f64, f64)]) -> Vec<usize> {
    // −0 is equal to 0, but comes before it
    let points: Vec<(f64, f64)> = points.iter().map(|(cost, quality)| (cost + 0.0, quality + 0.0)).collect();
    let mut order: Vec<usize> = (0..points.len()).collect();
    order.sort_by(|&a, &b| points[a].0.total_cmp(&points[b].0).then(points[b].1.total_cmp(&points[a].1)));
    let mut kept: Vec<usize> = Vec::new();
    for index in order {
        let (cost, quality) = points[index];
        let beaten = kept.last().is_some_and(|&last| {
            let (of_last, best) = points[last];
            quality < best || (quality == best && cost > of_last)
        });
        if !beaten {
            kept.push(index);
        }
    }
    kept
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_cheaper_and_better_dominates() {
        let points = [(1.0, 20.0), (2.0, 25.0), (3.0, 24.0), (4.0, 30.0), (5.0, 29.9), (0.5, 10.0)];
        assert_eq!(frontier(&points), [5, 0, 1, 3]);
        assert_eq!(frontier(&[]), [0usize; 0]);
        assert_eq!(frontier(&[(7.0, -3.0)]), [0]);
    }

    #[test]
    fn every_point_off_the_frontier_is_dominated_by_one_on_it() {
        let wave = |i: usize, pace: f64| (4.0 * (i as f64 * pace).sin()).round();
        let points: Vec<(f64, f64)> = (0..60).map(|i| (wave(i, 1.3), wave(i, 2.1))).collect();
        let found = frontier(&points);
        let dominates = |a: (f64, f64), b: (f64, f64)| a.0 <= b.0 && a.1 >= b.1 && a != b;
        for index in 0..points.len() {
            let beaten = points.iter().any(|&other| dominates(other, points[index]));
            assert_eq!(found.contains(&index), !beaten, "{:?}", points[index]);
        }
    }

    #[test]
    fn equal_points_stay_and_ties_in_one_number_are_decided_by_the_other() {
        assert_eq!(frontier(&[(1.0, 5.0), (1.0, 5.0)]), [0, 1]);
        assert_eq!(frontier(&[(1.0, 5.0), (1.0, 6.0)]), [1]);
        assert_eq!(frontier(&[(2.0, 5.0), (1.0, 5.0)]), [1]);
        assert_eq!(frontier(&[(-0.0, 1.0), (0.0, 2.0)]), [1]);
    }
}
