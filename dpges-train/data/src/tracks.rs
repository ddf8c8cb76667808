//! Which views saw each point of a cloud.

/// For each point of a cloud, ascending numbers of the views that saw it; none where that is unknown. All of them lie in one list,
/// since captures have tens of millions of points.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Tracks {
    /// [N] of each point the end of its views.
    ends: Vec<usize>,
    views: Vec<u32>,
}

impl Tracks {
    /// No point yet, with room for so many `points` and `observations`.
    pub fn with_room(points: usize, observations: usize) -> Self {
        Self { ends: Vec::with_capacity(points), views: Vec::with_capacity(observations) }
    }

    /// Number of points.
    pub fn len(&self) -> usize {
        self.ends.len()
    }

    pub fn is_empty(&self) -> bool {
        self.ends.is_empty()
    }

    /// Whether no point has a view.
    pub fn are_unknown(&self) -> bool {
        self.views.is_empty()
    }

    /// The one of `count` views that nearly all points name, while nearly no other view sees any: the tracks are not real.
    pub fn placeholder(&self, count: usize) -> Option<usize> {
        let mut points = vec![0usize; count];
        self.views.iter().for_each(|&view| points[view as usize] += 1);
        let others = points.iter().filter(|&&points| points > 0).count().checked_sub(1)?;
        let (view, &most) = points.iter().enumerate().max_by_key(|(_, points)| **points)?;
        (count > 2 && 10 * most >= 9 * self.len().max(self.views.len()) && 10 * others <= count).then_some(view)
    }

    /// Adds a point that `views` saw, in any order, some perhaps twice.
    pub fn push(&mut self, views: impl IntoIterator<Item = u32>) {
        let start = self.views.len();
        self.views.extend(views);
        let own = &mut self.views[start..];
        own.sort_unstable();
        let mut kept = 0;
        for at in 0..own.len() {
            if kept == 0 || own[kept - 1] != own[at] {
                own[kept] = own[at];
                kept += 1;
            }
        }
        self.views.truncate(start + kept);
        self.ends.push(self.views.len());
    }

    /// The views that saw the point with index `point`; none if it is not one of these.
    pub fn of(&self, point: usize) -> &[u32] {
        let Some(&end) = self.ends.get(point) else { return &[] };
        let start = point.checked_sub(1).map_or(0, |before| self.ends[before]);
        &self.views[start..end]
    }

    /// The views of every point.
    pub fn iter(&self) -> impl Iterator<Item = &[u32]> {
        (0..self.len()).map(|point| self.of(point))
    }

    /// For each of `count` views, the points that it saw, ascending.
    pub fn by_view(&self, count: usize) -> Vec<Vec<u32>> {
        let mut points = vec![Vec::new(); count];
        for (point, views) in (0..).zip(self.iter()) {
            views.iter().for_each(|&view| points[view as usize].push(point));
        }
        points
    }

    /// Leaves out the views that are not kept, by the old numbers of all, and numbers the others anew from 0.
    pub fn keep_views(&mut self, is_kept: impl IntoIterator<Item = bool>) {
        let mut next = 0..;
        let new: Vec<Option<u32>> = is_kept.into_iter().map(|is_kept| is_kept.then(|| next.next()).flatten()).collect();
        let (mut at, mut kept) = (0, 0);
        for end in &mut self.ends {
            while at < *end {
                if let Some(view) = new[self.views[at] as usize] {
                    self.views[kept] = view;
                    kept += 1;
                }
                at += 1;
            }
            *end = kept;
        }
        self.views.truncate(kept);
    }
}

impl<V: IntoIterator<Item = u32>> FromIterator<V> for Tracks {
    fn from_iter<I: IntoIterator<Item = V>>(points: I) -> Self {
        let mut tracks = Self::default();
        points.into_iter().for_each(|views| tracks.push(views));
        tracks
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn views_are_ascending_and_there_once() {
        let tracks: Tracks = [vec![3, 1, 3, 0], vec![], vec![2], vec![2, 2]].into_iter().collect();
        assert_eq!(tracks.iter().collect::<Vec<_>>(), [&[0, 1, 3][..], &[], &[2], &[2]]);
        assert_eq!((tracks.of(2), tracks.of(9), tracks.len()), (&[2][..], &[][..], 4));
        assert!(!tracks.are_unknown() && Tracks::from_iter([vec![], vec![]]).are_unknown());
    }
}
