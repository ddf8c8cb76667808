//! Pixels that blend their nearest fragments in order, and mix the others behind them (HTGS).

use pulp::Simd;

use super::projected::{Drawn, Projected};
use super::walk::{Said, Tile};
use super::{ALPHA_PLANE, DEPTH_PLANE, DISTORTION_PLANE, MEDIAN, NORMAL_PLANE};
use crate::backend::real::Real;
use crate::backend::vectors::MOST;
use crate::ops::blend::{CORE, CORE_ALPHA};
use crate::scene::Transparency;
use crate::tiles::{TILE, TILE_PIXELS, for_each_lanes};

/// Numbers of a fragment that are mixed by weight: colour, z, normal, m and m².
const PAYLOAD: usize = 9;
const Z: usize = 3;
const NORMAL: usize = 4;
const M: usize = 7;
/// Smallest 1 − α that is divided by.
const LEAST_THROUGH: f64 = 1e-8;

/// A fragment.
#[derive(Clone, Copy)]
struct Fragment<T> {
    /// In the list of the tile.
    position: u32,
    /// α before it is capped.
    weight: T,
    depth: T,
}

/// The fragments of a pixel.
#[derive(Clone, Copy)]
struct Pixel<T> {
    /// Nearest first; what comes first in the list if equal.
    core: [Fragment<T>; CORE],
    len: usize,
    /// 1 / z of the first fragment in the list, 0 before it: m is counted from there.
    reference: T,
    /// Sums over the others: Σ α, Π (1 − α), Σ α payload.
    alpha: T,
    through: T,
    payload: [T; PAYLOAD],
}

/// The weights of a pixel.
struct Weights<T> {
    /// αT of the core.
    covered: [T; CORE],
    /// T behind the core, 0 if the pixel has ended there.
    through: T,
    /// Weight of a fragment of the tail over its α.
    share: T,
    /// Σ w
    total: T,
    /// Σ w payload
    sums: [T; PAYLOAD],
}

/// The blending of a tile.
pub struct HybridTile<'a, T, F, S> {
    simd: S,
    tile: &'a Tile<'a, T, F>,
    transparency: Transparency,
}

fn weighted<T: Real>(coefficients: &[T; PAYLOAD], payload: &[T; PAYLOAD]) -> T {
    coefficients.iter().zip(payload).map(|(&coefficient, &value)| coefficient * value).sum()
}

impl<'a, T: Real, F: Projected<T>, S: Simd> HybridTile<'a, T, F, S> {
    pub fn new(simd: S, tile: &'a Tile<'a, T, F>, transparency: Transparency) -> Self {
        Self { simd, tile, transparency }
    }

    /// Calls `visit(pixel, fragment)` for every fragment of an entry of the list.
    #[inline(always)]
    fn for_each_fragment(&self, position: usize, mut visit: impl FnMut(usize, Fragment<T>)) {
        let (sorted, origin) = (self.tile.sorted, self.tile.origin());
        let grid = sorted.grid;
        let id = self.tile.list()[position] as usize;
        let footprint = &sorted.footprints[id];
        for_each_lanes(
            self.simd,
            footprint.anchor(),
            &sorted.rects[id],
            origin,
            #[inline(always)]
            |start, dx, dy| {
                let Some(Drawn { drawn, weight, depth }) = footprint.draw(dx, dy) else { return };
                let (mut weights, mut depths) = ([T::zero(); MOST], [T::zero(); MOST]);
                weight.only(drawn).store(&mut weights);
                depth.store(&mut depths);
                for lane in 0..T::lane_count::<S>() {
                    let (weight, depth) = (weights[lane], depths[lane]);
                    let (column, line) = (origin.0 + start % TILE + lane, origin.1 + start / TILE);
                    // tiles at the right and lower borders have pixels outside the image
                    if weight > T::zero() && column < grid.width && line < grid.height {
                        visit(start + lane, Fragment { position: position as u32, weight, depth });
                    }
                }
            },
        );
    }

