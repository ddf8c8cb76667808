//! Frontiers: points for which no other is both cheaper and better.

/// Indices of the points (cost, quality) that none dominates, by ascending cost, equal ones by index. A point dominates
/// another if its cost is not higher and its quality not lower, and one of them is better; of equal points all stay. All
/// numbers are finite.
pub fn frontier(points: &[(f64, f64)]) -> Vec<usize> {
    let dominates = |a: (f64, f64), b: (f64, f64)| a.0 <= b.0 && a.1 >= b.1 && a != b;
    let is_beaten = |index: &usize| points.iter().any(|&other| dominates(other, points[*index]));
    let mut kept: Vec<usize> = (0..points.len()).filter(|index| !is_beaten(index)).collect();
    // −0 is equal to 0, but comes before it
    kept.sort_by(|&a, &b| (points[a].0 + 0.0).total_cmp(&(points[b].0 + 0.0)));
    kept
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_is_cheaper_and_better_dominates_and_ties_in_one_number_are_decided_by_the_other() {
        let points = [(1.0, 20.0), (2.0, 25.0), (3.0, 24.0), (4.0, 30.0), (5.0, 29.9), (0.5, 10.0)];
        assert_eq!(frontier(&points), [5, 0, 1, 3]);
        assert_eq!(frontier(&[]), [0usize; 0]);
        for (points, expected) in [
            ([(1.0, 5.0), (1.0, 5.0)], &[0, 1][..]),
            ([(1.0, 5.0), (1.0, 6.0)], &[1]),
            ([(2.0, 5.0), (1.0, 5.0)], &[1]),
            ([(-0.0, 1.0), (0.0, 2.0)], &[1]),
            ([(0.0, 1.0), (-0.0, 1.0)], &[0, 1]),
        ] {
            assert_eq!(frontier(&points), expected, "{points:?}");
        }
    }
}
