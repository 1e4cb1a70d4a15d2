//! Recorded aircraft, seen by two simulated radars: places are real, biases, noise and misses are drawn.

use std::collections::BTreeMap;
use std::path::PathBuf;

use rand::RngExt;
use rand_distr::{Distribution, StandardNormal};
use sumprod_fusion::association::{BiasField, BiasPrior, Mixture, Sensors, Tracks, associate};
use sumprod_graph::{FastStream, Purpose, Stream};

/// Places (m, east and north of 52° N, 1° W) of each aircraft at two instants 30 s apart.
fn recorded() -> Option<Vec<[[f64; 2]; 2]>> {
    let root = std::env::var_os("SUMPROD_DATA").map_or_else(
        || PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../../../shared/data"),
        PathBuf::from,
    );
    let text = std::fs::read_to_string(root.join("tracks/OpenSky_Plane_States_first_half.csv")).ok()?;
    let mut places: BTreeMap<&str, [Option<[f64; 2]>; 2]> = BTreeMap::new();
    for line in text.lines().skip(1) {
        let columns: Vec<&str> = line.split(',').collect();
        let number = |i: usize| columns[i].parse::<f64>().unwrap();
        let instants = ["1626098700", "1626098730"];
        if let Some(instant) = instants.iter().position(|instant| *instant == columns[0]) {
            let (latitude, longitude) = (number(2).to_radians(), number(3).to_radians());
            let earth = 6_371_000.0;
            let east = earth * (longitude + 1.0_f64.to_radians()) * 52.0_f64.to_radians().cos();
            places.entry(columns[1]).or_default()[instant] =
                Some([east, earth * (latitude - 52.0_f64.to_radians())]);
        }
    }
    Some(places.into_values().filter_map(|[a, b]| Some([a?, b?])).collect())
}

/// What a radar with offsets of range and azimuth sees of nine in ten aircraft, and which.
fn look(
    aircraft: &[[[f64; 2]; 2]],
    scans: usize,
    radar: [f64; 2],
    [range, azimuth]: [f64; 2],
    random: &mut FastStream,
) -> (Tracks, Vec<usize>) {
    let (mut coordinates, mut whose) = (Vec::new(), Vec::new());
    for (index, places) in aircraft.iter().enumerate() {
        if random.random::<f64>() >= 0.9 {
            continue;
        }
        whose.push(index);
        for place in &places[..scans] {
            let noise: [f64; 2] = [StandardNormal.sample(random), StandardNormal.sample(random)];
            let [dx, dy] = [0, 1].map(|i| place[i] + 100.0 * noise[i] - radar[i]);
            let (distance, angle) = (dx.hypot(dy) + range, dy.atan2(dx) + azimuth);
            coordinates.extend([radar[0] + distance * angle.cos(), radar[1] + distance * angle.sin()]);
        }
    }
    (Tracks::new(2, scans, coordinates).unwrap(), whose)
}

#[test]
fn recorded_aircraft_are_told_apart_under_bias() {
    let Some(aircraft) = recorded() else {
        eprintln!("skipped: tracks/OpenSky_Plane_States_first_half.csv is not below SUMPROD_DATA");
        return;
    };
    assert!(aircraft.len() > 40, "{}", aircraft.len());
    let sensors = Sensors { first: [-150e3, -250e3], second: [150e3, -250e3] };
    let truth = [900.0, -0.015, -600.0, 0.01];
    for scans in [1, 2] {
        let mut random = Stream::new(3, scans as u64, Purpose::World, 0).fast();
        let (first, mine) = look(&aircraft, scans, sensors.first, [truth[0], truth[1]], &mut random);
        let (second, other) = look(&aircraft, scans, sensors.second, [truth[2], truth[3]], &mut random);
        let mut field = BiasField::new(sensors, BiasPrior::independent(1500.0, 0.03)).unwrap();
        let found = associate(&first, &second, &mut field, &Mixture::default()).unwrap();
        let common = mine.iter().filter(|index| other.contains(index)).count();
        let right = found.pairs.iter().filter(|pair| mine[pair.first] == other[pair.second]).count();
        // Aircraft 60 km apart on average, displaced by up to 15 km: at most two are confused.
        assert!(right + 2 >= common && found.pairs.len() <= right + 2, "{right} of {common}");
        let (mean, covariance) = field.posterior().unwrap().scan(0).unwrap();
        for k in 0..4 {
            // Five deviations: one in a million.
            let error = (mean[k] - truth[k]).abs();
            assert!(error < 5.0 * covariance[(k, k)].sqrt(), "{scans} scans, bias {k}: {error}");
        }
    }
}
