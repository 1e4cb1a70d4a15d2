//! The simulated network: agents that stand still, anchors on a jittered lattice, and one range per pair in reach.
//!
//! Agents are uniform on a square of 100 m² an agent; anchors stand on a square lattice over it, each moved by up to a
//! fifth of the spacing along either axis, on as many of its places, drawn at random, as there are anchors. A range is
//! z = |p_i - p_j| + v, v ~ N(0, r).

use rand::seq::SliceRandom;
use rand_distr::{Distribution, StandardNormal, Uniform};
use serde::{Deserialize, Serialize};
use sumprod_graph::{Purpose, Stream};

use crate::cooperation::links::Reach;
use crate::cooperation::{AnchorRanging, Ranging};
use crate::error::PositioningError;
use crate::form::at_least_one;

/// The keys `[world]`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct World {
    /// Number of agents.
    pub agents: usize,
    /// Number of anchors per hundred agents; at least three stand where this is above zero.
    pub anchors_per_100: f64,
    /// Distance up to which nodes measure each other (m).
    pub radius: f64,
    /// Variance of a range (m²).
    pub range_variance: f64,
    /// Share of the pairs in reach that fail to measure each other.
    #[serde(default)]
    pub link_loss: f64,
    /// Whether methods that can take it that two who did not measure each other are hardly in reach. Where links fail
    /// often, or for reasons that distance does not explain, set it to false.
    #[serde(default = "yes")]
    pub silence: bool,
}

fn yes() -> bool {
    true
}

/// Area of the square for each agent (m²).
const AREA: f64 = 100.0;
/// Standard deviation of the noise on the start's mean (m).
const START_NOISE: f64 = 0.5;
/// Sweeps in which agents without an anchor take the mean of their neighbours' starts.
const START_SWEEPS: usize = 20;

/// One draw of the world.
#[derive(Clone, Debug, PartialEq)]
pub struct Draw {
    /// True positions (m).
    pub truth: Vec<[f64; 2]>,
    /// Positions of the anchors (m).
    pub anchors: Vec<[f64; 2]>,
    /// Ranges among agents, by agent.
    pub ranges: Vec<Ranging>,
    /// Ranges to anchors, by agent.
    pub anchor_ranges: Vec<AnchorRanging>,
    /// The weak start (m).
    pub start: Vec<[f64; 2]>,
}

/// Entities of the streams.
const ANCHORS: u64 = 0;
const AGENTS: u64 = 1;
const HEARS: u64 = 2;
const HEARS_ANCHORS: u64 = 3;
const STARTS: u64 = 4;

impl World {
    /// Checks every value.
    ///
    /// # Errors
    /// [`PositioningError::Setting`] naming the key.
    pub fn validate(&self) -> Result<(), PositioningError> {
        at_least_one("world.agents", self.agents, "agent")?;
        for (key, value, unit) in [
            ("radius", self.radius, "m; a radius"),
            ("range_variance", self.range_variance, "m²; a variance"),
        ] {
            if !(value > 0.0 && value.is_finite()) {
                let problem = format!("is {value} {unit} must be positive and finite");
                return Err(PositioningError::setting(format!("world.{key}"), problem));
            }
        }
        if !(self.anchors_per_100 >= 0.0 && self.anchors_per_100 <= 1e4) {
            let problem = format!("is {}; it must be from 0 to 10000", self.anchors_per_100);
            return Err(PositioningError::setting("world.anchors_per_100", problem));
        }
        if !(0.0..1.0).contains(&self.link_loss) {
            let problem = format!("is {}; a share must be at least 0 and below 1", self.link_loss);
            return Err(PositioningError::setting("world.link_loss", problem));
        }
        Ok(())
    }

    /// Side of the square (m).
    pub fn side(&self) -> f64 {
        (AREA * self.agents as f64).sqrt()
    }

    /// Number of anchors.
    pub fn anchor_count(&self) -> usize {
        if self.anchors_per_100 == 0.0 {
            return 0;
        }
        ((self.anchors_per_100 * self.agents as f64 / 100.0).round() as usize).max(3)
    }

