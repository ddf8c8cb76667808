//! Neighbours in space become neighbours in the file.

/// Bits of a Morton code per axis.
const AXIS_BITS: u32 = 21;

/// The rows of `positions` [N, 3], all finite, along a Morton curve through their bounding box. Rows in the same cell of
/// the curve keep their order.
pub fn along_morton_curve(positions: &[f32]) -> Vec<usize> {
    let (points, _) = positions.as_chunks::<3>();
    let mut low = [f64::INFINITY; 3];
    let mut high = [f64::NEG_INFINITY; 3];
    for point in points {
        for ((low, high), &coordinate) in low.iter_mut().zip(&mut high).zip(point) {
            *low = low.min(coordinate.into());
            *high = high.max(coordinate.into());
        }
    }
    let cells = f64::from((1u32 << AXIS_BITS) - 1);
    let cell = |point: &[f32; 3], axis: usize| {
        let share = (f64::from(point[axis]) - low[axis]) / (high[axis] - low[axis]);
        // 0 / 0 where all points share a coordinate: a cast makes it 0
        (share * cells) as u64
    };
    let code = |point: &[f32; 3]| (0..3).fold(0, |code, axis| code | (spread(cell(point, axis)) << axis));
    let codes: Vec<u64> = points.iter().map(code).collect();
    let mut rows: Vec<usize> = (0..points.len()).collect();
    rows.sort_by_key(|&row| codes[row]);
    rows
}

/// The lowest 21 bits of `value`, each followed by two zeros.
fn spread(value: u64) -> u64 {
    let mut bits = value & 0x1f_ffff;
    bits = (bits | (bits << 32)) & 0x001f_0000_0000_ffff;
    bits = (bits | (bits << 16)) & 0x001f_0000_ff00_00ff;
    bits = (bits | (bits << 8)) & 0x100f_00f0_0f00_f00f;
    bits = (bits | (bits << 4)) & 0x10c3_0c30_c30c_30c3;
    (bits | (bits << 2)) & 0x1249_2492_4924_9249
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bits_are_spread() {
        for bit in 0..AXIS_BITS {
            assert_eq!(spread(1 << bit), 1 << (3 * bit));
        }
        assert_eq!(spread(u64::MAX), (0..AXIS_BITS).map(|bit| 1 << (3 * bit)).sum::<u64>());
    }

    #[test]
    fn octants_follow_each_other() {
        // eight corners of a cube, the last first, and a point near the first corner
        let mut positions: Vec<f32> =
            (0..8u8).rev().flat_map(|i| [i & 1, (i >> 1) & 1, i >> 2]).map(f32::from).collect();
        positions.extend([0.1, 0.1, 0.1]);
        assert_eq!(along_morton_curve(&positions), [7, 8, 6, 5, 4, 3, 2, 1, 0]);
    }

    #[test]
    fn equal_points_keep_their_order_and_extremes_are_ordered() {
        assert_eq!(along_morton_curve(&[0.5; 12]), [0, 1, 2, 3]);
        let (far, near) = (f32::MAX, -f32::MAX);
        assert_eq!(along_morton_curve(&[far, 0.0, 0.0, near, 0.0, 0.0, 0.0, 0.0, 0.0]), [1, 2, 0]);
        assert!(along_morton_curve(&[]).is_empty());
    }
}
