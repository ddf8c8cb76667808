//! The parameters of a scene in host memory, as rows of `f32`: what initialisation writes, what
//! refinement edits, what the scene file holds.

use crate::scene::ColourModel;

/// View-dependent colour of N primitives.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct ColourData {
    /// [N × 3] zeroth-order coefficient k0; contributes `0.5 + C0 · k0`.
    pub base: Vec<f32>,
    /// [N × [`ColourModel::detail_len`]] raw lobes or higher spherical-harmonic coefficients.
    pub detail: Vec<f32>,
}

/// N surfels: opaque discs with semi-transparent rims.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SurfelData {
    /// [N × 3] world units.
    pub positions: Vec<f32>,
    /// [N × 4] (w, x, y, z), not necessarily of unit length; the third column of the rotation is the normal.
    pub quaternions: Vec<f32>,
    /// [N × 2] natural logarithm of the scales along the first two columns, world units.
    pub log_scales: Vec<f32>,
    pub colour: ColourData,
    /// `[N]` depth margin ε, world units.
    pub margins: Vec<f32>,
}

/// M Gaussians.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct GaussianData {
    /// [M × 3] world units.
    pub positions: Vec<f32>,
    /// [M × 4] (w, x, y, z), not necessarily of unit length.
    pub quaternions: Vec<f32>,
    /// [M × 3] natural logarithm of the scales, world units.
    pub log_scales: Vec<f32>,
    /// `[M]` linear opacity, used as max(0, opacity); may exceed 1.
    pub opacities: Vec<f32>,
    pub colour: ColourData,
}

fn select<const W: usize>(values: &[f32], rows: &[usize]) -> Vec<f32> {
    select_rows(values, W, rows)
}

/// Rows of `values` (`width` numbers each) in the order of `rows`.
pub fn select_rows(values: &[f32], width: usize, rows: &[usize]) -> Vec<f32> {
    rows.iter().flat_map(|&row| &values[row * width..(row + 1) * width]).copied().collect()
}

impl ColourData {
    pub fn select(&self, model: ColourModel, rows: &[usize]) -> Self {
        Self { base: select::<3>(&self.base, rows), detail: select_rows(&self.detail, model.detail_len(), rows) }
    }

    pub fn append(&mut self, other: Self) {
        self.base.extend(other.base);
        self.detail.extend(other.detail);
    }
}

impl SurfelData {
    pub fn len(&self) -> usize {
        self.margins.len()
    }

    pub fn is_empty(&self) -> bool {
        self.margins.is_empty()
    }

    pub fn select(&self, model: ColourModel, rows: &[usize]) -> Self {
        Self {
            positions: select::<3>(&self.positions, rows),
            quaternions: select::<4>(&self.quaternions, rows),
            log_scales: select::<2>(&self.log_scales, rows),
            colour: self.colour.select(model, rows),
            margins: select::<1>(&self.margins, rows),
        }
    }
}

impl GaussianData {
    pub fn len(&self) -> usize {
        self.opacities.len()
    }

    pub fn is_empty(&self) -> bool {
        self.opacities.is_empty()
    }

    pub fn select(&self, model: ColourModel, rows: &[usize]) -> Self {
        Self {
            positions: select::<3>(&self.positions, rows),
            quaternions: select::<4>(&self.quaternions, rows),
            log_scales: select::<3>(&self.log_scales, rows),
            opacities: select::<1>(&self.opacities, rows),
            colour: self.colour.select(model, rows),
        }
    }

    pub fn append(&mut self, other: Self) {
        self.positions.extend(other.positions);
        self.quaternions.extend(other.quaternions);
        self.log_scales.extend(other.log_scales);
        self.opacities.extend(other.opacities);
        self.colour.append(other.colour);
    }
}
