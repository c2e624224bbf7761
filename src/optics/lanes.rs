//! Numbers side by side, in the widest vectors the processor has.

use pulp::Simd;

/// Vectors that are followed together: while one waits for a root or a division, the others go on.
const TOGETHER: usize = 2;

/// Numbers side by side: what is done to one is done to all.
#[derive(Clone, Copy)]
pub(super) struct Lanes<S: Simd> {
    pub(super) simd: S,
    x: [S::f64s; TOGETHER],
}

impl<S: Simd> Lanes<S> {
    /// How many they are.
    pub(super) const COUNT: usize = TOGETHER * S::F64_LANES;

    #[inline(always)]
    pub(super) fn all(simd: S, x: f64) -> Self {
        Self { simd, x: [simd.splat_f64s(x); TOGETHER] }
    }

    /// The first of `column`.
    #[inline(always)]
    pub(super) fn load(simd: S, column: &[f64]) -> Self {
        let vectors = S::as_simd_f64s(column).0;
        Self { simd, x: std::array::from_fn(|i| vectors[i]) }
    }

    #[inline(always)]
    pub(super) fn store(self, column: &mut [f64]) {
        S::as_mut_simd_f64s(column).0[..TOGETHER].copy_from_slice(&self.x);
    }

    #[inline(always)]
    fn each(self, f: impl Fn(usize) -> S::f64s) -> Self {
        Self { x: std::array::from_fn(f), ..self }
    }

    #[inline(always)]
    pub(super) fn sqrt(self) -> Self {
        self.each(|i| self.simd.sqrt_f64s(self.x[i]))
    }

    #[inline(always)]
    pub(super) fn abs(self) -> Self {
        self.each(|i| self.simd.abs_f64s(self.x[i]))
    }

    /// self b + c.
    #[inline(always)]
    pub(super) fn mul_add(self, b: Self, c: Self) -> Self {
        self.each(|i| self.simd.mul_add_e_f64s(self.x[i], b.x[i], c.x[i]))
    }

    /// `yes` where self < 0, else `no`.
    #[inline(always)]
    pub(super) fn if_negative(self, yes: Self, no: Self) -> Self {
        let zero = self.simd.splat_f64s(0.0);
        self.each(|i| self.simd.select_f64s(self.simd.less_than_f64s(self.x[i], zero), yes.x[i], no.x[i]))
    }

    #[inline(always)]
    pub(super) fn sum(self) -> f64 {
        self.x.iter().map(|x| self.simd.reduce_sum_f64s(*x)).sum()
    }
}

macro_rules! operator {
    ($name:ident, $function:ident, $vector:ident) => {
        impl<S: Simd> std::ops::$name for Lanes<S> {
            type Output = Self;
            #[inline(always)]
            fn $function(self, other: Self) -> Self {
                self.each(|i| self.simd.$vector(self.x[i], other.x[i]))
            }
        }

        impl<S: Simd> std::ops::$name<Lanes<S>> for f64 {
            type Output = Lanes<S>;
            #[inline(always)]
            fn $function(self, other: Lanes<S>) -> Lanes<S> {
                Lanes::all(other.simd, self).$function(other)
            }
        }

        impl<S: Simd> std::ops::$name<f64> for Lanes<S> {
            type Output = Self;
            #[inline(always)]
            fn $function(self, other: f64) -> Self {
                self.$function(Self::all(self.simd, other))
            }
        }
    };
}

operator!(Add, add, add_f64s);
operator!(Sub, sub, sub_f64s);
operator!(Mul, mul, mul_f64s);
operator!(Div, div, div_f64s);

impl<S: Simd> std::ops::Neg for Lanes<S> {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        self.each(|i| self.simd.neg_f64s(self.x[i]))
    }
}

/// 1 / x of each by one division: what takes longest.
#[inline(always)]
pub(super) fn inverses<S: Simd, const N: usize>(x: [Lanes<S>; N]) -> [Lanes<S>; N] {
    let mut before = [Lanes::all(x[0].simd, 1.0); N];
    for i in 1..N {
        before[i] = before[i - 1] * x[i - 1];
    }
    let mut rest = 1.0 / (before[N - 1] * x[N - 1]);
    for i in (0..N).rev() {
        before[i] = rest * before[i];
        rest = rest * x[i];
    }
    before
}
