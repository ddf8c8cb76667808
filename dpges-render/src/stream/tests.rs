//! The cut and what is resident, on flights with loads that take their time or fail.

use std::collections::BTreeMap;

use dpges_core::scene::lod::Index;

use super::fixtures::{PRIMITIVES, Random, camera, forest};
use super::residency::Residency;

/// Cells that are held somewhere: loading, or loaded and not dropped.
struct World {
    residency: Residency,
    /// When each load ends, s.
    loads: BTreeMap<usize, f64>,
    held: Vec<bool>,
    now: f64,
}

impl World {
    fn new(index: Index, budget: usize) -> Self {
        let mut held = vec![false; index.cells.len()];
        index.roots().for_each(|root| held[root] = true);
        Self { residency: Residency::new(index, budget).unwrap(), loads: BTreeMap::new(), held, now: 0.0 }
    }

    /// One frame: loads take `seconds()`, and fail where `fails(cell)`. Returns the loads that were asked for.
    fn step(&mut self, eye: [f64; 3], mut seconds: impl FnMut() -> f64, mut fails: impl FnMut(usize) -> bool) -> usize {
        self.now += 1.0 / 60.0;
        let ended: Vec<usize> = self.loads.iter().filter(|&(_, &end)| end <= self.now).map(|(&cell, _)| cell).collect();
        for cell in ended {
            self.loads.remove(&cell);
            let failure = fails(cell).then(|| format!("cell {cell} is torn"));
            self.held[cell] = self.residency.loaded(cell, failure.as_ref(), self.now);
        }
        let orders = self.residency.update(&camera(eye), self.now);
        for &cell in &orders.drop {
            assert!(std::mem::take(&mut self.held[cell]), "cell {cell} is dropped and was not held");
        }
        for &cell in &orders.load {
            assert!(!self.held[cell] && self.loads.insert(cell, self.now + seconds()).is_none(), "{cell} comes twice");
        }
        self.check();
        orders.load.len()
    }

    /// Checks the invariants: the budget holds, and every way from a root to a leaf is covered once in all.
    fn check(&self) {
        let (residency, index) = (&self.residency, &self.residency.index);
        let of =
            |cells: &mut dyn Iterator<Item = usize>| cells.map(|cell| index.cells[cell].primitives()).sum::<usize>();
        let held = of(&mut (0..self.held.len()).filter(|&cell| self.held[cell]));
        let loading = of(&mut self.loads.keys().copied());
        assert_eq!(residency.resident, held + loading);
        assert!(residency.resident <= residency.budget, "{} of {}", residency.resident, residency.budget);
        let drawn: BTreeMap<usize, f32> =
            residency.drawn(self.now).into_iter().map(|(cell, fade)| (cell, fade.gaussians)).collect();
        assert!(drawn.keys().all(|&cell| self.held[cell]), "a cell is drawn that is not there");
        for leaf in index.level(0) {
            let mut sum = 0.0;
            let mut above = Some(leaf);
            while let Some(cell) = above {
                sum += drawn.get(&cell).copied().unwrap_or(0.0);
                above = index.cells[cell].parent;
            }
            assert!((sum - 1.0).abs() < 1e-6, "leaf {leaf} is drawn {sum} times");
        }
    }

    fn drawn(&self) -> Vec<usize> {
        self.residency.drawn(self.now).into_iter().map(|(cell, _)| cell).collect()
    }

    fn settle(&mut self, eye: [f64; 3]) {
        for _ in 0..5000 {
            self.step(eye, || 0.05, |_| false);
            if self.residency.complete {
                return;
            }
        }
        panic!("it never comes to rest");
    }
}

#[test]
fn the_budget_holds_on_any_flight_with_any_loads_and_failures() {
    for seed in 0..24 {
        let mut random = Random(seed);
        let (roots, levels) = (1 + (3.0 * random.next()) as usize, 2 + (3.0 * random.next()) as u32);
        let mut index = forest(roots, levels);
        for cell in &mut index.cells {
            cell.gaussians = (PRIMITIVES as f64 * (0.2 + 2.0 * random.next())) as usize;
        }
        let least = index.roots().map(|root| index.cells[root].primitives()).sum::<usize>();
        let all = index.cells.iter().map(|cell| cell.primitives()).sum::<usize>();
        let mut world = World::new(index, least + (all as f64 * random.next()) as usize);
        let failing = 0.3 * random.next();
        let mut eye = [0.0, 0.0, -3.0];
        let mut aim = eye;
        for frame in 0..1500 {
            if frame % 90 == 0 {
                aim = [6.0 * random.next() - 3.0, 2.0 * random.next() - 1.0, -0.5 - 12.0 * random.next()];
            }
            // flights, and a jump now and then
            let speed = if frame % 360 == 0 { 1.0 } else { 0.05 };
            eye = std::array::from_fn(|axis| eye[axis] + speed * (aim[axis] - eye[axis]));
            let mut chance = Random(seed ^ frame << 20);
            world.step(eye, || 0.3 * random.next(), |_| chance.next() < failing);
        }
        // whatever happened, it comes to the same cut as without a past
        world.now += 100.0;
        world.settle(eye);
        assert_eq!(world.residency.failures().0, 0);
    }
}

