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

/// Ranges of [`aside`](super::aside) in x and in y over ranges of positions.
#[cube]
pub fn aside_ranges(lens: LensUniforms, u: Range, v: Range) -> (Range, Range) {
    let (p1, p2) = lens.tangential;
    let (s1, s2) = lens.thin_prism;
    let (t1, t2) = lens.thin_prism_quartic;
    let (uu, vv, uv) = (squared(u), squared(v), times(u, v));
    // every term has its own extremes: ranges may be wider than necessary, never narrower
    let quartic = squared(plus(uu, vv));
    let mixed_x = scaled(uv, 2.0f32 * p1);
    let along_x = scaled(uu, 3.0f32 * p2 + s1);
    let x = plus(mixed_x, plus(along_x, plus(scaled(vv, p2 + s1), scaled(quartic, t1))));
    let mixed_y = scaled(uv, 2.0f32 * p2);
    let along_y = scaled(vv, 3.0f32 * p1 + s2);
    let y = plus(mixed_y, plus(along_y, plus(scaled(uu, p1 + s2), scaled(quartic, t2))));
    (x, y)
}
