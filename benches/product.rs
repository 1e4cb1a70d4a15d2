//! Products of kernel densities: time and distance to the truth, method by method.
//!
//! The cases of the peers' workload W5: two thousand points of the product of L mixtures of N equal kernels, one
//! covariance a mixture, in d dimensions. Distance is the largest Kolmogorov-Smirnov distance of a marginal to the
//! truth on a grid; two thousand independent exact points score about 0.019. Times are of the processor, one thread,
//! median of the repeats. The peers' figures stand beside them: published ones, but those that
//! `benches/beside-peers` has measured just before (`$PEERS_DIR/w5.jsonl`), which are marked "now". Ihler's toolbox is
//! never among these.
//!
//! `cargo bench --bench product [-- cases|growth] [d=1] [L=3] [N=1000] [auto]`
//!
//! Where $PEERS_DIR/w5data holds the peers' own data (`d_L_N.txt`, centres by mixture and then the kernels' widths),
//! that is used; else data of the same law.
//!
//! The last lines say in how many cases `auto` is on the front, and how many times faster than each peer the fastest
//! of our methods is whose distance is at most the peer's, ties within 0.02.

use rand::{RngExt, SeedableRng};
use rand_distr::{Distribution, StandardNormal};
use rand_xoshiro::Xoshiro256PlusPlus;
use sumprod::graph::{Purpose, Space, Stream};
use sumprod::messages::{
    AnnealedGibbs, Auto, Exact, GaussianImportance, Gibbs, Mixture, MixtureImportance, MultiscaleGibbs,
    Pairwise, Particles, ProductMethod,
};

type Fallible<T> = Result<T, Box<dyn std::error::Error>>;

const SAMPLES: usize = 2000;

/// Names of the peers: what they are called here, and in the file of those measured just before.
const PEER_NAMES: [(&str, &str); 4] =
    [("importance", "mix-is"), ("gibbs", "gibbs-numba-10"), ("multiscale", ""), ("exact", "exact-enum")];

/// Peers: d, L, N, then milliseconds and distance in the order of the names; of several settings the nearest.
type Peer = (usize, usize, usize, [Option<(f64, f64)>; 4]);

const PEERS: &[Peer] = &[
    (1, 2, 200, [Some((5.5, 0.040)), Some((77.0, 0.017)), Some((160.0, 0.018)), Some((0.67, 0.023))]),
    (1, 2, 1000, [Some((44.0, 0.018)), Some((244.0, 0.032)), Some((707.0, 0.019)), Some((37.0, 0.032))]),
    (1, 2, 5000, [Some((301.0, 0.016)), Some((1660.0, 0.013)), Some((4640.0, 0.019)), Some((683.0, 0.029))]),
    (1, 3, 200, [Some((40.0, 0.015)), Some((115.0, 0.153)), Some((246.0, 0.028)), Some((297.0, 0.014))]),
    (1, 3, 1000, [Some((94.0, 0.014)), Some((351.0, 0.113)), Some((1310.0, 0.018)), None]),
    (1, 5, 1000, [Some((261.0, 0.015)), Some((681.0, 0.027)), Some((2460.0, 0.206)), None]),
    (1, 8, 1000, [Some((706.0, 0.013)), Some((1040.0, 0.131)), Some((3890.0, 0.281)), None]),
    (1, 8, 5000, [Some((3720.0, 0.015)), None, Some((26400.0, 0.278)), None]),
    (2, 2, 1000, [Some((71.0, 0.021)), Some((259.0, 0.027)), Some((1240.0, 0.017)), Some((42.0, 0.021))]),
    (2, 3, 200, [Some((33.0, 0.021)), Some((93.0, 0.092)), Some((176.0, 0.021)), Some((346.0, 0.012))]),
    (2, 3, 1000, [Some((150.0, 0.021)), Some((427.0, 0.087)), Some((506.0, 0.027)), None]),
    (2, 5, 1000, [Some((468.0, 0.030)), Some((718.0, 0.107)), Some((2770.0, 0.033)), None]),
    (2, 8, 1000, [Some((1260.0, 0.020)), Some((1050.0, 0.276)), Some((3910.0, 0.045)), None]),
    (2, 8, 5000, [Some((6600.0, 0.015)), None, Some((32200.0, 0.200)), None]),
];

