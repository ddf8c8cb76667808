//! CPU kernels: separable windows, one task per image row.

use burn::backend::TensorMetadata;
use burn::backend::tensor::FloatTensor;
use rayon::prelude::*;

use super::{SsimBackwardOps, SsimOps, SsimOutput};
use crate::host::{self, Host, for_each_cpu_backend, with_real};
use crate::real::Real;
use crate::simd::vectorised;

pub const WINDOW: usize = 11;
pub const RADIUS: usize = WINDOW / 2;
const SIGMA_PX: f64 = 1.5;
pub const C1: f64 = 0.01 * 0.01;
pub const C2: f64 = 0.03 * 0.03;
const MIN_ROWS: usize = 8;

/// Normalised weights of the window.
pub fn taps<T: Real>() -> [T; WINDOW] {
    let raw: [f64; WINDOW] =
        std::array::from_fn(|i| (-(i as f64 - RADIUS as f64).powi(2) / (2.0 * SIGMA_PX * SIGMA_PX)).exp());
    let sum: f64 = raw.iter().sum();
    raw.map(|tap| T::of(tap / sum))
}

/// `Q` images that are windowed together, interleaved by row: [row, Q, W].
struct Rows<T> {
    width: usize,
    height: usize,
    values: Vec<T>,
}

impl<T: Real> Rows<T> {
    /// Windows along x the quantities that `fill` writes for each row into padded buffers.
    fn horizontal<const Q: usize>(
        lines: usize,
        width: usize,
        height: usize,
        fill: impl Fn(usize, &mut [Vec<T>; Q]) + Sync,
    ) -> Self {
        let taps = taps::<T>();
        let mut values = vec![T::zero(); lines * Q * width];
        values.par_chunks_mut((Q * width).max(1)).with_min_len(MIN_ROWS).enumerate().for_each_init(
            || std::array::from_fn(|_| vec![T::zero(); width + 2 * RADIUS]),
            |padded: &mut [Vec<T>; Q], (line, out)| {
                vectorised(
                    #[inline(always)]
                    || {
                        fill(line, padded);
                        for (out, padded) in out.chunks_exact_mut(width).zip(padded.iter()) {
                            for (t, &tap) in taps.iter().enumerate() {
                                for (out, &value) in out.iter_mut().zip(&padded[t..t + width]) {
                                    *out = *out + tap * value;
                                }
                            }
                        }
                    },
                );
            },
        );
        Self { width, height, values }
    }

    /// Windows along y at `line` (a row of one of the images) into `out`, [Q, W].
    #[inline(always)]
    fn vertical(&self, line: usize, taps: &[T; WINDOW], out: &mut [T]) {
        let stride = out.len();
        let y = line % self.height;
        out.fill(T::zero());
        let first = RADIUS.saturating_sub(y);
        let last = WINDOW.min(self.height - y + RADIUS);
        for (t, &tap) in taps.iter().enumerate().take(last).skip(first) {
            let source = &self.values[(line + t - RADIUS) * stride..][..stride];
            for (out, &value) in out.iter_mut().zip(source) {
                *out = *out + tap * value;
            }
        }
    }
}

/// Value, and partial derivatives as [3, C, H, W].
fn forward<T: Real>(image: &[T], target: &[T], lines: usize, width: usize, height: usize) -> (T, Vec<T>) {
    let rows = Rows::horizontal::<5>(lines, width, height, |line, padded| {
        let (a, b) = (&image[line * width..][..width], &target[line * width..][..width]);
        for x in 0..width {
            let products = [a[x], b[x], a[x] * a[x], b[x] * b[x], a[x] * b[x]];
            for (padded, value) in padded.iter_mut().zip(products) {
                padded[RADIUS + x] = value;
            }
        }
    });
    let taps = taps::<T>();
    let mut partials = vec![T::zero(); 3 * lines * width];
    let (means, rest) = partials.split_at_mut(lines * width);
    let (squares, products) = rest.split_at_mut(lines * width);
    let scale = T::one() / T::of((lines * width) as f64);
    let width_or_one = width.max(1);
    let sums: Vec<T> = means
        .par_chunks_mut(width_or_one)
        .zip(squares.par_chunks_mut(width_or_one))
        .zip(products.par_chunks_mut(width_or_one))
        .with_min_len(MIN_ROWS)
        .enumerate()
        .map_init(
            || vec![T::zero(); 5 * width],
            |windowed, (line, ((means, squares), products))| {
                vectorised(
                    #[inline(always)]
                    || {
                        rows.vertical(line, &taps, windowed);
                        let mut sum = T::zero();
                        for x in 0..rows.width {
                            let at = |quantity: usize| windowed[quantity * width + x];
                            let (value, partial) = similarity(at(0), at(1), at(2), at(3), at(4));
                            sum = sum + value;
                            (means[x], squares[x], products[x]) =
                                (partial[0] * scale, partial[1] * scale, partial[2] * scale);
                        }
                        sum
                    },
                )
            },
        )
        .collect();
    (sums.into_iter().sum::<T>() * scale, partials)
}

