//! The cells that are loaded, drawn and faded, and what changes next. Knows neither files nor devices.
//!
//! The cells that are drawn are a cut of the forest. It changes by one parent and its children at a time: once all that come
//! are loaded, they fade in while the others fade out. Until then, and if one cannot be loaded, the cut stays.
//!
//! A change holds both its parent and the children, so that a cut leaves as much of the budget free as the largest parent
//! needs: any change can then be made.

use std::collections::BTreeMap;

use dpges_core::camera::Camera;
use dpges_core::scene::lod::Index;

use super::StreamError;
use super::cut::{children_primitives, refinements};

/// Time that a parent and its children fade for, s.
pub(super) const FADE_S: f64 = 0.4;
const LOADS: usize = 6;
/// Time until a cell that could not be loaded is asked for again, s: doubles with each failure.
const RETRY_S: [f64; 2] = [2.0, 60.0];

#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Fade {
    /// Factor of the weights of Gaussians: those of a parent and its children add up to 1.
    pub gaussians: f32,
    /// Factor of the sizes of surfels: a parent shrinks once its children have grown, so that no hole opens.
    pub surfels: f32,
}

impl Fade {
    const WHOLE: Self = Self { gaussians: 1.0, surfels: 1.0 };

    fn of(share: f64) -> Self {
        Self { gaussians: share as f32, surfels: (2.0 * share).min(1.0) as f32 }
    }
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum State {
    Absent,
    Loading,
    /// Asked for, and dropped when it comes.
    Unwanted,
    /// Loaded, not drawn yet.
    Ready,
    Drawn,
}

/// A parent and its children take each other's place.
#[derive(Clone, Copy, Debug)]
struct Change {
    parent: usize,
    refines: bool,
    /// When the fade began, s.
    begun: Option<f64>,
}

#[derive(Debug)]
struct Failure {
    retry_at: f64,
    wait_s: f64,
    reason: String,
}

#[derive(Debug, Default, PartialEq)]
pub(super) struct Orders {
    /// Cells to load, the most urgent first.
    pub load: Vec<usize>,
    pub drop: Vec<usize>,
}

#[derive(Debug)]
pub(super) struct Residency {
    pub index: Index,
    pub budget: usize,
    /// Primitives of the largest cell with children.
    reserve: usize,
    /// Whether the budget has room for all of level 0.
    holds_everything: bool,
    states: Vec<State>,
    changes: Vec<Change>,
    failures: BTreeMap<usize, Failure>,
    /// Primitives of all cells that are not absent: never more than the budget.
    pub resident: usize,
    pub loading: usize,
    /// Whether nothing changes any more while the camera stays and nothing is tried again.
    pub complete: bool,
}

impl Residency {
    /// Nothing but the roots, which are loaded.
    pub fn new(index: Index, budget: usize) -> Result<Self, StreamError> {
        let mut states = vec![State::Absent; index.cells.len()];
        index.roots().for_each(|root| states[root] = State::Drawn);
        let resident = index.roots().map(|root| index.cells[root].primitives()).sum();
        if resident > budget {
            return Err(StreamError::Budget { budget, least: resident });
        }
        let parents = index.cells.iter().filter(|cell| !cell.children.is_empty());
        let reserve = parents.map(|cell| cell.primitives()).max().unwrap_or(0);
        let finest = index.level(0).map(|cell| index.cells[cell].primitives()).sum::<usize>();
        Ok(Self {
            index,
            budget,
            reserve,
            holds_everything: finest + reserve <= budget,
            states,
            changes: Vec::new(),
            failures: BTreeMap::new(),
            resident,
            loading: 0,
            complete: false,
        })
    }

    /// Cells that could not be loaded and are missed, and why the first could not.
    pub fn failures(&self) -> (usize, Option<&str>) {
        (self.failures.len(), self.failures.values().next().map(|failure| failure.reason.as_str()))
    }

    pub fn is_fading(&self) -> bool {
        self.changes.iter().any(|change| change.begun.is_some())
    }

    /// The next time at which a cell is tried again, s.
    pub fn next_retry(&self) -> Option<f64> {
        self.failures.values().map(|failure| failure.retry_at).min_by(f64::total_cmp)
    }

