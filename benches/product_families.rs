//! Gibbs samplers of products at equal time, on families where modes are separated or kernels narrow.
//!
//! For each family twenty random instances; weights are Dirichlet(3). The error is the total variation between the
//! exact product and the density of a sampler's output, both on a grid, the latter from the labels of 5,000 chains
//! (which leave a floor of about one per cent themselves). Multiscale sampling runs with one sweep a level, from the
//! roots of its trees (`roots`) and from the finest level that can be enumerated (`multiscale`); plain Gibbs sampling,
//! from both its starts, gets as many sweeps as make it take at least as long as the slower of these, and ten at
//! least.
//!
//! | family | generator |
//! |---|---|
//! | overlap | centres N(0, 1), kernels' standard deviation 0.5 |
//! | narrow | centres N(0, 1), kernels 0.15 |
//! | bimodal | centres at -2 or 2, equally likely, and N(0, 0.3²) about them; kernels 0.3 |
//! | rings | range rings of radius to a common point and N(0, s²) more about anchors 60 to 100 m away in random directions, centres equally spaced from a random phase; kernels s |
//!
//! `cargo bench --bench product_families [-- narrow]`

use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, StandardNormal};
use rand_xoshiro::Xoshiro256PlusPlus;
use std::time::Instant;
use sumprod::graph::{Purpose, Space, Stream};
use sumprod::messages::{Evaluator, Gibbs, GibbsStart, Mixture, MultiscaleGibbs};

type Fallible<T> = Result<T, Box<dyn std::error::Error>>;

const INSTANCES: u64 = 20;
const CHAINS: usize = 5000;

struct Family {
    name: &'static str,
    /// Standard deviation of the kernels.
    width: f64,
    sizes: &'static [(usize, usize)],
}

const FAMILIES: [Family; 5] = [
    Family { name: "overlap", width: 0.5, sizes: &[(2, 10), (3, 10), (3, 100)] },
    Family { name: "narrow", width: 0.15, sizes: &[(2, 10), (3, 10), (2, 200), (3, 100)] },
    Family { name: "bimodal", width: 0.3, sizes: &[(2, 10), (3, 10), (2, 200), (3, 100)] },
    Family { name: "rings", width: 10.0, sizes: &[(2, 40), (3, 40), (2, 200), (3, 200)] },
    Family { name: "rings", width: 1.78, sizes: &[(2, 60), (3, 60), (2, 400), (3, 400)] },
];

fn main() -> Fallible<()> {
    let wanted: Vec<String> =
        std::env::args().skip(1).filter(|argument| !argument.starts_with('-')).collect();
    println!("total variation, mean (largest) of {INSTANCES} instances; milliseconds for {CHAINS} chains");
    for family in FAMILIES {
        if !wanted.is_empty() && !wanted.iter().any(|name| name == family.name) {
            continue;
        }
        for &(count, size) in family.sizes {
            let rows = compare(&family, count, size)?;
            print!("{} {} ({count}, {size})", family.name, family.width);
            for row in rows {
                let largest = row.errors.iter().copied().fold(0.0, f64::max);
                let mean = row.errors.iter().sum::<f64>() / INSTANCES as f64;
                print!(
                    " | {} {mean:.3} ({largest:.2}) {:.1} ms",
                    row.name,
                    row.seconds * 1e3 / INSTANCES as f64
                );
            }
            println!();
        }
    }
    Ok(())
}

#[derive(Default)]
struct Row {
    name: String,
    errors: Vec<f64>,
    seconds: f64,
}

fn compare(family: &Family, count: usize, size: usize) -> Fallible<Vec<Row>> {
    let names = ["multiscale", "roots", "gibbs sequential", "gibbs independent"];
    let mut rows: Vec<Row> = names.map(|name| Row { name: name.into(), ..Row::default() }).into();
    for instance in 0..INSTANCES {
        let inputs = inputs(family, count, size, instance)?;
        let references: Vec<&Mixture> = inputs.iter().collect();
        let grid = Grid::new(&references);
        let exact = grid.density(&references)?;
        let stream = || Stream::new(5, instance, Purpose::User(1), 0);
        let mut slower: f64 = 0.0;
        for (row, enumerate) in rows.iter_mut().zip([10_000, 1]) {
            let sampler = MultiscaleGibbs { sweeps: 1, enumerate };
            let start = Instant::now();
            let labels = sampler.labels(&references, CHAINS, &mut stream())?;
            let seconds = start.elapsed().as_secs_f64();
            slower = slower.max(seconds);
            row.seconds += seconds;
            row.errors.push(grid.distance(&exact, &grid.density(&[&chosen(&inputs, &labels)?])?));
        }
        for (row, kind) in rows[2..].iter_mut().zip([GibbsStart::Sequential, GibbsStart::Independent]) {
            let mut sweeps = 10;
            loop {
                let start = Instant::now();
                let labels = Gibbs { sweeps, start: kind }.labels(&references, CHAINS, &mut stream())?;
                let seconds = start.elapsed().as_secs_f64();
                if seconds >= slower {
                    row.seconds += seconds;
                    row.errors.push(grid.distance(&exact, &grid.density(&[&chosen(&inputs, &labels)?])?));
                    break;
                }
                sweeps = (sweeps as f64 * (1.1 * slower / seconds).max(1.2)).ceil() as usize;
            }
        }
    }
    Ok(rows)
}

