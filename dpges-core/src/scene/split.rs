//! Details whose columns do not fit one buffer of a device, in several tensors: 12 million Gaussians with harmonics of
//! degree 3 have 2.16 GB of them, and most graphics drivers bind less than 2 GiB.

use burn::tensor::Device;

use super::lobes::LOBE_LEN;
use super::schema::{Attribute, Width};
use crate::backend::device::largest_buffer;

/// Columns that stay together: those of a lobe, or of two coefficients of harmonics.
const UNIT: usize = LOBE_LEN;

/// Columns of each tensor on `device` that holds an attribute of shape [`count`, `width`]: all columns in one if the device
/// has such buffers, or if the attribute is no detail.
pub fn widths(attribute: &Attribute, [count, width]: [usize; 2], device: &Device) -> Vec<usize> {
    if attribute.width == Width::Detail {
        widths_within(width, largest_buffer(device) / (size_of::<f32>() * count.max(1)))
    } else {
        vec![width]
    }
}

/// `width` columns in tensors of as many whole units as `most` columns have, or of one unit.
fn widths_within(width: usize, most: usize) -> Vec<usize> {
    if width <= most {
        return vec![width];
    }
    let taken = (most / UNIT * UNIT).max(UNIT);
    (0..width).step_by(taken).map(|first| taken.min(width - first)).collect()
}

/// Row-major `rows` of all columns as rows of each of the `widths`.
pub fn split(rows: &[f32], widths: &[usize]) -> Vec<Vec<f32>> {
    let mut first = 0;
    let all = widths.iter().sum::<usize>().max(1);
    let of = |&width: &usize| {
        let from = first;
        first += width;
        rows.chunks_exact(all).flat_map(|row| &row[from..from + width]).copied().collect()
    };
    widths.iter().map(of).collect()
}

/// Row-major rows of all columns from those of `parts`, each with its number of columns.
pub fn join(mut parts: Vec<(Vec<f32>, usize)>) -> Vec<f32> {
    if parts.len() == 1 {
        return parts.remove(0).0;
    }
    let count = parts.first().map_or(0, |(rows, width)| rows.len() / width);
    let row = |row: usize| parts.iter().flat_map(move |(rows, width)| &rows[row * width..(row + 1) * width]);
    (0..count).flat_map(row).copied().collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn tensors_have_whole_units_and_no_more_columns_than_a_buffer() {
        assert_eq!(widths_within(45, 45), [45]);
        assert_eq!(widths_within(45, 44), [42, 3]);
        assert_eq!(widths_within(45, 17), [12, 12, 12, 9]);
        assert_eq!(widths_within(12, 11), [6, 6]);
        assert_eq!(widths_within(12, 2), [6, 6], "a unit is the least");
        assert_eq!(widths_within(0, 0), [0]);
    }

    #[test]
    fn what_is_split_comes_back() {
        let rows: Vec<f32> = (0..27).map(|at| at as f32).collect();
        let parts = split(&rows, &[3, 6]);
        assert_eq!(
            (&parts[0][..], &parts[1][..6]),
            (&[0.0, 1.0, 2.0, 9.0, 10.0, 11.0, 18.0, 19.0, 20.0][..], &rows[3..9])
        );
        assert_eq!(join(parts.into_iter().zip([3, 6]).collect()), rows);
        assert_eq!(split(&[], &[0]), [Vec::<f32>::new()]);
        assert!(join(vec![(Vec::new(), 3), (Vec::new(), 6)]).is_empty());
    }
}
