//! CPU kernels: separable windows, one task per image row.

use std::borrow::Cow;

use burn::backend::TensorMetadata;
use burn::backend::tensor::FloatTensor;
use rayon::prelude::*;

use super::autodiff::PhotometricState;
use super::{C1, C2, PhotometricInput, PhotometricOps, PhotometricOutput, PhotometricWeights, RADIUS, WINDOW, taps};
use crate::backend::host::{self, Host, with_real};
use crate::backend::real::Real;
use crate::backend::tape::BackwardState;
use crate::backend::vectorised::vectorised;
use crate::backend::vectors::MOST;

const MIN_ROWS: usize = 8;

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
            // zeros on both sides are the padding: the loop below needs no test, and is vectorised
            || std::array::from_fn(|_| vec![T::zero(); width + 2 * RADIUS]),
            |padded: &mut [Vec<T>; Q], (line, out)| {
                vectorised(
                    #[inline(always)]
                    || {
                        fill(line, padded);
                        for (out, padded) in out.chunks_exact_mut(width).zip(padded.iter()) {
                            window(&taps, |t| &padded[t..t + width], out);
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
        // rows beyond the image are 0, and left out
        let first = RADIUS.saturating_sub(y);
        let last = WINDOW.min(self.height - y + RADIUS);
        window(&taps[first..last], |t| &self.values[(line + first + t - RADIUS) * stride..][..stride], out);
    }
}

/// Σ tap t × source(t), by blocks whose sums stay in registers.
#[inline(always)]
fn window<'a, T: Real>(taps: &[T], source: impl Fn(usize) -> &'a [T], out: &mut [T]) {
    let (blocks, rest) = out.as_chunks_mut::<MOST>();
    let after = blocks.len() * MOST;
    for (block, out) in blocks.iter_mut().enumerate() {
        let mut sums = [T::zero(); MOST];
        for (t, &tap) in taps.iter().enumerate() {
            for (sum, &value) in sums.iter_mut().zip(&source(t)[block * MOST..][..MOST]) {
                *sum = *sum + tap * value;
            }
        }
        *out = sums;
    }
    for (x, out) in rest.iter_mut().enumerate() {
        *out = taps.iter().enumerate().fold(T::zero(), |sum, (t, &tap)| sum + tap * source(t)[after + x]);
    }
}

/// The two images, row by row.
struct Pair<'a, T: Real> {
    lines: usize,
    width: usize,
    height: usize,
    image: &'a [T],
    /// The image itself where pixels do not count.
    target: Cow<'a, [T]>,
    /// [H, W]
    ignored: Option<&'a [T]>,
}

impl<'a, T: Real> Pair<'a, T> {
    fn new(image: &'a [T], target: &'a [T], ignored: Option<&'a [T]>, [channels, height, width]: [usize; 3]) -> Self {
        let target = match ignored {
            None => Cow::Borrowed(target),
            Some(ignored) => Cow::Owned(
                (image.par_chunks(ignored.len().max(1)).zip(target.par_chunks(ignored.len().max(1))))
                    .flat_map_iter(|(image, target)| {
                        let pixels = image.iter().zip(target).zip(ignored);
                        pixels.map(|((&image, &target), &ignored)| if is_ignored(ignored) { image } else { target })
                    })
                    .collect(),
            ),
        };
        Self { lines: channels * height, width, height, image, target, ignored }
    }

    /// A row of the image and of the target.
    #[inline(always)]
    fn rows(&self, line: usize) -> (&[T], &[T]) {
        let range = line * self.width..(line + 1) * self.width;
        (&self.image[range.clone()], &self.target[range])
    }

    #[inline(always)]
    fn counts(&self, line: usize, x: usize) -> bool {
        self.ignored.is_none_or(|ignored| !is_ignored(ignored[line % self.height * self.width + x]))
    }
}

#[inline(always)]
fn is_ignored<T: Real>(ignored: T) -> bool {
    ignored > T::of(0.5)
}

