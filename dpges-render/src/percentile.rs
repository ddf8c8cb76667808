//! Values by their rank.

/// Shares of depths that are nearer than the ends of the colour ramp.
pub(crate) const DEPTH_PERCENTILES: [f64; 2] = [0.02, 0.98];

/// The values that `shares` of `values` are below, by the nearest rank; `None` without any.
pub fn percentiles<const N: usize>(mut values: Vec<f64>, shares: [f64; N]) -> Option<[f64; N]> {
    values.sort_unstable_by(f64::total_cmp);
    let last = values.len().checked_sub(1)?;
    Some(shares.map(|share| values[(share * last as f64).round() as usize]))
}
