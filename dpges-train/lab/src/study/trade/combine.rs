//! Which knobs are turned together: those that cost least quality for what they save, one after another.

use super::super::row::Row;
use super::knob::{AS_TRAINED, Change};

/// Most knobs that are turned together.
const MOST: usize = 4;
/// A knob has to save this share of the cost. Frame times scatter by less.
const LEAST_SAVING: f64 = 0.02;
/// Knobs that lose more are not combined, dB.
const MOST_LOSS: f64 = 3.0;
/// Losses below this count as this much, dB: they are chance.
const LEAST_LOSS: f64 = 0.02;

/// Measures that knobs are to save.
const COSTS: [&str; 2] = ["frame_ms", "bytes"];

/// Combinations of 2, 3, … of `singles` that are worth measuring, for frame times and for file sizes, without
/// repetitions. Of each knob the value counts that saves most for what it loses (the logarithm of the cost per dB); knobs
/// join in the order of that. `rows` have the measurement of every single change and of none; a change that has not been
/// measured is left out.
pub fn combinations(singles: &[Change], rows: &[Row]) -> Vec<Vec<Change>> {
    let measured = |label: &str| rows.iter().find(|row| row.label == label);
    let Some(base) = measured(AS_TRAINED) else { return Vec::new() };
    let mut all: Vec<Vec<Change>> = Vec::new();
    for cost in COSTS {
        let worth = |&change: &Change| {
            let row = measured(&change.to_string())?;
            let (saved, lost) = (row.get(cost)? / base.get(cost)?, base.get("psnr")? - row.get("psnr")?);
            (saved <= 1.0 - LEAST_SAVING && lost <= MOST_LOSS).then(|| (-saved.ln() / lost.max(LEAST_LOSS), change))
        };
        let mut candidates: Vec<(f64, Change)> = singles.iter().filter_map(worth).collect();
        candidates.sort_by(|a, b| b.0.total_cmp(&a.0));
        let mut best: Vec<Change> = Vec::new();
        for (_, change) in candidates {
            if best.iter().all(|other| other.knob() != change.knob()) {
                best.push(change);
            }
        }
        for count in 2..=best.len().min(MOST) {
            let place = |change: &Change| singles.iter().position(|single| single == change);
            let mut combination = best[..count].to_vec();
            combination.sort_by_key(place);
            if !all.contains(&combination) {
                all.push(combination);
            }
        }
    }
    all
}

#[cfg(test)]
mod tests {
    use super::super::super::row::tests::drawn;
    use super::*;

    #[test]
    fn knobs_join_by_what_they_save_for_what_they_lose() {
        let singles =
            [Change::Layers(2), Change::Layers(1), Change::Detail(0), Change::Resolution(50), Change::HalfSums];
        let rows = [
            drawn("as trained", 30.0, 10.0, 1000),
            drawn("layers=2", 29.9, 8.0, 1000),
            drawn("layers=1", 29.0, 6.0, 1000),
            drawn("detail=0", 29.5, 9.9, 400),
            drawn("resolution=50%", 25.0, 3.0, 1000),
            drawn("sums=16bit", 30.0, 9.0, 1000),
        ];
        // by time: 16-bit sums (no loss), then two layers (0.22 for 0.1 dB before 0.51 for 1 dB); half the sides lose too
        // much and lobes save nothing. By size only lobes save anything.
        let found = combinations(&singles, &rows);
        assert_eq!(found, [vec![Change::Layers(2), Change::HalfSums]]);
        let mut small = rows.to_vec();
        small.push(drawn("primitives=50%", 29.8, 7.0, 500));
        let singles = [&singles[..], &[Change::Primitives(50)]].concat();
        let found = combinations(&singles, &small);
        let expected = [
            vec![Change::Layers(2), Change::HalfSums],
            vec![Change::Layers(2), Change::HalfSums, Change::Primitives(50)],
            vec![Change::Detail(0), Change::Primitives(50)],
        ];
        assert_eq!(found.len(), expected.len(), "{found:?}");
        assert!(found.iter().all(|combination| expected.contains(combination)), "{found:?}");
        assert!(combinations(&singles, &rows[1..]).is_empty(), "without the scene as it was trained");
    }
}
