//! A channel of a picture as rows of numbers.

use rayon::prelude::*;

/// The size of a picture, px.
#[derive(Clone, Copy)]
pub struct Plane {
    pub width: usize,
    pub height: usize,
}

impl Plane {
    /// `values` convolved with `across` along rows and `down` along columns; pixels beyond the border are those at it.
    pub fn convolved(self, values: &[f64], across: &[f64], down: &[f64]) -> Vec<f64> {
        let Self { width, height } = self;
        let near = |at: usize, offset: usize, kernel: &[f64], length: usize| {
            (at + offset).saturating_sub(kernel.len() / 2).min(length - 1)
        };
        let mut rows = vec![0.0; values.len()];
        rows.par_chunks_mut(width.max(1)).zip(values.par_chunks(width.max(1))).for_each(|(out, row)| {
            for (x, out) in out.iter_mut().enumerate() {
                *out = across.iter().enumerate().map(|(k, weight)| weight * row[near(x, k, across, width)]).sum();
            }
        });
        let mut columns = vec![0.0; values.len()];
        columns.par_chunks_mut(width.max(1)).enumerate().for_each(|(y, out)| {
            for (k, weight) in down.iter().enumerate() {
                let row = &rows[near(y, k, down, height) * width..][..width];
                out.iter_mut().zip(row).for_each(|(out, value)| *out += weight * value);
            }
        });
        columns
    }

    /// Half as many pixels along both axes, rounded up, each the mean of four; a last odd row or column counts twice.
    pub fn halved(self, values: &[f64]) -> (Self, Vec<f64>) {
        let half = Self { width: self.width.div_ceil(2), height: self.height.div_ceil(2) };
        let at = |x: usize, y: usize| values[y.min(self.height - 1) * self.width + x.min(self.width - 1)];
        let mean = |pixel: usize| {
            let (x, y) = (2 * (pixel % half.width), 2 * (pixel / half.width));
            (at(x, y) + at(x + 1, y) + at(x, y + 1) + at(x + 1, y + 1)) / 4.0
        };
        (half, (0..half.width * half.height).map(mean).collect())
    }

    /// Mean of `values` over the pixels that are at least `margin` px from the border, of which there is one or more.
    pub fn mean_within(self, values: &[f64], margin: usize) -> f64 {
        let rows = values.chunks_exact(self.width).skip(margin).take(self.height - 2 * margin);
        let sum: f64 = rows.flat_map(|row| &row[margin..self.width - margin]).sum();
        sum / ((self.width - 2 * margin) * (self.height - 2 * margin)) as f64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn halves_are_means_of_four_and_the_border_counts_twice() {
        let (half, values) = Plane { width: 3, height: 2 }.halved(&[1.0, 3.0, 10.0, 5.0, 7.0, 20.0]);
        assert_eq!((half.width, half.height, values), (2, 1, vec![4.0, 15.0]));
    }

    #[test]
    fn the_margin_is_left_out() {
        let plane = Plane { width: 4, height: 3 };
        let values = [9.0, 9.0, 9.0, 9.0, 9.0, 1.0, 2.0, 9.0, 9.0, 9.0, 9.0, 9.0];
        assert_eq!(plane.mean_within(&values, 1), 1.5);
        assert_eq!(plane.mean_within(&values, 0), 93.0 / 12.0);
    }
}
