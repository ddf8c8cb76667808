//! The attributes of a scene in host memory, as rows of `f32`: what initialisation writes, what refinement edits, what
//! the scene file holds.

use super::schema::{Attribute, Colour, Columns, GaussianColumns, SurfelColumns};
use super::{ColourModel, EnvironmentData, SceneInfo};
use crate::error::{Error, Result};

/// View-dependent colour of N primitives: each column has N × its width numbers.
pub type ColourData = Colour<Vec<f32>>;
/// N surfels: each column has N × its width numbers.
pub type SurfelData = SurfelColumns<Vec<f32>>;
/// M Gaussians: each column has M × its width numbers.
pub type GaussianData = GaussianColumns<Vec<f32>>;

/// A scene in host memory.
#[derive(Clone, Debug, PartialEq)]
pub struct SceneData {
    pub info: SceneInfo,
    pub surfels: SurfelData,
    pub gaussians: GaussianData,
    /// The environment behind them; `None` for the constant background of [`info`](Self::info).
    pub environment: Option<EnvironmentData>,
}

impl SceneData {
    /// The same scene in coordinates that are those of the dataset minus `offset`.
    #[must_use]
    pub fn relocated(mut self, offset: [f64; 3]) -> Self {
        if self.info.offset != offset {
            let columns = [&mut self.surfels.positions, &mut self.gaussians.positions];
            for position in columns.into_iter().flat_map(|column| column.as_chunks_mut::<3>().0) {
                for (x, (from, to)) in position.iter_mut().zip(self.info.offset.iter().zip(offset)) {
                    *x = (f64::from(*x) + from - to) as f32;
                }
            }
            self.info.offset = offset;
        }
        self
    }
}

macro_rules! on_the_host {
    ($data:ident) => {
        impl $data {
            /// `count` primitives of which nothing is known: every attribute has its neutral value.
            pub fn neutral(model: ColourModel, count: usize) -> Self {
                let values = |attribute: &Attribute| {
                    let all = attribute.neutral.iter().copied().cycle();
                    all.take(count * attribute.width.under(model)).collect()
                };
                Self::generate(model, Self::ATTRIBUTES.iter().map(values))
            }

            pub fn len(&self) -> usize {
                self.positions.len() / 3
            }

            pub fn is_empty(&self) -> bool {
                self.positions.is_empty()
            }

            /// The primitives `rows`, in that order; repetitions are allowed.
            pub fn select(&self, rows: &[usize]) -> Self {
                self.map_ref(|attribute, values| {
                    let width = attribute.width.under(self.model());
                    rows.iter().flat_map(|&row| &values[row * width..(row + 1) * width]).copied().collect()
                })
            }

            /// Adds the primitives of `other` after these.
            pub fn append(&mut self, other: Self) {
                self.list_mut().into_iter().zip(other.into_list()).for_each(|(values, more)| values.extend(more));
            }

            pub(crate) fn check(&self) -> Result<()> {
                let (model, count) = (self.model(), self.len());
                self.iter().try_for_each(|(attribute, values)| {
                    check_numbers(attribute.name, &attribute.stored_shape(count, model), values)
                })
            }
        }
    };
}

on_the_host!(SurfelData);
on_the_host!(GaussianData);

/// Whether `values` are finite and as many as `shape` asks for.
pub(crate) fn check_numbers(name: &str, shape: &[usize], values: &[f32]) -> Result<()> {
    if values.len() != shape.iter().product::<usize>() {
        let expected = format!("{shape:?}");
        return Err(Error::Shape { tensor: name.to_owned(), expected, found: vec![values.len()] });
    }
    match values.iter().position(|value| !value.is_finite()) {
        Some(at) => {
            let width = shape[1..].iter().product::<usize>();
            Err(Error::NonFinite { tensor: name.to_owned(), row: at / width })
        }
        None => Ok(()),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rows_are_selected_and_appended_in_every_column() {
        let model = ColourModel::SphericalBeta { lobes: 1 };
        let mut surfels = SurfelData::neutral(model, 3);
        assert_eq!((surfels.len(), surfels.colour.detail.len(), surfels.margins.len()), (3, 18, 3));
        assert_eq!(surfels.quaternions, [1.0, 0.0, 0.0, 0.0].repeat(3));
        surfels.margins = vec![1.0, 2.0, 3.0];
        surfels.append(surfels.select(&[2, 0]));
        assert_eq!((surfels.len(), &surfels.margins[..]), (5, &[1.0, 2.0, 3.0, 3.0, 1.0][..]));
        surfels.check().unwrap();
        surfels.log_scales.pop();
        assert!(surfels.check().unwrap_err().to_string().contains("surfels.log_scales"));
    }
}
