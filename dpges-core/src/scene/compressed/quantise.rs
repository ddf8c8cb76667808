//! Numbers as steps of the range of their block.

/// Numbers, row-major, as symbols of some bits each.
pub struct Quantised {
    /// The lowest and the highest number of every block and group: [blocks, groups, 2].
    pub bounds: Vec<f32>,
    /// [rows, width]
    pub symbols: Vec<u32>,
}

/// Which components of a row of numbers share a range.
///
/// Group g has the components whose entry is g; entries begin at 0 and never fall.
#[derive(Clone, Debug, PartialEq)]
pub struct Groups(Vec<usize>);

impl Groups {
    pub fn new(group_of_component: Vec<usize>) -> Self {
        Self(group_of_component)
    }

    /// Numbers per row.
    pub fn width(&self) -> usize {
        self.0.len()
    }

    /// Number of groups.
    pub fn len(&self) -> usize {
        self.0.last().map_or(0, |last| last + 1)
    }

    /// The first components of the groups that are red, green and blue: those of three.
    pub fn channels(&self) -> impl Iterator<Item = usize> {
        (0..self.len()).filter_map(|group| {
            let first = self.0.iter().position(|&of| of == group)?;
            (self.0.iter().filter(|&&of| of == group).count() == 3).then_some(first)
        })
    }
}

/// The largest symbol of `bits`.
pub const fn largest(bits: u8) -> u32 {
    (1 << bits) - 1
}

/// Symbols of `values` [rows, width], all finite. Every `block_len` rows are a block, the last may be shorter.
pub fn quantise(values: &[f32], groups: &Groups, bits: u8, block_len: usize) -> Quantised {
    let (mut bounds, mut symbols) = (Vec::new(), Vec::with_capacity(values.len()));
    let steps = f64::from(largest(bits));
    // an attribute of width 0 has no values, whatever the length of its chunks
    for block in values.chunks((block_len * groups.width()).max(1)) {
        let mut ranges = vec![[f32::INFINITY, f32::NEG_INFINITY]; groups.len()];
        for row in block.chunks_exact(groups.width()) {
            for (&group, &value) in groups.0.iter().zip(row) {
                let [low, high] = &mut ranges[group];
                (*low, *high) = (low.min(value), high.max(value));
            }
        }
        for row in block.chunks_exact(groups.width()) {
            symbols.extend(groups.0.iter().zip(row).map(|(&group, &value)| {
                let [low, high] = ranges[group].map(f64::from);
                let share = (f64::from(value) - low) / (high - low);
                // 0 / 0 where all are equal: a cast makes it 0
                (share * steps).round() as u32
            }));
        }
        bounds.extend_from_slice(ranges.as_flattened());
    }
    Quantised { bounds, symbols }
}

