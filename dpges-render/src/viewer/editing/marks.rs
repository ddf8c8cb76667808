//! Marks of the primitives of a scene, selected or deleted, with undo and redo.

use std::collections::VecDeque;

/// Rows of all changes that can be undone, at most: 200 MB.
const MOST_ROWS: usize = 50_000_000;

/// How a region changes the selection.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Combine {
    Replace,
    Add,
    Subtract,
}

/// Rows whose marks are turned over: done twice, everything is as it was.
#[derive(Debug, Default)]
struct Change {
    selected: Vec<u32>,
    deleted: Vec<u32>,
}

impl Change {
    fn deletes(&self) -> bool {
        !self.deleted.is_empty()
    }

    fn rows(&self) -> usize {
        self.selected.len() + self.deleted.len()
    }
}

#[derive(Debug)]
pub struct Marks {
    selected: Vec<bool>,
    deleted: Vec<bool>,
    done: VecDeque<Change>,
    undone: Vec<Change>,
    /// Rows of all changes, at most: the oldest changes are forgotten.
    most_rows: usize,
    /// Whether the last change is a stroke that goes on.
    grows: bool,
}

impl Marks {
    /// Nothing is selected, and nothing deleted of `count` primitives.
    pub fn new(count: usize) -> Self {
        let (selected, deleted) = (vec![false; count], vec![false; count]);
        let (done, undone) = (VecDeque::new(), Vec::new());
        Self { selected, deleted, done, undone, most_rows: MOST_ROWS, grows: false }
    }

    pub fn selected(&self) -> &[bool] {
        &self.selected
    }

    pub fn deleted(&self) -> &[bool] {
        &self.deleted
    }

    pub fn selected_count(&self) -> usize {
        self.selected.iter().filter(|selected| **selected).count()
    }

    pub fn can_undo(&self) -> bool {
        !self.done.is_empty()
    }

    pub fn can_redo(&self) -> bool {
        !self.undone.is_empty()
    }

    /// The next selection is a change of its own.
    pub fn end_stroke(&mut self) {
        self.grows = false;
    }

    /// Selects `rows`, as one change with those before up to [`end_stroke`](Self::end_stroke). Rows that are deleted are left out.
    pub fn select(&mut self, rows: impl IntoIterator<Item = usize>, combine: Combine) {
        let mut wanted = match combine {
            Combine::Replace => vec![false; self.selected.len()],
            Combine::Add | Combine::Subtract => self.selected.clone(),
        };
        for row in rows {
            wanted[row] = combine != Combine::Subtract && !self.deleted[row];
        }
        let selected = differing(&self.selected, &wanted);
        let grows = std::mem::replace(&mut self.grows, true);
        self.change(Change { selected, deleted: Vec::new() }, grows);
    }

    pub fn select_all(&mut self) {
        self.select_alone(0..self.selected.len());
    }

    pub fn select_nothing(&mut self) {
        self.select_alone([]);
    }

    /// Selects what is not selected, and nothing else.
    pub fn invert(&mut self) {
        let rows: Vec<usize> = (0..self.selected.len()).filter(|&row| !self.selected[row]).collect();
        self.select_alone(rows);
    }

    fn select_alone(&mut self, rows: impl IntoIterator<Item = usize>) {
        self.end_stroke();
        self.select(rows, Combine::Replace);
        self.end_stroke();
    }

    /// Deletes what is selected. Returns whether other rows are deleted than before, as all that follow.
    pub fn delete(&mut self) -> bool {
        let rows = differing(&self.selected, &vec![false; self.selected.len()]);
        let redraws = !rows.is_empty();
        self.end_stroke();
        self.change(Change { selected: rows.clone(), deleted: rows }, false);
        redraws
    }

    /// Takes the last change back.
    pub fn undo(&mut self) -> bool {
        let Some(change) = self.done.pop_back() else { return false };
        self.end_stroke();
        self.turn(&change);
        self.undone.push(change);
        self.undone.last().is_some_and(Change::deletes)
    }

    /// Does again what was undone last.
    pub fn redo(&mut self) -> bool {
        let Some(change) = self.undone.pop() else { return false };
        self.end_stroke();
        self.turn(&change);
        self.done.push_back(change);
        self.done.back().is_some_and(Change::deletes)
    }

