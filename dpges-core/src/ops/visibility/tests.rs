use burn::tensor::{Int, Tensor, TensorData};

use super::{Visibility, visibility};
use crate::ops::fixtures::{assert_near, constant, gradient_of};
use crate::ops::peel::Layers;
use crate::scene::Peeling;
use crate::scene::peeling::{ORDER, RAMP, STEP};
use crate::testing::device;
use crate::testing::golden::values;
use crate::testing::gradients::{check, leaf};
use crate::testing::random::Random;

const ALL: [Peeling; 3] = [Peeling::Continuous, Peeling::Nearest, Peeling::Literal];

/// A fragment: opacity, depth, margin.
type Fragment = [f64; 3];

/// Pixels side by side, each a stack of at most `layers` fragments, of surfels of their own.
#[derive(Clone)]
struct Stacks {
    layers: usize,
    of_pixels: Vec<Vec<Fragment>>,
}

impl Stacks {
    fn one(layers: usize, stack: &[Fragment]) -> Self {
        Self { layers, of_pixels: vec![stack.to_vec()] }
    }

    /// Every number of layers. Neighbours are near each other, and margins such that some of them mix and others do not; some
    /// have none. A third of the stacks end with cores, up to three of them.
    fn random(layers: usize, seed: u64) -> Self {
        let mut random = Random::new(seed);
        let stack = |at: usize, random: &mut Random| {
            let count = at % (layers + 1);
            let cores = if at.is_multiple_of(3) { 1 + random.below(3) } else { 0 };
            let mut depth = random.between(1.0, 3.0);
            let fragment = |k: usize, random: &mut Random| {
                depth += random.between(0.0, 0.05);
                let opacity = if k + cores >= count { 1.0 } else { random.between(0.05, 0.95) };
                let margin = if random.below(5) == 0 { 0.0 } else { random.between(0.1, 0.6) };
                [opacity, depth, margin]
            };
            let mut fragment = fragment;
            (0..count).map(|k| fragment(k, random)).collect()
        };
        Self { layers, of_pixels: (0..60).map(|at| stack(at, &mut random)).collect() }
    }

    /// [K, 1, P] of the fragments' entry `of`, `missing` where there is none.
    fn planes(&self, of: usize, missing: f64) -> Vec<f64> {
        let entry = |k: usize, stack: &Vec<Fragment>| stack.get(k).map_or(missing, |fragment| fragment[of]);
        (0..self.layers).flat_map(|k| self.of_pixels.iter().map(move |stack| entry(k, stack))).collect()
    }

    fn leaves(&self) -> [Tensor<3>; 2] {
        let shape = [self.layers, 1, self.of_pixels.len()];
        [self.planes(0, 0.0), self.planes(1, f64::INFINITY)].map(|planes| leaf(&planes, shape, &device()))
    }

    fn seen(&self, [alpha, depth]: &[Tensor<3>; 2], peeling: Peeling) -> Visibility {
        let pixels = self.of_pixels.len();
        let id =
            |k: usize, pixel: usize| if k < self.of_pixels[pixel].len() { (k * pixels + pixel) as i32 } else { -1 };
        let ids: Vec<i32> = (0..self.layers).flat_map(|k| (0..pixels).map(move |pixel| id(k, pixel))).collect();
        let ids = Tensor::<3, Int>::from_data(TensorData::new(ids, [self.layers, 1, pixels]), &device());
        let margins = constant(&self.planes(2, 0.0), [self.layers * pixels, 1]);
        visibility(&Layers { ids, alpha: alpha.clone(), depth: depth.clone() }, &margins, peeling).unwrap()
    }

    /// Weights, transmittances and limits by their formulas.
    fn plainly(&self, peeling: Peeling) -> [Vec<f64>; 3] {
        let pixels = self.of_pixels.len();
        let mut out = [self.layers, self.layers + 1, self.layers + 1].map(|planes| vec![0.0; planes * pixels]);
        for (pixel, stack) in self.of_pixels.iter().enumerate() {
            let found = plainly(stack, self.layers, peeling);
            for (planes, found) in out.iter_mut().zip(found) {
                found.into_iter().enumerate().for_each(|(k, value)| planes[k * pixels + pixel] = value);
            }
        }
        out
    }
}