    fn alpha(&self, fragment: &Fragment<T>) -> T {
        fragment.weight.min(self.tile.thresholds.max_alpha)
    }

    #[inline(always)]
    fn payload<const MAPS: bool>(&self, fragment: &Fragment<T>, reference: T) -> [T; PAYLOAD] {
        let mut payload = [T::zero(); PAYLOAD];
        let id = self.tile.list()[fragment.position as usize] as usize;
        payload[..3].copy_from_slice(&self.tile.sorted.footprints[id].colour());
        if MAPS {
            let m = self.tile.slope * (reference - T::one() / fragment.depth);
            payload[Z] = fragment.depth;
            payload[NORMAL..M].copy_from_slice(&self.tile.sorted.normals[id]);
            (payload[M], payload[M + 1]) = (m, m * m);
        }
        payload
    }

    #[inline(always)]
    fn add<const MAPS: bool>(&self, pixel: &mut Pixel<T>, found: Fragment<T>) {
        if pixel.reference == T::zero() {
            pixel.reference = T::one() / found.depth;
        }
        let mut leaving = Some(found);
        if self.transparency != Transparency::Tail && found.weight >= T::of(CORE_ALPHA) {
            // `<=` leaves what came first before others of the same depth
            let at = pixel.core[..pixel.len].partition_point(|kept| kept.depth <= found.depth);
            if at < CORE {
                leaving = (pixel.len == CORE).then(|| pixel.core[CORE - 1]);
                pixel.len = CORE.min(pixel.len + 1);
                pixel.core.copy_within(at..pixel.len - 1, at + 1);
                pixel.core[at] = found;
            }
        }
        if let Some(leaving) = leaving.filter(|_| self.transparency != Transparency::Nearest) {
            let (alpha, payload) = (self.alpha(&leaving), self.payload::<MAPS>(&leaving, pixel.reference));
            pixel.alpha = pixel.alpha + alpha;
            pixel.through = pixel.through * (T::one() - alpha);
            for (sum, value) in pixel.payload.iter_mut().zip(payload) {
                *sum = *sum + alpha * value;
            }
        }
    }

    #[inline(always)]
    fn pixels<const MAPS: bool>(&self) -> Vec<Pixel<T>> {
        let nothing = Fragment { position: 0, weight: T::zero(), depth: T::INFINITY };
        let empty = Pixel {
            core: [nothing; CORE],
            len: 0,
            reference: T::zero(),
            alpha: T::zero(),
            through: T::one(),
            payload: [T::zero(); PAYLOAD],
        };
        let mut pixels = vec![empty; TILE_PIXELS];
        for position in 0..self.tile.list().len() {
            self.for_each_fragment(
                position,
                #[inline(always)]
                |pixel, found| self.add::<MAPS>(&mut pixels[pixel], found),
            );
        }
        pixels
    }

    fn weights<const MAPS: bool>(&self, pixel: &Pixel<T>) -> Weights<T> {
        let (zero, one) = (T::zero(), T::one());
        let mut weights =
            Weights { covered: [zero; CORE], through: one, share: zero, total: zero, sums: [zero; PAYLOAD] };
        let mut through = one;
        for (fragment, covered) in pixel.core[..pixel.len].iter().zip(&mut weights.covered) {
            let alpha = self.alpha(fragment);
            *covered = alpha * through;
            through = through * (one - alpha);
            let payload = self.payload::<MAPS>(fragment, pixel.reference);
            for (sum, value) in weights.sums.iter_mut().zip(payload) {
                *sum = *sum + *covered * value;
            }
            weights.through = through;
            if through < self.tile.thresholds.min_transmittance {
                // the tail is hidden as well
                weights.through = zero;
                break;
            }
        }
        if pixel.alpha > zero && weights.through > zero {
            // together the tail covers 1 − Π (1 − α), as it would in any order
            weights.share = through * (one - pixel.through) / pixel.alpha;
            through = through * pixel.through;
            for (sum, value) in weights.sums.iter_mut().zip(pixel.payload) {
                *sum = *sum + weights.share * value;
            }
        }
        weights.total = one - through;
        weights
    }

