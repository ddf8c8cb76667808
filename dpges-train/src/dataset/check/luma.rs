//! How sharp pictures are: the variance of their Laplacian (Pech-Pacheco et al. 2000), which compares pictures of the same
//! things.

use crate::dataset::Picture;

/// A picture in one channel.
#[derive(Clone, Debug, PartialEq)]
pub struct Luma {
    /// px
    pub width: usize,
    /// px
    pub height: usize,
    /// [height, width], 0 to 1.
    pub values: Vec<f32>,
    /// Whether a pixel counts, [height, width]. `None` if all do.
    pub counted: Option<Vec<bool>>,
}

impl Luma {
    /// Weights of red, green and blue (Rec. 709).
    const WEIGHTS: [f32; 3] = [0.2126, 0.7152, 0.0722];

    /// Luma of a picture, from its values as they are stored.
    pub fn of(picture: &Picture) -> Self {
        let counted = picture.counted.clone();
        Self { counted, ..Self::of_planes(&picture.planes(), picture.width, picture.height) }
    }

    /// Whether a pixel counts.
    fn counts(&self, pixel: usize) -> bool {
        self.counted.as_ref().is_none_or(|counted| counted[pixel])
    }

    /// Luma of the red, green and blue planes of a picture, [3, height, width].
    pub fn of_planes(planes: &[f32], width: usize, height: usize) -> Self {
        let count = width * height;
        let value = |pixel: usize| (0..3).map(|channel| Self::WEIGHTS[channel] * planes[channel * count + pixel]).sum();
        Self { width, height, values: (0..count).map(value).collect(), counted: None }
    }

    /// Halved until its longer side is at most `longest` px: the noise of single pixels of a large photograph says nothing.
    pub fn at_most(mut self, longest: usize) -> Self {
        while self.width.max(self.height) > longest.max(1) {
            self = self.halved();
        }
        self
    }

    /// The mean of each block of 2 × 2 px, which counts if all of them do; at a side of odd length the last column or row is
    /// left out.
    pub fn halved(&self) -> Self {
        let (width, height) = ((self.width / 2).max(1), (self.height / 2).max(1));
        let place = |x: usize, y: usize| y.min(self.height - 1) * self.width + x.min(self.width - 1);
        let block = |pixel: usize| {
            let (x, y) = (2 * (pixel % width), 2 * (pixel / width));
            [place(x, y), place(x + 1, y), place(x, y + 1), place(x + 1, y + 1)]
        };
        let mean = |pixel: usize| block(pixel).iter().map(|&place| self.values[place]).sum::<f32>() / 4.0;
        let counted = self
            .counted
            .as_ref()
            .map(|counted| (0..width * height).map(|pixel| block(pixel).iter().all(|&place| counted[place])).collect());
        Self { width, height, values: (0..width * height).map(mean).collect(), counted }
    }

    /// Variance of the Laplacian (of four neighbours) over all pixels but those of the border and those that have to do with
    /// a pixel that does not count; 0 without such.
    pub fn laplacian_variance(&self) -> f64 {
        let (width, height) = (self.width, self.height);
        let (mut sum, mut squares, mut count) = (0.0, 0.0, 0usize);
        for y in 1..height.saturating_sub(1) {
            for x in 1..width.saturating_sub(1) {
                let at = y * width + x;
                let around = [at - 1, at + 1, at - width, at + width];
                if !self.counts(at) || !around.iter().all(|&pixel| self.counts(pixel)) {
                    continue;
                }
                let neighbours: f32 = around.iter().map(|&pixel| self.values[pixel]).sum();
                let laplacian = f64::from(neighbours - 4.0 * self.values[at]);
                sum += laplacian;
                squares += laplacian * laplacian;
                count += 1;
            }
        }
        let count = count.max(1) as f64;
        (squares / count - (sum / count).powi(2)).max(0.0)
    }