    /// The cells that are drawn at `now`, s.
    pub fn drawn(&self, now: f64) -> Vec<(usize, Fade)> {
        let mut fades: BTreeMap<usize, Fade> = BTreeMap::new();
        for change in &self.changes {
            let Some(begun) = change.begun else { continue };
            let share = ((now - begun) / FADE_S).clamp(0.0, 1.0);
            let finer = if change.refines { share } else { 1.0 - share };
            fades.insert(change.parent, Fade::of(1.0 - finer));
            fades.extend(self.index.cells[change.parent].children.iter().map(|&child| (child, Fade::of(finer))));
        }
        let all = self.states.iter().enumerate();
        let drawn = all.filter_map(|(cell, state)| match (fades.get(&cell), state) {
            (Some(&fade), _) => Some((cell, fade)),
            (None, State::Drawn) => Some((cell, Fade::WHOLE)),
            (None, _) => None,
        });
        drawn.filter(|(_, fade)| fade.gaussians > 0.0).collect()
    }

    /// Takes the end of a load, which may have failed. Returns whether the cell is wanted: else it must not be kept.
    pub fn loaded(&mut self, cell: usize, failure: Option<&String>, now: f64) -> bool {
        self.loading -= 1;
        match failure {
            None => {
                self.failures.remove(&cell);
                if self.states[cell] == State::Loading {
                    self.states[cell] = State::Ready;
                }
            }
            Some(reason) => {
                let before = self.failures.get(&cell).map_or(0.0, |failure| failure.wait_s);
                let wait_s = (2.0 * before).clamp(RETRY_S[0], RETRY_S[1]);
                self.failures.insert(cell, Failure { retry_at: now + wait_s, wait_s, reason: reason.clone() });
            }
        }
        if self.states[cell] != State::Ready {
            self.leave(cell);
        }
        self.states[cell] == State::Ready
    }

    /// Goes on at the time `now`, s, for what `camera` sees.
    pub fn update(&mut self, camera: &Camera, now: f64) -> Orders {
        let mut orders = Orders::default();
        self.finish(now, &mut orders);
        let blocked = |cell: usize| {
            let children = &self.index.cells[cell].children;
            self.states[cell] == State::Drawn && children.iter().any(|&child| self.must_wait(child, now))
        };
        let room = self.budget.saturating_sub(self.reserve);
        let refined = |cell| self.is_refined(cell);
        let wanted = refinements(&self.index, camera, room, self.holds_everything, refined, blocked);
        let mut is_wanted = vec![false; self.states.len()];
        wanted.iter().for_each(|&cell| is_wanted[cell] = true);
        self.cancel(&is_wanted, now, &mut orders);
        let coarsened = self.coarsen(&is_wanted, now, &mut orders);
        let refined = self.refine(&wanted, &mut orders);
        self.begin(now);
        self.failures.retain(|&cell, failure| failure.retry_at > now || self.states[cell] == State::Loading);
        self.complete = self.changes.is_empty() && coarsened && refined && self.loading == 0;
        orders
    }

    fn change_of(&self, parent: usize) -> Option<&Change> {
        self.changes.iter().find(|change| change.parent == parent)
    }

    /// Whether the cut lies below this cell, or is on its way there.
    fn is_refined(&self, cell: usize) -> bool {
        if let Some(change) = self.change_of(cell) {
            return change.refines;
        }
        let mut above = Some(cell);
        while let Some(cell) = above {
            if self.states[cell] == State::Drawn {
                return false;
            }
            above = self.index.cells[cell].parent;
        }
        true
    }

    fn must_wait(&self, cell: usize, now: f64) -> bool {
        self.failures.get(&cell).is_some_and(|failure| failure.retry_at > now)
    }

    fn leave(&mut self, cell: usize) {
        self.states[cell] = State::Absent;
        self.resident -= self.index.cells[cell].primitives();
    }

    /// Asks for a cell; one that is on its way already is not asked for again.
    fn come(&mut self, cell: usize, orders: &mut Orders) {
        match self.states[cell] {
            State::Absent => {
                self.resident += self.index.cells[cell].primitives();
                self.loading += 1;
                self.states[cell] = State::Loading;
                orders.load.push(cell);
            }
            State::Unwanted => self.states[cell] = State::Loading,
            State::Loading | State::Ready | State::Drawn => {}
        }
    }

    fn incoming(&self, change: &Change) -> Vec<usize> {
        if change.refines { self.index.cells[change.parent].children.clone() } else { vec![change.parent] }
    }

    fn outgoing(&self, change: &Change) -> Vec<usize> {
        self.incoming(&Change { refines: !change.refines, ..*change })
    }

