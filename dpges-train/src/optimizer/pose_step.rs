//! One step of the correction of a camera.

use dpges_core::ops::adam::AdamStep;

/// How far a correction moves in one step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PoseStep {
    /// Learning rate of the rotation, rad, and of the translation, extents.
    pub rate: f64,
    /// World units.
    pub extent: f64,
    /// Adam's constants; `time` counts the steps of this correction.
    pub adam: AdamStep,
}

impl PoseStep {
    /// Steps the six numbers of a correction (rad, world units) with their two `moments`, against a `gradient`, by Adam.
    pub fn take(&self, row: &mut [f32; 6], [first, second]: [&mut [f32; 6]; 2], gradient: [f64; 6]) {
        let AdamStep { beta_1, beta_2, epsilon, time, .. } = self.adam;
        let left = |beta: f64| 1.0 - beta.powf(time as f64);
        for (at, gradient) in gradient.into_iter().enumerate() {
            first[at] = (beta_1 * f64::from(first[at]) + (1.0 - beta_1) * gradient) as f32;
            second[at] = (beta_2 * f64::from(second[at]) + (1.0 - beta_2) * gradient * gradient) as f32;
            let deviation = (f64::from(second[at]) / left(beta_2)).sqrt();
            let rate = if at < 3 { self.rate } else { self.rate * self.extent };
            row[at] = (f64::from(row[at]) - rate * f64::from(first[at]) / left(beta_1) / (deviation + epsilon)) as f32;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const ADAM: AdamStep = AdamStep { learning_rate: 0.0, beta_1: 0.9, beta_2: 0.9, epsilon: 1e-15, time: 1 };
    const STEP: PoseStep = PoseStep { rate: 0.01, extent: 20.0, adam: ADAM };

    /// The numbers after as many steps as there are `gradients`.
    fn after(start: [f32; 6], gradients: impl IntoIterator<Item = [f64; 6]>) -> [f32; 6] {
        let (mut row, mut moments) = (start, [[0.0; 6]; 2]);
        for (time, gradient) in (1..).zip(gradients) {
            let [first, second] = &mut moments;
            PoseStep { adam: AdamStep { time, ..ADAM }, ..STEP }.take(&mut row, [first, second], gradient);
        }
        row
    }

    #[test]
    fn a_first_step_is_the_learning_rate_in_radians_and_extents() {
        let row = after([0.0; 6], [[3.0, -0.1, 1.0, 1.0, -7.0, 0.0]]);
        let expected = [-0.01, 0.01, -0.01, -0.2, 0.2, 0.0];
        assert!(row.iter().zip(expected).all(|(found, expected)| (found - expected).abs() < 1e-6), "{row:?}");
    }

    #[test]
    fn the_size_of_all_gradients_says_nothing() {
        let gradients = |size: f64| {
            (0..20).map(move |at| [1.0, -2.0, 0.5, 1.5, 0.3, -0.7].map(|g| size * (g + 0.1 * f64::from(at))))
        };
        let (small, large) = (after([0.1; 6], gradients(1e-3)), after([0.1; 6], gradients(1e3)));
        assert!(small.iter().zip(large).all(|(a, b)| (a - b).abs() < 1e-5), "{small:?} {large:?}");
    }

    #[test]
    fn gradients_that_agree_move_farther_than_those_that_do_not() {
        let agreeing = after([0.0; 6], std::iter::repeat_n([1.0; 6], 60));
        let alternating = after([0.0; 6], (0..60).map(|at| [if at % 2 == 0 { 1.0 } else { -1.0 }; 6]));
        assert!((agreeing[0] + 0.6).abs() < 1e-4 && alternating[0].abs() < 0.1, "{agreeing:?} {alternating:?}");
    }
}
