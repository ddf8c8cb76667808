//! A palette of vectors that stand for many: k-means in two levels, since comparing every vector with each of 65,536 would
//! take hours. The first makes groups, the second divides each group by itself.

use rayon::prelude::*;

/// Vectors are first divided into so many groups.
const GROUPS: usize = 256;
const STEPS: usize = 5;

/// At most `count` vectors of `width` numbers, one after the other, and which of them stands for each of `vectors`. `count`
/// is at most the number of vectors.
pub fn palette(vectors: &[f32], width: usize, count: usize) -> (Vec<f32>, Vec<usize>) {
    let all: Vec<&[f32]> = vectors.chunks_exact(width).collect();
    if count <= GROUPS {
        return k_means(&all, width, count);
    }
    let mut groups = vec![Vec::new(); GROUPS];
    for (row, group) in k_means(&all, width, GROUPS).1.into_iter().enumerate() {
        groups[group].push(row);
    }
    groups.retain(|rows| !rows.is_empty());
    let divided = groups.par_iter().map(|rows| {
        let share = 1 + (count - GROUPS) * rows.len() / all.len();
        k_means(&rows.iter().map(|&row| all[row]).collect::<Vec<_>>(), width, share)
    });
    let (mut entries, mut labels) = (Vec::new(), vec![0; all.len()]);
    for (rows, (more, of_rows)) in groups.iter().zip(divided.collect::<Vec<_>>()) {
        let first = entries.len() / width;
        rows.iter().zip(of_rows).for_each(|(&row, label)| labels[row] = first + label);
        entries.extend(more);
    }
    (entries, labels)
}

/// Starts from vectors at even distances in their order.
fn k_means(vectors: &[&[f32]], width: usize, count: usize) -> (Vec<f32>, Vec<usize>) {
    let mut entries: Vec<f32> = (0..count).flat_map(|at| vectors[at * vectors.len() / count]).copied().collect();
    for _ in 0..STEPS {
        let labels = nearest(vectors, &entries, width);
        let (mut sums, mut counts) = (vec![0.0; entries.len()], vec![0u32; count]);
        for (vector, label) in vectors.iter().zip(labels) {
            counts[label] += 1;
            sums[label * width..].iter_mut().zip(*vector).for_each(|(sum, &value)| *sum += f64::from(value));
        }
        for (at, &of) in counts.iter().enumerate().filter(|(_, of)| **of > 0) {
            let span = at * width..(at + 1) * width;
            entries[span.clone()]
                .iter_mut()
                .zip(&sums[span])
                .for_each(|(entry, sum)| *entry = (sum / f64::from(of)) as f32);
        }
    }
    let labels = nearest(vectors, &entries, width);
    (entries, labels)
}

fn nearest(vectors: &[&[f32]], entries: &[f32], width: usize) -> Vec<usize> {
    let label = |vector: &&[f32]| {
        let distances = entries.chunks_exact(width).map(|entry| distance(vector, entry));
        distances.enumerate().fold((0, f32::INFINITY), |best, found| if found.1 < best.1 { found } else { best }).0
    };
    vectors.par_iter().map(label).collect()
}

/// Squared, in eight sums that a processor adds at a time.
fn distance(a: &[f32], b: &[f32]) -> f32 {
    let square = |(a, b): (&f32, &f32)| (a - b) * (a - b);
    let ((wide, rest), (other_wide, other_rest)) = (a.as_chunks::<8>(), b.as_chunks::<8>());
    let mut sums = [0.0; 8];
    for (a, b) in wide.iter().zip(other_wide) {
        sums.iter_mut().zip(a.iter().zip(b)).for_each(|(sum, pair)| *sum += square(pair));
    }
    sums.iter().sum::<f32>() + rest.iter().zip(other_rest).map(square).sum::<f32>()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn vectors_that_are_alike_share_an_entry() {
        // three places, and a little beside them
        let vectors: Vec<f32> = (0..60).flat_map(|at| [(at % 3 * 10) as f32 + (at / 3) as f32 / 100.0, 1.0]).collect();
        let (entries, labels) = palette(&vectors, 2, 3);
        assert_eq!(entries.len(), 6);
        for (row, &label) in labels.iter().enumerate() {
            assert!((entries[2 * label] - (row % 3 * 10) as f32 - 0.095).abs() < 1e-5, "{row}: {entries:?}");
        }
    }

    #[test]
    fn large_palettes_are_made_group_by_group() {
        let vectors: Vec<f32> = (0..2000).flat_map(|at| [(at as f32 * 0.7).sin(), (at as f32 * 1.3).cos()]).collect();
        let (entries, labels) = palette(&vectors, 2, 1024);
        assert!((768..=1024).contains(&(entries.len() / 2)), "{}", entries.len());
        let errors = labels.iter().zip(vectors.chunks_exact(2)).map(|(label, vector)| {
            let entry = &entries[2 * label..][..2];
            (entry[0] - vector[0]).powi(2) + (entry[1] - vector[1]).powi(2)
        });
        // numbers up to 1
        assert!((errors.sum::<f32>() / 2000.0).sqrt() < 0.01);
        let same = vec![0.5; 3 * 300];
        let (entries, labels) = palette(&same, 3, 256);
        assert!(labels.iter().all(|&label| entries[3 * label..][..3] == [0.5; 3]));
    }
}
