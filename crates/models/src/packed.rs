//! Eight numbers as one: residuals and motions evaluated at eight particles at a time.
//!
//! What users write for any [`Real`](crate::Real) runs on these numbers too, lane by lane, and the compiler makes
//! vector instructions of it. A function that looks at a number to branch on it would take one lane's branch for all
//! eight; so looking (a comparison, or [`DualStruct::re`]) is noted, and whoever evaluated asks [`looked`] and
//! evaluates again, one particle at a time. Functions without such branches, which is most, never pay for that.

use num_dual::{DualNum, DualStruct, Mappable};
use rand_distr::num_traits::{FromPrimitive, Inv, Num, One, Signed, Zero};
use std::any::TypeId;
use std::array::from_fn;
use std::cell::Cell;
use std::cmp::Ordering;
use std::fmt;
use std::iter::{Product, Sum};
use std::ops::{Add, AddAssign, Div, DivAssign, Mul, MulAssign, Neg, Rem, RemAssign, Sub, SubAssign};
use sumprod_messages::vector;

/// Numbers in a [`Packed`].
pub(crate) const WIDTH: usize = 8;

/// Eight numbers that are worked on alike.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Packed(pub(crate) [f64; WIDTH]);

thread_local! {
    static LOOKED: Cell<bool> = const { Cell::new(false) };
}

/// Whether a packed number was looked at on this thread since the last call.
pub(crate) fn looked() -> bool {
    LOOKED.replace(false)
}

/// Whether a number type is [`Packed`]; known when compiling.
#[inline(always)]
pub(crate) fn is_packed<T: 'static>() -> bool {
    TypeId::of::<T>() == TypeId::of::<Packed>()
}

impl Packed {
    #[inline(always)]
    pub(crate) fn map(self, f: impl Fn(f64) -> f64) -> Self {
        Self(from_fn(|lane| f(self.0[lane])))
    }

    #[inline(always)]
    fn with(self, other: Self, f: impl Fn(f64, f64) -> f64) -> Self {
        Self(from_fn(|lane| f(self.0[lane], other.0[lane])))
    }

    #[inline(always)]
    fn all(self, f: impl Fn(f64) -> bool) -> bool {
        self.0.iter().fold(true, |all, &x| all & f(x))
    }

    /// `fast` where every lane is in its range, else the library's function.
    #[inline(always)]
    fn either(self, range: impl Fn(f64) -> bool, fast: impl Fn(f64) -> f64, exact: fn(f64) -> f64) -> Self {
        if self.all(range) { self.map(fast) } else { self.map(exact) }
    }
}

#[inline(always)]
fn of(x: f64) -> Packed {
    Packed([x; WIDTH])
}

macro_rules! operator {
    ($($trait:ident $method:ident $assign:ident $assign_method:ident $operator:tt;)*) => { $(
        impl $trait for Packed {
            type Output = Self;
            #[inline(always)]
            fn $method(self, other: Self) -> Self {
                self.with(other, |a, b| a $operator b)
            }
        }

        impl $trait<&Self> for Packed {
            type Output = Self;
            #[inline(always)]
            fn $method(self, other: &Self) -> Self {
                self $operator *other
            }
        }

        impl $trait<f64> for Packed {
            type Output = Self;
            #[inline(always)]
            fn $method(self, other: f64) -> Self {
                self.map(|a| a $operator other)
            }
        }

        impl $assign for Packed {
            #[inline(always)]
            fn $assign_method(&mut self, other: Self) {
                *self = *self $operator other;
            }
        }

        impl $assign<f64> for Packed {
            #[inline(always)]
            fn $assign_method(&mut self, other: f64) {
                *self = *self $operator other;
            }
        }
    )* };
}

operator! {
    Add add AddAssign add_assign +;
    Sub sub SubAssign sub_assign -;
    Mul mul MulAssign mul_assign *;
    Div div DivAssign div_assign /;
    Rem rem RemAssign rem_assign %;
}

impl Neg for Packed {
    type Output = Self;
    #[inline(always)]
    fn neg(self) -> Self {
        self.map(|x| -x)
    }
}

impl Inv for Packed {
    type Output = Self;
    #[inline(always)]
    fn inv(self) -> Self {
        self.map(f64::recip)
    }
}

