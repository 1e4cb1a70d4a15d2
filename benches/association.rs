//! Track-to-track association: time of large sets, their peak memory, and the share of right pairs.
//!
//! `cargo bench --bench association [-- 500|10000]`
//!
//! Targets have the density of 30 in 60 km by 60 km whatever their number; each sensor sees nine in ten and as many false
//! tracks again as a tenth. Biases displace tracks by the same metres whatever the size of the square. Where $PEERS_DIR
//! is set, the tracks of the smaller case are left there for `benches/association_pycpd.py`.

mod common;

use std::fmt::Write;

use common::{Timing, sizes};
use sumprod::fusion::association::{
    AssociationError, BiasField, BiasPrior, CoherentDrift, Mixture, Pair, Start, Tails, associate,
};
use sumprod::positioning::association::{Scene, WorldSettings};

type Fallible<T> = Result<T, Box<dyn std::error::Error>>;

fn main() -> Fallible<()> {
    for size in sizes(&[500, 10_000]) {
        let world = WorldSettings {
            targets: size as u32,
            side_m: None,
            offset_m: 20e3,
            detection_probability: 0.9,
            false_tracks: size as u32 / 10,
            noise_variance: 1e4,
            bias_level: 2.0,
            range_bias_m: 300.0,
            azimuth_bias_rad: 0.5_f64.to_radians() * (30.0 / size as f64).sqrt(),
        };
        let scene = world.simulate(1, 0)?;
        println!("{} and {} tracks, {} common", scene.first.len(), scene.second.len(), scene.common());
        if size <= 1000 {
            leave(&scene)?;
        }
        for (name, run) in methods(4.0 * world.bias_level * world.azimuth_bias_rad) {
            let mut found = Vec::new();
            let repeats = if size <= 1000 { 5 } else { 1 };
            let timing = Timing::of_thread(repeats, || {
                found = run(&scene)?;
                Ok::<(), AssociationError>(())
            })?;
            let judgement = scene.judge(&found);
            let [correct, wrong] =
                [judgement.correct, judgement.wrong].map(|share| share.unwrap_or(f64::NAN));
            println!("  {name:14} correct {correct:.4}, false {wrong:.4}; runs {timing}");
        }
        if let Some(peak) = peak_megabytes() {
            println!("  peak memory {peak:.0} MB");
        }
    }
    Ok(())
}

type Method = Box<dyn Fn(&Scene) -> Result<Vec<Pair>, AssociationError>>;

fn methods(azimuth_deviation: f64) -> Vec<(&'static str, Method)> {
    let gaussian = Mixture {
        tails: Tails::Gaussian,
        outlier_weight: 0.2,
        estimate_weights: false,
        start: Start::Spread,
        ..Mixture::flexible(3000.0)
    };
    let student = Mixture { tails: Tails::Estimated(3.0), ..Mixture::flexible(3000.0) };
    let drift = |mixture: Mixture| -> Method {
        Box::new(move |scene| {
            let mut field = CoherentDrift::new(3.0, 3.0)?;
            Ok(associate(&scene.first, &scene.second, &mut field, &mixture)?.pairs)
        })
    };
    let bias = Box::new(move |scene: &Scene| {
        let mut field = BiasField::new(scene.sensors, BiasPrior::independent(1500.0, azimuth_deviation))?;
        Ok(associate(&scene.first, &scene.second, &mut field, &Mixture::default())?.pairs)
    });
    vec![("gaussian-cpd", drift(gaussian)), ("t-cpd-uniform", drift(student)), ("t-bias", bias)]
}

/// Leaves the tracks for the peer: set, target (-1 where false), coordinates.
fn leave(scene: &Scene) -> Fallible<()> {
    let Ok(folder) = std::env::var("PEERS_DIR") else { return Ok(()) };
    let mut text = String::new();
    for (set, tracks, targets) in
        [(0, &scene.first, &scene.first_targets), (1, &scene.second, &scene.second_targets)]
    {
        for (track, target) in tracks.iter().zip(targets) {
            let target = target.map_or(-1, i64::from);
            writeln!(text, "{set} {target} {} {}", track[0], track[1])?;
        }
    }
    std::fs::create_dir_all(&folder)?;
    Ok(std::fs::write(std::path::Path::new(&folder).join("tracks.txt"), text)?)
}

/// Most memory that this process has had, where the system tells it.
fn peak_megabytes() -> Option<f64> {
    let text = std::fs::read_to_string("/proc/self/status").ok()?;
    let line = text.lines().find_map(|line| line.strip_prefix("VmHWM:"))?;
    line.split_whitespace().next()?.parse::<f64>().ok().map(|kilobytes| kilobytes / 1024.0)
}
