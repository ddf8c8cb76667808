//! One step of the correction of a camera.

use dpges_core::ops::adam::AdamStep;

/// How far a correction moves in one step, and what holds it back.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PoseStep {
    /// Learning rate of the rotation, rad.
    pub rotation: f64,
    /// Learning rate of the translation, extents.
    pub translation: f64,
    /// Of the scene, world units.
    pub extent: f64,
    /// Adam's constants; `time` counts the steps of this correction.
    pub adam: AdamStep,
    /// How much stronger than noise a mean gradient has to be to count: 1 takes away from its square what noise adds to it on
    /// average, 0 nothing.
    pub doubt: f64,
    /// Share of the correction that a step takes back, relative to the learning rate: per radian and per extent.
    pub pull: f64,
}

impl PoseStep {
    /// Steps the six numbers of a correction (rad, world units) with their two `moments`, against a `gradient`. Each moves by
    ///
    /// ```text
    /// learning rate · (b d + pull · number)    d = m / (√v + ε)    b = max(0, 1 − doubt · 6 n / |d|²)
    /// ```
    ///
    /// with Adam's means m and v, corrected for their start, and the number in radians or extents. Of gradients that are
    /// nothing but noise the mean square of d is `n = (1 − β₁)/(1 + β₁) · (1 + β₁ᵗ)/(1 − β₁ᵗ)`: b is the shrinkage of a mean
    /// of six numbers by James and Stein, at `doubt = 1` nearly.
    pub fn take(&self, row: &mut [f32; 6], [first, second]: [&mut [f32; 6]; 2], gradient: [f64; 6]) {
        let AdamStep { beta_1, beta_2, epsilon, time, .. } = self.adam;
        let left = |beta: f64| 1.0 - beta.powf(time as f64);
        let directions: [f64; 6] = std::array::from_fn(|at| {
            let gradient = gradient[at];
            first[at] = (beta_1 * f64::from(first[at]) + (1.0 - beta_1) * gradient) as f32;
            second[at] = (beta_2 * f64::from(second[at]) + (1.0 - beta_2) * gradient * gradient) as f32;
            let deviation = (f64::from(second[at]) / left(beta_2)).sqrt();
            f64::from(first[at]) / left(beta_1) / (deviation + epsilon)
        });
        let evidence: f64 = directions.iter().map(|direction| direction * direction).sum();
        let noise = 6.0 * (1.0 - beta_1) / (1.0 + beta_1) * (2.0 - left(beta_1)) / left(beta_1);
        let believed = if evidence > 0.0 { (1.0 - self.doubt * noise / evidence).max(0.0) } else { 0.0 };
        for (at, direction) in directions.into_iter().enumerate() {
            let (rate, unit) = if at < 3 { (self.rotation, 1.0) } else { (self.translation, self.extent) };
            let number = f64::from(row[at]) / unit;
            row[at] = (unit * (number - rate * (believed * direction + self.pull * number))) as f32;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ADAM: AdamStep = AdamStep { learning_rate: 0.0, beta_1: 0.95, beta_2: 0.95, epsilon: 1e-15, time: 1 };
    const STEP: PoseStep =
        PoseStep { rotation: 0.01, translation: 0.1, extent: 2.0, adam: ADAM, doubt: 0.0, pull: 0.0 };

    /// The numbers after as many steps as there are `gradients`.
    fn after(step: PoseStep, start: [f32; 6], gradients: impl IntoIterator<Item = [f64; 6]>) -> [f32; 6] {
        let (mut row, mut moments) = (start, [[0.0; 6]; 2]);
        for (time, gradient) in (1..).zip(gradients) {
            let [first, second] = &mut moments;
            PoseStep { adam: AdamStep { time, ..ADAM }, ..step }.take(&mut row, [first, second], gradient);
        }
        row
    }

    #[test]
    fn a_first_step_is_the_learning_rate_in_radians_and_extents() {
        let row = after(STEP, [0.0; 6], [[3.0, -0.1, 1.0, 1.0, -7.0, 0.0]]);
        let expected = [-0.01, 0.01, -0.01, -0.2, 0.2, 0.0];
        assert!(row.iter().zip(expected).all(|(found, expected)| (found - expected).abs() < 1e-6), "{row:?}");
    }

    #[test]
    fn the_size_of_all_gradients_says_nothing() {
        let gradients = |size: f64| {
            (0..20).map(move |at| [1.0, -2.0, 0.5, 1.5, 0.3, -0.7].map(|g| size * (g + 0.1 * f64::from(at))))
        };
        let doubtful = PoseStep { doubt: 1.5, pull: 3.0, ..STEP };
        let (small, large) = (after(doubtful, [0.1; 6], gradients(1e-3)), after(doubtful, [0.1; 6], gradients(1e3)));
        assert!(small.iter().zip(large).all(|(a, b)| (a - b).abs() < 1e-5), "{small:?} {large:?}");
    }

    #[test]
    fn gradients_that_agree_are_believed_and_those_that_do_not_are_not() {
        let doubtful = PoseStep { doubt: 1.5, ..STEP };
        let agreeing = || std::iter::repeat_n([1.0; 6], 60);
        let (doubted, adam) = (after(doubtful, [0.0; 6], agreeing()), after(STEP, [0.0; 6], agreeing()));
        assert!(doubted[0] < 0.85 * adam[0] && adam[0] < 0.0, "{doubted:?} {adam:?}");
        // a single gradient agrees with itself: that proves nothing
        assert_eq!(after(doubtful, [0.0; 6], [[1.0; 6]]), [0.0; 6]);
        let alternating = || (0..60).map(|at| [if at % 2 == 0 { 1.0 } else { -1.0 }; 6]);
        let (doubted, adam) = (after(doubtful, [0.0; 6], alternating()), after(STEP, [0.0; 6], alternating()));
        assert!(doubted == [0.0; 6] && adam != doubted, "{doubted:?} {adam:?}");
    }

    #[test]
    fn what_noise_adds_to_the_mean_gradient_is_as_expected() {
        // a doubt of 1 believes in half of what noise says now and then, one of 4 in next to nothing
        let mut state = 1u64;
        let mut noise = || {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            (state >> 33) as f64 / f64::from(1u32 << 30) - 1.0
        };
        let mut square = 0.0;
        let (mut moments, mut row) = ([[0.0; 6]; 2], [0.0; 6]);
        let steps = 4000;
        for time in 1..=steps {
            let before = row;
            let [first, second] = &mut moments;
            let step = PoseStep { adam: AdamStep { time, ..ADAM }, extent: 1.0, translation: 0.01, ..STEP };
            step.take(&mut row, [first, second], std::array::from_fn(|_| noise()));
            let moved = row.iter().zip(before).map(|(after, before)| (f64::from(after - before) / 0.01).powi(2));
            square += moved.sum::<f64>() / (6.0 * steps as f64);
        }
        let expected = 0.05 / 1.95;
        assert!((square / expected - 1.0).abs() < 0.25, "{square}, expected {expected}");
        let quiet =
            after(PoseStep { doubt: 4.0, ..STEP }, [0.0; 6], (0..500).map(|_| std::array::from_fn(|_| noise())));
        let loud = after(STEP, [0.0; 6], (0..500).map(|_| std::array::from_fn(|_| noise())));
        let size = |row: [f32; 6]| row.iter().map(|number| number.abs()).sum::<f32>();
        assert!(size(quiet) < 0.3 * size(loud), "{quiet:?} {loud:?}");
    }

    #[test]
    fn without_gradients_a_correction_decays_by_the_pull() {
        let pulled = PoseStep { doubt: 1.5, pull: 5.0, ..STEP };
        let row = after(pulled, [0.2, -0.1, 0.0, 0.4, -0.6, 0.0], [[0.0; 6]; 3]);
        // a step takes 5 % of a rotation and 50 % of a translation back
        let (turned, shifted) = (0.95f32.powi(3), 0.5f32.powi(3));
        let expected = [0.2 * turned, -0.1 * turned, 0.0, 0.4 * shifted, -0.6 * shifted, 0.0];
        assert!(row.iter().zip(expected).all(|(found, expected)| (found - expected).abs() < 1e-6), "{row:?}");
    }
}