    /// Mean squares of the second differences along rows and along columns, of pixels that count: how much detail of the size
    /// of a pixel there is in each direction. 0 where there are fewer than 3 px.
    pub fn detail(&self) -> [f64; 2] {
        let (width, height) = (self.width, self.height);
        let mean = |columns: usize, rows: usize, step: usize| {
            let (mut sum, mut count) = (0.0, 0usize);
            for y in 0..rows {
                for x in 0..columns {
                    let [a, b, c] = [0, 1, 2].map(|i| y * width + x + i * step);
                    if self.counts(a) && self.counts(b) && self.counts(c) {
                        let difference = self.values[a] + self.values[c] - 2.0 * self.values[b];
                        sum += f64::from(difference * difference);
                        count += 1;
                    }
                }
            }
            sum / count.max(1) as f64
        };
        [mean(width.saturating_sub(2), height, 1), mean(width, height.saturating_sub(2), width)]
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn luma(width: usize, height: usize, value: impl Fn(usize, usize) -> f32) -> Luma {
        let values = (0..width * height).map(|i| value(i % width, i / width)).collect();
        Luma { width, height, values, counted: None }
    }

    #[test]
    fn edges_are_sharper_than_ramps_and_ramps_as_sharp_as_nothing() {
        let edge = luma(8, 8, |x, _| if x < 4 { 0.0 } else { 1.0 }).laplacian_variance();
        let soft = luma(8, 8, |x, _| [0.0, 0.0, 0.1, 0.35, 0.65, 0.9, 1.0, 1.0][x]).laplacian_variance();
        // two of six inner columns have a Laplacian of 1 and -1
        assert!((edge - 1.0 / 3.0).abs() < 1e-12, "{edge}");
        assert!(soft > 0.0 && soft < 0.1 * edge, "{soft}");
        assert!(luma(8, 8, |x, y| (x + y) as f32 / 16.0).laplacian_variance() < 1e-12);
        assert_eq!(luma(2, 9, |x, _| x as f32).laplacian_variance(), 0.0);
    }

    #[test]
    fn detail_has_directions() {
        let columns = luma(6, 4, |x, _| (x % 2) as f32);
        assert_eq!(columns.detail(), [4.0, 0.0]);
        let rows = luma(4, 6, |_, y| (y % 2) as f32);
        assert_eq!(rows.detail(), [0.0, 4.0]);
        assert_eq!(luma(2, 1, |x, _| x as f32).detail(), [0.0; 2]);
    }

    #[test]
    fn what_does_not_count_has_no_part() {
        let stripes = |x: usize, y: usize| if x < 4 { (x % 2) as f32 } else { y as f32 * 0.01 };
        let mut masked = luma(12, 8, stripes);
        masked.counted = Some((0..12 * 8).map(|pixel| pixel % 12 >= 4).collect());
        let [along_rows, along_columns] = masked.detail();
        assert!(along_rows == 0.0 && along_columns < 1e-12, "{along_rows} {along_columns}");
        assert!(masked.laplacian_variance() < 1e-12);
        assert!(luma(12, 8, stripes).laplacian_variance() > 0.1);
        let half = masked.halved();
        assert_eq!(half.counted, Some((0..6 * 4).map(|pixel| pixel % 6 >= 2).collect()));
        masked.counted = Some(vec![false; 12 * 8]);
        assert_eq!((masked.detail(), masked.laplacian_variance()), ([0.0; 2], 0.0));
    }

    #[test]
    fn halving_takes_means_and_stops_at_the_size() {
        let picture = luma(5, 4, |x, y| (x + 10 * y) as f32);
        let half = picture.clone().at_most(4);
        assert_eq!((half.width, half.height), (2, 2));
        assert_eq!(half.values, [5.5, 7.5, 25.5, 27.5]);
        assert_eq!(picture.clone().at_most(5), picture);
        assert_eq!(picture.at_most(1).values.len(), 1);
    }

    #[test]
    fn luma_weighs_the_channels() {
        let values = Luma::of_planes(&[1.0, 0.0, 0.0, 1.0, 0.0, 1.0], 2, 1).values;
        assert!((values[0] - 0.2126).abs() < 1e-6 && (values[1] - 0.7874).abs() < 1e-6, "{values:?}");
    }
}
