//! What every surfel is worth: how much more the pictures would be wrong without it.

/// Sums over views for `[N]` surfels.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Worths {
    /// Squared error that the surfel saves at the pixels where it is the nearest, summed over channels.
    pub saved: Vec<f64>,
    /// Pixels at which it is the nearest.
    pub pixels: Vec<u32>,
}

impl Worths {
    pub fn new(surfels: usize) -> Self {
        Self { saved: vec![0.0; surfels], pixels: vec![0; surfels] }
    }

    /// Adds a view in which pixel i shows surfel `nearest[i]` (−1: none) and has the squared error `with[i]`, or
    /// `without[i]` in a picture without the surfels of which `left_out` is true.
    pub fn add(&mut self, nearest: &[i32], with: &[f32], without: &[f32], left_out: &[bool]) {
        for (pixel, &surfel) in nearest.iter().enumerate() {
            let Ok(surfel) = usize::try_from(surfel) else { continue };
            if left_out[surfel] {
                self.saved[surfel] += f64::from(without[pixel]) - f64::from(with[pixel]);
                self.pixels[surfel] += 1;
            }
        }
    }

    /// The surfels to keep: those that were not seen, and those that save error.
    pub fn worthy(&self) -> Vec<usize> {
        (0..self.saved.len()).filter(|&row| self.pixels[row] == 0 || self.saved[row] > 0.0).collect()
    }
}

/// `[N]` whether each of N surfels belongs to `group` of `groups`, of which neighbouring rows are in different ones.
pub fn members(surfels: usize, group: usize, groups: usize) -> Vec<bool> {
    (0..surfels).map(|row| row % groups == group).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_surfel_is_worth_the_error_that_it_saves_where_it_is_nearest() {
        let mut worths = Worths::new(4);
        let nearest = [0, 0, 1, -1, 2];
        for group in 0..2 {
            let left_out = members(4, group, 2);
            worths.add(&nearest, &[0.1, 0.1, 0.5, 9.0, 0.2], &[0.4, 0.0, 0.2, 0.0, 0.3], &left_out);
        }
        assert_eq!(worths.pixels, [2, 1, 1, 0]);
        for (found, expected) in worths.saved.iter().zip([0.2, -0.3, 0.1, 0.0]) {
            assert!((found - expected).abs() < 1e-6, "{found}, expected {expected}");
        }
        assert_eq!(worths.worthy(), [0, 2, 3]);
    }

    #[test]
    fn every_surfel_is_in_one_group() {
        for (surfels, groups) in [(0, 3), (2, 3), (10, 3)] {
            let counts = (0..groups).flat_map(|group| members(surfels, group, groups)).filter(|&member| member).count();
            assert_eq!(counts, surfels);
        }
    }
}
