//! The environment behind every primitive, at infinity: sky, horizon, everything too far away to have a depth.

use super::data::check_numbers;
use super::schema::ENVIRONMENT;
use crate::error::{Error, Result};

/// An environment: spherical harmonics of the world direction v of a pixel's ray, added to the background.
///
/// `B(v) = C_b + Σ c_k Y_k(v)`, one colour per pixel, takes the place of the background C_b wherever a scene has an
/// environment. The harmonics are those of [`ColourModel::SphericalHarmonics`](super::ColourModel), with Y_0 = C0.
#[derive(Clone, Debug, PartialEq)]
pub struct EnvironmentData {
    /// [(degree + 1)², 3] coefficient-major, display-referred.
    pub coefficients: Vec<f32>,
}

impl EnvironmentData {
    pub const MAX_DEGREE: usize = 3;
    /// The expected shape, for errors.
    pub(crate) const EXPECTED_SHAPE: &str = "[(degree + 1)², 3] with a degree from 0 to 3";

    /// Coefficients of an environment of `degree`, 3 numbers each.
    pub const fn coefficient_count(degree: usize) -> usize {
        (degree + 1) * (degree + 1)
    }

    /// The degree that has `count` coefficients.
    pub fn degree_of(count: usize) -> Option<usize> {
        (0..=Self::MAX_DEGREE).find(|&degree| Self::coefficient_count(degree) == count)
    }

    /// An environment that adds nothing to the background.
    pub fn neutral(degree: usize) -> Self {
        Self { coefficients: vec![0.0; 3 * Self::coefficient_count(degree)] }
    }

    /// Number of coefficients, 3 numbers each.
    pub fn len(&self) -> usize {
        self.coefficients.len() / 3
    }

    pub fn is_empty(&self) -> bool {
        self.coefficients.is_empty()
    }

    /// # Errors
    /// [`Error::Shape`] if the number of coefficients is that of no degree, [`Error::NonFinite`].
    pub fn check(&self) -> Result<()> {
        let (name, found) = (ENVIRONMENT.name, self.coefficients.len());
        if Self::degree_of(self.len()).is_none() {
            let (tensor, expected) = (name.to_owned(), Self::EXPECTED_SHAPE.to_owned());
            return Err(Error::Shape { tensor, expected, found: vec![found] });
        }
        check_numbers(name, &[self.len(), 3], &self.coefficients)
    }
}
