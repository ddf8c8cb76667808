//! Small pictures in which some pixels do not count.

use super::device;
use crate::losses::Mask;

pub const WIDTH: usize = 23;
pub const HEIGHT: usize = 19;
pub const AREA: usize = WIDTH * HEIGHT;

/// A rectangle in the middle and a column at the border do not count.
pub fn counted() -> Vec<bool> {
    let is_ignored = |x: usize, y: usize| ((6..15).contains(&x) && (4..12).contains(&y)) || x + 1 == WIDTH;
    (0..AREA).map(|at| !is_ignored(at % WIDTH, at / WIDTH)).collect()
}

pub fn mask(counted: &[bool]) -> Mask {
    Mask::new(counted, WIDTH, HEIGHT, &device()).expect("the size of the picture")
}

/// `values` [3 × H × W] with `others` where pixels do not count.
pub fn overpainted(values: &[f64], others: &[f64]) -> Vec<f64> {
    let counted = counted();
    (0..3 * AREA).map(|at| if counted[at % AREA] { values[at] } else { others[at] }).collect()
}