/// Undoes [`quantise`], up to half a step: half of (high − low) / (2^bits − 1) of the block, and the rounding of `f32`.
/// The numbers lie within the bounds.
///
/// # Errors
/// The bounds of a block that are not finite, or the wrong way round.
///
/// # Panics
/// If there are fewer bounds than the blocks of the symbols need.
pub fn dequantise(quantised: &Quantised, groups: &Groups, bits: u8, block_len: usize) -> Result<Vec<f32>, String> {
    let Quantised { bounds, symbols } = quantised;
    let (ranges, _) = bounds.as_chunks::<2>();
    if let Some([low, high]) = ranges.iter().find(|[low, high]| !(low.is_finite() && high.is_finite() && low <= high)) {
        return Err(format!("has a block from {low} to {high}, expected finite bounds in order"));
    }
    let steps = f64::from(largest(bits));
    let mut values = Vec::with_capacity(symbols.len());
    for (at, row) in symbols.chunks_exact(groups.width().max(1)).enumerate() {
        let ranges = &ranges[at / block_len * groups.len()..];
        values.extend(groups.0.iter().zip(row).map(|(&group, &symbol)| {
            let [low, high] = ranges[group].map(f64::from);
            (low + (high - low) * (f64::from(symbol) / steps)).clamp(low, high) as f32
        }));
    }
    Ok(values)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The quantised values come back within half a step and one rounding of `f32`.
    fn check(values: &[f32], groups: &Groups, bits: u8, block_len: usize) {
        let quantised = quantise(values, groups, bits, block_len);
        let width = groups.width();
        let rows = values.len() / width;
        assert_eq!(quantised.bounds.len(), rows.div_ceil(block_len) * groups.len() * 2);
        assert!(quantised.symbols.iter().all(|&symbol| symbol <= largest(bits)));
        let found = dequantise(&quantised, groups, bits, block_len).unwrap();
        assert_eq!(found.len(), values.len());
        for (at, (&value, &found)) in values.iter().zip(&found).enumerate() {
            let range = 2 * (at / width / block_len * groups.len() + groups.0[at % width]);
            let [low, high] = [quantised.bounds[range], quantised.bounds[range + 1]].map(f64::from);
            assert!(low <= f64::from(value) && f64::from(value) <= high);
            let half_step = 0.5 * (high - low) / f64::from(largest(bits));
            let rounding = f64::from(value.abs().max(found.abs())) * f64::from(f32::EPSILON);
            let error = (f64::from(value) - f64::from(found)).abs();
            assert!(error <= half_step * (1.0 + 1e-9) + rounding, "{value} became {found} at {bits} bits");
        }
    }

    #[test]
    fn errors_are_within_half_a_step() {
        let values: Vec<f32> =
            (0..600).map(|i| 3.0 * (i as f32 * 0.37).sin() + 40.0 * (i as f32 * 0.011).cos()).collect();
        for bits in 2..=24 {
            for block_len in [1, 7, 2048] {
                check(&values, &Groups::new(vec![0, 1, 2]), bits, block_len);
                check(&values, &Groups::new(vec![0, 0, 0, 1, 2, 3]), bits, block_len);
            }
        }
    }

    #[test]
    fn extreme_ranges_stay_finite() {
        let (most, least) = (f32::MAX, f32::MIN_POSITIVE);
        let values = [most, -most, 0.0, least, -least, f32::from_bits(1), 1e20, -1e-20];
        for bits in [2, 8, 16, 24] {
            check(&values, &Groups::new(vec![0]), bits, 3);
            check(&values, &Groups::new(vec![0]), bits, 100);
        }
    }

    #[test]
    fn equal_values_and_the_ends_of_a_block_are_exact() {
        for values in [vec![0.1f32; 9], vec![-0.0; 9], vec![f32::MAX; 9]] {
            let quantised = quantise(&values, &Groups::new(vec![0]), 5, 4);
            assert_eq!(dequantise(&quantised, &Groups::new(vec![0]), 5, 4).unwrap(), values);
        }
        let quantised = quantise(&[0.1, 0.7, -0.3, 0.1], &Groups::new(vec![0]), 2, 4);
        let found = dequantise(&quantised, &Groups::new(vec![0]), 2, 4).unwrap();
        assert_eq!(found[1..3], [0.7, -0.3]);
    }

    #[test]
    fn bounds_that_cannot_be_are_told() {
        for bounds in [[f32::NAN, 1.0], [0.0, f32::INFINITY], [2.0, 1.0]] {
            let quantised = Quantised { bounds: bounds.to_vec(), symbols: vec![3] };
            let error = dequantise(&quantised, &Groups::new(vec![0]), 8, 4).unwrap_err();
            assert!(error.contains("expected finite bounds in order"), "{error}");
        }
    }

    #[test]
    fn channels_are_groups_of_three() {
        let channels = |groups: &[usize]| Groups::new(groups.to_vec()).channels().collect::<Vec<_>>();
        assert_eq!(channels(&[0, 0, 0, 1, 2, 3]), [0]);
        assert_eq!(channels(&[0, 0, 0, 1, 1, 1]), [0, 3]);
        assert!(channels(&[0, 1, 2]).is_empty() && channels(&[]).is_empty());
        assert_eq!((Groups::new(vec![]).len(), Groups::new(vec![0, 0, 1]).len()), (0, 2));
    }
}
