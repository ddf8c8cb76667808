//! Which lobes of a spherical Beta colour are there. In memory every primitive has room for all lobes of the model; one
//! that is not needed has raw colours so low that it adds nothing, and the scene file leaves it out.

use std::f64::consts::LN_2;

/// Raw numbers of a lobe: r, g, b, θ, φ, β.
pub const LOBE_LEN: usize = 6;

/// b of the softplus ln(1 + e^(b x)) / b of a lobe's colour (DBS): a raw value of 0 means 0.1.
pub const SHARPNESS: f64 = 10.0 * LN_2;

/// A lobe whose three raw colours are all this or less is absent: it would add less than 1.2e-31 to any colour.
pub const ABSENT_BELOW: f32 = -10.0;

/// Raw colour of a lobe that was dropped. Its softplus, 9e-62, and the derivative of that, 6e-61, are exactly 0 in f32,
/// so that no gradient reaches the lobe and it stays absent while the scene is trained.
pub const ABSENT: f32 = -20.0;

/// A lobe that was dropped.
pub const ABSENT_LOBE: [f32; LOBE_LEN] = [ABSENT, ABSENT, ABSENT, 0.0, 0.0, 0.0];

/// Whether the lobe with the raw numbers `lobe` (r, g, b, θ, φ, β) adds nothing to any colour.
pub fn is_absent(lobe: &[f32]) -> bool {
    lobe[..3].iter().all(|&raw| raw <= ABSENT_BELOW)
}

/// A colour of a lobe from its raw number.
pub fn softplus(raw: f64) -> f64 {
    let x = SHARPNESS * raw;
    (x.max(0.0) + (-x.abs()).exp().ln_1p()) / SHARPNESS
}

/// Unit vector of a lobe with the angles θ and φ, rad.
pub fn lobe_axis(theta: f64, phi: f64) -> [f64; 3] {
    [theta.sin() * phi.cos(), theta.sin() * phi.sin(), theta.cos()]
}

/// How many lobes each of N = `count` primitives has that are there, of the L = `lobes` in `detail` [N × 6 L].
///
/// # Panics
/// If `detail` is too short, or a primitive has more than 255 lobes.
pub fn present(detail: &[f32], count: usize, lobes: usize) -> Vec<u8> {
    let (all, _) = detail.as_chunks::<LOBE_LEN>();
    let of = |row: usize| all[row * lobes..(row + 1) * lobes].iter().filter(|lobe| !is_absent(&lobe[..])).count();
    (0..count).map(|row| u8::try_from(of(row)).expect("at most 255 lobes")).collect()
}

/// The lobes that are there in `detail` [N × 6 L] of N = `count` primitives with room for L = `lobes`: how many each
/// primitive has `[N]`, and the numbers of all, in order [sum of the counts × 6].
pub fn pack(detail: &[f32], count: usize, lobes: usize) -> (Vec<u8>, Vec<f32>) {
    let (all, _) = detail.as_chunks::<LOBE_LEN>();
    let rows = all.iter().filter(|lobe| !is_absent(&lobe[..])).flatten().copied().collect();
    (present(detail, count, lobes), rows)
}

/// Undoes [`pack`]: detail [N × 6 L] of N primitives with `counts` `[N]` of the lobes in `rows`, and room for L = `lobes`.
/// The lobes of a primitive come first, then as many [`ABSENT_LOBE`]s as there is room for.
///
/// # Errors
/// A message about `counts`: one is above `lobes`, or they do not add up to the number of `rows`.
pub fn unpack(counts: &[u8], rows: &[f32], lobes: usize) -> Result<Vec<f32>, String> {
    if let Some(row) = counts.iter().position(|&count| usize::from(count) > lobes) {
        return Err(format!("has {} lobes at row {row}, expected at most {lobes}", counts[row]));
    }
    let (all, _) = rows.as_chunks::<LOBE_LEN>();
    let total = counts.iter().map(|&count| usize::from(count)).sum::<usize>();
    if total != all.len() {
        return Err(format!("adds up to {total} lobes, expected the {} that are listed", all.len()));
    }
    let mut detail = Vec::with_capacity(counts.len() * lobes * LOBE_LEN);
    let mut rest = all;
    for &count in counts {
        let (present, others) = rest.split_at(usize::from(count));
        detail.extend_from_slice(present.as_flattened());
        detail.extend_from_slice([ABSENT_LOBE].repeat(lobes - present.len()).as_flattened());
        rest = others;
    }
    Ok(detail)
}

#[cfg(all(test, feature = "burn"))]
mod tests {
    use burn::tensor::DType;

    use super::*;
    use crate::ops::colour::colour;
    use crate::scene::tensors::rows_to_tensor;
    use crate::scene::{Colour, ColourModel, SH_C0};
    use crate::testing::device;
    use crate::testing::golden::values;

    /// A lobe of raw colour `raw`, told from others by `tag`.
    fn lobe(raw: f32, tag: f32) -> [f32; LOBE_LEN] {
        [raw, raw, raw, tag, -tag, 2.0 * tag]
    }

    #[test]
    fn a_lobe_is_there_if_one_of_its_colours_is() {
        assert!(is_absent(&ABSENT_LOBE) && is_absent(&lobe(ABSENT_BELOW, 3.0)));
        for channel in 0..3 {
            let mut lobe = ABSENT_LOBE;
            lobe[channel] = ABSENT_BELOW.next_up();
            assert!(!is_absent(&lobe));
            lobe[channel] = f32::NAN;
            assert!(!is_absent(&lobe));
        }
    }

    /// The colour of a primitive that is black but for its lobes, and the gradient of its detail.
    fn colour_and_gradient(detail: &[f32], dtype: DType) -> [Vec<f64>; 2] {
        let (device, lobes) = (device(), detail.len() / LOBE_LEN);
        let black = [(-0.5 / SH_C0) as f32; 3];
        let of = Colour::new(
            ColourModel::SphericalBeta { lobes },
            rows_to_tensor(&black, 3, &device, dtype),
            rows_to_tensor(detail, detail.len(), &device, dtype).require_grad(),
        );
        let positions = rows_to_tensor(&[0.3, -0.4, 0.8], 3, &device, dtype);
        let out = colour(&of, &positions, [0.0; 3]).unwrap();
        let gradients = out.clone().sum().backward();
        [values(&out), values(&of.detail.grad(&gradients).unwrap())]
    }

    #[test]
    fn an_absent_lobe_colours_nothing_and_receives_no_gradient() {
        let (still, tilted) = (ABSENT_LOBE, [ABSENT, ABSENT, ABSENT, 0.5, -0.7, 1.5]);
        for (dtype, most) in [(DType::F32, 0.0), (DType::F64, 1e-50)] {
            let [bare, _] = colour_and_gradient(&lobe(-1e9, 0.5), dtype);
            let [found, gradient] = colour_and_gradient(&[still, tilted].concat(), dtype);
            assert_eq!(found, bare, "{dtype:?}");
            // those of θ, φ and β are multiples of the lobe's colour
            assert!(gradient.iter().all(|g| g.abs() <= most), "{dtype:?}: {gradient:?}");
            let [_, gradient] = colour_and_gradient(&lobe(ABSENT_BELOW, 0.5), dtype);
            assert!(gradient.iter().all(|g| g.abs() > 1e-34), "{dtype:?}: {gradient:?}");
        }
    }
}