fn plainly(stack: &[Fragment], layers: usize, peeling: Peeling) -> [Vec<f64>; 3] {
    let mut through = vec![1.0];
    for k in 0..layers {
        through.push(through[k] * (1.0 - stack.get(k).map_or(0.0, |fragment| fragment[0])));
    }
    let mut weights = vec![0.0; layers];
    let mut limits = vec![f64::INFINITY; layers + 1];
    let core = stack.iter().position(|fragment| fragment[0] >= 1.0);
    if peeling == Peeling::Continuous {
        for (i, a) in stack.iter().enumerate() {
            weights[i] = a[0];
            for (j, b) in stack.iter().enumerate().filter(|(j, _)| *j != i) {
                let reach = ORDER * a[2].min(b[2]);
                let share = if reach > 0.0 { 0.5 + (a[1] - b[1]) / (2.0 * reach) } else { f64::from(u8::from(i > j)) };
                weights[i] *= 1.0 - b[0] * share.clamp(0.0, 1.0);
            }
        }
        let total: f64 = weights.iter().sum();
        let margin = stack.iter().zip(&weights).map(|(fragment, weight)| fragment[2] * weight).sum::<f64>();
        let margin = if total > 0.0 { margin / total } else { 0.0 };
        weights
            .iter_mut()
            .for_each(|weight| *weight *= if total > 0.0 { (1.0 - through[layers]) / total } else { 0.0 });
        for (k, limit) in limits[..layers].iter_mut().enumerate() {
            let hidden_by = core.filter(|&core| k >= core).or((k < stack.len()).then_some(k));
            *limit = hidden_by.map_or(f64::INFINITY, |k| stack[k][1] + margin * (1.0 + 0.5 * RAMP));
        }
        limits[layers] = if margin > 0.0 { 1.0 / (RAMP * margin) } else { STEP };
    } else {
        (0..stack.len()).for_each(|k| weights[k] = stack[k][0] * through[k]);
        let shifted = |k: usize| stack[k][1] + stack[k][2];
        let closed = core.is_some() || stack.len() == layers;
        let mut reached = f64::NEG_INFINITY;
        for k in 0..layers {
            let end = match peeling {
                _ if k >= stack.len() => f64::INFINITY,
                Peeling::Literal if k + 1 == layers => f64::INFINITY,
                Peeling::Literal => stack[k][1],
                _ => shifted(k),
            };
            reached = reached.max(end);
            limits[k] = if closed { reached.min(shifted(stack.len() - 1)) } else { reached };
        }
        limits[layers] = STEP;
    }
    [weights, through, limits]
}

#[test]
fn outputs_are_the_formulas() {
    for (layers, peeling) in (1..=8).flat_map(|layers| ALL.map(|peeling| (layers, peeling))) {
        let mut stacks = Stacks::random(layers, layers as u64);
        if peeling != Peeling::Continuous {
            // nothing is peeled behind a core
            stacks.of_pixels.iter_mut().for_each(|stack| {
                let end = stack.iter().position(|fragment| fragment[0] >= 1.0).map_or(stack.len(), |core| core + 1);
                stack.truncate(end);
            });
        }
        let seen = stacks.seen(&stacks.leaves(), peeling);
        for (found, expected) in [seen.weights, seen.transmittance, seen.limits].iter().zip(stacks.plainly(peeling)) {
            assert_near(&values(found), &expected, 1e-12);
        }
    }
}

