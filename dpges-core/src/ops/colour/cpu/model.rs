//! The two colour models for one primitive, forward and backward.

use crate::backend::real::Real;
use crate::math::{V3, dot, scale, sub};
use crate::ops::colour::{LARGEST_BETA, SHARPNESS};
use crate::scene::SH_C0;

/// Unit vector from the camera to a primitive; zero at the camera itself.
#[inline(always)]
pub fn direction<T: Real>(position: V3<T>, centre: V3<T>) -> V3<T> {
    let offset = sub(position, centre);
    scale(offset, T::one() / dot(offset, offset).sqrt().max(T::of(1e-12)))
}

#[inline(always)]
pub fn base<T: Real>(coefficients: V3<T>) -> V3<T> {
    coefficients.map(|k| T::of(0.5) + T::of(SH_C0) * k)
}

/// Logarithm below which an exponential counts as 0, as it does in f32 on GPUs: no gradient reaches a lobe that is absent.
const VANISHED: f64 = 87.0;

/// Stable softplus and its derivative.
#[inline(always)]
fn softplus<T: Real>(raw: T) -> (T, T) {
    let x = T::of(SHARPNESS) * raw;
    // the exponential of a negative number on either side, which cannot overflow
    let decay = if x.abs() < T::of(VANISHED) { (-x.abs()).exp_nonpositive() } else { T::zero() };
    let value = (x.max(T::zero()) + decay.ln_1p_share()) / T::of(SHARPNESS);
    // written by `decay` on both sides: 1 − 1 / (1 + d) would cancel
    let sigmoid = if x >= T::zero() { T::one() / (T::one() + decay) } else { decay / (T::one() + decay) };
    (value, sigmoid)
}

/// One lobe evaluated in a direction on its lit side.
struct Lobe<T> {
    rgb: [(T, T); 3],
    /// (d·μ)^exponent, above 0.
    lit: T,
    exponent: T,
    saturated: bool,
    cosine: T,
    /// Derivatives of d·μ with respect to θ and φ.
    cosine_theta: T,
    cosine_phi: T,
}

impl<T: Real> Lobe<T> {
    /// `None` on the unlit side and where the power underflows: nothing of the lobe is seen there.
    #[inline(always)]
    fn new(raw: &[T], d: V3<T>) -> Option<Self> {
        let (sin_theta, cos_theta) = raw[3].sin_cos();
        let (sin_phi, cos_phi) = raw[4].sin_cos();
        let across = d[0] * cos_phi + d[1] * sin_phi;
        let cosine = sin_theta * across + cos_theta * d[2];
        let (exponent, lit) = if cosine > T::zero() {
            let exponent = T::of(4.0) * raw[5].min(T::of(LARGEST_BETA)).exp();
            // only on the lit side: a power of a negative cosine is NaN
            (exponent, cosine.powf(exponent))
        } else {
            (T::zero(), T::zero())
        };
        if lit <= T::zero() {
            return None;
        }
        Some(Self {
            rgb: [softplus(raw[0]), softplus(raw[1]), softplus(raw[2])],
            lit,
            exponent,
            saturated: raw[5] > T::of(LARGEST_BETA),
            cosine,
            cosine_theta: cos_theta * across - sin_theta * d[2],
            cosine_phi: sin_theta * (d[1] * cos_phi - d[0] * sin_phi),
        })
    }
}

/// Σ over the lobes in `raw` (6 numbers each) seen in direction `d`.
#[inline(always)]
pub fn lobes<T: Real>(raw: &[T], d: V3<T>) -> V3<T> {
    raw.chunks_exact(6)
        .filter_map(|raw| Lobe::new(raw, d))
        .fold([T::zero(); 3], |sum, lobe| std::array::from_fn(|c| sum[c] + lobe.rgb[c].0 * lobe.lit))
}

/// Gradient of [`lobes`] with respect to `raw`, written to `out`.
#[inline(always)]
pub fn lobes_backward<T: Real>(raw: &[T], d: V3<T>, grad: V3<T>, out: &mut [T]) {
    for (raw, out) in raw.chunks_exact(6).zip(out.chunks_exact_mut(6)) {
        let Some(lobe) = Lobe::new(raw, d) else {
            out.fill(T::zero());
            continue;
        };
        let brightness = (0..3).map(|c| grad[c] * lobe.rgb[c].0).sum::<T>();
        // no second power; a lobe that is lit has a positive cosine
        let grad_cosine = brightness * lobe.exponent * lobe.lit / lobe.cosine;
        for c in 0..3 {
            out[c] = grad[c] * lobe.lit * lobe.rgb[c].1;
        }
        out[3] = grad_cosine * lobe.cosine_theta;
        out[4] = grad_cosine * lobe.cosine_phi;
        out[5] = if lobe.saturated { T::zero() } else { brightness * lobe.exponent * lobe.lit * lobe.cosine.ln() };
    }
}

/// Values of the spherical harmonics Y1..Y15 in direction `d` (3DGS).
#[inline(always)]
pub fn harmonics<T: Real>([x, y, z]: V3<T>) -> [T; 15] {
    let c = T::of;
    let (xx, yy, zz) = (x * x, y * y, z * z);
    [
        c(-0.488_602_511_902_919_9) * y,
        c(0.488_602_511_902_919_9) * z,
        c(-0.488_602_511_902_919_9) * x,
        c(1.092_548_430_592_079_2) * x * y,
        c(-1.092_548_430_592_079_2) * y * z,
        c(0.315_391_565_252_520_05) * (c(2.0) * zz - xx - yy),
        c(-1.092_548_430_592_079_2) * x * z,
        c(0.546_274_215_296_039_6) * (xx - yy),
        c(-0.590_043_589_926_643_5) * y * (c(3.0) * xx - yy),
        c(2.890_611_442_640_554) * x * y * z,
        c(-0.457_045_799_464_465_8) * y * (c(4.0) * zz - xx - yy),
        c(0.373_176_332_590_115_4) * z * (c(2.0) * zz - c(3.0) * xx - c(3.0) * yy),
        c(-0.457_045_799_464_465_8) * x * (c(4.0) * zz - xx - yy),
        c(1.445_305_721_320_277) * z * (xx - yy),
        c(-0.590_043_589_926_643_5) * x * (xx - c(3.0) * yy),
    ]
}

/// Σ over the higher coefficients in `raw` (3 numbers each), after so many `before` them, seen in direction `d`.
#[inline(always)]
pub fn higher_harmonics<T: Real>(raw: &[T], before: usize, d: V3<T>) -> V3<T> {
    raw.chunks_exact(3)
        .zip(&harmonics(d)[before..])
        .fold([T::zero(); 3], |sum, (raw, y)| std::array::from_fn(|c| sum[c] + raw[c] * *y))
}

/// Gradient of [`higher_harmonics`] with respect to `raw`, written to `out`.
#[inline(always)]
pub fn higher_harmonics_backward<T: Real>(before: usize, d: V3<T>, grad: V3<T>, out: &mut [T]) {
    for (out, y) in out.chunks_exact_mut(3).zip(&harmonics(d)[before..]) {
        // directions carry no gradient to positions
        out.copy_from_slice(&scale(grad, *y));
    }
}
