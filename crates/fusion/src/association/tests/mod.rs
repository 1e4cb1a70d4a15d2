//! Laws of the mixture, of its fields and of the assignment; random scenes have fixed seeds.

mod assignments;
mod edges;
mod fields;
mod laws;
mod posterior;

use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, StandardNormal};
use rand_xoshiro::Xoshiro256PlusPlus;

use super::{
    Association, BiasField, BiasPrior, CoherentDrift, Mixture, Sensors, Start, Tails, Tracks, associate,
};

const DEGREE: f64 = std::f64::consts::PI / 180.0;

const SENSORS: Sensors = Sensors { first: [0.0, 0.0], second: [60e3, 0.0] };

/// Deviation of a coordinate of a track (m).
const NOISE: f64 = 100.0;

/// A draw of targets and tracks in one or more scans.
struct Scene {
    first: Tracks,
    second: Tracks,
    /// Whose track each is; those above the number of targets are false.
    first_owners: Vec<usize>,
    second_owners: Vec<usize>,
}

impl Scene {
    /// `targets` that both sensors see with probability 0.9 beside `false_tracks` each, at the density of 30 in 60 km
    /// by 60 km; `biases` scan by scan.
    fn new(seed: u64, targets: usize, false_tracks: usize, biases: &[[f64; 4]]) -> Self {
        let mut random = Xoshiro256PlusPlus::seed_from_u64(seed);
        let side = (targets.max(1) as f64 * 120e6).sqrt();
        let courses: Vec<[f64; 4]> =
            (0..targets + 2 * false_tracks).map(|_| course(side, &mut random)).collect();
        let mut look = |sensor: usize, place: [f64; 2]| {
            let mut sees = |owner: &usize| match owner.checked_sub(targets) {
                None => random.random::<f64>() < 0.9,
                Some(number) => number % 2 == sensor,
            };
            let owners: Vec<usize> = (0..courses.len()).filter(|owner| sees(owner)).collect();
            let mut coordinates = Vec::new();
            for owner in &owners {
                for (scan, biases) in biases.iter().enumerate() {
                    let [x, y, vx, vy] = courses[*owner];
                    let time = 10.0 * scan as f64;
                    let noise: [f64; 2] = std::array::from_fn(|_| StandardNormal.sample(&mut random));
                    let seen = [x + time * vx + NOISE * noise[0], y + time * vy + NOISE * noise[1]];
                    coordinates.extend(biased(seen, place, [biases[2 * sensor], biases[2 * sensor + 1]]));
                }
            }
            (Tracks::new(2, biases.len(), coordinates).unwrap(), owners)
        };
        let (first, first_owners) = look(0, SENSORS.first);
        let (second, second_owners) = look(1, SENSORS.second);
        Self { first, second, first_owners, second_owners }
    }

    /// Share of the common targets whose tracks are paired.
    fn correct(&self, found: &Association) -> f64 {
        let common = self.first_owners.iter().filter(|owner| self.second_owners.contains(owner)).count();
        let right = |pair: &&super::Pair| self.first_owners[pair.first] == self.second_owners[pair.second];
        found.pairs.iter().filter(right).count() as f64 / common as f64
    }
}

fn course(side: f64, random: &mut Xoshiro256PlusPlus) -> [f64; 4] {
    let [x, y, vx, vy]: [f64; 4] = random.random();
    [side * x, 20e3 + side * y, 400.0 * (vx - 0.5), 400.0 * (vy - 0.5)]
}

fn biased(place: [f64; 2], sensor: [f64; 2], [range, azimuth]: [f64; 2]) -> [f64; 2] {
    let (dx, dy) = (place[0] - sensor[0], place[1] - sensor[1]);
    let (distance, angle) = (dx.hypot(dy) + range, dy.atan2(dx) + azimuth);
    [sensor[0] + distance * angle.cos(), sensor[1] + distance * angle.sin()]
}

/// Biases of level 2 with these signs.
fn level_two(signs: [f64; 4]) -> [f64; 4] {
    [600.0 * signs[0], DEGREE * signs[1], 600.0 * signs[2], DEGREE * signs[3]]
}

fn prior() -> BiasPrior {
    BiasPrior::independent(1500.0, 2.5 * DEGREE)
}

fn by_bias(scene: &Scene, mixture: &Mixture) -> (Association, BiasField) {
    let mut field = BiasField::new(SENSORS, prior()).unwrap();
    let found = associate(&scene.first, &scene.second, &mut field, mixture).unwrap();
    (found, field)
}

fn by_drift(scene: &Scene, mixture: &Mixture) -> Association {
    let mut field = CoherentDrift::new(3.0, 3.0).unwrap();
    associate(&scene.first, &scene.second, &mut field, mixture).unwrap()
}

/// The paper's own mixture.
fn paper() -> Mixture {
    Mixture {
        tails: Tails::Estimated(3.0),
        outlier_weight: 0.0,
        start: Start::Spread,
        ..Mixture::flexible(3000.0)
    }
}

/// Gaussian coherent point drift.
fn gaussian() -> Mixture {
    Mixture {
        tails: Tails::Gaussian,
        outlier_weight: 0.2,
        estimate_weights: false,
        start: Start::Spread,
        ..Mixture::flexible(3000.0)
    }
}
