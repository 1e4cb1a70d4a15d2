//! Beliefs made directly from what they hold.

use nalgebra::{Matrix2, Vector2};
use rand::RngExt;
use rand_xoshiro::Xoshiro256PlusPlus;
use rand_xoshiro::rand_core::SeedableRng;
use sumprod_fusion::{Fusible, InformationSet, Item, Known};
use sumprod_messages::{Categorical, Gaussian, MixtureMessage};

pub type Random = Xoshiro256PlusPlus;

pub fn random(seed: u64) -> Random {
    Random::seed_from_u64(seed)
}

pub fn uniform(random: &mut Random, low: f64, high: f64) -> f64 {
    low + (high - low) * random.random::<f64>()
}

pub fn below(random: &mut Random, count: usize) -> usize {
    (random.random::<f64>() * count as f64) as usize % count
}

/// A family with a prior and a likelihood for every item.
pub trait World: Fusible {
    fn prior() -> Self;
    fn likelihood(item: Item) -> Self;
    fn times(&self, other: &Self) -> Self;
    /// How far two beliefs are from each other, relative to what they say.
    fn distance(&self, other: &Self) -> f64;

    /// The posterior of the items, in order.
    fn posterior(items: &InformationSet) -> Self {
        items.iter().fold(Self::prior(), |belief, item| match item {
            Item::PRIOR => belief,
            item => belief.times(&Self::likelihood(item)),
        })
    }

    fn known() -> Known<Self> {
        Known::new(InformationSet::prior(), Self::prior())
    }
}

fn of_item(item: Item) -> Random {
    random(u64::from(item.source) * 1_000_003 + item.number)
}

impl World for Gaussian<2> {
    fn prior() -> Self {
        Self::from_moments(Vector2::new(1.0, -2.0), Matrix2::new(9.0, 1.0, 1.0, 4.0)).unwrap()
    }

    /// One direction at a time: likelihoods of rank one.
    fn likelihood(item: Item) -> Self {
        let mut random = of_item(item);
        let h = Vector2::new(uniform(&mut random, -1.0, 1.0), uniform(&mut random, -1.0, 1.0));
        let weight = uniform(&mut random, 0.1, 2.0);
        Self::from_information(h * h.transpose() * weight, h * (weight * uniform(&mut random, -3.0, 3.0)))
    }

    fn times(&self, other: &Self) -> Self {
        Gaussian::times(self, other)
    }

    fn distance(&self, other: &Self) -> f64 {
        let information = (self.information() - other.information()).norm() / other.information().norm();
        let vector = self.information_vector() - other.information_vector();
        information.max(vector.norm() / (1.0 + other.information_vector().norm()))
    }
}

impl World for Categorical {
    fn prior() -> Self {
        Self::from_probabilities(&[0.5, 0.3, 0.2]).unwrap()
    }

    fn likelihood(item: Item) -> Self {
        let mut random = of_item(item);
        Self::from_probabilities(&std::array::from_fn::<f64, 3, _>(|_| uniform(&mut random, 0.1, 1.0)))
            .unwrap()
    }

    fn times(&self, other: &Self) -> Self {
        let logs: Vec<f64> = self.logs().iter().zip(other.logs()).map(|(a, b)| a + b).collect();
        Self::new(&logs).unwrap()
    }

    fn distance(&self, other: &Self) -> f64 {
        let pairs = self.probabilities().into_iter().zip(other.probabilities());
        pairs.map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
    }
}

/// A mixture of one coordinate by its moments and a few values.
pub fn mixture_distance(a: &MixtureMessage, b: &MixtureMessage) -> f64 {
    let value = |m: &MixtureMessage, x: f64| m.log_value(&[x]).unwrap() - m.log_value(&[0.0]).unwrap();
    [-3.0, -1.0, 0.5, 2.0, 4.0].map(|x| (value(a, x) - value(b, x)).abs()).into_iter().fold(0.0, f64::max)
}
