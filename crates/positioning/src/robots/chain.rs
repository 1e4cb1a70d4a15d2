//! A chain of states, one a slice, each with the evidence that came since the slice before.
//!
//! p(x₀) ∏ₖ p(xₖ | xₖ₋₁) ∏ₖ p(zₖ | xₖ): a window of one slice is its filter, of more a fixed-lag smoother, and
//! forward-backward on the whole its (iterated) smoother. Nonlinear factors are linearised anew at the beliefs in
//! each round and sweep.

use serde::{Deserialize, Serialize};
use sumprod_graph::schedule::{ForwardBackward, Sliced};
use sumprod_graph::{Engine, Factor, FactorGraph, GraphError, Options, Space, Window, WindowVariable};
use sumprod_messages::{AnyForm, AnyMessage, Moments};
use sumprod_models::{Cluster, Model, Motion, Transition};

use super::numbers::at_least_one;
use crate::PositioningError;
use crate::scenario::{FormUse, GraphSummary};

/// What a system says of its chain.
pub trait Chain {
    /// The step from one slice to the next.
    type Motion: Motion + 'static;

    /// The space of a slice's state.
    fn space(&self) -> Space;

    /// Times of the slices (s), increasing.
    fn times(&self) -> &[f64];

    /// Mean and covariance of the state of slice 0 before any evidence.
    fn start(&self) -> &Moments;

    /// The motion from slice `slice` − 1 to `slice`.
    fn motion(&self, slice: usize) -> Self::Motion;

    /// What is measured at `slice` (from 1); empty where nothing is.
    ///
    /// # Errors
    /// Where a noise model cannot be made.
    fn evidence(&self, slice: usize) -> Result<Cluster, PositioningError>;

    /// The kind of evidence: `range`, `sighting`.
    fn evidence_kind(&self) -> &'static str;
}

/// What a method does with the evidence.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Inference {
    /// Dead reckoning: no evidence at all.
    Odometry,
    /// Each slice from the evidence up to it.
    Filter,
    /// Each slice from the evidence up to it, by particles.
    ParticleFilter,
    /// Each slice from all evidence, or from that of a fixed lag.
    Smoother,
}

/// How a chain is run.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Plan {
    /// A window of one slice, the evidence linearised `rounds` times.
    Filter {
        /// At least 1.
        rounds: usize,
    },
    /// A window that reaches `lag` slices back, its messages sent to and fro `sweeps` times a slice.
    FixedLag {
        /// At least 1.
        lag: usize,
        /// At least 1.
        sweeps: usize,
    },
    /// The whole chain, forward and backward `sweeps` times.
    Smoother {
        /// At least 1.
        sweeps: usize,
    },
}

impl Plan {
    /// The plan of a method table: `rounds`, `lag` and `sweeps` as it gives them, or 1, none and 1.
    ///
    /// # Errors
    /// [`PositioningError::Setting`] for a zero, or a key that its inference does not know.
    pub fn new(
        id: &str,
        inference: Inference,
        rounds: Option<u32>,
        lag: Option<u32>,
        sweeps: Option<u32>,
    ) -> Result<Self, PositioningError> {
        let smoother = inference == Inference::Smoother;
        for (key, value, known) in
            [("rounds", rounds, !smoother), ("lag", lag, smoother), ("sweeps", sweeps, smoother)]
        {
            let Some(value) = value else { continue };
            let key = format!("method.{id}.{key}");
            if !known {
                let whose = if smoother { "a filter" } else { "a smoother" };
                return Err(PositioningError::setting(key, format!("belongs to {whose}; leave it out")));
            }
            at_least_one(&key, value)?;
        }
        let number = |value: Option<u32>| value.unwrap_or(1) as usize;
        Ok(match (smoother, lag) {
            (false, _) => Self::Filter { rounds: number(rounds) },
            (true, Some(lag)) => Self::FixedLag { lag: lag as usize, sweeps: number(sweeps) },
            (true, None) => Self::Smoother { sweeps: number(sweeps) },
        })
    }
}