    /// Depth of the first fragment of the core behind which T ≤ ½, else the mean depth of the tail if T is there, else 0.
    fn median_depth(&self, pixel: &Pixel<T>, weights: &Weights<T>) -> T {
        let half = T::of(0.5);
        let mut through = T::one();
        for fragment in &pixel.core[..pixel.len] {
            through = through * (T::one() - self.alpha(fragment));
            if through <= half {
                return fragment.depth;
            }
        }
        if weights.share > T::zero() && weights.total >= half { pixel.payload[Z] / pixel.alpha } else { T::zero() }
    }

    /// Writes the planes [planes, `TILE_PIXELS`].
    #[inline(always)]
    pub fn blend<const MAPS: bool>(&self, block: &mut [T]) {
        for (at, pixel) in self.pixels::<MAPS>().iter().enumerate() {
            let weights = self.weights::<MAPS>(pixel);
            let sums = &weights.sums;
            let mut set = |plane: usize, value: T| block[plane * TILE_PIXELS + at] = value;
            (0..3).for_each(|c| set(c, sums[c]));
            set(ALPHA_PLANE, weights.total);
            if MAPS {
                set(DEPTH_PLANE, sums[Z]);
                (0..3).for_each(|c| set(NORMAL_PLANE + c, sums[NORMAL + c]));
                // a variance cannot be negative, but its two terms cancel, and rounding may leave them so
                set(DISTORTION_PLANE, (weights.total * sums[M + 1] - sums[M] * sums[M]).max(T::zero()));
                set(MEDIAN, self.median_depth(pixel, &weights));
            }
        }
    }

    /// Values of every pixel for every entry of the list; `grad` is [planes, `TILE_PIXELS`].
    #[inline(always)]
    pub fn backward<const MAPS: bool>(&self, grad: &[T]) -> Vec<Said<T>> {
        let pixels = self.pixels::<MAPS>();
        let mut said: Vec<Said<T>> = vec![[[T::zero(); TILE_PIXELS]; 3]; self.tile.list().len()];
        let back: Vec<BackwardState<T>> =
            (0..TILE_PIXELS).map(|at| self.say_core::<MAPS>(&pixels[at], at, grad, &mut said)).collect();
        for (position, said) in said.iter_mut().enumerate() {
            self.for_each_fragment(position, |at, found| {
                let (pixel, back) = (&pixels[at], &back[at]);
                let in_core = pixel.core[..pixel.len].iter().any(|kept| kept.position == found.position);
                // without a share the pixel has ended within its core, or has no tail
                if !in_core && back.share > T::zero() {
                    let alpha = self.alpha(&found);
                    let own = weighted(&back.coefficients, &self.payload::<MAPS>(&found, pixel.reference));
                    let through = (T::one() - alpha).max(T::of(LEAST_THROUGH));
                    let grad_alpha = back.share * (own - back.mean) + back.of_through / through;
                    self.say(said, at, &found, [back.share * alpha, alpha * grad_alpha], back, pixel.reference);
                }
            });
        }
        said
    }

    /// Says αT, or the weight that stands for it, and the gradients of a fragment.
    fn say(
        &self,
        said: &mut Said<T>,
        at: usize,
        fragment: &Fragment<T>,
        [covered, power]: [T; 2],
        back: &BackwardState<T>,
        reference: T,
    ) {
        let inverse = T::one() / fragment.depth;
        let m = self.tile.slope * (reference - inverse);
        let grad_m = back.coefficients[M] + T::of(2.0) * back.coefficients[M + 1] * m;
        let free = fragment.weight < self.tile.thresholds.max_alpha;
        said[0][at] = covered;
        said[1][at] = if free { power } else { T::zero() };
        said[2][at] = covered * (back.coefficients[Z] + grad_m * self.tile.slope * inverse * inverse);
    }

