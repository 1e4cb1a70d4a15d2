//! Which sensors are asked at a scan, where energy forbids to ask them all.
//!
//! A range from sensor j, whose gradient at the predicted mean is h, is expected to tell ½ ln(1 + h'P h / R) nats about
//! the state of predicted covariance P. Sensors are chosen one after the other, each for what it adds to those chosen
//! before it, P ← P - P h h'P / (h'P h + R). The information of a set is submodular, so that this greedy choice tells
//! at least 1 - 1/e of what the best set does; source: Krause, Guestrin, "Near-optimal nonmyopic value of information
//! in graphical models" (2005).
//!
//! What is spent are transmissions: a message takes as many as the way from the sensor to the sink has hops.

use nalgebra::{Matrix4, Vector4};
use rand::seq::SliceRandom;
use serde::{Deserialize, Serialize};
use sumprod_graph::FastStream;
use sumprod_messages::Moments;

use super::world::WorldSettings;
use crate::tracking::range_gradient;

/// The rule by which sensors are chosen.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Rule {
    /// Those whose ranges tell most.
    #[default]
    Information,
    /// Those whose ranges tell most a transmission.
    Economy,
    /// Those nearest to the predicted position.
    Nearest,
    /// Any.
    Random,
}

/// Number of transmissions that a message from a place takes to the sink; none from the sink itself.
pub fn transmissions(settings: &WorldSettings, place: [f64; 2]) -> u32 {
    let distance = (place[0] - settings.sink[0]).hypot(place[1] - settings.sink[1]);
    (distance / settings.hop).ceil() as u32
}

/// The sensors to ask, at most `active` of them, ascending; `able` are those that the sink believes to work.
///
/// O(M · active) for M sensors.
pub fn choose(
    rule: Rule,
    active: usize,
    belief: &Moments,
    settings: &WorldSettings,
    sensors: &[[f64; 2]],
    able: &[usize],
    random: &mut FastStream,
) -> Vec<usize> {
    let state: [f64; 4] = std::array::from_fn(|k| belief.mean[k]);
    let distance = |sensor: usize| (state[0] - sensors[sensor][0]).hypot(state[2] - sensors[sensor][1]);
    let mut open = able.to_vec();
    if let Some(reach) = settings.reach {
        // One beyond reach may hear the target still, since its position is not known exactly.
        let doubt = 2.0 * (belief.covariance_at(0, 0) + belief.covariance_at(2, 2)).sqrt();
        open.retain(|&sensor| distance(sensor) <= reach + doubt);
    }
    let active = active.min(open.len());
    let mut chosen = match rule {
        Rule::Random => {
            open.shuffle(random);
            open[..active].to_vec()
        }
        Rule::Nearest => {
            open.sort_by(|&a, &b| distance(a).total_cmp(&distance(b)));
            open[..active].to_vec()
        }
        Rule::Information | Rule::Economy => {
            let mut covariance = Matrix4::from_row_slice(&belief.covariance);
            let variance = settings.measurement_variance;
            let mut chosen = Vec::with_capacity(active);
            for _ in 0..active {
                let worth = |&sensor: &usize| -> f64 {
                    let gain = range_gradient(&state, sensors[sensor])
                        .map_or(0.0, |h| 0.5 * (h.dot(&(covariance * h)) / variance).ln_1p());
                    match rule {
                        Rule::Economy => gain / f64::from(transmissions(settings, sensors[sensor]).max(1)),
                        _ => gain,
                    }
                };
                let Some((place, sensor)) = first_best(&open, worth) else { break };
                open.swap_remove(place);
                chosen.push(sensor);
                let h = range_gradient(&state, sensors[sensor]).unwrap_or_else(Vector4::zeros);
                let gain = covariance * h;
                covariance -= gain * gain.transpose() / (h.dot(&gain) + variance);
            }
            chosen
        }
    };
    chosen.sort_unstable();
    chosen
}