impl Sum for Packed {
    fn sum<I: Iterator<Item = Self>>(all: I) -> Self {
        all.fold(of(0.0), Add::add)
    }
}

impl<'a> Sum<&'a Self> for Packed {
    fn sum<I: Iterator<Item = &'a Self>>(all: I) -> Self {
        all.copied().sum()
    }
}

impl Product for Packed {
    fn product<I: Iterator<Item = Self>>(all: I) -> Self {
        all.fold(of(1.0), Mul::mul)
    }
}

impl<'a> Product<&'a Self> for Packed {
    fn product<I: Iterator<Item = &'a Self>>(all: I) -> Self {
        all.copied().product()
    }
}

impl From<f64> for Packed {
    #[inline(always)]
    fn from(x: f64) -> Self {
        of(x)
    }
}

impl FromPrimitive for Packed {
    fn from_i64(n: i64) -> Option<Self> {
        f64::from_i64(n).map(of)
    }

    fn from_u64(n: u64) -> Option<Self> {
        f64::from_u64(n).map(of)
    }

    #[inline(always)]
    fn from_f64(n: f64) -> Option<Self> {
        Some(of(n))
    }
}

impl Zero for Packed {
    #[inline(always)]
    fn zero() -> Self {
        of(0.0)
    }

    fn is_zero(&self) -> bool {
        self.re() == 0.0
    }
}

impl One for Packed {
    #[inline(always)]
    fn one() -> Self {
        of(1.0)
    }
}

impl Num for Packed {
    type FromStrRadixErr = <f64 as Num>::FromStrRadixErr;

    fn from_str_radix(text: &str, radix: u32) -> Result<Self, Self::FromStrRadixErr> {
        f64::from_str_radix(text, radix).map(of)
    }
}

impl Signed for Packed {
    #[inline(always)]
    fn abs(&self) -> Self {
        self.map(f64::abs)
    }

    #[inline(always)]
    fn abs_sub(&self, other: &Self) -> Self {
        self.with(*other, |a, b| if a > b { a - b } else { 0.0 })
    }

    #[inline(always)]
    fn signum(&self) -> Self {
        self.map(f64::signum)
    }

    fn is_positive(&self) -> bool {
        self.re().is_sign_positive()
    }

    fn is_negative(&self) -> bool {
        self.re().is_sign_negative()
    }
}

impl PartialEq for Packed {
    fn eq(&self, other: &Self) -> bool {
        self.re() == other.re()
    }
}

impl PartialEq<f64> for Packed {
    fn eq(&self, other: &f64) -> bool {
        self.re() == *other
    }
}

impl PartialOrd for Packed {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        self.re().partial_cmp(&other.re())
    }
}

impl PartialOrd<f64> for Packed {
    fn partial_cmp(&self, other: &f64) -> Option<Ordering> {
        self.re().partial_cmp(other)
    }
}

impl fmt::Display for Packed {
    fn fmt(&self, formatter: &mut fmt::Formatter<'_>) -> fmt::Result {
        LOOKED.set(true);
        fmt::Debug::fmt(&self.0, formatter)
    }
}

impl DualStruct for Packed {
    type Real = f64;
    type Inner = f64;

    fn re(&self) -> f64 {
        LOOKED.set(true);
        self.0[0]
    }

    fn from_inner(inner: &f64) -> Self {
        of(*inner)
    }
}

impl Mappable<Self> for Packed {
    type Output<O> = O;

    fn map_dual<M: FnOnce(Self) -> O, O>(self, f: M) -> O {
        f(self)
    }
}

macro_rules! lane_by_lane {
    ($($function:ident)*) => { $(
        fn $function(&self) -> Self {
            self.map(|x| DualNum::$function(&x))
        }
    )* };
}

impl DualNum for Packed {
    type Primitive = f64;
    const NDERIV: usize = 0;
    type InnerDual = f64;

    #[inline(always)]
    fn from_re(re: f64) -> Self {
        of(re)
    }

    #[inline(always)]
    fn scale(self, factor: &f64) -> Self {
        self * *factor
    }

    #[inline(always)]
    fn recip(&self) -> Self {
        self.map(f64::recip)
    }