fn main() -> Fallible<()> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let only = |key: &str| {
        let given = arguments.iter().find_map(|argument| argument.strip_prefix(key)?.strip_prefix('='));
        given.and_then(|value| value.parse::<usize>().ok())
    };
    let wants = |part: &str| {
        arguments.iter().any(|argument| argument == part)
            || !arguments.iter().any(|argument| argument == "cases" || argument == "growth")
    };
    let methods: Vec<(Box<dyn ProductMethod>, f64)> = methods()
        .into_iter()
        .filter(|(method, _)| {
            let named = |argument: &String| all_names().contains(&argument.as_str());
            !arguments.iter().any(named) || arguments.iter().any(|argument| argument == method.name())
        })
        .collect();
    if wants("cases") {
        println!("milliseconds / distance; * marks the front (nothing faster is as near, within 0.02)");
        let mut standing = Standing::default();
        for d in [1, 2] {
            for count in [2, 3, 5, 8] {
                for size in [100, 200, 500, 1000, 5000] {
                    let keeps = |key, value| only(key).is_none_or(|wanted| wanted == value);
                    if keeps("d", d) && keeps("L", count) && keeps("N", size) {
                        case(d, count, size, &methods, &mut standing)?;
                    }
                }
            }
        }
        standing.print();
    }
    if wants("growth") {
        growth()?;
    }
    Ok(())
}

/// The methods with the largest work they are asked to do, in kernel evaluations.
fn methods() -> Vec<(Box<dyn ProductMethod>, f64)> {
    vec![
        (Box::new(Exact::default()), f64::INFINITY),
        (Box::new(Gibbs::default()), 1e9),
        (Box::new(AnnealedGibbs::default()), 3e8),
        (Box::new(MultiscaleGibbs::default()), 1e9),
        (Box::new(MixtureImportance::default()), f64::INFINITY),
        (Box::new(GaussianImportance::default()), f64::INFINITY),
        (Box::new(Pairwise::default()), f64::INFINITY),
        (Box::new(Auto::default()), f64::INFINITY),
    ]
}

fn all_names() -> Vec<&'static str> {
    methods().iter().map(|(method, _)| method.name()).collect()
}

/// How the cases went.
#[derive(Default)]
struct Standing {
    cases: usize,
    /// Cases in which `auto` is on the front.
    front: usize,
    /// By peer, how many times slower than ours at its distance it was in each case, and the case.
    ratios: [Vec<(f64, String)>; 4],
}

impl Standing {
    fn print(&mut self) {
        println!("auto is on the front in {} of {} cases", self.front, self.cases);
        for ((name, _), ratios) in PEER_NAMES.iter().zip(&mut self.ratios) {
            ratios.sort_by(|a, b| a.0.total_cmp(&b.0));
            if let (Some(least), Some(median)) = (ratios.first(), ratios.get(ratios.len() / 2)) {
                let (cases, (ratio, case)) = (ratios.len(), least);
                println!(
                    "peer {name}: {cases} cases, at least {ratio:.1} times slower ({case}), median {:.0}",
                    median.0
                );
            }
        }
    }
}