/// Receives the belief of each slice, in the order of the slices.
pub type Visit<'a> = dyn FnMut(usize, &Moments) -> Result<(), PositioningError> + 'a;

/// Runs the method `id` on a chain and hands each slice's belief to `visit`.
///
/// A chain of n slices of d coordinates takes O(n d³) for each round or sweep, and with a lag of L slices O(L n d³).
///
/// # Errors
/// [`PositioningError::Method`] where a message cannot be computed, and whatever `visit` returns.
pub fn run<C: Chain>(
    id: &str,
    chain: &C,
    plan: Plan,
    seed: u64,
    visit: &mut Visit<'_>,
) -> Result<(), PositioningError> {
    let options = Options { seed, parallel: false, ..Options::default() };
    let failed = |error: GraphError| PositioningError::method(id, error);
    match plan {
        Plan::Filter { rounds } => {
            let mut window = Windowed::new(chain, 1, options).map_err(failed)?;
            for slice in 0..chain.times().len() {
                window.advance(id, slice)?;
                window.window.run(&mut Sliced::new(rounds)).map_err(failed)?;
                visit(slice, &window.moments(id, 0)?)?;
            }
        }
        Plan::FixedLag { lag, sweeps } => {
            let options = Options { max_iterations: sweeps, ..options };
            let mut window = Windowed::new(chain, lag, options).map_err(failed)?;
            let count = chain.times().len();
            for slice in 0..count {
                window.advance(id, slice)?;
                window.window.run(&mut Sliced::new(1).smoothing()).map_err(failed)?;
                if let Some(done) = slice.checked_sub(lag) {
                    visit(done, &window.moments(id, lag)?)?;
                }
            }
            for back in (0..lag.min(count)).rev() {
                visit(count - 1 - back, &window.moments(id, back)?)?;
            }
        }
        Plan::Smoother { sweeps } => {
            let graph = graph(id, chain)?;
            let mut engine = Engine::new(&graph, options).map_err(failed)?;
            engine.run(&mut ForwardBackward::iterated(sweeps)).map_err(failed)?;
            for (slice, variable) in graph.variable_ids().enumerate() {
                let moments = engine.belief(variable).moments();
                visit(slice, &moments.map_err(|error| PositioningError::method(id, error))?)?;
            }
        }
    }
    Ok(())
}

type BoxedFactor = Box<dyn Factor<AnyMessage>>;

/// A chain seen through a window.
struct Windowed<'a, C> {
    chain: &'a C,
    space: Space,
    window: Window<AnyMessage, BoxedFactor>,
}

impl<'a, C: Chain> Windowed<'a, C> {
    fn new(chain: &'a C, lag: usize, options: Options) -> Result<Self, GraphError> {
        Ok(Self { chain, space: chain.space(), window: Window::new(lag, options)? })
    }

    /// Begins a slice with its variable and factors.
    fn advance(&mut self, id: &str, slice: usize) -> Result<(), PositioningError> {
        let before = self.window.slice(0).first().copied();
        let evidence = evidence(self.chain, slice)?;
        let failed = |error: GraphError| PositioningError::method(id, error);
        let state = self.add(slice, before, evidence).map_err(failed)?;
        if before.is_none() {
            self.window.set_prior(state, start(id, self.chain, &self.space)?).map_err(failed)?;
        }
        Ok(())
    }

    fn add(
        &mut self,
        slice: usize,
        before: Option<WindowVariable>,
        evidence: Option<Cluster>,
    ) -> Result<WindowVariable, GraphError> {
        let form = AnyForm::gaussian();
        self.window.begin(self.chain.times()[slice])?;
        let state = self.window.variable(format!("slice {slice}"), self.space.clone())?;
        if let Some(before) = before {
            let motion: BoxedFactor = Box::new(Model(Transition::new(self.chain.motion(slice))));
            self.window.factor("motion", motion, &[(before, form), (state, form)])?;
        }
        if let Some(cluster) = evidence {
            self.window.factor(self.chain.evidence_kind(), Box::new(Model(cluster)), &[(state, form)])?;
        }
        Ok(state)
    }