    #[inline(always)]
    fn powi(&self, n: i32) -> Self {
        self.map(|x| x.powi(n))
    }

    fn powf(&self, n: f64) -> Self {
        self.map(|x| x.powf(n))
    }

    fn powd(&self, n: Self) -> Self {
        self.with(n, f64::powf)
    }

    fn log(&self, base: f64) -> Self {
        self.map(|x| x.log(base))
    }

    #[inline(always)]
    fn sqrt(&self) -> Self {
        self.map(f64::sqrt)
    }

    #[inline(always)]
    fn exp(&self) -> Self {
        self.either(|x| (-708.0..=709.0).contains(&x), vector::exp, f64::exp)
    }

    #[inline(always)]
    fn ln(&self) -> Self {
        self.either(|x| (f64::MIN_POSITIVE..=f64::MAX).contains(&x), vector::ln, f64::ln)
    }

    #[inline(always)]
    fn sin(&self) -> Self {
        self.sin_cos().0
    }

    #[inline(always)]
    fn cos(&self) -> Self {
        self.sin_cos().1
    }

    #[inline(always)]
    fn sin_cos(&self) -> (Self, Self) {
        let near = self.all(|x| x.abs() < vector::LARGEST_ANGLE);
        let both: [(f64, f64); WIDTH] = if near {
            from_fn(|lane| vector::sin_cos(self.0[lane]))
        } else {
            from_fn(|lane| self.0[lane].sin_cos())
        };
        (Self(both.map(|(sine, _)| sine)), Self(both.map(|(_, cosine)| cosine)))
    }

    #[inline(always)]
    fn atan2(&self, other: Self) -> Self {
        // Beyond this the sum of two lengths would leave the range of numbers.
        let moderate = self.all(|y| y.abs() < 1e300) & other.all(|x| x.abs() < 1e300);
        if moderate { self.with(other, vector::atan2) } else { self.with(other, f64::atan2) }
    }

    #[inline(always)]
    fn atan(&self) -> Self {
        self.atan2(of(1.0))
    }

    #[inline(always)]
    fn mul_add(&self, a: Self, b: Self) -> Self {
        *self * a + b
    }

    lane_by_lane! {
        cbrt exp2 exp_m1 log2 log10 ln_1p tan asin acos sinh cosh tanh asinh acosh atanh sph_j0 sph_j1 sph_j2
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn sample() -> Packed {
        Packed([0.3, 1.5, 2.5, 0.01, 7.0, 0.9, 100.0, 3.0])
    }

    #[test]
    fn every_function_agrees_with_the_scalar_one() {
        let x = sample();
        let unit = x * 0.005;
        let check = |packed: Packed, of: Packed, exact: fn(f64) -> f64| {
            for (value, x) in packed.0.iter().zip(of.0) {
                assert!((value - exact(x)).abs() <= 2e-15 * exact(x).abs().max(1.0), "{x}: {value}");
            }
        };
        check(x.sqrt(), x, f64::sqrt);
        check(x.exp() * (-x).exp(), x, |_| 1.0);
        check(x.ln(), x, f64::ln);
        check(x.sin(), x, f64::sin);
        check(x.cos(), x, f64::cos);
        check(x.atan(), x, f64::atan);
        check((-x).atan2(-x * x), x, |x| (-x).atan2(-x * x));
        check(unit.asin(), unit, f64::asin);
        check(x.ln_1p(), x, f64::ln_1p);
        check(x.powi(3) / x / x, x, |x| x);
        check((x * 1e9).sin(), x * 1e9, f64::sin);
        assert!(of(-1.0).ln().0[0].is_nan() && of(0.0).ln().0[0] == f64::NEG_INFINITY);
        assert_eq!(of(1000.0).exp().0[0], f64::INFINITY);
    }

    #[test]
    fn looking_is_noted_once() {
        looked();
        let x = sample();
        assert!(!looked());
        let _ = (x.re(), x < 1.0);
        assert!(looked() && !looked());
        let _ = x.sqrt() + x * 2.0 - x.abs();
        assert!(!looked());
        assert!(is_packed::<Packed>() && !is_packed::<f64>());
    }
}