/// The element of greatest worth with its place; of equals the one of least number, whatever their order.
fn first_best(open: &[usize], worth: impl Fn(&usize) -> f64) -> Option<(usize, usize)> {
    let mut best: Option<(f64, usize, usize)> = None;
    for (place, &sensor) in open.iter().enumerate() {
        let value = worth(&sensor);
        let better = best.is_none_or(|(worth, _, other)| value > worth || (value == worth && sensor < other));
        if better {
            best = Some((value, place, sensor));
        }
    }
    best.map(|(_, place, sensor)| (place, sensor))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::wsn::world::Layout;
    use sumprod_graph::{Purpose, Stream};

    fn belief(mean: [f64; 4], variances: [f64; 4]) -> Moments {
        let covariance = Matrix4::from_diagonal(&Vector4::from(variances));
        Moments { mean: mean.to_vec(), covariance: covariance.as_slice().to_vec() }
    }

    fn ask(rule: Rule, active: usize, belief: &Moments, sensors: &[[f64; 2]]) -> Vec<usize> {
        let settings = WorldSettings { layout: Layout::Scattered, ..WorldSettings::default() };
        let able: Vec<usize> = (0..sensors.len()).collect();
        let mut random = Stream::new(1, 0, Purpose::Optimizer, 0).fast();
        choose(rule, active, belief, &settings, sensors, &able, &mut random)
    }

    #[test]
    fn the_uncertain_direction_is_asked_about_first_and_not_twice() {
        // Uncertain along y first, then along x: the sensor to the north, then one in the east, not the south one.
        let belief = belief([250.0, 0.0, 250.0, 0.0], [4.0, 0.1, 9.0, 0.1]);
        let sensors = [[500.0, 250.0], [250.0, 500.0], [250.0, 0.0], [0.0, 250.0]];
        assert_eq!(ask(Rule::Information, 1, &belief, &sensors), [1]);
        assert_eq!(ask(Rule::Information, 2, &belief, &sensors), [0, 1]);
        assert_eq!(ask(Rule::Nearest, 2, &belief, &[[0.0; 2], [240.0, 250.0], [250.0, 200.0]]), [1, 2]);
        assert_eq!(ask(Rule::Random, 9, &belief, &sensors), [0, 1, 2, 3]);
    }

    #[test]
    fn greedy_choice_is_the_best_pair_or_close_to_it() {
        // Against all pairs: never below 1 - 1/e, and here never below 0.9 of the best.
        let settings = WorldSettings::default();
        let mut random = Stream::new(3, 0, Purpose::Optimizer, 0).fast();
        use rand::RngExt;
        for _ in 0..50 {
            let sensors: Vec<[f64; 2]> =
                (0..8).map(|_| [500.0 * random.random::<f64>(), 500.0 * random.random::<f64>()]).collect();
            let belief =
                belief([200.0, 1.0, 300.0, 2.0], [5.0 * random.random::<f64>() + 0.1, 1.0, 2.0, 1.0]);
            let told = |set: &[usize]| {
                let state: [f64; 4] = std::array::from_fn(|k| belief.mean[k]);
                let mut information = Matrix4::identity();
                let covariance = Matrix4::from_row_slice(&belief.covariance);
                for &sensor in set {
                    let h = range_gradient(&state, sensors[sensor]).unwrap();
                    information += covariance * h * h.transpose() / settings.measurement_variance;
                }
                0.5 * information.determinant().ln()
            };
            let greedy = told(&ask(Rule::Information, 2, &belief, &sensors));
            let best =
                (0..8).flat_map(|a| (0..a).map(move |b| [a, b])).map(|pair| told(&pair)).fold(0.0, f64::max);
            assert!(greedy <= best + 1e-9 && greedy > 0.9 * best, "{greedy} of {best}");
        }
    }

    #[test]
    fn economy_weighs_what_is_told_against_the_hops_it_takes() {
        let settings = WorldSettings::default();
        assert_eq!(transmissions(&settings, [250.0, 250.0]), 0);
        assert_eq!(transmissions(&settings, [250.0, 400.0]), 1);
        assert_eq!(transmissions(&settings, [0.0, 0.0]), 3);
        let belief = belief([100.0, 0.0, 100.0, 0.0], [4.0, 0.1, 3.6, 0.1]);
        // Along x the far corner tells a little more, at three times the price.
        let sensors = [[0.0, 100.0], [100.0, 250.0]];
        assert_eq!(ask(Rule::Information, 1, &belief, &sensors), [0]);
        assert_eq!(ask(Rule::Economy, 1, &belief, &sensors), [1]);
    }
}
