//! One number, or a vector of them: formulas that are the same for all primitives are written once, for both.

use std::ops::{Add, BitAnd, BitOr, Div, Mul, Neg, Sub};

use pulp::Simd;

use super::lanes::{Lanes, Mask};
use super::real::Real;
use super::vectors::MOST;

/// Numbers, or as many as a vector of the machine holds.
pub trait Arithmetic: Copy + Add<Output = Self> + Sub<Output = Self> + Mul<Output = Self> + Neg<Output = Self> {}

impl<N: Copy + Add<Output = N> + Sub<Output = N> + Mul<Output = N> + Neg<Output = N>> Arithmetic for N {}

/// A [`Real`], or [`Lanes`] of one.
pub trait Number: Arithmetic + Div<Output = Self> {
    /// The result of a comparison.
    type Mask: Copy + BitAnd<Output = Self::Mask> + BitOr<Output = Self::Mask>;

    /// `value` in all lanes, like `self`.
    fn constant(self, value: f64) -> Self;
    fn sqrt(self) -> Self;
    fn abs(self) -> Self;
    fn exp(self) -> Self;
    fn ln(self) -> Self;
    fn sin_cos(self) -> (Self, Self);
    /// [`Real::exp_nonpositive`]
    fn exp_nonpositive(self) -> Self;
    /// [`Real::ln_1p_share`]
    fn ln_1p_share(self) -> Self;
    /// `other` if self is not a number.
    fn max(self, other: Self) -> Self;
    /// `other` if self is not a number.
    fn min(self, other: Self) -> Self;
    /// self ≥ other
    fn at_least(self, other: Self) -> Self::Mask;
    /// self < other
    fn below(self, other: Self) -> Self::Mask;
    /// `a` where the mask is set, else `b`.
    fn select(mask: Self::Mask, a: Self, b: Self) -> Self;
    /// Whether the mask is set in some lane.
    fn any(mask: Self::Mask) -> bool;
    /// `function` in f64, lane by lane: for what has no form in vectors.
    fn each<const I: usize, const O: usize>(inputs: [Self; I], function: impl Fn([f64; I]) -> [f64; O]) -> [Self; O];
}

macro_rules! delegate {
    ($of:ty: $($function:ident($($argument:ident),*) -> $result:ty;)+) => {
        $(
            #[inline(always)]
            fn $function(self, $($argument: Self),*) -> $result {
                <$of>::$function(self, $($argument),*)
            }
        )+
    };
}

impl<T: Real> Number for T {
    type Mask = bool;

    delegate! {
        T: sqrt() -> Self; abs() -> Self; exp() -> Self; ln() -> Self; sin_cos() -> (Self, Self);
        exp_nonpositive() -> Self; ln_1p_share() -> Self; max(other) -> Self; min(other) -> Self;
    }

    #[inline(always)]
    fn constant(self, value: f64) -> Self {
        T::of(value)
    }

    #[inline(always)]
    fn at_least(self, other: Self) -> bool {
        self >= other
    }

    #[inline(always)]
    fn below(self, other: Self) -> bool {
        self < other
    }

    #[inline(always)]
    fn select(mask: bool, a: Self, b: Self) -> Self {
        if mask { a } else { b }
    }

    #[inline(always)]
    fn any(mask: bool) -> bool {
        mask
    }

    #[inline(always)]
    fn each<const I: usize, const O: usize>(inputs: [Self; I], function: impl Fn([f64; I]) -> [f64; O]) -> [Self; O] {
        function(inputs.map(T::as_f64)).map(T::of)
    }
}

impl<T: Real, S: Simd> Number for Lanes<T, S> {
    type Mask = Mask<T, S>;

    #[inline(always)]
    fn constant(self, value: f64) -> Self {
        Self::splat(self.simd(), T::of(value))
    }

    delegate! {
        Self: sqrt() -> Self; abs() -> Self; exp() -> Self; ln() -> Self; sin_cos() -> (Self, Self);
        exp_nonpositive() -> Self; ln_1p_share() -> Self; max(other) -> Self; min(other) -> Self;
        at_least(other) -> Mask<T, S>; below(other) -> Mask<T, S>;
    }

    #[inline(always)]
    fn select(mask: Mask<T, S>, a: Self, b: Self) -> Self {
        Lanes::select(mask, a, b)
    }

    #[inline(always)]
    fn any(mask: Mask<T, S>) -> bool {
        mask.any()
    }

    #[inline(always)]
    fn each<const I: usize, const O: usize>(inputs: [Self; I], function: impl Fn([f64; I]) -> [f64; O]) -> [Self; O] {
        let mut columns = [[T::zero(); MOST]; O];
        for (lane, row) in Self::to_rows(inputs).into_iter().enumerate().take(T::lane_count::<S>()) {
            for (column, value) in columns.iter_mut().zip(function(row.map(T::as_f64))) {
                column[lane] = T::of(value);
            }
        }
        columns.map(|column| Self::load(inputs[0].simd(), &column))
    }
}