    /// The belief of the slice `back` slices before the newest.
    fn moments(&self, id: &str, back: usize) -> Result<Moments, PositioningError> {
        let belief = self.window.slice(back).first().and_then(|&state| self.window.belief(state));
        let Some(belief) = belief else {
            return Err(PositioningError::method(id, format!("no belief {back} slices back")));
        };
        belief.moments().map_err(|error| PositioningError::method(id, error))
    }
}

fn start<C: Chain>(id: &str, chain: &C, space: &Space) -> Result<AnyMessage, PositioningError> {
    let Moments { mean, covariance } = chain.start();
    AnyMessage::gaussian(space, mean, covariance).map_err(|error| PositioningError::method(id, error))
}

fn evidence<C: Chain>(chain: &C, slice: usize) -> Result<Option<Cluster>, PositioningError> {
    let cluster = if slice == 0 { None } else { Some(chain.evidence(slice)?) };
    Ok(cluster.filter(|cluster| !cluster.is_empty()))
}

/// The whole chain as a graph, its variables in the order of the slices.
fn graph<C: Chain>(id: &str, chain: &C) -> Result<FactorGraph<AnyMessage>, PositioningError> {
    let failed = |error: GraphError| PositioningError::method(id, error);
    let mut graph = FactorGraph::<AnyMessage>::new();
    let space = chain.space();
    let mut before = None;
    for (slice, &time) in chain.times().iter().enumerate() {
        let state = graph.variable(format!("slice {slice}"), space.clone()).map_err(failed)?;
        graph.set_time(state, time).map_err(failed)?;
        match before {
            Some(before) => {
                let motion: BoxedFactor = Box::new(Model(Transition::new(chain.motion(slice))));
                graph.factor("motion", motion, &[before, state]).map_err(failed)?;
            }
            None => graph.set_prior(state, start(id, chain, &space)?).map_err(failed)?,
        }
        if let Some(cluster) = evidence(chain, slice)? {
            let factor: BoxedFactor = Box::new(Model(cluster));
            graph.factor(chain.evidence_kind(), factor, &[state]).map_err(failed)?;
        }
        before = Some(state);
    }
    Ok(graph)
}

