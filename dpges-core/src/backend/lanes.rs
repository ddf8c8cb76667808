//! Numbers of pixels that a kernel processes together, in the vector instructions of the machine: written out, since
//! compilers leave loops over arrays in scalar instructions wherever they cannot exclude that the arrays overlap.

use std::ops::{Add, BitAnd, BitOr, Div, Mul, Neg, Sub};

use pulp::Simd;

use super::real::Real;
use super::vectors::MOST;

/// As many numbers as a vector instruction of `S` processes.
#[derive(Clone, Copy)]
pub struct Lanes<T: Real, S: Simd> {
    simd: S,
    of: T::Vector<S>,
}

/// Which of the numbers.
#[derive(Clone, Copy)]
pub struct Mask<T: Real, S: Simd> {
    simd: S,
    of: T::Mask<S>,
}

impl<T: Real, S: Simd> Lanes<T, S> {
    /// All the same.
    #[inline(always)]
    pub fn splat(simd: S, value: T) -> Self {
        Self { simd, of: T::splat_lanes(simd, value) }
    }

    /// One vector for each number. `array::map` is not always inlined, and then runs without vector instructions.
    #[inline(always)]
    pub fn splat_three(simd: S, [a, b, c]: [T; 3]) -> [Self; 3] {
        [Self::splat(simd, a), Self::splat(simd, b), Self::splat(simd, c)]
    }

    #[inline(always)]
    pub fn zero(simd: S) -> Self {
        Self::splat(simd, T::zero())
    }

    /// The first of `values`.
    ///
    /// # Panics
    /// If there are too few.
    #[inline(always)]
    pub fn load(simd: S, values: &[T]) -> Self {
        Self { simd, of: T::load_lanes(simd, &values[..T::lane_count::<S>()]) }
    }

    /// `values` as far as they go, then 0.
    #[inline(always)]
    pub fn load_some(simd: S, values: &[T]) -> Self {
        if values.len() >= T::lane_count::<S>() {
            return Self::load(simd, values);
        }
        let mut padded = [T::zero(); MOST];
        padded[..values.len()].copy_from_slice(values);
        Self::load(simd, &padded)
    }

    /// Into `values` as far as they go.
    #[inline(always)]
    pub fn store_some(self, values: &mut [T]) {
        if values.len() >= T::lane_count::<S>() {
            return self.store(values);
        }
        let mut padded = [T::zero(); MOST];
        self.store(&mut padded);
        values.copy_from_slice(&padded[..values.len()]);
    }

    /// Into the first of `values`.
    ///
    /// # Panics
    /// If there are too few.
    #[inline(always)]
    pub fn store(self, values: &mut [T]) {
        T::store_lanes(self.simd, &mut values[..T::lane_count::<S>()], self.of);
    }

    /// The columns of `row(lane)` of every lane.
    #[inline(always)]
    pub fn from_rows<const W: usize>(simd: S, row: impl Fn(usize) -> [T; W]) -> [Self; W] {
        let mut columns = [[T::zero(); MOST]; W];
        for lane in 0..T::lane_count::<S>() {
            for (column, value) in columns.iter_mut().zip(row(lane)) {
                column[lane] = value;
            }
        }
        let mut out = [Self::zero(simd); W];
        for (out, column) in out.iter_mut().zip(&columns) {
            *out = Self::load(simd, column);
        }
        out
    }

    /// The numbers of `columns`, a row for each lane; those of lanes that `S` lacks are 0.
    #[inline(always)]
    pub fn to_rows<const W: usize>(columns: [Self; W]) -> [[T; W]; MOST] {
        let mut rows = [[T::zero(); W]; MOST];
        for (d, of) in columns.into_iter().enumerate() {
            let mut column = [T::zero(); MOST];
            of.store(&mut column);
            for (row, value) in rows[..T::lane_count::<S>()].iter_mut().zip(column) {
                row[d] = value;
            }
        }
        rows
    }

    #[inline(always)]
    pub fn simd(self) -> S {
        self.simd
    }

    /// self × factor + summand
    #[inline(always)]
    pub fn mul_add(self, factor: Self, summand: Self) -> Self {
        Self { of: T::mul_add_lanes(self.simd, self.of, factor.of, summand.of), ..self }
    }

    #[inline(always)]
    pub fn sqrt(self) -> Self {
        Self { of: T::sqrt_lanes(self.simd, self.of), ..self }
    }

    #[inline(always)]
    pub fn min(self, other: Self) -> Self {
        Self { of: T::min_lanes(self.simd, self.of, other.of), ..self }
    }

    #[inline(always)]
    pub fn abs(self) -> Self {
        self.max(-self)
    }

    #[inline(always)]
    pub fn max(self, other: Self) -> Self {
        Self { of: T::max_lanes(self.simd, self.of, other.of), ..self }
    }