    /// Draws run `run`; near-linear time in the number of agents.
    ///
    /// # Errors
    /// As [`World::validate`].
    pub fn draw(&self, seed: u64, run: u32) -> Result<Draw, PositioningError> {
        self.validate()?;
        let stream = |entity: u64| Stream::new(seed, u64::from(run), Purpose::World, entity);
        let side = self.side();
        let anchors = self.anchors(&mut stream(ANCHORS))?;
        let uniform = uniform("world.agents", 0.0, side)?;
        let agents = stream(AGENTS);
        let truth: Vec<[f64; 2]> = (0..self.agents as u64)
            .map(|agent| {
                let mut random = agents.derive(agent);
                [uniform.sample(&mut random), uniform.sample(&mut random)]
            })
            .collect();
        let (ranges, anchor_ranges) = self.measure(&truth, &anchors, &[stream(HEARS), stream(HEARS_ANCHORS)]);
        let start = starts(self.agents, side, &anchors, &ranges, &anchor_ranges, &stream(STARTS));
        Ok(Draw { truth, anchors, ranges, anchor_ranges, start })
    }

    fn anchors(&self, random: &mut Stream) -> Result<Vec<[f64; 2]>, PositioningError> {
        let count = self.anchor_count();
        let across = (count as f64).sqrt().ceil() as usize;
        let mut places: Vec<usize> = (0..across * across).collect();
        places.shuffle(random);
        let jitter = uniform("world.anchors_per_100", -0.2, 0.2)?;
        let spacing = self.side() / across.max(1) as f64;
        let place = |place: usize| {
            [place % across, place / across]
                .map(|index| (index as f64 + 0.5 + jitter.sample(&mut *random)) * spacing)
        };
        Ok(places.into_iter().take(count).map(place).collect())
    }

    fn measure(
        &self,
        truth: &[[f64; 2]],
        anchors: &[[f64; 2]],
        [pairs, to_anchors]: &[Stream; 2],
    ) -> (Vec<Ranging>, Vec<AnchorRanging>) {
        let (others, known) = (Reach::new(truth, Some(self.radius)), Reach::new(anchors, Some(self.radius)));
        let deviation = self.range_variance.sqrt();
        let noisy = |distance: f64, stream: &Stream, own: usize, other: usize| {
            let mut random = stream.derive(own as u64).derive(other as u64);
            let measured = distance + deviation * normal(&mut random);
            let lost = self.link_loss > 0.0 && share(&mut random) < self.link_loss;
            (!lost).then_some(measured)
        };
        let (mut ranges, mut anchor_ranges) = (Vec::new(), Vec::new());
        for (agent, &position) in truth.iter().enumerate() {
            for (other, distance) in others.within(position).filter(|&(other, _)| other > agent) {
                if let Some(measured) = noisy(distance, pairs, agent, other) {
                    ranges.push(Ranging { agents: [agent, other], measured });
                }
            }
            for (anchor, distance) in known.within(position) {
                if let Some(measured) = noisy(distance, to_anchors, agent, anchor) {
                    anchor_ranges.push(AnchorRanging { agent, anchor, measured });
                }
            }
        }
        (ranges, anchor_ranges)
    }
}

fn uniform(key: &str, low: f64, high: f64) -> Result<Uniform<f64>, PositioningError> {
    Uniform::new(low, high).map_err(|error| PositioningError::setting(key, error.to_string()))
}

fn normal(random: &mut Stream) -> f64 {
    StandardNormal.sample(random)
}

fn share(random: &mut Stream) -> f64 {
    use rand::RngExt;
    random.random::<f64>()
}

