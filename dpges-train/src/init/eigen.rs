//! Eigenvectors of a symmetric 3 × 3 matrix.

use glam::{DMat3, DVec3};

/// Eigenvalues, ascending, and their unit eigenvectors, by Jacobi rotations: exact to rounding also
/// where eigenvalues coincide.
pub fn symmetric_eigen(matrix: DMat3) -> [(f64, DVec3); 3] {
    let mut a = matrix.to_cols_array_2d();
    let mut vectors = DMat3::IDENTITY.to_cols_array_2d();
    for _ in 0..32 {
        let (p, q) = [(0, 1), (0, 2), (1, 2)]
            .into_iter()
            .max_by(|&(i, j), &(k, l)| a[i][j].abs().total_cmp(&a[k][l].abs()))
            .expect("three pairs");
        if a[p][q].abs() <= f64::EPSILON * 1e-3 * (a[p][p].abs() + a[q][q].abs()) {
            break;
        }
        let cotangent = (a[q][q] - a[p][p]) / (2.0 * a[p][q]);
        let tangent = cotangent.signum() / (cotangent.abs() + (cotangent * cotangent + 1.0).sqrt());
        let cosine = 1.0 / (tangent * tangent + 1.0).sqrt();
        let sine = tangent * cosine;
        for column in &mut a {
            (column[p], column[q]) = (cosine * column[p] - sine * column[q], sine * column[p] + cosine * column[q]);
        }
        for k in 0..3 {
            (a[p][k], a[q][k]) = (cosine * a[p][k] - sine * a[q][k], sine * a[p][k] + cosine * a[q][k]);
            let (x, y) = (vectors[p][k], vectors[q][k]);
            (vectors[p][k], vectors[q][k]) = (cosine * x - sine * y, sine * x + cosine * y);
        }
    }
    let mut pairs = [0, 1, 2].map(|i| (a[i][i], DVec3::from_array(vectors[i]).normalize()));
    pairs.sort_by(|x, y| x.0.total_cmp(&y.0));
    pairs
}

#[cfg(test)]
mod tests {
    use glam::DQuat;

    use super::*;

    #[test]
    fn eigenvectors_solve_the_equation_whatever_the_eigenvalues() {
        let axes = DMat3::from_quat(DQuat::from_euler(glam::EulerRot::XYZ, 0.3, -1.1, 2.0));
        for values in
            [[1.0, 2.0, 3.0], [1.0, 1.0, 1.0], [0.0, 0.0, 5.0], [0.0; 3], [1e-12, 4.0, 4.0], [-3.0, 1e-9, 1e9]]
        {
            let matrix = axes * DMat3::from_diagonal(DVec3::from_array(values)) * axes.transpose();
            let size = values.iter().fold(1e-30, |size: f64, value| size.max(value.abs()));
            let pairs = symmetric_eigen(matrix);
            for ((value, vector), expected) in pairs.into_iter().zip(values) {
                assert!((value - expected).abs() <= 1e-13 * size, "{values:?}: {pairs:?}");
                assert!((matrix * vector - vector * value).length() <= 1e-13 * size, "{values:?}");
            }
            assert!(pairs[0].1.dot(pairs[1].1).abs() < 1e-12 && pairs[0].1.dot(pairs[2].1).abs() < 1e-12);
        }
    }
}