    fn finish(&mut self, now: f64, orders: &mut Orders) {
        let is_over = |change: &Change| change.begun.is_some_and(|begun| now - begun >= FADE_S);
        let (over, rest) = std::mem::take(&mut self.changes).into_iter().partition::<Vec<Change>, _>(is_over);
        self.changes = rest;
        for change in over {
            for cell in self.outgoing(&change) {
                self.leave(cell);
                orders.drop.push(cell);
            }
            self.incoming(&change).into_iter().for_each(|cell| self.states[cell] = State::Drawn);
        }
    }

    /// Gives up changes that have not begun to fade and are not wanted, or one of whose cells cannot be loaded.
    fn cancel(&mut self, is_wanted: &[bool], now: f64, orders: &mut Orders) {
        let is_cancelled = |change: &Change| {
            let fails = || self.incoming(change).iter().any(|&cell| self.must_wait(cell, now));
            change.begun.is_none() && (is_wanted[change.parent] != change.refines || fails())
        };
        let cancelled: Vec<Change> = self.changes.iter().copied().filter(is_cancelled).collect();
        self.changes.retain(|change| cancelled.iter().all(|other| other.parent != change.parent));
        for cell in cancelled.iter().flat_map(|change| self.incoming(change)).collect::<Vec<_>>() {
            match self.states[cell] {
                State::Ready => {
                    self.leave(cell);
                    orders.drop.push(cell);
                }
                State::Loading => self.states[cell] = State::Unwanted,
                State::Absent | State::Unwanted | State::Drawn => {}
            }
        }
    }

    /// Starts to replace children by parents that need not be refined. Returns whether there was none.
    fn coarsen(&mut self, is_wanted: &[bool], now: f64, orders: &mut Orders) -> bool {
        let mut complete = true;
        // the finest last, as in the index: they make room first
        for parent in (0..self.states.len()).rev() {
            let children = &self.index.cells[parent].children;
            let is_cut = !children.is_empty() && children.iter().all(|&child| self.states[child] == State::Drawn);
            let is_changing = children.iter().any(|&child| self.change_of(child).is_some());
            if is_wanted[parent] || !is_cut || is_changing || self.change_of(parent).is_some() {
                continue;
            }
            if self.must_wait(parent, now) {
                continue;
            }
            complete = false;
            if self.loading < LOADS && self.resident + self.missing(&[parent]) <= self.budget {
                self.changes.push(Change { parent, refines: false, begun: None });
                self.come(parent, orders);
            }
        }
        complete
    }

    /// Starts to replace parents by their children. Returns whether there was none to replace.
    fn refine(&mut self, wanted: &[usize], orders: &mut Orders) -> bool {
        let mut complete = true;
        for &parent in wanted {
            let above = self.index.cells[parent].parent;
            let is_changing = |cell| self.change_of(cell).is_some();
            if self.states[parent] != State::Drawn || is_changing(parent) || above.is_some_and(is_changing) {
                continue;
            }
            complete = false;
            let children = self.index.cells[parent].children.clone();
            let later = self.resident_later() + children_primitives(&self.index, parent)
                - self.index.cells[parent].primitives();
            let fits = self.resident + self.missing(&children) <= self.budget && later + self.reserve <= self.budget;
            if self.loading < LOADS && fits {
                self.changes.push(Change { parent, refines: true, begun: None });
                children.into_iter().for_each(|child| self.come(child, orders));
            }
        }
        complete
    }

    fn missing(&self, cells: &[usize]) -> usize {
        let absent = cells.iter().filter(|&&cell| self.states[cell] == State::Absent);
        absent.map(|&cell| self.index.cells[cell].primitives()).sum()
    }

    fn resident_later(&self) -> usize {
        let leave = self.changes.iter().flat_map(|change| self.outgoing(change));
        let unwanted = (0..self.states.len()).filter(|&cell| self.states[cell] == State::Unwanted);
        self.resident - leave.chain(unwanted).map(|cell| self.index.cells[cell].primitives()).sum::<usize>()
    }

    /// Begins the fades of changes whose cells are all there.
    fn begin(&mut self, now: f64) {
        let is_ready = |change: &Change| {
            change.begun.is_none() && self.incoming(change).iter().all(|&cell| self.states[cell] == State::Ready)
        };
        let ready: Vec<bool> = self.changes.iter().map(is_ready).collect();
        for (change, ready) in self.changes.iter_mut().zip(ready) {
            if ready {
                change.begun = Some(now);
            }
        }
    }
}