fn case(
    d: usize,
    count: usize,
    size: usize,
    methods: &[(Box<dyn ProductMethod>, f64)],
    standing: &mut Standing,
) -> Fallible<()> {
    let inputs = data(d, count, size)?;
    let references: Vec<&Mixture> = inputs.iter().collect();
    let truth = Truth::new(&inputs);
    let mut rows = Vec::new();
    for (method, most) in methods {
        let work = (SAMPLES * 10 * count * size) as f64;
        let too_large = method.name() == "exact" && (size as f64).powi(count as i32) > 4e6;
        if too_large || work > *most {
            continue;
        }
        let (mut seconds, mut distances) = (Vec::new(), Vec::new());
        let mut chosen = String::new();
        // The system counts a thread's time in ticks of some milliseconds.
        let mut batch = 1;
        let start = processor_seconds();
        for repeat in 0.. {
            let before = processor_seconds();
            for call in 0..batch {
                let mut stream = Stream::new(11, repeat, Purpose::User(0), call);
                let product = method.product(&references, SAMPLES, &mut stream)?;
                if call == 0 {
                    distances.push(truth.distance(&product.particles));
                    chosen = product.quality.method;
                }
            }
            let taken = processor_seconds() - before;
            seconds.push(taken / batch as f64);
            if taken < 0.05 && repeat == 0 {
                batch = (0.2 / taken.max(1e-3)).ceil() as u64;
                seconds.clear();
            } else if repeat >= 10 || (repeat >= 2 && processor_seconds() - start > 0.5) {
                break;
            }
        }
        rows.push((method.name(), median(&mut seconds) * 1e3, median(&mut distances), chosen));
    }
    let published = PEERS.iter().find(|peer| (peer.0, peer.1, peer.2) == (d, count, size));
    let now = measured(d, count, size)?;
    let peers: [(Option<(f64, f64)>, bool); 4] =
        std::array::from_fn(|i| (now[i].or(published.and_then(|peer| peer.3[i])), now[i].is_some()));
    print!("{d},{count},{size}");
    standing.cases += 1;
    let mut others: Vec<(f64, f64)> = rows.iter().map(|row| (row.1, row.2)).collect();
    others.extend(peers.iter().filter_map(|(figure, _)| *figure));
    for (name, time, distance, chosen) in &rows {
        // A tenth is the noise of timing; `auto` costs what it chose, and looking.
        let ahead = |other: &(f64, f64)| other.0 < 0.9 * time && other.1 <= distance + 0.02;
        let front = !others.iter().any(ahead);
        standing.front += usize::from(front && *name == "auto");
        let mark = if front { "*" } else { "" };
        let chosen = if chosen == name { String::new() } else { format!(" ({chosen})") };
        print!(" | {name}{chosen} {time:.3}/{distance:.3}{mark}");
    }
    for (i, (figure, now)) in peers.iter().enumerate() {
        let Some((time, distance)) = figure else { continue };
        let now = if *now { "now " } else { "" };
        print!(" | peer {} {now}{time:.2}/{distance:.3}", PEER_NAMES[i].0);
        let as_near = rows.iter().filter(|row| row.2 <= distance + 0.02).map(|row| row.1);
        let ours = as_near.fold(f64::INFINITY, f64::min);
        standing.ratios[i].push((time / ours, format!("{d},{count},{size}")));
    }
    println!();
    Ok(())
}

/// Milliseconds and distance of the peers that were measured just before, in the order of the names.
fn measured(d: usize, count: usize, size: usize) -> Fallible<[Option<(f64, f64)>; 4]> {
    let folder = std::env::var("PEERS_DIR").unwrap_or_default();
    let mut found = [None; 4];
    let Ok(text) = std::fs::read_to_string(std::path::PathBuf::from(folder).join("w5.jsonl")) else {
        return Ok(found);
    };
    for line in text.lines().filter(|line| line.starts_with('{')) {
        let row: serde_json::Value = serde_json::from_str(line)?;
        let is = |key: &str, value: usize| row[key].as_u64() == Some(value as u64);
        let place = PEER_NAMES.iter().position(|(_, name)| row["peer"].as_str() == Some(name));
        let figures = (row["cpu_med"].as_f64(), row["ks"].as_f64());
        if let (true, Some(place), (Some(seconds), Some(distance))) =
            (is("d", d) && is("L", count) && is("N", size), place, figures)
        {
            found[place] = Some((1e3 * seconds, distance));
        }
    }
    Ok(found)
}