/// The size and shape of a method's graph.
///
/// # Errors
/// As [`run`].
pub fn summary<C: Chain>(id: &str, chain: &C, plan: Plan) -> Result<GraphSummary, PositioningError> {
    let graph = graph(id, chain)?;
    let extent = match plan {
        Plan::Filter { .. } => "the whole recording, one slice at a time".to_owned(),
        Plan::FixedLag { lag, .. } => format!("the whole recording, {} slices at a time", lag + 1),
        Plan::Smoother { .. } => "the whole recording".to_owned(),
    };
    let kinds = ["motion", chain.evidence_kind()];
    let forms = kinds.iter().map(|&kind| {
        let factors = graph.factor_ids().filter(|&factor| graph.factor_kind(factor) == kind);
        let edges = factors.map(|factor| graph.ports(factor).count()).sum();
        FormUse { kind: kind.to_owned(), form: AnyForm::gaussian().name().to_owned(), edges }
    });
    Ok(GraphSummary::new(id, extent, &graph, forms.filter(|form| form.edges > 0).collect()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use sumprod_models::library::{LinearGaussian, Unicycle};
    use sumprod_models::{Block, Noise};

    /// A robot that drives straight on and sees each of its coordinates in turn.
    struct Straight {
        times: Vec<f64>,
        start: Moments,
        noise: Noise,
    }

    impl Straight {
        fn new(slices: u32) -> Self {
            let covariance = vec![0.5, 0.1, 0.0, 0.1, 0.4, 0.0, 0.0, 0.0, 0.02];
            Self {
                times: (0..slices).map(f64::from).collect(),
                start: Moments { mean: vec![1.0, -2.0, 0.3], covariance },
                noise: Noise::isotropic(1, 0.25).unwrap(),
            }
        }
    }

    impl Chain for Straight {
        type Motion = Unicycle;

        fn space(&self) -> Space {
            Space::pose2()
        }

        fn times(&self) -> &[f64] {
            &self.times
        }

        fn start(&self) -> &Moments {
            &self.start
        }

        fn motion(&self, _slice: usize) -> Unicycle {
            // Without a distance driven, and with round noise, the motion is linear: all plans agree to rounding.
            Unicycle::new(0.0, 0.1, [0.04, 0.04, 0.001]).unwrap()
        }

        fn evidence(&self, slice: usize) -> Result<Cluster, PositioningError> {
            let mut cluster = Cluster::new(3);
            let measured = 0.1 * slice as f64;
            if !slice.is_multiple_of(3) {
                let seen = LinearGaussian::new(&[&[1.0]], &[measured], self.noise.clone()).unwrap();
                cluster.add(seen, &[Block::new(slice % 3 - 1, 1)]).unwrap();
            }
            Ok(cluster)
        }

        fn evidence_kind(&self) -> &'static str {
            "coordinate"
        }
    }

    fn beliefs(plan: Plan) -> Vec<Moments> {
        let mut found = Vec::new();
        run("test", &Straight::new(12), plan, 1, &mut |slice, moments| {
            assert_eq!(slice, found.len());
            found.push(moments.clone());
            Ok(())
        })
        .unwrap();
        assert_eq!(found.len(), 12);
        found
    }

    fn apart(a: &Moments, b: &Moments) -> f64 {
        let numbers = |moments: &Moments| [moments.mean.clone(), moments.covariance.clone()].concat();
        numbers(a).iter().zip(numbers(b)).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
    }

    #[test]
    fn a_lag_as_long_as_the_chain_is_the_smoother_and_all_agree_on_the_last_slice() {
        let smoother = beliefs(Plan::Smoother { sweeps: 1 });
        for lag in [11, 12, 20] {
            let lagged = beliefs(Plan::FixedLag { lag, sweeps: 1 });
            assert!(lagged.iter().zip(&smoother).all(|(a, b)| apart(a, b) < 1e-9));
        }
        let filter = beliefs(Plan::Filter { rounds: 1 });
        for lag in [1, 2, 5] {
            let lagged = beliefs(Plan::FixedLag { lag, sweeps: 1 });
            assert!(apart(&lagged[11], &smoother[11]) < 1e-9);
            // Slice 4 hears slices 5 and on only where the lag reaches them.
            let variance = |belief: &Moments| belief.covariance_at(0, 0);
            assert!(variance(&lagged[4]) <= variance(&filter[4]) + 1e-12);
            assert!(variance(&lagged[4]) >= variance(&smoother[4]) - 1e-12);
        }
        assert!(apart(&filter[11], &smoother[11]) < 1e-9);
    }

    #[test]
    fn keys_that_mean_nothing_are_refused() {
        let sentence =
            |inference, rounds, lag| Plan::new("m", inference, rounds, lag, None).unwrap_err().to_string();
        assert_eq!(
            sentence(Inference::Filter, None, Some(3)),
            "`method.m.lag` belongs to a smoother; leave it out"
        );
        assert_eq!(
            sentence(Inference::Smoother, None, Some(0)),
            "`method.m.lag` is 0; it must be at least 1"
        );
        assert_eq!(
            sentence(Inference::Filter, Some(0), None),
            "`method.m.rounds` is 0; it must be at least 1"
        );
    }

    #[test]
    fn the_summary_counts_a_chain() {
        let summary = summary("m", &Straight::new(12), Plan::Smoother { sweeps: 1 }).unwrap();
        assert_eq!((summary.variables, summary.factors, summary.edges), (12, 11 + 8, 22 + 8));
        assert_eq!((summary.components, summary.loops), (1, 0));
        assert_eq!(summary.forms[1].edges, 8);
    }
}
