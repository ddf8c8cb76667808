//! Places in the buffers of a fixed size that cells share.

use std::iter::once;
use std::ops::Range;

use crate::scene::PAGE;

/// Which pages of a buffer are taken.
#[derive(Debug)]
pub(super) struct Pages {
    taken: Vec<bool>,
}

impl Pages {
    pub fn new(count: usize) -> Self {
        Self { taken: vec![false; count] }
    }

    /// Places for `count` primitives: ranges of primitives whose starts are those of pages, in one piece if a gap is long
    /// enough, and else in the first gaps. `None` if there are not enough pages.
    pub fn take(&mut self, count: usize) -> Option<Vec<Range<u32>>> {
        let needed = count.div_ceil(PAGE);
        let gaps = self.gaps();
        let mut found: Vec<Range<usize>> = match gaps.iter().find(|gap| gap.len() >= needed) {
            Some(gap) => once(gap.start..gap.start + needed).collect(),
            None => {
                let mut left = needed;
                let pieces = gaps.into_iter().map(|gap| {
                    let length = gap.len().min(left);
                    left -= length;
                    gap.start..gap.start + length
                });
                let pieces = pieces.collect();
                if left > 0 {
                    return None;
                }
                pieces
            }
        };
        found.retain(|pages| !pages.is_empty());
        found.iter().for_each(|pages| self.taken[pages.clone()].fill(true));
        let mut left = count;
        let places = found.into_iter().map(|pages| {
            let length = (pages.len() * PAGE).min(left);
            left -= length;
            let first = pages.start * PAGE;
            first as u32..(first + length) as u32
        });
        Some(places.collect())
    }

    /// Gives places back.
    pub fn give(&mut self, places: &[Range<u32>]) {
        for place in places {
            self.taken[place.start as usize / PAGE..(place.end as usize).div_ceil(PAGE)].fill(false);
        }
    }

    fn gaps(&self) -> Vec<Range<usize>> {
        let mut gaps: Vec<Range<usize>> = Vec::new();
        for (page, _) in self.taken.iter().enumerate().filter(|(_, taken)| !**taken) {
            match gaps.last_mut() {
                Some(gap) if gap.end == page => gap.end += 1,
                _ => gaps.push(page..page + 1),
            }
        }
        gaps
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn places_are_in_one_piece_where_they_can_and_never_shared() {
        let mut pages = Pages::new(10);
        let page = PAGE as u32;
        let one = |range: Range<u32>| Vec::from_iter(once(range));
        let [a, b, c] = [PAGE + 1, 3 * PAGE, 2 * PAGE - 5].map(|count| pages.take(count).unwrap());
        assert_eq!([&a, &b], [&one(0..page + 1), &one(2 * page..5 * page)]);
        assert_eq!(c, one(5 * page..7 * page - 5));
        pages.give(&b);
        assert_eq!(pages.take(3 * PAGE - 1).unwrap(), one(2 * page..5 * page - 1));
        pages.give(&one(2 * page..3 * page));
        // the gaps are pages 2 and 7 to 9
        assert_eq!(pages.take(4 * PAGE).unwrap(), [2 * page..3 * page, 7 * page..10 * page]);
        assert_eq!(pages.take(1), None);
        assert_eq!(pages.take(0), Some(vec![]));
        pages.give(&a);
        assert_eq!(pages.take(PAGE).unwrap(), one(0..page));
    }
}