/// Time of the multiscale product against the size of its inputs.
fn growth() -> Fallible<()> {
    println!("multiscale Gibbs sampling, L = 3, d = 2: milliseconds, and these over N log N");
    for size in [625, 1250, 2500, 5000, 10_000] {
        let inputs = data(2, 3, size)?;
        let references: Vec<&Mixture> = inputs.iter().collect();
        let mut seconds = Vec::new();
        for repeat in 0..3 {
            let mut stream = Stream::new(12, repeat, Purpose::User(0), 0);
            let before = processor_seconds();
            MultiscaleGibbs::default().product(&references, SAMPLES, &mut stream)?;
            seconds.push(processor_seconds() - before);
        }
        let time = median(&mut seconds) * 1e3;
        println!("{size:>6} {time:>9.1} {:.5}", time / (size as f64 * (size as f64).ln()));
    }
    Ok(())
}

/// Seconds that this thread has run, where the system tells; else seconds on the clock.
fn processor_seconds() -> f64 {
    use std::sync::OnceLock;
    use std::time::Instant;
    static START: OnceLock<Instant> = OnceLock::new();
    let told = std::fs::read_to_string("/proc/thread-self/schedstat").ok();
    let nanoseconds = told.and_then(|text| text.split_whitespace().next()?.parse::<f64>().ok());
    nanoseconds.map_or_else(|| START.get_or_init(Instant::now).elapsed().as_secs_f64(), |n| n * 1e-9)
}

fn median(values: &mut [f64]) -> f64 {
    values.sort_by(f64::total_cmp);
    values[values.len() / 2]
}

/// The peers' data where it is there, else of their law: two clusters, every mixture shifted a little.
fn data(d: usize, count: usize, size: usize) -> Fallible<Vec<Mixture>> {
    let folder = std::env::var("PEERS_DIR").unwrap_or_default();
    let file = std::path::PathBuf::from(folder).join(format!("w5data/{d}_{count}_{size}.txt"));
    let numbers = if file.exists() { read(&file)? } else { generate(d, count, size) };
    let (centres, widths) = numbers.split_at(count * size * d);
    let mut mixtures = Vec::new();
    for (means, widths) in centres.chunks_exact(size * d).zip(widths.chunks_exact(d)) {
        let mut covariance = vec![0.0; d * d];
        for (k, width) in widths.iter().enumerate() {
            covariance[k * d + k] = width * width;
        }
        let log_weights = vec![0.0; size];
        mixtures.push(Mixture::with_shared_covariance(
            &Space::real(d),
            log_weights,
            means.to_vec(),
            covariance,
        )?);
    }
    Ok(mixtures)
}

fn read(path: &std::path::Path) -> Fallible<Vec<f64>> {
    let text = std::fs::read_to_string(path)?;
    Ok(text.split_whitespace().map(str::parse).collect::<Result<_, _>>()?)
}

fn generate(d: usize, count: usize, size: usize) -> Vec<f64> {
    let mut shifts = Xoshiro256PlusPlus::seed_from_u64((1000 * d + 10 * count) as u64);
    let mut random = Xoshiro256PlusPlus::seed_from_u64((77 + size + 1000 * d + 10 * count) as u64);
    let mut centres = Vec::new();
    let mut widths = Vec::new();
    let factor = 0.7 * (4.0 / (d as f64 + 2.0) / size as f64).powf(1.0 / (d as f64 + 4.0));
    for _ in 0..count {
        let shift: Vec<f64> = (0..d).map(|_| 0.3 * normal(&mut shifts)).collect();
        let start = centres.len();
        for _ in 0..size {
            let near = random.random::<f64>() < 0.6;
            for shift in &shift {
                let z = normal(&mut random);
                centres.push(shift + if near { z } else { 4.0 + 0.7 * z });
            }
        }
        for k in 0..d {
            let mut column: Vec<f64> = centres[start..].iter().skip(k).step_by(d).copied().collect();
            column.sort_by(f64::total_cmp);
            let mean = column.iter().sum::<f64>() / size as f64;
            let variance = column.iter().map(|x| (x - mean) * (x - mean)).sum::<f64>() / size as f64;
            let range = column[3 * size / 4] - column[size / 4];
            widths.push(factor * variance.sqrt().min(range / 1.34));
        }
    }
    centres.extend(widths);
    centres
}