/// Compares the gradients of weighted sums of both outputs with central differences.
fn check_gradients(name: &str, stacks: &Stacks, peeling: Peeling) {
    let leaves = stacks.leaves();
    let shape = leaves[0].dims();
    let mut random = Random::new(5);
    let factors = [shape[0], shape[0] + 1].map(|planes| random.numbers(planes * shape[2], -1.0, 1.0));
    let loss = |leaves: &[Tensor<3>; 2], parts: [f64; 2]| {
        let seen = stacks.seen(leaves, peeling);
        let weighted = |of: Tensor<3>, factors: &[f64]| (of.clone() * constant(factors, of.dims())).sum();
        weighted(seen.weights, &factors[0]) * parts[0] + weighted(seen.transmittance, &factors[1]) * parts[1]
    };
    for parts in [[1.0, 0.0], [0.0, 1.0], [1.0, 1.0]] {
        let gradients = loss(&leaves, parts).backward();
        for (i, of) in ["alpha", "depth"].into_iter().enumerate() {
            // missing layers cannot be moved
            let missing = [0.0, f64::INFINITY][i];
            let all = stacks.planes(i, missing);
            let place: Vec<usize> = (0..all.len()).filter(|&at| all[at] != missing).collect();
            let pick = |values: &[f64]| -> Vec<f64> { place.iter().map(|&at| values[at]).collect() };
            let found = pick(&gradient_of(&leaves[i], &gradients));
            check(&format!("{name}, {parts:?}, {of}"), &pick(&all), &found, 1e-7, |moved| {
                let mut planes = all.clone();
                place.iter().zip(moved).for_each(|(&at, &value)| planes[at] = value);
                let mut leaves = stacks.leaves();
                leaves[i] = leaf(&planes, shape, &device());
                values(&loss(&leaves, parts))[0]
            });
        }
    }
}

#[test]
fn gradients_are_central_differences() {
    for layers in 1..=5 {
        for peeling in ALL {
            // a core's opacity is not moved: it has no gradient, and its neighbours would have another
            let mut stacks = Stacks::random(layers, 20 + layers as u64);
            stacks.of_pixels.iter_mut().flatten().for_each(|fragment| fragment[0] = fragment[0].min(0.999));
            check_gradients(&format!("{peeling:?}, K = {layers}"), &stacks, peeling);
        }
    }
}

/// At the ends of ramps, of width 0, with a margin of 0 and at one depth, one, two and three fragments.
#[test]
fn gradients_at_the_ends_of_ramps_are_those_of_one_side_and_finite() {
    let reach = ORDER * 0.4;
    for stack in [
        vec![[0.5, 2.0, 0.4], [0.5, 2.0 + reach, 0.4]],
        vec![[0.5, 2.0, 0.4], [1.0, 2.0 + reach, 0.4]],
        vec![[0.5, 2.0, 0.0], [0.7, 2.0, 0.4], [1.0, 2.0, 0.4]],
        vec![[1.0, 2.0, 0.0], [1.0, 2.0, 0.0]],
        vec![[1.0, 2.0, 1e-30], [1.0, 2.0, 1e-30], [1.0, 2.0, 1e-30]],
        vec![[0.3, 2.0, 0.4], [0.6, 2.0, 0.4], [0.9, 2.0, 0.4]],
    ] {
        let stacks = Stacks::one(4, &stack);
        let leaves = stacks.leaves();
        let seen = stacks.seen(&leaves, Peeling::Continuous);
        assert!(values(&seen.weights).iter().all(|weight| weight.is_finite()), "{stack:?}");
        let gradients = (seen.weights.clone().slice_dim(0, 0..1).sum() + seen.transmittance.sum()).backward();
        for leaf in &leaves {
            assert!(gradient_of(leaf, &gradients).iter().all(|gradient| gradient.is_finite()), "{stack:?}");
        }
        let hidden = 1.0 - stack.iter().map(|fragment| 1.0 - fragment[0]).product::<f64>();
        assert!((values(&seen.weights).iter().sum::<f64>() - hidden).abs() < 1e-12, "{stack:?}");
    }
    // inside of the ramps, where slopes exist, three fragments at one depth
    let near = |step: f64| vec![[0.3, 2.0, 0.4], [0.6, 2.0 + step, 0.4], [0.9, 2.0 + 2.0 * step, 0.4]];
    check_gradients("one depth", &Stacks::one(3, &near(1e-4)), Peeling::Continuous);
}

/// Colour of a stack of fragments in any order: that of fragment i is its opacity plus i.
fn colour(stack: &[Fragment]) -> f64 {
    let mut order: Vec<usize> = (0..stack.len()).collect();
    order.sort_by(|&a, &b| stack[a][1].total_cmp(&stack[b][1]));
    let sorted: Vec<Fragment> = order.iter().map(|&i| stack[i]).collect();
    let stacks = Stacks::one(stack.len(), &sorted);
    let weights = values(&stacks.seen(&stacks.leaves(), Peeling::Continuous).weights);
    order.iter().zip(weights).map(|(&i, weight)| (i as f64 + 1.0) * weight).sum()
}

