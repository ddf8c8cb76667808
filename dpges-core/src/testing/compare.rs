//! Distances between arrays.

/// ‖a − b‖₂ / ‖b‖₂; infinite entries must agree exactly and are left out. 0 if both vanish.
pub fn relative_l2(found: &[f64], expected: &[f64]) -> f64 {
    if found.len() != expected.len() {
        return f64::INFINITY;
    }
    let (mut difference, mut norm) = (0.0, 0.0);
    for (&a, &b) in found.iter().zip(expected) {
        if b.is_infinite() {
            if a != b {
                return f64::INFINITY;
            }
            continue;
        }
        difference += (a - b) * (a - b);
        norm += b * b;
    }
    match (difference == 0.0, norm == 0.0) {
        (true, _) => 0.0,
        (false, true) => f64::INFINITY,
        // phrased so that NaN is not small
        _ if difference / norm >= 0.0 => (difference / norm).sqrt(),
        _ => f64::INFINITY,
    }
}

#[cfg(test)]
mod tests {
    use super::relative_l2;

    #[test]
    fn nan_wrong_lengths_and_misplaced_infinities_are_far() {
        assert_eq!(relative_l2(&[f64::NAN], &[1.0]), f64::INFINITY);
        assert_eq!(relative_l2(&[1.0, 2.0], &[1.0]), f64::INFINITY);
        assert_eq!(relative_l2(&[1.0], &[f64::INFINITY]), f64::INFINITY);
        assert_eq!(relative_l2(&[1e-30], &[0.0]), f64::INFINITY);
        assert_eq!(relative_l2(&[f64::INFINITY, 3.0], &[f64::INFINITY, 2.0]), 0.5);
    }
}