fn normal(random: &mut Xoshiro256PlusPlus) -> f64 {
    StandardNormal.sample(random)
}

/// Distribution functions of the product's marginals on a grid.
struct Truth {
    axes: Vec<(f64, f64, Vec<f64>)>,
}

impl Truth {
    /// Kernels are axis-aligned, so that a plane's density is a product of two matrices.
    fn new(inputs: &[Mixture]) -> Self {
        let d = inputs[0].dimension();
        let points = if d == 1 { 8001 } else { 500 };
        let bounds: Vec<(f64, f64)> = (0..d)
            .map(|k| {
                let values = inputs.iter().flat_map(|input| input.means().iter().skip(k).step_by(d));
                let (low, high) =
                    values.fold((f64::MAX, f64::MIN), |(low, high), &x| (low.min(x), high.max(x)));
                (low - 1.0, (high - low + 2.0) / (points - 1) as f64)
            })
            .collect();
        let cells = if d == 1 { points } else { points * points };
        let mut log = vec![0.0; cells];
        for input in inputs {
            let kernel = |k: usize, i: usize, at: usize| {
                let width = input.covariance_of(0)[k * d + k].sqrt();
                let z = (bounds[k].0 + at as f64 * bounds[k].1 - input.mean_of(i)[k]) / width;
                (-0.5 * z * z).exp()
            };
            let mut sum = vec![0.0; cells];
            for i in 0..input.len() {
                let first: Vec<f64> = (0..points).map(|at| kernel(0, i, at)).collect();
                if d == 1 {
                    sum.iter_mut().zip(&first).for_each(|(sum, value)| *sum += value);
                    continue;
                }
                let second: Vec<f64> = (0..points).map(|at| kernel(1, i, at)).collect();
                for (row, factor) in
                    sum.chunks_exact_mut(points).zip(&first).filter(|(_, factor)| **factor > 1e-30)
                {
                    row.iter_mut().zip(&second).for_each(|(sum, value)| *sum += factor * value);
                }
            }
            log.iter_mut().zip(&sum).for_each(|(log, sum)| *log += (sum + 1e-300).ln());
        }
        let largest = log.iter().copied().fold(f64::MIN, f64::max);
        let density: Vec<f64> = log.iter().map(|log| (log - largest).exp()).collect();
        let axes = (0..d)
            .map(|k| {
                let mut marginal = vec![0.0; points];
                for (cell, value) in density.iter().enumerate() {
                    marginal[if d == 1 || k == 1 { cell % points } else { cell / points }] += value;
                }
                let total: f64 = marginal.iter().sum();
                let mut sum = 0.0;
                let distribution = marginal
                    .iter()
                    .map(|value| {
                        sum += value / total;
                        sum - 0.5 * value / total
                    })
                    .collect();
                (bounds[k].0, bounds[k].1, distribution)
            })
            .collect();
        Self { axes }
    }

    fn distance(&self, particles: &Particles) -> f64 {
        let weights = particles.weights();
        let mut worst: f64 = 0.0;
        for (k, (start, step, distribution)) in self.axes.iter().enumerate() {
            let mut sorted: Vec<(f64, f64)> =
                weights.iter().enumerate().map(|(i, &weight)| (particles.point(i)[k], weight)).collect();
            sorted.sort_by(|a, b| a.0.total_cmp(&b.0));
            let mut reached = 0.0;
            for (x, weight) in sorted {
                let place = ((x - start) / step).clamp(0.0, (distribution.len() - 2) as f64);
                let (cell, share) = (place as usize, place.fract());
                let exact = distribution[cell] * (1.0 - share) + distribution[cell + 1] * share;
                worst = worst.max((reached - exact).abs());
                reached += weight;
                worst = worst.max((reached - exact).abs());
            }
        }
        worst
    }
}