/// Sums of absolute differences, of SSIM and of squared errors, and partial derivatives as [3, C, H, W].
fn forward<T: Real>(pair: &Pair<T>) -> ([T; 3], Vec<T>) {
    let &Pair { lines, width, height, .. } = pair;
    let rows = Rows::horizontal::<4>(lines, width, height, |line, padded| {
        let (a, b) = pair.rows(line);
        for x in 0..width {
            // SSIM has both variances in one sum: four windows, not five
            let products = [a[x], b[x], a[x] * a[x] + b[x] * b[x], a[x] * b[x]];
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
    let sums: Vec<[T; 3]> = means
        .par_chunks_mut(width_or_one)
        .zip(squares.par_chunks_mut(width_or_one))
        .zip(products.par_chunks_mut(width_or_one))
        .with_min_len(MIN_ROWS)
        .enumerate()
        .map_init(
            || vec![T::zero(); 4 * width],
            |windowed, (line, ((means, squares), products))| {
                vectorised(
                    #[inline(always)]
                    || {
                        rows.vertical(line, &taps, windowed);
                        let mut similarities = T::zero();
                        for x in 0..rows.width {
                            let at = |quantity: usize| windowed[quantity * width + x];
                            let (value, partial) = similarity(at(0), at(1), at(2), at(3));
                            similarities = similarities + value;
                            (means[x], squares[x], products[x]) =
                                (partial[0] * scale, partial[1] * scale, partial[2] * scale);
                        }
                        let [differences, errors] = differences(pair, line);
                        [differences, similarities, errors]
                    },
                )
            },
        )
        .collect();
    // rows are added in their order: the same bits with any number of threads
    let total = |which: usize| sums.iter().map(|sums| sums[which]).sum::<T>();
    ([total(0), total(1), total(2)], partials)
}

/// Sums of absolute differences and of squared errors of a row.
#[inline(always)]
fn differences<T: Real>(pair: &Pair<T>, line: usize) -> [T; 2] {
    let (image, target) = pair.rows(line);
    let (mut absolute, mut squared) = (T::zero(), T::zero());
    for (x, (&a, &b)) in image.iter().zip(target).enumerate() {
        absolute = absolute + (a - b).abs();
        // clamped, since PSNR is that of the picture as it is shown
        let error = a.max(T::zero()).min(T::one()) - b;
        squared = squared + if pair.counts(line, x) { error * error } else { T::zero() };
    }
    [absolute, squared]
}

/// SSIM of one window with these means of a, b, a² + b² and ab, and its derivatives with respect to E\[a\], E\[a²\] and E\[ab\].
#[inline(always)]
fn similarity<T: Real>(mean_a: T, mean_b: T, squares: T, product: T) -> (T, [T; 3]) {
    let two = T::of(2.0);
    let covariance = product - mean_a * mean_b;
    let luminance = two * mean_a * mean_b + T::of(C1);
    let structure = two * covariance + T::of(C2);
    let means = mean_a * mean_a + mean_b * mean_b + T::of(C1);
    let variances = squares - mean_a * mean_a - mean_b * mean_b + T::of(C2);
    let inverse = T::one() / (means * variances);
    let value = luminance * structure * inverse;
    let by_variance = -value / variances;
    let by_covariance = two * luminance * inverse;
    let by_mean = two * mean_b * structure * inverse - two * mean_a * value / means;
    (value, [by_mean - two * mean_a * by_variance - mean_b * by_covariance, by_variance, by_covariance])
}

fn backward<T: Real>(pair: &Pair<T>, partials: &[T], grad: T, weights: &PhotometricWeights) -> Vec<T> {
    let &Pair { lines, width, height, .. } = pair;
    let plane = lines * width;
    let of_similarity = grad * T::of(weights.ssim * weights.pixels_per_counted);
    // the partial derivatives of SSIM are those of a mean already; absolute differences are divided here
    let of_difference = grad * T::of(weights.l1 * weights.pixels_per_counted / plane as f64);
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
                    let (a, b) = pair.rows(line);
                    for x in 0..width {
                        let from_square = T::of(2.0) * a[x] * windowed[width + x];
                        let by_similarity = windowed[x] + from_square + b[x] * windowed[2 * width + x];
                        let gradient = of_similarity * by_similarity + of_difference * sign(a[x] - b[x]);
                        out[x] = if pair.counts(line, x) { gradient } else { T::zero() };
                    }
                },
            );
        },
    );
    out
}

/// −1, 0 or 1.
#[inline(always)]
fn sign<T: Real>(value: T) -> T {
    // `signum` of 0.0 is 1
    if value == T::zero() { value } else { value.signum() }
}

/// Calls `kernel` with the tensors as slices.
fn with_pair<B: Host, T: Real, R>(input: &PhotometricInput<B>, masked: bool, kernel: impl FnOnce(&Pair<T>) -> R) -> R {
    let (image, target) = (host::floats::<B, T>(&input.image), host::floats::<B, T>(&input.target));
    let ignored = masked.then(|| host::floats::<B, T>(&input.ignored));
    kernel(&Pair::new(&image, &target, ignored.as_deref(), input.image.shape().dims()))
}

impl<B: Host> PhotometricOps for B {
    fn photometric(input: PhotometricInput<B>, weights: PhotometricWeights, masked: bool) -> PhotometricOutput<B> {
        let [channels, height, width] = input.image.shape().dims();
        let device = input.image.device();
        with_real!(input.image.dtype(), T => {
            let ([differences, similarities, errors], partials) = with_pair::<B, T, _>(&input, masked, forward);
            let mean = T::of(weights.pixels_per_counted / (channels * height * width) as f64);
            let offset = T::of(weights.offset * weights.pixels_per_counted);
            let value = offset + (T::of(weights.l1) * differences + T::of(weights.ssim) * similarities) * mean;
            PhotometricOutput {
                value: host::float_tensor::<B, T, 1>(vec![value], [1], &device),
                squared_error: host::float_tensor::<B, T, 1>(vec![errors * mean], [1], &device),
                partials: host::float_tensor::<B, T, 4>(partials, [3, channels, height, width], &device),
            }
        })
    }
}

impl<B: Host> BackwardState<B, 1> for PhotometricState<B> {
    fn backward(self, grad: FloatTensor<B>) -> [Option<FloatTensor<B>>; 1] {
        let Self { input, partials, weights, masked } = self;
        let shape: [usize; 3] = input.image.shape().dims();
        with_real!(input.image.dtype(), T => {
            let (partials, grad) = (host::floats::<B, T>(&partials), host::floats::<B, T>(&grad)[0]);
            let out = with_pair::<B, T, _>(&input, masked, |pair| backward(pair, &partials, grad, &weights));
            [Some(host::float_tensor::<B, T, 3>(out, shape, &input.image.device()))]
        })
    }
}