    /// self ≥ other
    #[inline(always)]
    pub fn at_least(self, other: Self) -> Mask<T, S> {
        Mask { simd: self.simd, of: T::at_least_lanes(self.simd, self.of, other.of) }
    }

    /// self < other
    #[inline(always)]
    pub fn below(self, other: Self) -> Mask<T, S> {
        Mask { simd: self.simd, of: T::below_lanes(self.simd, self.of, other.of) }
    }

    /// `a` where the mask is set, else `b`.
    #[inline(always)]
    pub fn select(mask: Mask<T, S>, a: Self, b: Self) -> Self {
        Self { simd: a.simd, of: T::select_lanes(a.simd, mask.of, a.of, b.of) }
    }

    /// The numbers where the mask is set, else 0.
    #[inline(always)]
    pub fn only(self, mask: Mask<T, S>) -> Self {
        Self::select(mask, self, Self::zero(self.simd))
    }

    /// e^x for x ≤ 0, within 2 units in the last place; 0 far below the cutoff.
    #[inline(always)]
    pub fn exp_nonpositive(self) -> Self {
        Self { of: T::exp_nonpositive_lanes(self.simd, self.of), ..self }
    }

    /// ln(1 + x) for x from 0 to 1, within 3 units in the last place.
    #[inline(always)]
    pub fn ln_1p_share(self) -> Self {
        Self { of: T::ln_1p_share_lanes(self.simd, self.of), ..self }
    }

    /// e^x within 2 units in the last place, also where it is subnormal or infinite.
    #[inline(always)]
    pub fn exp(self) -> Self {
        Self { of: T::exp_lanes(self.simd, self.of), ..self }
    }

    /// ln x within 3 units in the last place; −∞ of 0, not a number below.
    #[inline(always)]
    pub fn ln(self) -> Self {
        Self { of: T::ln_lanes(self.simd, self.of), ..self }
    }

    /// sin x and cos x within 1e-7.
    #[inline(always)]
    pub fn sin_cos(self) -> (Self, Self) {
        let (sine, cosine) = T::sin_cos_lanes(self.simd, self.of);
        (Self { of: sine, ..self }, Self { of: cosine, ..self })
    }

    #[inline(always)]
    pub fn sum(self) -> T {
        T::sum_lanes(self.simd, self.of)
    }

    #[inline(always)]
    pub fn largest(self) -> T {
        T::largest_lanes(self.simd, self.of)
    }
}

impl<T: Real, S: Simd> Mask<T, S> {
    /// Whether one is set.
    #[inline(always)]
    pub fn any(self) -> bool {
        T::any_lane(self.simd, self.of)
    }
}

macro_rules! operator {
    ($operator:ident, $function:ident, $of:ident, $instruction:ident) => {
        impl<T: Real, S: Simd> $operator for $of<T, S> {
            type Output = Self;

            #[inline(always)]
            fn $function(self, other: Self) -> Self {
                Self { of: T::$instruction(self.simd, self.of, other.of), ..self }
            }
        }
    };
}
operator!(Add, add, Lanes, add_lanes);
operator!(Sub, sub, Lanes, sub_lanes);
operator!(Mul, mul, Lanes, mul_lanes);
operator!(Div, div, Lanes, div_lanes);
operator!(BitAnd, bitand, Mask, both_lanes);
operator!(BitOr, bitor, Mask, either_lanes);

impl<T: Real, S: Simd> Neg for Lanes<T, S> {
    type Output = Self;

    #[inline(always)]
    fn neg(self) -> Self {
        Self::zero(self.simd) - self
    }
}

#[cfg(test)]
mod tests {
    use pulp::WithSimd;

    use super::*;
    use crate::backend::vectorised::vectorised;
    use crate::backend::vectors::MOST;

