//! Places in the buffers of a fixed size that cells share.

use std::ops::Range;

use crate::scene::{PAGE, joined};

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
        let free: Vec<usize> = (0..self.taken.len()).filter(|&page| !self.taken[page]).collect();
        let is_whole = |pages: &[usize]| pages[pages.len() - 1] - pages[0] + 1 == pages.len();
        let from = free.windows(needed.max(1)).position(is_whole).unwrap_or(0);
        let pages = free.get(from..from + needed)?;
        pages.iter().for_each(|&page| self.taken[page] = true);
        let range = |(index, page): (usize, &usize)| {
            let (first, length) = (page * PAGE, PAGE.min(count - index * PAGE));
            first as u32..(first + length) as u32
        };
        Some(joined(pages.iter().enumerate().map(range)))
    }

    /// Gives places back.
    pub fn give(&mut self, places: &[Range<u32>]) {
        for place in places {
            self.taken[place.start as usize / PAGE..(place.end as usize).div_ceil(PAGE)].fill(false);
        }
    }
}

#[cfg(test)]
mod tests {
    use std::iter::once;

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
