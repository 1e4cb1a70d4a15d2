//! Tracks of two radars whose ranges and azimuths are off: nearest neighbours pair the wrong ones, and the sensors' biases,
//! found together with the pairs, the right ones.

use sumprod::fusion::association::{
    BiasField, BiasPrior, CoherentDrift, Mixture, associate, global_nearest, nearest,
};
use sumprod::positioning::association::WorldSettings;

/// Prints each method's pairs and the biases; fails where the biases are not found.
pub fn main() -> Result<(), Box<dyn std::error::Error>> {
    // Thirty targets in 60 km by 60 km, of which each radar sees nine in ten, and three false tracks each. Ranges are
    // 1.2 km off and azimuths two degrees, so that tracks of one target may be 5 km apart.
    let world = WorldSettings {
        targets: 30,
        side_m: Some(60e3),
        offset_m: 20e3,
        detection_probability: 0.9,
        false_tracks: 3,
        noise_variance: 1e4,
        bias_level: 4.0,
        range_bias_m: 300.0,
        azimuth_bias_rad: 0.5_f64.to_radians(),
    };
    let scene = world.simulate(7, 0)?;
    let (first, second) = (&scene.first, &scene.second);
    println!("{} and {} tracks, {} common targets", first.len(), second.len(), scene.common());

    let mut drift = CoherentDrift::new(3.0, 3.0)?;
    let mut biases = BiasField::new(scene.sensors, BiasPrior::independent(1500.0, 2.5_f64.to_radians()))?;
    let by_drift = associate(first, second, &mut drift, &Mixture::flexible(3e3))?;
    let by_biases = associate(first, second, &mut biases, &Mixture::default())?;
    let rows = [
        ("nearest neighbour", nearest(first, second, 8e3)?),
        ("global nearest neighbour", global_nearest(first, second, 8e3)?),
        ("smooth field", by_drift.pairs),
        ("biases", by_biases.pairs),
    ];
    for (name, pairs) in &rows {
        let judgement = scene.judge(pairs);
        let percent = |share: Option<f64>| 100.0 * share.unwrap_or(0.0);
        println!(
            "{name:25} {:5.1} % correct, {:4.1} % wrong",
            percent(judgement.correct),
            percent(judgement.wrong)
        );
    }

    let (mean, covariance) =
        biases.posterior().and_then(|posterior| posterior.scan(0)).ok_or("no posterior was left")?;
    for (k, name) in
        ["range 1 (m)", "azimuth 1 (rad)", "range 2 (m)", "azimuth 2 (rad)"].into_iter().enumerate()
    {
        println!(
            "{name:16} {:9.4} ± {:.4}, true {:9.4}",
            mean[k],
            covariance[(k, k)].sqrt(),
            scene.biases[k]
        );
        // Five deviations: one in a million.
        if (mean[k] - scene.biases[k]).abs() > 5.0 * covariance[(k, k)].sqrt() {
            return Err(format!("{name} is {}, not {}", mean[k], scene.biases[k]).into());
        }
    }
    let correct = |pairs: &[_]| scene.judge(pairs).correct;
    let [_, (_, plain), _, (_, found)] = &rows;
    (correct(found) > correct(plain)).then_some(()).ok_or("the biases brought nothing".into())
}