/// Share of Gaussians at `depth` that a stack lets through.
fn let_through(stack: &[Fragment], depth: f64, peeling: Peeling) -> f64 {
    let stacks = Stacks::one(stack.len() + 1, stack);
    let seen = stacks.seen(&stacks.leaves(), peeling);
    let (limits, through) = (values(&seen.limits), values(&seen.transmittance));
    let slope = limits[stack.len() + 1];
    let mut before = 0.0;
    let mut seen = 0.0;
    for k in 0..=stack.len() {
        let share = ((limits[k] - depth) * slope).clamp(0.0, 1.0);
        seen += (share - before) * through[k];
        before = share;
    }
    seen
}

#[test]
fn nothing_jumps_where_two_or_three_fragments_change_places_or_one_fades() {
    const STEP: f64 = 1e-5;
    let largest_jump = |of: &dyn Fn(f64) -> f64| {
        let steps = (-4000..4000).map(|step| of(f64::from(step) * STEP));
        let values: Vec<f64> = steps.collect();
        values.windows(2).map(|pair| (pair[1] - pair[0]).abs()).fold(0.0, f64::max)
    };
    for opacities in [[1.0, 1.0, 0.5], [0.5, 0.8, 1.0], [1.0, 1.0, 1.0], [0.2, 1.0, 0.7]] {
        let stack = |offset: f64| {
            let depths = [2.0, 2.0 + offset, 2.005];
            let mut stack: Vec<Fragment> = (0..3).map(|i| [opacities[i], depths[i], 0.3 + 0.1 * i as f64]).collect();
            stack.sort_by(|a, b| a[1].total_cmp(&b[1]));
            stack
        };
        let unsorted = |offset: f64| {
            colour(&[[opacities[0], 2.0, 0.3], [opacities[1], 2.0 + offset, 0.4], [opacities[2], 2.005, 0.5]])
        };
        let jump = largest_jump(&unsorted);
        assert!(jump < 2e-3, "{opacities:?}: the colour jumps by {jump}");
        for depth in [2.29, 2.35, 2.42] {
            let jump = largest_jump(&|offset| let_through(&stack(offset), depth, Peeling::Continuous));
            assert!(jump < 2e-3, "{opacities:?}, {depth}: a Gaussian jumps by {jump}");
        }
    }
    // a Gaussian that passes a layer: it fades, where it was there or not
    let core = [[1.0, 2.0, 0.3]];
    let passing = |peeling: Peeling| largest_jump(&|offset| let_through(&core, 2.3 + offset, peeling));
    assert!(passing(Peeling::Continuous) < 2e-3 && passing(Peeling::Nearest) == 1.0);
    let shares = [2.26, 2.3, 2.34].map(|depth| let_through(&core, depth, Peeling::Continuous));
    assert_near(&shares, &[1.0, 0.5, 0.0], 1e-12);
}

#[test]
fn fragments_further_apart_than_their_margins_say_weigh_as_in_strict_order() {
    let mut stacks = Stacks::random(5, 3);
    for fragment in stacks.of_pixels.iter_mut().flatten() {
        fragment[2] = 0.0;
    }
    let [soft, strict] =
        [Peeling::Continuous, Peeling::Nearest].map(|peeling| stacks.seen(&stacks.leaves(), peeling).weights);
    assert_near(&values(&soft), &values(&strict), 1e-12);
}

#[test]
fn cores_at_one_depth_share_a_pixel_whatever_their_number_and_hide_all_behind_them() {
    for count in 1..=4 {
        let stacks = Stacks::one(4, &vec![[1.0, 2.0, 0.3]; count]);
        let seen = stacks.seen(&stacks.leaves(), Peeling::Continuous);
        let shares: Vec<f64> = (0..4).map(|k| if k < count { 1.0 / count as f64 } else { 0.0 }).collect();
        assert_near(&values(&seen.weights), &shares, 1e-12);
        assert_eq!(values(&seen.transmittance), [1.0, 0.0, 0.0, 0.0, 0.0]);
    }
}
