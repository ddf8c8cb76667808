//! Gradients against central differences in f64, judged element by element and as a vector.

use burn::tensor::{DType, Device, Tensor, TensorData};

/// Central differences of `loss` at `parameters` along `elements`. `None` where half the step gives
/// another slope: there the loss jumps or has a kink.
pub fn central_differences(
    parameters: &[f64],
    elements: &[usize],
    step: f64,
    mut loss: impl FnMut(&[f64]) -> f64,
) -> Vec<Option<f64>> {
    const AGREEMENT: f64 = 1e-4;
    let mut moved = parameters.to_vec();
    let rounding = 1e3 * f64::EPSILON * loss(&moved).abs() / step;
    let mut slope = |element: usize, step: f64| {
        let mut at = |value: f64| {
            moved[element] = value;
            loss(&moved)
        };
        let (above, below) = (at(parameters[element] + step), at(parameters[element] - step));
        moved[element] = parameters[element];
        (above - below) / (2.0 * step)
    };
    let slopes: Vec<[f64; 2]> = elements.iter().map(|&e| [slope(e, step), slope(e, step / 2.0)]).collect();
    let mut sizes: Vec<f64> = slopes.iter().map(|s| s[1].abs()).collect();
    sizes.sort_by(f64::total_cmp);
    let usual = sizes.get(sizes.len() / 2).copied().unwrap_or(0.0);
    let agree = |[a, b]: [f64; 2]| (a - b).abs() <= AGREEMENT * (b.abs() + 0.1 * usual) + rounding;
    slopes.into_iter().map(|s| agree(s).then_some(s[1])).collect()
}

#[derive(Clone, Copy, Debug)]
pub struct Judgement {
    /// Largest difference of an element, over its size plus a hundredth of the largest element.
    pub element: f64,
    pub relative_l2: f64,
    /// 1 − cosine of the angle between the two.
    pub angle: f64,
    /// Mean of found − expected over the mean size of the expected elements.
    pub bias: f64,
    /// Share of the elements at which the loss is not smooth; they are left out.
    pub left_out: f64,
}

impl Judgement {
    pub fn new(found: &[f64], expected: &[Option<f64>]) -> Self {
        assert_eq!(found.len(), expected.len(), "gradients of different lengths");
        let pairs: Vec<[f64; 2]> = found.iter().zip(expected).filter_map(|(&f, &e)| e.map(|e| [f, e])).collect();
        let largest = pairs.iter().fold(0.0, |m: f64, p| m.max(p[1].abs()));
        let sum = |term: fn(&[f64; 2]) -> f64| pairs.iter().map(term).sum::<f64>();
        // 0 / 0 is a perfect zero gradient
        let ratio = |a: f64, b: f64| if a == 0.0 { 0.0 } else { a / b };
        let element = |p: &[f64; 2]| ratio((p[0] - p[1]).abs(), p[1].abs() + 0.01 * largest);
        let (found_norm, norm) = (sum(|p| p[0] * p[0]).sqrt(), sum(|p| p[1] * p[1]).sqrt());
        let cosine = if found_norm == 0.0 && norm == 0.0 { 1.0 } else { sum(|p| p[0] * p[1]) / (found_norm * norm) };
        Self {
            // phrased so that NaN is not lost
            element: pairs.iter().map(element).fold(0.0, |m, v| if v <= m { m } else { v }),
            relative_l2: ratio(sum(|p| (p[0] - p[1]).powi(2)).sqrt(), norm),
            angle: 1.0 - cosine,
            bias: ratio(sum(|p| p[0] - p[1]), sum(|p| p[1].abs())),
            left_out: ratio((expected.len() - pairs.len()) as f64, expected.len() as f64),
        }
    }

    /// Whether the gradient is right to within what central differences can tell.
    pub fn is_close(&self) -> bool {
        self.element < 1e-3
            && self.relative_l2 < 1e-5
            && self.angle < 1e-9
            && self.bias.abs() < 1e-5
            && self.left_out < 0.1
    }
}

/// Compares `gradient` at `elements` of `parameters` with central differences of `loss`.
pub fn check_elements(
    name: &str,
    parameters: &[f64],
    gradient: &[f64],
    elements: &[usize],
    step: f64,
    loss: impl FnMut(&[f64]) -> f64,
) {
    assert_eq!(gradient.len(), parameters.len(), "{name}: gradient of another length");
    let expected = central_differences(parameters, elements, step, loss);
    let found: Vec<f64> = elements.iter().map(|&element| gradient[element]).collect();
    let judgement = Judgement::new(&found, &expected);
    assert!(judgement.is_close(), "gradient of {name}: {judgement:?}\nfound    {found:?}\nexpected {expected:?}");
}

/// [`check_elements`] with all of them.
pub fn check(name: &str, parameters: &[f64], gradient: &[f64], step: f64, loss: impl FnMut(&[f64]) -> f64) {
    check_elements(name, parameters, gradient, &(0..parameters.len()).collect::<Vec<_>>(), step, loss);
}

/// An f64 tensor of `values` that a gradient is wanted for.
pub fn leaf<const D: usize>(values: &[f64], shape: [usize; D], device: &Device) -> Tensor<D> {
    Tensor::from_data(TensorData::new(values.to_vec(), shape), (device, DType::F64)).require_grad()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn loss(x: &[f64]) -> f64 {
        x.iter().enumerate().map(|(i, x)| (x * (i as f64 + 1.0)).sin()).sum()
    }

    fn gradient(x: &[f64]) -> Vec<f64> {
        x.iter().enumerate().map(|(i, x)| (i as f64 + 1.0) * (x * (i as f64 + 1.0)).cos()).collect()
    }

    #[test]
    fn a_right_gradient_is_close_and_wrong_ones_are_not() {
        let x: Vec<f64> = (0..20).map(|i| f64::from(i) * 0.37 - 2.0).collect();
        let right = gradient(&x);
        check("sum of sines", &x, &right, 1e-5, loss);
        let expected: Vec<Option<f64>> = right.iter().copied().map(Some).collect();
        let close = |found: Vec<f64>| Judgement::new(&found, &expected).is_close();
        assert!(close(right.clone()));
        assert!(!close(right.iter().map(|g| g * 1.0001).collect()));
        assert!(!close(right.iter().map(|g| g + 1e-3).collect()));
        assert!(!close(vec![0.0; 20]));
        let mut one_off = right.clone();
        one_off[7] = -one_off[7];
        assert!(!close(one_off));
        let mut not_a_number = right;
        not_a_number[3] = f64::NAN;
        assert!(!close(not_a_number));
        assert!(Judgement::new(&[0.0; 3], &[Some(0.0); 3]).is_close());
    }

    #[test]
    fn jumps_and_kinks_are_left_out() {
        let steps = |x: &[f64]| x[0].floor() + (x[1] - 0.3e-5).abs() + x[2] * x[2];
        let slopes = central_differences(&[1.0, 0.0, 2.0], &[0, 1, 2], 1e-5, steps);
        assert!(slopes[0].is_none() && slopes[1].is_none());
        approx::assert_relative_eq!(slopes[2].unwrap(), 4.0, epsilon = 1e-6);
    }
}