/// The weak start: the centroid of the anchors an agent hears, weighed by the reciprocal of the range; without one the
/// mean of its neighbours' starts, of those who have one; without these the middle of the square. Half a metre of noise
/// keeps two agents from starting in one place.
fn starts(
    agents: usize,
    side: f64,
    anchors: &[[f64; 2]],
    ranges: &[Ranging],
    anchor_ranges: &[AnchorRanging],
    stream: &Stream,
) -> Vec<[f64; 2]> {
    let mut sums = vec![[0.0; 3]; agents];
    let add = |sums: &mut Vec<[f64; 3]>, agent: usize, at: [f64; 2], weight: f64| {
        let sum = &mut sums[agent];
        sum[0] += weight * at[0];
        sum[1] += weight * at[1];
        sum[2] += weight;
    };
    for range in anchor_ranges {
        // A range that noise has made nothing would weigh without bound.
        add(&mut sums, range.agent, anchors[range.anchor], 1.0 / range.measured.max(1e-3));
    }
    let mean = |sum: &[f64; 3]| (sum[2] > 0.0).then(|| [sum[0] / sum[2], sum[1] / sum[2]]);
    let mut starts: Vec<Option<[f64; 2]>> = sums.iter().map(mean).collect();
    for _ in 0..START_SWEEPS {
        if starts.iter().all(Option::is_some) {
            break;
        }
        sums.fill([0.0; 3]);
        for range in ranges {
            let [a, b] = range.agents;
            for (own, other) in [(a, b), (b, a)] {
                if let Some(at) = starts[other] {
                    add(&mut sums, own, at, 1.0);
                }
            }
        }
        for (start, sum) in starts.iter_mut().zip(&sums).filter(|(start, _)| start.is_none()) {
            *start = mean(sum);
        }
    }
    let placed = starts.into_iter().enumerate().map(|(agent, start)| {
        let mut random = stream.derive(agent as u64);
        start.unwrap_or([0.5 * side; 2]).map(|x| x + START_NOISE * normal(&mut random))
    });
    placed.collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    pub(super) fn world(agents: usize) -> World {
        World {
            agents,
            anchors_per_100: 13.0,
            radius: 20.0,
            range_variance: 0.25,
            link_loss: 0.0,
            silence: true,
        }
    }

    #[test]
    fn a_draw_depends_on_seed_and_run_alone() {
        let world = world(100);
        let draw = world.draw(1, 3).unwrap();
        assert_eq!(draw, world.draw(1, 3).unwrap());
        assert_ne!(draw.truth, world.draw(1, 4).unwrap().truth);
        assert_ne!(draw.anchors, world.draw(2, 3).unwrap().anchors);
        assert_eq!((draw.truth.len(), draw.anchors.len()), (100, 13));
    }

    #[test]
    fn all_pairs_in_reach_measure_each_other_unless_links_fail() {
        let all = world(200).draw(5, 0).unwrap();
        let near = |a: [f64; 2], b: [f64; 2]| (a[0] - b[0]).hypot(a[1] - b[1]) <= 20.0;
        let pairs = (0..200).flat_map(|i| (0..i).map(move |j| (i, j)));
        let expected = pairs.filter(|&(i, j)| near(all.truth[i], all.truth[j])).count();
        assert_eq!(all.ranges.len(), expected);
        let lossy = World { link_loss: 0.5, ..world(200) }.draw(5, 0).unwrap();
        // Of n links half fail, within 5 deviations: a chance of 6e-7.
        let n = expected as f64;
        assert!((lossy.ranges.len() as f64 - 0.5 * n).abs() < 5.0 * (0.25 * n).sqrt());
    }

    #[test]
    fn a_start_is_the_centroid_of_the_anchors_heard() {
        let anchors = [[0.0, 0.0], [10.0, 0.0]];
        let heard = |agent, anchor, measured| AnchorRanging { agent, anchor, measured };
        let ranges = [Ranging { agents: [0, 1], measured: 3.0 }];
        let to_anchors = [heard(0, 0, 1.0), heard(0, 1, 3.0)];
        let stream = Stream::new(1, 0, Purpose::World, 4);
        let start = starts(3, 50.0, &anchors, &ranges, &to_anchors, &stream);
        let noise = |agent: u64| {
            let mut random = stream.derive(agent);
            [normal(&mut random), normal(&mut random)].map(|x| 0.5 * x)
        };
        for (agent, expected) in [[2.5, 0.0], [2.5, 0.0], [25.0, 25.0]].into_iter().enumerate() {
            let noise = noise(agent as u64);
            assert!((start[agent][0] - expected[0] - noise[0]).abs() < 1e-12);
            assert!((start[agent][1] - expected[1] - noise[1]).abs() < 1e-12);
        }
    }

    #[test]
    fn wrong_values_are_refused_by_their_key() {
        let good = world(10);
        for (world, part) in [
            (World { agents: 0, ..good.clone() }, "`world.agents` is 0"),
            (World { radius: -1.0, ..good.clone() }, "`world.radius` is -1 m"),
            (World { range_variance: 0.0, ..good.clone() }, "`world.range_variance` is 0 m²"),
            (World { link_loss: 1.0, ..good.clone() }, "`world.link_loss` is 1"),
            (World { anchors_per_100: f64::NAN, ..good.clone() }, "`world.anchors_per_100` is NaN"),
        ] {
            let message = world.validate().unwrap_err().to_string();
            assert!(message.contains(part), "{message}");
        }
    }
}