/// SSIM of one window and its derivatives with respect to E\[a\], E\[a²\] and E\[ab\].
#[inline(always)]
fn similarity<T: Real>(mean_a: T, mean_b: T, square_a: T, square_b: T, product: T) -> (T, [T; 3]) {
    let two = T::of(2.0);
    let covariance = product - mean_a * mean_b;
    let luminance = two * mean_a * mean_b + T::of(C1);
    let structure = two * covariance + T::of(C2);
    let means = mean_a * mean_a + mean_b * mean_b + T::of(C1);
    let variances = (square_a - mean_a * mean_a) + (square_b - mean_b * mean_b) + T::of(C2);
    let inverse = T::one() / (means * variances);
    let value = luminance * structure * inverse;
    let by_variance = -value / variances;
    let by_covariance = two * luminance * inverse;
    let by_mean = two * mean_b * structure * inverse - two * mean_a * value / means;
    (value, [by_mean - two * mean_a * by_variance - mean_b * by_covariance, by_variance, by_covariance])
}

fn backward<T: Real>(
    image: &[T],
    target: &[T],
    partials: &[T],
    grad: T,
    lines: usize,
    width: usize,
    height: usize,
) -> Vec<T> {
    let plane = lines * width;
    let rows = Rows::horizontal::<3>(lines, width, height, |line, padded| {
        for (quantity, padded) in padded.iter_mut().enumerate() {
            padded[RADIUS..RADIUS + width].copy_from_slice(&partials[quantity * plane + line * width..][..width]);
        }
    });
    let taps = taps::<T>();
    let mut out = vec![T::zero(); plane];
    out.par_chunks_mut(width.max(1)).with_min_len(MIN_ROWS).enumerate().for_each_init(
        || vec![T::zero(); 3 * width],
        |windowed, (line, out)| {
            vectorised(
                #[inline(always)]
                || {
                    rows.vertical(line, &taps, windowed);
                    let (a, b) = (&image[line * width..][..width], &target[line * width..][..width]);
                    for x in 0..width {
                        let from_square = T::of(2.0) * a[x] * windowed[width + x];
                        out[x] = grad * (windowed[x] + from_square + b[x] * windowed[2 * width + x]);
                    }
                },
            );
        },
    );
    out
}

fn ssim_on<B: Host>(image: &FloatTensor<B>, target: &FloatTensor<B>) -> SsimOutput<B> {
    let [channels, height, width] = image.shape().dims();
    with_real!(image.dtype(), T => {
        let (a, b) = (host::floats::<B, T>(image), host::floats::<B, T>(target));
        let (value, partials) = forward(&a, &b, channels * height, width, height);
        SsimOutput {
            value: host::float_tensor::<B, T, 1>(vec![value], [1], &image.device()),
            partials: host::float_tensor::<B, T, 4>(partials, [3, channels, height, width], &image.device()),
        }
    })
}

fn ssim_backward_on<B: Host>(
    image: &FloatTensor<B>,
    target: &FloatTensor<B>,
    partials: &FloatTensor<B>,
    grad: &FloatTensor<B>,
) -> FloatTensor<B> {
    let [channels, height, width] = image.shape().dims();
    with_real!(image.dtype(), T => {
        let (a, b, partials) = (host::floats::<B, T>(image), host::floats::<B, T>(target), host::floats::<B, T>(partials));
        let out = backward(&a, &b, &partials, host::floats::<B, T>(grad)[0], channels * height, width, height);
        host::float_tensor::<B, T, 3>(out, [channels, height, width], &image.device())
    })
}

macro_rules! implement {
    ($backend:ty) => {
        impl SsimOps for $backend {
            fn ssim(image: FloatTensor<Self>, target: FloatTensor<Self>) -> SsimOutput<Self> {
                ssim_on::<Self>(&image, &target)
            }
        }

        impl SsimBackwardOps for $backend {
            fn ssim_backward(
                image: FloatTensor<Self>,
                target: FloatTensor<Self>,
                partials: FloatTensor<Self>,
                grad: FloatTensor<Self>,
            ) -> FloatTensor<Self> {
                ssim_backward_on::<Self>(&image, &target, &partials, &grad)
            }
        }
    };
}
for_each_cpu_backend!(implement);
