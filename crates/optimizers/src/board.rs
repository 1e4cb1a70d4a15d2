//! The knowledge-board co-operative swarm: sub-swarms that search, and a board that they read and write.
//!
//! The prior's cloud is cut into S sub-swarms that lie side by side along its principal axis. Each keeps a
//! five-tuple on the [board](Board): its diversity, its ability to search, its life state, its best state and its
//! weight. The life state says what its particles do next:
//!
//! | state | when | the particles |
//! |---|---|---|
//! | growing | the best's log fitness rose by more than ε_C | (6) v ← ω v + c₁ r₁∘(b_s − x), x ← x + v |
//! | pseudo-mature | it did not, while the sub-swarm is spread by more than ε_D | (7) v ← ω v + c₁ r₁∘(b_s − x) + c₂ r₂∘(b_s′ − x), x ← x + v, with s′ drawn by the weights on the board |
//! | mature | it did not, and the sub-swarm has converged | are drawn anew from the prior, v ← 0 |
//!
//! Two forms use that search.
//!
//! **Literal.** The fitness is log ℓ, and the moved cloud, weighed by ℓ, is handed on as if it were a sample. It is
//! not one of any known distribution: what (6) and (7) move no longer follows the density that the weights assume,
//! the prior's weights are forgotten, and the spread shrinks to the likelihood's ridge.
//!
//! **Valid.** The fitness is log ℓ + log p̂, and the search does no more than shape a proposal
//!
//! q = α p̂ + (1 − α) (½ A + ½ B),
//!
//! where A is the Gaussians of the prior's particles weighed by ℓ, and B those of the moved ones weighed by ℓ p̂ over a
//! Gaussian around their own sub-swarm, both widened. Particles are drawn anew from q and weighed by ℓ p̂ / q, at most
//! ℓ / α, so that a bad search lowers the effective sample size and never the validity; the mean weight is the
//! evidence. p̂ is the prior's density where it is known, else p̃, the board's Gaussian sum of the prior (weight, mean and
//! covariance of each sub-swarm): then the prior keeps its mean and covariance, and its shape to the resolution of S
//! Gaussians.
//!
//! Source: Wang, Wang, Zou, Qian, "Cooperative particle filtering algorithm based on knowledge plate" (2014), whose
//! equations are lost in the copies that exist; the names of the states and of (6) to (8) are the paper's, the
//! formulae a reconstruction from its text and from Jie, Zeng, Han, "Knowledge-based cooperative particle swarm
//! optimization" (2008).

mod chart;
mod knowledge;
mod partition;
mod proposal;
mod settings;
mod swarm;

use sumprod_graph::FastStream;
use sumprod_messages::{Evaluator, Mixture, Particles};

use crate::error::OptimizerError;
use crate::moves::{Move, Moved, Validity};
use crate::target::Target;
use chart::Chart;
use partition::Partition;
use proposal::{Components, Proposal};
use swarm::Swarms;

pub use knowledge::{Board, Knowledge, LifeState};
pub use settings::{BoardForm, BoardSettings};

/// The knowledge-board co-operative swarm as a move; see the [module](self).
#[derive(Clone, Debug, PartialEq)]
pub struct KnowledgeBoard {
    settings: BoardSettings,
}

/// What a search leaves behind.
#[derive(Clone, Debug, PartialEq)]
pub struct Search {
    /// The points reached, one after the other.
    pub points: Vec<f64>,
    /// Log fitness at each.
    pub log_fitness: Vec<f64>,
    /// The board after the last iteration; its best states are points of the target's space.
    pub board: Board,
    /// How many times a sub-swarm was growing, pseudo-mature and mature when it acted.
    pub lives: [u64; 3],
}

impl KnowledgeBoard {
    /// The swarm of these settings.
    ///
    /// # Errors
    ///
    /// [`OptimizerError::Parameter`] where one is out of range.
    pub fn new(settings: BoardSettings) -> Result<Self, OptimizerError> {
        settings.validate()?;
        Ok(Self { settings })
    }

    /// The search alone, from the prior's cloud, with the fitness of the settings' form.
    ///
    /// # Errors
    ///
    /// Where the likelihood or the prior's density cannot be evaluated.
    pub fn search(&self, target: &mut Target<'_>, random: &mut FastStream) -> Result<Search, OptimizerError> {
        let cloud = self.cloud(target)?;
        let prior_density = Evaluator::new(&cloud.prior);
        let (swarms, _) = self.moved(&cloud, &prior_density, target, random)?;
        let mut board = swarms.board;
        for knowledge in board.local.iter_mut().chain(std::iter::once(&mut board.global)) {
            knowledge.best_state = cloud.chart.places(&knowledge.best_state);
        }
        Ok(Search {
            points: cloud.chart.places(&swarms.positions),
            log_fitness: swarms.fitness,
            board,
            lives: swarms.lives,
        })
    }