    /// Replaces numbers by their exponentials or by the logarithms of 1 and them, by lanes.
    struct Functions<'a, T, const LOGARITHM: bool>(&'a mut [T]);

    impl<T: Real, const LOGARITHM: bool> WithSimd for Functions<'_, T, LOGARITHM> {
        type Output = ();

        #[inline(always)]
        fn with_simd<S: Simd>(self, simd: S) {
            for values in self.0.chunks_exact_mut(T::lane_count::<S>()) {
                let of = Lanes::load(simd, values);
                if LOGARITHM { of.ln_1p_share() } else { of.exp_nonpositive() }.store(values);
            }
        }
    }

    #[test]
    fn exponentials_by_lanes_and_of_single_numbers_are_accurate_and_vanish_far_below() {
        let arguments: Vec<f32> = (0..200_000).map(|step| -(step as f32) * 1e-4).collect();
        let mut found = arguments.clone();
        vectorised(Functions::<_, false>(&mut found));
        for (argument, found) in arguments.into_iter().zip(found) {
            let exact = f64::from(argument).exp();
            for found in [found, argument.exp_nonpositive()] {
                assert!((f64::from(found) - exact).abs() < 2.5e-7 * exact, "exp({argument}) is {found}, not {exact}");
            }
        }
        assert_eq!(0f32.exp_nonpositive(), 1.0);
        let mut far = [f32::NEG_INFINITY, -1e30, -200.0, f32::NAN].repeat(4);
        assert!(far.iter().all(|value| value.exp_nonpositive() < 1e-37));
        vectorised(Functions::<_, false>(&mut far));
        assert!(far.iter().all(|&value| value < 1e-37), "{far:?}");
        let mut exact: Vec<f64> = (0..16).map(|step| -f64::from(step)).collect();
        vectorised(Functions::<_, false>(&mut exact));
        assert!(exact.iter().enumerate().all(|(step, &value)| value == (-(step as f64)).exp()), "{exact:?}");
    }

    /// Results of the operations on two vectors of 16 numbers.
    struct Operations<'a, T>(&'a [T; MOST], &'a [T; MOST]);

    impl<T: Real> WithSimd for Operations<'_, T> {
        type Output = (Vec<[T; 10]>, T, T);

        #[inline(always)]
        fn with_simd<S: Simd>(self, simd: S) -> Self::Output {
            let count = T::lane_count::<S>();
            let (mut rows, mut sum, mut largest) = (Vec::new(), T::zero(), -T::INFINITY);
            for (a, b) in self.0.chunks_exact(count).zip(self.1.chunks_exact(count)) {
                let (a, b) = (Lanes::load(simd, a), Lanes::load(simd, b));
                assert_eq!(a.at_least(b).any(), (a - b).largest() >= T::zero());
                let both = a.at_least(b) & Lanes::splat(simd, -T::one()).below(b);
                let of = [
                    a + b,
                    a - b,
                    a.mul_add(b, a * b),
                    a.max(b),
                    Lanes::select(both, a, b),
                    a.only(both),
                    a.only(both | a.below(b)),
                    a.min(b),
                    a.abs(),
                    a / Lanes::splat(simd, T::of(4.0)),
                ];
                let mut stored = [[T::zero(); MOST]; 10];
                of.iter().zip(&mut stored).for_each(|(lanes, stored)| lanes.store(stored));
                rows.extend((0..count).map(|lane| stored.map(|row| row[lane])));
                sum = sum + a.sum();
                largest = largest.max(a.largest());
            }
            (rows, sum, largest)
        }
    }

    fn operations_are_those_of_single_numbers<T: Real>() {
        let a: [T; MOST] = std::array::from_fn(|i| T::of(i as f64 - 5.0));
        let b: [T; MOST] = std::array::from_fn(|i| T::of((i * 7 % 16) as f64 - 4.0));
        let (rows, sum, largest) = vectorised(Operations(&a, &b));
        assert_eq!((rows.len(), sum.as_f64(), largest.as_f64()), (MOST, 40.0, 10.0));
        for ((&a, &b), row) in a.iter().zip(&b).zip(rows) {
            let both = a >= b && b > -T::one();
            let [chosen, only] = if both { [a, a] } else { [b, T::zero()] };
            let either = if both || a < b { a } else { T::zero() };
            let quarter = a / T::of(4.0);
            let expected = [a + b, a - b, a * b + a * b, a.max(b), chosen, only, either, a.min(b), a.abs(), quarter];
            assert_eq!(row.map(T::as_f64), expected.map(T::as_f64));
        }
    }

    #[test]
    fn logarithms_are_accurate_from_one_to_two() {
        let arguments: Vec<f32> = (0..=200_016).flat_map(|step| [5e-6, 5e-12].map(|unit| step as f32 * unit)).collect();
        let arguments: Vec<f32> = arguments.into_iter().filter(|&x| x <= 1.0).take(400_000).collect();
        let mut found = arguments.clone();
        vectorised(Functions::<_, true>(&mut found));
        for (argument, found) in arguments.into_iter().zip(found) {
            let exact = f64::from(argument).ln_1p();
            assert!((f64::from(found) - exact).abs() <= 3.6e-7 * exact, "ln(1 + {argument}) is {found}, not {exact}");
        }
        let mut exact: Vec<f64> = (0..16).map(|step| f64::from(step) / 16.0).collect();
        vectorised(Functions::<_, true>(&mut exact));
        assert!(exact.iter().enumerate().all(|(step, &value)| value == (step as f64 / 16.0).ln_1p()), "{exact:?}");
    }

    #[test]
    fn both_kinds_of_numbers_have_the_same_operations() {
        operations_are_those_of_single_numbers::<f32>();
        operations_are_those_of_single_numbers::<f64>();
    }
}
