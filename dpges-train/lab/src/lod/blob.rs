//! A primitive as a weight spread about a place, which merging adds up.

use glam::{DMat3, DVec3};
use nalgebra::{Matrix3, SymmetricEigen};

/// The weight of one or more primitives: order-free sums of them, whose mean and covariance those of a Gaussian match.
#[derive(Clone, Copy, Debug)]
pub struct Blob {
    /// Weight × area.
    pub mass: f64,
    /// World units.
    pub mean: DVec3,
    /// World units².
    pub covariance: DMat3,
    /// Red, green, blue.
    pub colour: DVec3,
}

impl Blob {
    /// Both in one.
    pub fn merged(&self, other: &Self) -> Self {
        let mass = self.mass + other.mass;
        let share = if mass > 0.0 { other.mass / mass } else { 0.5 };
        let between = |a: DVec3, b: DVec3| a + share * (b - a);
        let apart = other.mean - self.mean;
        let covariance =
            self.covariance * (1.0 - share) + other.covariance * share + outer(apart) * (share * (1.0 - share));
        Self { mass, mean: between(self.mean, other.mean), covariance, colour: between(self.colour, other.colour) }
    }

    /// Eigenvalues of the covariance, the largest first, and their axes, which are right-handed.
    pub fn axes(&self) -> ([f64; 3], DMat3) {
        let columns = self.covariance.to_cols_array();
        let SymmetricEigen { eigenvalues, eigenvectors } = SymmetricEigen::new(Matrix3::from_column_slice(&columns));
        let mut order = [0, 1, 2];
        order.sort_by(|&a, &b| eigenvalues[b].total_cmp(&eigenvalues[a]));
        let axis = |at: usize| DVec3::from_slice(eigenvectors.column(order[at]).as_slice());
        let (first, second) = (axis(0), axis(1));
        (order.map(|at| eigenvalues[at].max(0.0)), DMat3::from_cols(first, second, first.cross(second)))
    }
}

pub fn outer(v: DVec3) -> DMat3 {
    DMat3::from_cols(v * v.x, v * v.y, v * v.z)
}

/// The covariance of the columns of `frame` with standard deviations `sigmas`.
pub fn covariance(frame: DMat3, sigmas: DVec3) -> DMat3 {
    let scaled = frame * DMat3::from_diagonal(sigmas);
    scaled * scaled.transpose()
}

/// Mean over all directions of the area of the projection of an ellipsoid with semi-axes of one σ, world units²: a quarter
/// of its surface, within 1.1 % (Thomsen).
pub fn mean_area(sigmas: [f64; 3]) -> f64 {
    const P: f64 = 1.6075;
    let [a, b, c] = sigmas.map(|sigma| sigma.max(f64::MIN_POSITIVE).powf(P));
    std::f64::consts::PI * ((a * b + a * c + b * c) / 3.0).powf(1.0 / P)
}