    fn cloud(&self, target: &Target<'_>) -> Result<Cloud, OptimizerError> {
        let prior = target.prior();
        match self.settings.form {
            BoardForm::Valid => Cloud::new(prior, self.settings.sub_swarms),
            BoardForm::Literal => {
                let forgetful = Particles::equally_weighted(&target.space(), prior.points().to_vec())?;
                Cloud::new(&forgetful, self.settings.sub_swarms)
            }
        }
    }

    /// The swarms after their search, and the log likelihood at the prior's points in the partition's order.
    fn moved(
        &self,
        cloud: &Cloud,
        prior_density: &Evaluator<'_>,
        target: &mut Target<'_>,
        random: &mut FastStream,
    ) -> Result<(Swarms, Vec<f64>), OptimizerError> {
        let valid = self.settings.form == BoardForm::Valid;
        let count = cloud.partition.len();
        let (mut likelihood, mut density) = (vec![0.0; count], vec![0.0; count]);
        let mut evaluate = |standard: &[f64], likelihood: &mut [f64], density: &mut [f64]| {
            let points = cloud.chart.places(standard);
            target.log_likelihood(&points, likelihood)?;
            if valid {
                cloud.log_prior(target, prior_density, standard, &points, density)?;
            }
            Ok::<(), OptimizerError>(())
        };
        let mut swarms = Swarms::new(cloud.standard.clone(), cloud.partition.ranges());
        evaluate(&swarms.positions, &mut likelihood, &mut density)?;
        swarms.fitness.iter_mut().zip(likelihood.iter().zip(&density)).for_each(|(sum, (a, b))| *sum = a + b);
        let mut fitness = |standard: &[f64], values: &mut [f64]| -> Result<(), OptimizerError> {
            evaluate(standard, values, &mut density)?;
            values.iter_mut().zip(&density).for_each(|(value, log)| *value += log);
            Ok(())
        };
        swarms.search(&self.settings, &cloud.prior, &mut fitness, random)?;
        Ok((swarms, likelihood))
    }

    fn literal(&self, target: &mut Target<'_>, random: &mut FastStream) -> Result<Moved, OptimizerError> {
        let cloud = self.cloud(target)?;
        let prior_density = Evaluator::new(&cloud.prior);
        let (swarms, _) = self.moved(&cloud, &prior_density, target, random)?;
        let points = cloud.chart.places(&swarms.positions);
        let mut moved = Moved::weighed(target, points, swarms.fitness)?;
        moved.ancestors = cloud.partition.order().to_vec();
        moved.log_evidence = None;
        Ok(moved)
    }

    fn valid(&self, target: &mut Target<'_>, random: &mut FastStream) -> Result<Moved, OptimizerError> {
        let cloud = self.cloud(target)?;
        let prior_density = Evaluator::new(&cloud.prior);
        let (swarms, likelihood) = self.moved(&cloud, &prior_density, target, random)?;
        let weighed: Vec<f64> =
            likelihood.iter().zip(&cloud.log_weights).map(|(log, weight)| log + weight).collect();
        let ranges = cloud.partition.ranges();
        let fits = [
            Components::weighted(&cloud.standard, &weighed, ranges, cloud.chart.dimension()),
            swarms.corrected()?,
        ];
        let shaped = Components::shaped(fits).filter(|_| self.settings.defensive_share < 1.0);
        let (count, share) = (cloud.partition.len(), self.settings.defensive_share);
        let proposal = Proposal::new(target.prior_density(), &cloud.sum, shaped, share, count)?;
        let points = proposal.draw(&cloud.chart, random)?;
        let standard = cloud.chart.standardises(&points);
        let (mut log_weights, mut prior, mut proposed) =
            (vec![0.0; count], vec![0.0; count], vec![0.0; count]);
        target.log_likelihood(&points, &mut log_weights)?;
        cloud.log_prior(target, &prior_density, &standard, &points, &mut prior)?;
        proposal.log_densities(&standard, &prior, &mut proposed)?;
        for (weight, (prior, proposed)) in log_weights.iter_mut().zip(prior.iter().zip(&proposed)) {
            *weight += prior - proposed - (count as f64).ln();
        }
        let moved = Moved::weighed(target, points, log_weights)?;
        Ok(Moved { ancestors: Vec::new(), ..moved })
    }
}