    fn change(&mut self, change: Change, grows: bool) {
        if change.rows() == 0 {
            // there may be no change yet that could grow
            self.grows = grows;
            return;
        }
        self.turn(&change);
        self.undone.clear();
        match self.done.back_mut().filter(|_| grows) {
            Some(last) => last.selected.extend(change.selected),
            None => self.done.push_back(change),
        }
        let mut rows: usize = self.done.iter().map(Change::rows).sum();
        while rows > self.most_rows && self.done.len() > 1 {
            rows -= self.done.pop_front().map_or(0, |oldest| oldest.rows());
        }
    }

    fn turn(&mut self, change: &Change) {
        for (marks, rows) in [(&mut self.selected, &change.selected), (&mut self.deleted, &change.deleted)] {
            rows.iter().for_each(|&row| marks[row as usize] ^= true);
        }
    }
}

/// The rows where two marks differ.
fn differing(a: &[bool], b: &[bool]) -> Vec<u32> {
    let rows = a.iter().zip(b).enumerate();
    rows.filter(|(_, (a, b))| a != b).map(|(row, _)| row as u32).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn rows(marks: &[bool]) -> Vec<usize> {
        (0..marks.len()).filter(|&row| marks[row]).collect()
    }

    fn select(marks: &mut Marks, rows: &[usize], combine: Combine) {
        marks.select(rows.iter().copied(), combine);
        marks.end_stroke();
    }

    #[test]
    fn selections_are_replaced_added_to_and_subtracted_from() {
        let mut marks = Marks::new(6);
        for (now, combine, expected) in [
            (&[1, 2][..], Combine::Replace, &[1, 2][..]),
            (&[2, 4], Combine::Add, &[1, 2, 4]),
            (&[2, 3], Combine::Subtract, &[1, 4]),
            (&[5], Combine::Replace, &[5]),
        ] {
            select(&mut marks, now, combine);
            assert_eq!(rows(marks.selected()), expected, "{combine:?}");
        }
        marks.invert();
        assert_eq!(rows(marks.selected()), [0, 1, 2, 3, 4]);
        marks.select_nothing();
        marks.select_all();
        assert_eq!(rows(marks.selected()), [0, 1, 2, 3, 4, 5]);
    }

    #[test]
    fn deleted_rows_are_selected_no_more_and_come_back_selected() {
        let mut marks = Marks::new(4);
        select(&mut marks, &[1, 2], Combine::Replace);
        marks.delete();
        assert_eq!((rows(marks.selected()), rows(marks.deleted())), (vec![], vec![1, 2]));
        select(&mut marks, &[0, 1], Combine::Add);
        assert_eq!(rows(marks.selected()), [0]);
        marks.invert();
        assert_eq!(rows(marks.selected()), [3]);
        assert!(!marks.undo() && !marks.undo(), "selections redraw nothing");
        assert!(marks.undo());
        assert_eq!((rows(marks.selected()), rows(marks.deleted())), (vec![1, 2], vec![]));
        assert!(marks.redo() && !marks.redo());
        assert_eq!((rows(marks.selected()), rows(marks.deleted())), (vec![0], vec![1, 2]));
    }

    #[test]
    fn a_stroke_is_one_change_and_what_changes_nothing_is_none() {
        let mut marks = Marks::new(6);
        select(&mut marks, &[5], Combine::Replace);
        marks.select([], Combine::Add);
        marks.select([0, 1], Combine::Add);
        marks.select([1, 2], Combine::Add);
        marks.end_stroke();
        assert_eq!(rows(marks.selected()), [0, 1, 2, 5]);
        marks.undo();
        assert_eq!(rows(marks.selected()), [5], "the change before does not grow");
        marks.redo();
        select(&mut marks, &[], Combine::Add);
        marks.undo();
        marks.undo();
        assert!(rows(marks.selected()).is_empty() && !marks.can_undo() && marks.can_redo());
        select(&mut marks, &[3], Combine::Add);
        assert!(!marks.can_redo(), "another change takes the place of what was undone");
        assert!(marks.delete() && !marks.delete());
        marks.undo();
        assert_eq!((rows(marks.selected()), rows(marks.deleted())), (vec![3], vec![]), "nothing was deleted twice");
    }
    #[test]
    fn the_oldest_changes_are_forgotten() {
        let mut marks = Marks { most_rows: 5, ..Marks::new(4) };
        for row in 0..4 {
            select(&mut marks, &[row], Combine::Replace);
        }
        // 1, 2, 2 and 2 rows
        marks.undo();
        marks.undo();
        assert_eq!((rows(marks.selected()), marks.can_undo()), (vec![1], false));
    }
}
