//! The colour of primitives that become one.

use dpges_core::scene::lobes::{ABSENT, ABSENT_LOBE, LOBE_LEN, SHARPNESS, is_absent, lobe_axis, softplus};
use dpges_core::scene::{ColourData, ColourModel, SH_C0};
use glam::DVec3;

/// Lobes whose axes are nearer than this cosine are one.
const ONE_LOBE: f64 = 0.95;

/// Appends the mean of the colours of primitives, each a row of `colour` with its share, to `merged`. Harmonics are linear
/// in their coefficients. Of the lobes those remain that add most over all directions; the mean of the others becomes part
/// of the base.
pub fn append_mean(merged: &mut ColourData, colour: &ColourData, shares: &[(usize, f64)]) {
    let mut base = DVec3::ZERO;
    for &(row, share) in shares {
        base += share * DVec3::from_array([0, 1, 2].map(|channel| colour.base[3 * row + channel].into()));
    }
    let width = colour.model.detail_len();
    match colour.model {
        ColourModel::SphericalBeta { lobes } => {
            let mut all = gathered(colour, lobes, shares);
            all.sort_by(|a, b| b.energy().total_cmp(&a.energy()));
            for spare in all.iter().skip(lobes) {
                base += spare.colour * spare.mean() / SH_C0;
            }
            all.truncate(lobes);
            merged.detail.extend(all.iter().flat_map(Lobe::raw));
            merged.detail.extend([ABSENT_LOBE].repeat(lobes - all.len()).as_flattened());
        }
        ColourModel::SphericalHarmonics { .. } | ColourModel::HarmonicsAndOpacity { .. } => {
            let mean = |at: usize| {
                let sum: f64 =
                    shares.iter().map(|&(row, share)| share * f64::from(colour.detail[row * width + at])).sum();
                sum as f32
            };
            merged.detail.extend((0..width).map(mean));
        }
    }
    merged.base.extend(base.as_vec3().to_array());
}

/// `colour max(0, d·axis)^(4 e^β)` in direction d.
#[derive(Clone, Copy)]
struct Lobe {
    colour: DVec3,
    axis: DVec3,
    beta: f64,
}

impl Lobe {
    fn new(raw: &[f32], share: f64) -> Self {
        Self {
            colour: share * DVec3::from_array([0, 1, 2].map(|channel| softplus(raw[channel].into()))),
            axis: DVec3::from_array(lobe_axis(raw[3].into(), raw[4].into())),
            beta: raw[5].into(),
        }
    }

    fn raw(&self) -> [f32; LOBE_LEN] {
        // x = s softplus is ln(1 + e^(s raw)); below the smallest, a lobe is absent
        let inverse = |value: f64| {
            let x = SHARPNESS * value;
            let raw = if x > 30.0 { x } else { x.exp_m1().ln() } / SHARPNESS;
            raw.max(ABSENT.into()) as f32
        };
        let [red, green, blue] = self.colour.to_array().map(inverse);
        let (theta, phi) = (self.axis.z.clamp(-1.0, 1.0).acos(), self.axis.y.atan2(self.axis.x));
        [red, green, blue, theta as f32, phi as f32, self.beta as f32]
    }

    /// Mean over all directions of what the lobe has of its colour: ∫ cosⁿ over a hemisphere is 2π / (n + 1).
    fn mean(&self) -> f64 {
        0.5 / (4.0 * self.beta.exp() + 1.0)
    }

    fn energy(&self) -> f64 {
        self.colour.max_element() * self.mean()
    }

    fn add(&mut self, other: &Self) {
        let [own, added] = [self.colour.element_sum(), other.colour.element_sum()];
        let share = added / (own + added).max(f64::MIN_POSITIVE);
        // an axis that is alike stays as it is
        if self.axis != other.axis {
            self.axis = self.axis.lerp(other.axis, share).normalize_or(self.axis);
        }
        self.beta += share * (other.beta - self.beta);
        self.colour += other.colour;
    }
}

/// The lobes that are there, those with about the same axis as one.
fn gathered(colour: &ColourData, lobes: usize, shares: &[(usize, f64)]) -> Vec<Lobe> {
    let mut all: Vec<Lobe> = Vec::new();
    for &(row, share) in shares {
        let raw = colour.detail[row * lobes * LOBE_LEN..(row + 1) * lobes * LOBE_LEN].chunks_exact(LOBE_LEN);
        for lobe in raw.filter(|raw| !is_absent(raw)).map(|raw| Lobe::new(raw, share)) {
            match all.iter_mut().find(|other| other.axis.dot(lobe.axis) > ONE_LOBE) {
                Some(other) => other.add(&lobe),
                None => all.push(lobe),
            }
        }
    }
    all
}