impl Move for KnowledgeBoard {
    fn advance(&self, target: &mut Target<'_>, random: &mut FastStream) -> Result<Moved, OptimizerError> {
        match self.settings.form {
            BoardForm::Literal => self.literal(target, random),
            BoardForm::Valid => self.valid(target, random),
        }
    }

    fn validity(&self) -> Validity {
        match self.settings.form {
            BoardForm::Literal => Validity::Literal,
            BoardForm::Valid => Validity::GaussianSum,
        }
    }
}

/// The prior's cloud in standard coordinates, in the order of its sub-swarms.
struct Cloud {
    chart: Chart,
    partition: Partition,
    standard: Vec<f64>,
    log_weights: Vec<f64>,
    /// The board's Gaussian sum of the prior, by its components and as a density.
    sum: Components,
    prior: Mixture,
}

impl Cloud {
    fn new(prior: &Particles, sub_swarms: usize) -> Result<Self, OptimizerError> {
        let d = prior.dimension();
        let chart = Chart::of(prior);
        let unsorted = chart.standardises(prior.points());
        let partition = Partition::new(&unsorted, d, sub_swarms);
        let standard: Vec<f64> =
            partition.order().iter().flat_map(|&i| &unsorted[i * d..(i + 1) * d]).copied().collect();
        let log_weights: Vec<f64> = partition.order().iter().map(|&i| prior.log_weights()[i]).collect();
        let sum = Components::weighted(&standard, &log_weights, partition.ranges(), d);
        let prior = sum.mixture()?;
        Ok(Self { chart, partition, standard, log_weights, sum, prior })
    }

    /// Log density of the prior in standard coordinates: its own where it is known, else the board's.
    fn log_prior(
        &self,
        target: &Target<'_>,
        board: &Evaluator<'_>,
        standard: &[f64],
        points: &[f64],
        values: &mut [f64],
    ) -> Result<(), OptimizerError> {
        if target.log_prior(points, values)? {
            let scale = self.chart.log_scale();
            values.iter_mut().for_each(|value| *value += scale);
            return Ok(());
        }
        Ok(board.log_densities(standard, values)?)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use sumprod_graph::{Purpose, Space, Stream};

    fn line(count: u32) -> Particles {
        let points = (0..count).map(|k| 8.0 * (f64::from(k) / f64::from(count - 1) - 0.5)).collect();
        Particles::equally_weighted(&Space::real(1), points).unwrap()
    }

    fn search(settings: BoardSettings, likelihood: &dyn crate::LogDensity) -> Search {
        let prior = line(200);
        let mut target = Target::new(&prior, likelihood).unwrap();
        let mut random = Stream::new(1, 0, Purpose::Optimizer, 0).fast();
        KnowledgeBoard::new(settings).unwrap().search(&mut target, &mut random).unwrap()
    }

    #[test]
    fn sub_swarms_pass_from_growing_to_maturity_and_begin_again() {
        let peak = |x: &[f64]| -200.0 * (x[0] - 1.234).powi(2);
        let settings = BoardSettings { iterations: 40, enough: 1.0, ..BoardSettings::literal() };
        let found = search(settings.clone(), &peak);
        assert_eq!(found.lives.iter().sum::<u64>(), 40 * settings.sub_swarms as u64);
        assert!(found.lives.iter().all(|&count| count > 0), "{:?}", found.lives);
        assert!((found.board.global.best_state[0] - 1.234).abs() < 0.01);
        let best = found.log_fitness.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        assert!(found.board.global.best_fitness >= best);
        for knowledge in &found.board.local {
            assert!(knowledge.weight >= 0.0 && knowledge.diversity >= 0.0 && !knowledge.ability.is_nan());
        }
    }

    #[test]
    fn an_even_fitness_ends_the_search_and_no_fitness_does_not_break_it() {
        let even = search(BoardSettings::literal(), &|_: &[f64]| 0.0);
        assert_eq!(even.lives, [0; 3]);
        let none = search(BoardSettings::default(), &|_: &[f64]| f64::NEG_INFINITY);
        assert!(none.points.iter().all(|x| x.is_finite()));
    }

    #[test]
    fn settings_out_of_range_are_refused() {
        let refused = |settings| KnowledgeBoard::new(settings).unwrap_err().to_string();
        let base = BoardSettings::default;
        assert!(
            refused(BoardSettings { sub_swarms: 0, ..base() }).starts_with("the number of sub-swarms is 0")
        );
        assert!(refused(BoardSettings { inertia: f64::NAN, ..base() }).starts_with("the inertia is NaN"));
        assert!(
            refused(BoardSettings { enough: 2.0, ..base() }).starts_with("the share that is enough is 2")
        );
        assert!(refused(BoardSettings { defensive_share: 0.0, ..base() }).contains("must be above 0"));
    }
}