fn inputs(family: &Family, count: usize, size: usize, instance: u64) -> Fallible<Vec<Mixture>> {
    let mut random = Xoshiro256PlusPlus::seed_from_u64(instance);
    let d = if family.name == "rings" { 2 } else { 1 };
    let mut all = Vec::new();
    for _ in 0..count {
        // A gamma variable of shape three is the sum of three exponential ones.
        let mut third = || -(1.0 - random.random::<f64>()).ln();
        let log_weights: Vec<f64> = (0..size).map(|_| (third() + third() + third()).ln()).collect();
        let mut means = Vec::with_capacity(size * d);
        let (direction, away) =
            (random.random_range(0.0..std::f64::consts::TAU), random.random_range(60.0..100.0));
        let (anchor, phase) =
            ([away * f64::cos(direction), away * f64::sin(direction)], random.random::<f64>());
        let radius = away + family.width * normal(&mut random);
        for i in 0..size {
            match family.name {
                "rings" => {
                    let angle = std::f64::consts::TAU * (i as f64 + phase) / size as f64;
                    means.extend([anchor[0] + radius * angle.cos(), anchor[1] + radius * angle.sin()]);
                }
                "bimodal" => {
                    let side = if random.random::<bool>() { 2.0 } else { -2.0 };
                    means.push(side + 0.3 * normal(&mut random));
                }
                _ => means.push(normal(&mut random)),
            }
        }
        let kernel =
            (0..d * d).map(|entry| if entry % (d + 1) == 0 { family.width.powi(2) } else { 0.0 }).collect();
        all.push(Mixture::with_shared_covariance(&Space::real(d), log_weights, means, kernel)?);
    }
    Ok(all)
}

fn normal(random: &mut Xoshiro256PlusPlus) -> f64 {
    StandardNormal.sample(random)
}

/// The mixture of the Gaussian products of the labels: all kernels are equal, so that their product lies at the mean
/// of their centres and has an L-th of their variance.
fn chosen(inputs: &[Mixture], labels: &[u32]) -> Fallible<Mixture> {
    let d = inputs[0].dimension();
    let count = inputs.len();
    let mut means = Vec::with_capacity(labels.len() / count * d);
    for chain in labels.chunks_exact(count) {
        for k in 0..d {
            let sum: f64 =
                chain.iter().zip(inputs).map(|(&label, input)| input.mean_of(label as usize)[k]).sum();
            means.push(sum / count as f64);
        }
    }
    let kernel = inputs[0].covariance_of(0).iter().map(|entry| entry / count as f64).collect();
    let chains = labels.len() / count;
    Ok(Mixture::with_shared_covariance(&Space::real(d), vec![0.0; chains], means, kernel)?)
}

/// Points that cover all inputs, regularly.
struct Grid {
    points: Vec<f64>,
}

impl Grid {
    fn new(inputs: &[&Mixture]) -> Self {
        let d = inputs[0].dimension();
        let axes: Vec<Vec<f64>> = (0..d)
            .map(|k| {
                let values = inputs.iter().flat_map(|input| input.means().iter().skip(k).step_by(d));
                let (low, high) =
                    values.fold((f64::MAX, f64::MIN), |(low, high), &x| (low.min(x), high.max(x)));
                let width = inputs[0].covariance_of(0)[0].sqrt();
                let points =
                    if d == 1 { 2000 } else { (6.0 * (high - low) / width).clamp(150.0, 500.0) as usize };
                let place =
                    |i: usize| low - width + (high - low + 2.0 * width) * i as f64 / (points - 1) as f64;
                (0..points).map(place).collect()
            })
            .collect();
        let points = match axes.as_slice() {
            [first, second] => first.iter().flat_map(|x| second.iter().flat_map(move |y| [*x, *y])).collect(),
            _ => axes[0].clone(),
        };
        Self { points }
    }

    /// The product's density, its sum over the grid one.
    fn density(&self, inputs: &[&Mixture]) -> Fallible<Vec<f64>> {
        let mut sums = vec![0.0; self.points.len() / inputs[0].dimension()];
        let mut logs = vec![0.0; sums.len()];
        for input in inputs {
            Evaluator::new(input).log_densities_within(&self.points, 1e-4, &mut logs)?;
            sums.iter_mut().zip(&logs).for_each(|(sum, log)| *sum += log);
        }
        let largest = sums.iter().copied().fold(f64::MIN, f64::max);
        sums.iter_mut().for_each(|log| *log = (*log - largest).exp());
        let total: f64 = sums.iter().sum();
        sums.iter_mut().for_each(|value| *value /= total);
        Ok(sums)
    }

    fn distance(&self, a: &[f64], b: &[f64]) -> f64 {
        0.5 * a.iter().zip(b).map(|(x, y)| (x - y).abs()).sum::<f64>()
    }
}
