//! Intervals: where a lens may show what lies within some of them.

use cubecl::prelude::*;

use super::LensUniforms;

/// An interval.
#[derive(CubeType, Clone, Copy)]
#[expand(derive(Clone, Copy))]
pub struct Range {
    pub low: f32,
    pub high: f32,
}

/// Products of numbers of two ranges.
#[cube]
pub fn times(a: Range, b: Range) -> Range {
    let (p, q) = (a.low * b.low, a.low * b.high);
    let (r, s) = (a.high * b.low, a.high * b.high);
    Range { low: min(min(p, q), min(r, s)), high: max(max(p, q), max(r, s)) }
}

#[cube]
fn scaled(a: Range, by: f32) -> Range {
    let (low, high) = (a.low * by, a.high * by);
    Range { low: min(low, high), high: max(low, high) }
}

#[cube]
pub fn plus(a: Range, b: Range) -> Range {
    Range { low: a.low + b.low, high: a.high + b.high }
}

#[cube]
fn squared(a: Range) -> Range {
    let (low, high) = (a.low * a.low, a.high * a.high);
    let holds_zero = a.low <= 0.0f32 && a.high >= 0.0f32;
    Range { low: select(holds_zero, 0.0f32, min(low, high)), high: max(low, high) }
}

/// Range of t r⁴ over ranges of positions.
#[cube]
fn quartic(u: Range, v: Range, t: f32) -> Range {
    scaled(squared(plus(squared(u), squared(v))), t)
}

/// Range of [`aside`](super::aside) in x over ranges of positions.
#[cube]
pub fn aside_x(lens: LensUniforms, u: Range, v: Range) -> Range {
    let mixed = scaled(times(u, v), 2.0f32 * lens.p1);
    let along = scaled(squared(u), 3.0f32 * lens.p2 + lens.s1);
    plus(mixed, plus(along, plus(scaled(squared(v), lens.p2 + lens.s1), quartic(u, v, lens.t1))))
}

/// Range of [`aside`](super::aside) in y.
#[cube]
pub fn aside_y(lens: LensUniforms, u: Range, v: Range) -> Range {
    let mixed = scaled(times(u, v), 2.0f32 * lens.p2);
    let along = scaled(squared(v), 3.0f32 * lens.p1 + lens.s2);
    plus(mixed, plus(along, plus(scaled(squared(u), lens.p1 + lens.s2), quartic(u, v, lens.t2))))
}
