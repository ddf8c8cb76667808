//! 256 numbers that stand for many.

/// A byte names one of them.
const ENTRIES: usize = 256;
/// Bins of the histogram that the first entries are taken from.
const BINS: usize = 4096;
/// Steps of Lloyd's algorithm; after that, entries hardly move.
const STEPS: usize = 20;

/// 256 numbers, ascending.
#[derive(Debug)]
pub struct Codebook(pub Vec<f32>);

impl Codebook {
    /// Numbers with a small mean squared difference from `values`, which are finite and at least one: Lloyd's algorithm.
    pub fn of(values: impl IntoIterator<Item = f32>) -> Self {
        let mut sorted: Vec<f32> = values.into_iter().collect();
        sorted.sort_unstable_by(f32::total_cmp);
        let mut distinct = sorted.clone();
        distinct.dedup();
        if distinct.len() <= ENTRIES {
            let last = distinct[distinct.len() - 1];
            distinct.resize(ENTRIES, last);
            return Self(distinct);
        }
        let sums: Vec<f64> = std::iter::once(0.0)
            .chain(sorted.iter().scan(0.0, |sum, &value| {
                *sum += f64::from(value);
                Some(*sum)
            }))
            .collect();
        let mut book = Self(start(&sorted));
        for _ in 0..STEPS {
            let mut from = 0;
            for at in 0..ENTRIES {
                let to = if at + 1 < ENTRIES { sorted.partition_point(|&v| v < book.end(at)) } else { sorted.len() };
                if to > from {
                    book.0[at] = ((sums[to] - sums[from]) / (to - from) as f64) as f32;
                }
                from = to.max(from);
            }
            book.0.sort_unstable_by(f32::total_cmp);
        }
        book
    }

    /// Half way to the next entry.
    fn end(&self, at: usize) -> f32 {
        0.5 * self.0[at] + 0.5 * self.0[at + 1]
    }

    /// The entry nearest to `value`.
    pub fn nearest(&self, value: f32) -> u8 {
        let above = self.0.partition_point(|&entry| entry < value).clamp(1, ENTRIES - 1);
        if value < self.end(above - 1) { above as u8 - 1 } else { above as u8 }
    }
}

/// Entries as dense as the cube root of the density of values: nearly optimal where there are many entries (Panter and Dite
/// 1951).
fn start(sorted: &[f32]) -> Vec<f32> {
    let (low, high) = (f64::from(sorted[0]), f64::from(sorted[sorted.len() - 1]));
    let mut bins = vec![0u32; BINS];
    let scale = (BINS - 1) as f64 / (high - low);
    sorted.iter().for_each(|&value| bins[((f64::from(value) - low) * scale) as usize] += 1);
    let mut reached = 0.0;
    let reach: Vec<f64> = bins
        .iter()
        .map(|&count| {
            reached += f64::from(count).cbrt();
            reached
        })
        .collect();
    let entry = |at: usize| {
        let share = (at as f64 + 0.5) / ENTRIES as f64 * reached;
        let bin = reach.partition_point(|&reach| reach < share);
        let before = if bin > 0 { reach[bin - 1] } else { 0.0 };
        (low + (bin as f64 + (share - before) / (reach[bin] - before)) / scale) as f32
    };
    (0..ENTRIES).map(entry).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn few_numbers_are_kept_as_they_are() {
        let values = [0.5, -1.25, 3.0, 0.5];
        let book = Codebook::of(values);
        assert_eq!(book.0.len(), 256);
        assert_eq!(values.map(|value| book.0[usize::from(book.nearest(value))]), values);
        assert_eq!(Codebook::of([7.0]).0, [7.0; 256]);
    }

    #[test]
    fn many_numbers_are_near_an_entry_and_nearest_to_the_one_that_is_named() {
        // even steps of 1 / 4096: entries are as far apart as 16 of them; one number is far from all
        let values: Vec<f32> = (0..4096).map(|at| at as f32 / 4096.0).chain([40.0]).collect();
        let book = Codebook::of(values.iter().copied());
        assert!(book.0.is_sorted());
        let mut squared = 0.0;
        for &value in &values {
            let found = book.0[usize::from(book.nearest(value))];
            let best = book.0.iter().map(|entry| (entry - value).abs()).fold(f32::INFINITY, f32::min);
            assert_eq!((found - value).abs(), best);
            squared += f64::from(best * best);
        }
        // the least possible is 1 / 255 / √12 for all but one
        let rms = (squared / 4097.0).sqrt();
        assert!(rms < 1.1 / 255.0 / 12f64.sqrt(), "{rms}");
        assert_eq!(book.0[255], 40.0);
    }
}