#[test]
fn a_budget_for_everything_ends_at_level_0() {
    let index = forest(2, 4);
    let finest: Vec<usize> = index.level(0).collect();
    let budget = (finest.len() + 1) * PRIMITIVES;
    let mut world = World::new(index, budget);
    // from so far away that no primitive covers a pixel
    world.settle([0.0, 0.0, -1e4]);
    assert_eq!(world.drawn(), finest);
    assert_eq!(world.residency.resident, finest.len() * PRIMITIVES);
}

#[test]
fn less_than_the_coarsest_level_is_refused() {
    let error = Residency::new(forest(2, 1), 199).unwrap_err().to_string();
    assert!(error.contains("199") && error.contains("at least 200"), "{error}");
    let mut world = World::new(forest(2, 1), 200);
    world.settle([0.0, 0.0, -3.0]);
    assert_eq!(world.drawn(), [0, 1]);
}

#[test]
fn what_is_near_is_fine_and_the_rest_coarse() {
    let mut world = World::new(forest(2, 4), 1500);
    world.settle([1.0, 0.0, -1.5]);
    let levels = |world: &World, root: usize| {
        let of_root = |mut cell: usize| {
            while let Some(parent) = world.residency.index.cells[cell].parent {
                cell = parent;
            }
            cell == root
        };
        let cells = world.drawn().into_iter().filter(|&cell| of_root(cell));
        cells.map(|cell| world.residency.index.cells[cell].level).min().unwrap()
    };
    assert!(levels(&world, 1) < levels(&world, 0));
    world.settle([-1.0, 0.0, -1.5]);
    assert!(levels(&world, 0) < levels(&world, 1));
}

#[test]
fn a_parent_stays_while_a_child_fails_and_goes_once_it_comes() {
    let mut world = World::new(forest(1, 1), 10 * PRIMITIVES);
    let eye = [0.0, 0.0, -2.0];
    let mut asked = 0;
    for _ in 0..600 {
        asked += world.step(eye, || 0.02, |cell| cell == 2);
        assert_eq!(world.drawn(), [0]);
    }
    // after 0, 2 and 6 s, and the sibling with it
    assert_eq!(asked, 6);
    let (count, reason) = world.residency.failures();
    assert_eq!((count, reason), (1, Some("cell 2 is torn")));
    assert!(world.residency.next_retry().is_some_and(|at| at > world.now));
    world.now += 60.0;
    world.settle(eye);
    assert_eq!(world.drawn(), [1, 2]);
    assert_eq!(world.residency.failures(), (0, None));
}

#[test]
fn children_stay_while_their_parent_cannot_be_loaded() {
    let mut world = World::new(forest(2, 1), 4 * PRIMITIVES);
    let [left, right] = [[-1.0, 0.0, -1.2], [1.0, 0.0, -1.2]];
    world.settle(left);
    assert_eq!(world.drawn(), [1, 2, 3]);
    for _ in 0..300 {
        world.step(right, || 0.02, |cell| cell == 0);
        assert_eq!(world.drawn(), [1, 2, 3], "there is no room to refine the other");
    }
    world.now += 60.0;
    world.settle(right);
    assert_eq!(world.drawn(), [0, 4, 5]);
}

#[test]
fn a_camera_that_trembles_changes_nothing() {
    let mut random = Random(7);
    for _ in 0..20 {
        let eye = [4.0 * random.next() - 2.0, random.next() - 0.5, -1.5 - 3.0 * random.next()];
        let mut world = World::new(forest(2, 4), 600 + (2500.0 * random.next()) as usize);
        let mut loads = [0, 0];
        for frame in 0..800 {
            let trembling = eye.map(|x| x + 0.06 * (random.next() - 0.5));
            loads[frame / 400] += world.step(trembling, || 0.0, |_| false);
        }
        assert!(loads[0] > 0 && loads[1] == 0, "{eye:?}: {loads:?}");
    }
}

#[test]
fn fades_add_up_and_surfels_leave_no_hole() {
    let mut world = World::new(forest(1, 1), 10 * PRIMITIVES);
    let mut shares = Vec::new();
    for _ in 0..60 {
        world.step([0.0, 0.0, -2.0], || 0.0, |_| false);
        let drawn = world.residency.drawn(world.now);
        if drawn.len() == 3 {
            let (parent, child) = (drawn[0].1, drawn[1].1);
            assert!(parent.surfels == 1.0 || child.surfels == 1.0);
            shares.push(child.gaussians);
        }
    }
    assert!(shares.len() > 10 && shares.is_sorted(), "{shares:?}");
    assert_eq!(world.drawn(), [1, 2]);
}
