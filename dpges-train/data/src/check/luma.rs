//! Pictures in one channel: how much detail they have, and whether two show the same.

use crate::Picture;

/// Weights of red, green and blue (Rec. 709).
const WEIGHTS: [f32; 3] = [0.2126, 0.7152, 0.0722];
/// Side of a thumbnail, px, and how many of its pixels two must have in common to be compared.
const SIDE: usize = 16;
const FEWEST_IN_COMMON: usize = SIDE * SIDE / 4;

/// A picture in one channel.
#[derive(Clone, Debug, PartialEq)]
pub struct Luma {
    /// px
    pub width: usize,
    /// px
    pub height: usize,
    /// [height, width], 0 to 1; NaN where pixels do not count, and so wherever such a pixel has a part.
    pub values: Vec<f32>,
}

impl Luma {
    /// Luma of a picture, from its values as they are stored.
    pub fn of(picture: &Picture) -> Self {
        let value = |pixel: usize| {
            let weighed = picture.colour(pixel).into_iter().zip(WEIGHTS).map(|(value, weight)| weight * value);
            if picture.counts(pixel) { weighed.sum() } else { f32::NAN }
        };
        Self { width: picture.width, height: picture.height, values: (0..picture.area()).map(value).collect() }
    }

    /// Halved until its longer side is at most `longest` px: the noise of single pixels of a large photograph says nothing.
    pub fn at_most(mut self, longest: usize) -> Self {
        while self.width.max(self.height) > longest.max(1) {
            self = self.halved();
        }
        self
    }

    /// The mean of each block of 2 × 2 px; at a side of odd length the last column or row is left out.
    pub fn halved(&self) -> Self {
        let (width, height) = ((self.width / 2).max(1), (self.height / 2).max(1));
        let at = |x: usize, y: usize| self.values[y.min(self.height - 1) * self.width + x.min(self.width - 1)];
        let mean = |pixel: usize| {
            let (x, y) = (2 * (pixel % width), 2 * (pixel / width));
            (at(x, y) + at(x + 1, y) + at(x, y + 1) + at(x + 1, y + 1)) / 4.0
        };
        Self { width, height, values: (0..width * height).map(mean).collect() }
    }

    /// Mean squares of the second differences along rows and along columns: how much detail of the size of a pixel there is
    /// in each direction. 0 where there are fewer than 3 px.
    pub fn detail(&self) -> [f64; 2] {
        let mean = |columns: usize, rows: usize, step: usize| {
            let places = (0..rows).flat_map(|y| (0..columns).map(move |x| y * self.width + x));
            let [a, b, c] = [0, 1, 2].map(|i| &self.values[(i * step).min(self.values.len())..]);
            let differences = places.map(|at| a[at] + c[at] - 2.0 * b[at]).filter(|difference| !difference.is_nan());
            let add = |(sum, count), difference: f32| (sum + f64::from(difference * difference), count + 1);
            let (sum, count) = differences.fold((0.0, 0usize), add);
            sum / count.max(1) as f64
        };
        let (width, height) = (self.width, self.height);
        [mean(width.saturating_sub(2), height, 1), mean(width, height.saturating_sub(2), width)]
    }

    /// In 16 × 16 px, each the mean of those that it stands for.
    pub fn thumbnail(&self) -> Vec<f32> {
        let range = |index: usize, length: usize| {
            let from = index * length / SIDE;
            from..((index + 1) * length / SIDE).max(from + 1).min(length)
        };
        let mean = |pixel: usize| {
            let (rows, columns) = (range(pixel / SIDE, self.height), range(pixel % SIDE, self.width));
            let count = (rows.len() * columns.len()).max(1) as f32;
            let row = |y: usize| &self.values[y * self.width + columns.start..y * self.width + columns.end];
            rows.flat_map(row).sum::<f32>() / count
        };
        (0..SIDE * SIDE).map(mean).collect()
    }
}

/// Root mean square difference of two thumbnails; `None` if they have too little in common.
pub fn difference(a: &[f32], b: &[f32]) -> Option<f64> {
    let differences = a.iter().zip(b).map(|(a, b)| f64::from(a - b)).filter(|difference| !difference.is_nan());
    let squares: Vec<f64> = differences.map(|difference| difference * difference).collect();
    (squares.len() >= FEWEST_IN_COMMON).then(|| (squares.iter().sum::<f64>() / squares.len() as f64).sqrt())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn luma(width: usize, height: usize, value: impl Fn(usize, usize) -> f32) -> Luma {
        Luma { width, height, values: (0..width * height).map(|i| value(i % width, i / width)).collect() }
    }

    #[test]
    fn detail_has_directions_and_nothing_of_what_does_not_count() {
        assert_eq!(luma(6, 4, |x, _| (x % 2) as f32).detail(), [4.0, 0.0]);
        assert_eq!(luma(4, 6, |_, y| (y % 2) as f32).detail(), [0.0, 4.0]);
        assert_eq!(luma(2, 1, |x, _| x as f32).detail(), [0.0; 2]);
        let masked = luma(12, 8, |x, y| if x < 4 { f32::NAN } else { y as f32 * 0.25 });
        assert_eq!(masked.detail(), [0.0; 2]);
        assert!(masked.halved().values.iter().enumerate().all(|(i, value)| value.is_nan() == (i % 6 < 2)));
    }

    #[test]
    fn halving_takes_means_and_stops_at_the_size() {
        let picture = luma(5, 4, |x, y| (x + 10 * y) as f32);
        let half = picture.clone().at_most(4);
        assert_eq!((half.width, half.height, half.values), (2, 2, vec![5.5, 7.5, 25.5, 27.5]));
        assert_eq!(picture.clone().at_most(5), picture);
    }

    #[test]
    fn thumbnails_are_means_of_pictures_of_any_size() {
        let large = luma(32, 48, |x, _| (x % 2) as f32);
        assert_eq!(large.thumbnail(), [0.5; SIDE * SIDE]);
        let small = luma(3, 1, |_, _| 0.25).thumbnail();
        assert_eq!(small, [0.25; SIDE * SIDE]);
        assert_eq!(difference(&large.thumbnail(), &small), Some(0.25));
        // a pixel stands for 2 × 3 of them
        let masked =
            |columns: usize| luma(32, 48, |x, _| if x < columns { f32::NAN } else { (x % 2) as f32 }).thumbnail();
        assert!(masked(9).iter().enumerate().all(|(i, value)| value.is_nan() == (i % SIDE < 5)));
        assert_eq!((difference(&masked(9), &small), difference(&masked(26), &small)), (Some(0.25), None));
    }
}