    /// Says what the core of a pixel says, and returns what the tail needs.
    fn say_core<const MAPS: bool>(
        &self,
        pixel: &Pixel<T>,
        at: usize,
        grad: &[T],
        said: &mut [Said<T>],
    ) -> BackwardState<T> {
        let weights = self.weights::<MAPS>(pixel);
        let mut back = BackwardState::new::<MAPS>(&weights, |plane| grad[plane * TILE_PIXELS + at]);
        let one = T::one();
        // derivative with respect to T behind the fragment that is next
        let mut behind = T::zero();
        if weights.share > T::zero() {
            back.share = weights.share;
            back.mean = weighted(&back.coefficients, &pixel.payload) / pixel.alpha;
            let mean = back.mean + back.rest;
            behind = (one - pixel.through) * mean;
            back.of_through = weights.through * pixel.through * mean;
        }
        for (fragment, &covered) in pixel.core[..pixel.len].iter().zip(&weights.covered).rev() {
            if covered > T::zero() {
                let alpha = self.alpha(fragment);
                let own = weighted(&back.coefficients, &self.payload::<MAPS>(fragment, pixel.reference)) + back.rest;
                let numbers = [covered, covered * (own - behind)];
                self.say(&mut said[fragment.position as usize], at, fragment, numbers, &back, pixel.reference);
                behind = alpha * own + (one - alpha) * behind;
            }
        }
        back
    }

    /// Calls `visit(id, w)` with the weight of every fragment.
    #[inline(always)]
    pub fn for_each_weight(&self, mut visit: impl FnMut(usize, T)) {
        let list = self.tile.list();
        let pixels = self.pixels::<false>();
        let weights: Vec<Weights<T>> = pixels.iter().map(|pixel| self.weights::<false>(pixel)).collect();
        for (pixel, weights) in pixels.iter().zip(&weights) {
            for (fragment, &covered) in pixel.core[..pixel.len].iter().zip(&weights.covered) {
                visit(list[fragment.position as usize] as usize, covered);
            }
        }
        for (position, &id) in list.iter().enumerate() {
            self.for_each_fragment(position, |at, found| {
                let in_core = pixels[at].core[..pixels[at].len].iter().any(|kept| kept.position == found.position);
                if !in_core {
                    visit(id as usize, weights[at].share * self.alpha(&found));
                }
            });
        }
    }
}

/// Gradients with respect to the weights of a pixel: that of a fragment's w is `coefficients · payload + rest`.
struct BackwardState<T> {
    coefficients: [T; PAYLOAD],
    rest: T,
    /// As in [`Weights`].
    share: T,
    /// Mean of `coefficients · payload` over the tail by α. `rest` is no part of it: by Σ α it changes nothing, and the
    /// difference would be rounding alone where the tail is opaque.
    mean: T,
    /// Gradient with respect to every α of the tail through Π (1 − α), times its 1 − α.
    of_through: T,
}

impl<T: Real> BackwardState<T> {
    fn new<const MAPS: bool>(weights: &Weights<T>, grad: impl Fn(usize) -> T) -> Self {
        let mut coefficients = [T::zero(); PAYLOAD];
        coefficients[..3].iter_mut().enumerate().for_each(|(c, value)| *value = grad(c));
        let mut rest = grad(ALPHA_PLANE);
        if MAPS {
            coefficients[Z] = grad(DEPTH_PLANE);
            (0..3).for_each(|c| coefficients[NORMAL + c] = grad(NORMAL_PLANE + c));
            // distortion is Σ w Σ w m² − (Σ w m)²
            let of_distortion = grad(DISTORTION_PLANE);
            coefficients[M] = T::of(-2.0) * of_distortion * weights.sums[M];
            coefficients[M + 1] = of_distortion * weights.total;
            rest = rest + of_distortion * weights.sums[M + 1];
        }
        Self { coefficients, rest, share: T::zero(), mean: T::zero(), of_through: T::zero() }
    }
}
