//! The two colour models for one primitive, forward and backward.

use crate::backend::number::Number;
use crate::math::{V3, dot, scale, sub};
use crate::ops::colour::{LARGEST_BETA, SHARPNESS};
use crate::scene::SH_C0;
use crate::scene::lobes::LOBE_LEN;

/// Unit vector from the camera to a primitive; zero at the camera itself.
#[inline(always)]
pub fn direction<N: Number>(position: V3<N>, centre: V3<N>) -> V3<N> {
    let offset = sub(position, centre);
    let length = dot(offset, offset).sqrt();
    scale(offset, length.constant(1.0) / length.max(length.constant(1e-12)))
}

#[inline(always)]
pub fn base<N: Number>([r, g, b]: V3<N>) -> V3<N> {
    let of = {
        #[inline(always)]
        |k: N| k.constant(0.5) + k.constant(SH_C0) * k
    };
    [of(r), of(g), of(b)]
}

/// Logarithm below which an exponential counts as 0, as it does in f32 on GPUs: no gradient reaches a lobe that is absent.
const VANISHED: f64 = 87.0;

/// Stable softplus and its derivative.
#[inline(always)]
fn softplus<N: Number>(raw: N) -> (N, N) {
    let (zero, one, sharpness) = (raw.constant(0.0), raw.constant(1.0), raw.constant(SHARPNESS));
    let x = sharpness * raw;
    // the exponential of a negative number on either side, which cannot overflow
    let is_there = x.abs().below(raw.constant(VANISHED));
    let decay = N::select(is_there, (-x.abs()).exp_nonpositive(), zero);
    let value = (x.max(zero) + decay.ln_1p_share()) / sharpness;
    // written by `decay` on both sides: 1 − 1 / (1 + d) would cancel
    let sigmoid = N::select(x.at_least(zero), one, decay) / (one + decay);
    (value, sigmoid)
}

/// One lobe evaluated in a direction.
struct Lobe<N> {
    rgb: [(N, N); 3],
    /// (d·μ)^exponent: 0 on the unlit side and where the power underflows, nothing of the lobe is seen there.
    lit: N,
    exponent: N,
    /// 1 on the unlit side, where nothing is divided by it then.
    cosine: N,
    /// Derivatives of d·μ with respect to θ and φ.
    cosine_theta: N,
    cosine_phi: N,
}

impl<N: Number> Lobe<N> {
    #[inline(always)]
    fn new([r, g, b, theta, phi, beta]: [N; LOBE_LEN], d: V3<N>) -> Self {
        let (sin_theta, cos_theta) = theta.sin_cos();
        let (sin_phi, cos_phi) = phi.sin_cos();
        let (zero, one) = (beta.constant(0.0), beta.constant(1.0));
        let across = d[0] * cos_phi + d[1] * sin_phi;
        let cosine = sin_theta * across + cos_theta * d[2];
        let is_lit = zero.below(cosine);
        // a power of a negative cosine is not a number
        let cosine = N::select(is_lit, cosine, one);
        let exponent = beta.constant(4.0) * beta.min(beta.constant(LARGEST_BETA)).exp();
        Self {
            rgb: [softplus(r), softplus(g), softplus(b)],
            lit: N::select(is_lit, (exponent * cosine.ln()).exp(), zero),
            exponent,
            cosine,
            cosine_theta: cos_theta * across - sin_theta * d[2],
            cosine_phi: sin_theta * (d[1] * cos_phi - d[0] * sin_phi),
        }
    }
}

/// A lobe with the numbers `raw` seen in direction `d`.
#[inline(always)]
pub fn lobe<N: Number>(raw: [N; LOBE_LEN], d: V3<N>) -> V3<N> {
    let Lobe { rgb: [(r, _), (g, _), (b, _)], lit, .. } = Lobe::new(raw, d);
    [r * lit, g * lit, b * lit]
}

/// Gradient of [`lobe`] with respect to `raw`.
#[inline(always)]
pub fn lobe_backward<N: Number>(raw: [N; LOBE_LEN], d: V3<N>, grad: V3<N>) -> [N; LOBE_LEN] {
    let Lobe { rgb: [(r, slope_r), (g, slope_g), (b, slope_b)], lit, exponent, cosine, cosine_theta, cosine_phi } =
        Lobe::new(raw, d);
    let brightness = dot(grad, [r, g, b]);
    // no second power
    let grad_power = brightness * exponent * lit;
    let grad_cosine = grad_power / cosine;
    let beta = raw[5];
    let is_saturated = beta.constant(LARGEST_BETA).below(beta);
    [
        grad[0] * lit * slope_r,
        grad[1] * lit * slope_g,
        grad[2] * lit * slope_b,
        grad_cosine * cosine_theta,
        grad_cosine * cosine_phi,
        N::select(is_saturated, beta.constant(0.0), grad_power * cosine.ln()),
    ]
}

/// Values of the spherical harmonics Y1..Y15 in direction `d` (3DGS).
#[inline(always)]
pub fn harmonics<N: Number>([x, y, z]: V3<N>) -> [N; 15] {
    let c = {
        #[inline(always)]
        |value: f64| x.constant(value)
    };
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
