//! Particles survive a text format bit for bit, and a run goes on from it.

use crate::any::Says;
use sumprod_graph::schedule::Flooding;
use sumprod_graph::{
    Checkpoint, Engine, Factor, FactorGraph, Incoming, Message, MessageError, Messages, Options, Port,
    Purpose, Space, Stream,
};
use sumprod_messages::{AnyForm, AnyMessage, Particles, ParticlesForm};

fn space() -> Space {
    Space::real(2)
}

fn cloud(entity: u64, count: usize) -> Particles {
    let wide = AnyMessage::gaussian(&space(), &[0.0, 1.0], &[4.0, 0.0, 0.0, 4.0]).unwrap();
    let mut stream = Stream::new(3, 0, Purpose::User(3), entity);
    let (drawn, _) = wide.to_particles(count, &mut stream).unwrap();
    Particles::equally_weighted(&space(), drawn.points().to_vec()).unwrap()
}

/// Cuts the receiver's particles to a half-plane and jitters their weights.
struct Half;

impl Factor<AnyMessage> for Half {
    fn dimensions(&self) -> &[usize] {
        &[2]
    }

    fn message(
        &self,
        to: Port,
        incoming: &Incoming<'_, AnyMessage>,
        _form: &AnyForm,
        stream: &mut Stream,
    ) -> Result<AnyMessage, MessageError> {
        use rand::RngExt;
        let Some(points) = incoming.belief(to).particles() else { return Ok(incoming.belief(to).clone()) };
        let mut random = stream.fast();
        let value = |k: usize| if points.point(k)[0] > 0.0 { random.random() } else { f64::NEG_INFINITY };
        let values = (0..points.len()).map(value).collect();
        Ok(AnyMessage::from_particles(Particles::likelihood(points, values)?))
    }
}

#[test]
fn weights_of_zero_survive_text() {
    let set = cloud(1, 5);
    let none = f64::NEG_INFINITY;
    let set = Particles::new(&space(), set.points().to_vec(), vec![0.1, none, 0.3, none, 1.0 / 3.0]).unwrap();
    let text = serde_json::to_string(&set).unwrap();
    assert_eq!(serde_json::from_str::<Particles>(&text).unwrap(), set);
}

#[test]
fn the_carrier_of_a_product_does_not_depend_on_shared_storage() {
    let (other, base) = (cloud(2, 30), cloud(3, 30));
    let likelihood = Particles::likelihood(&base, (0..30).map(f64::from).collect()).unwrap();
    let messages = [other, base, likelihood];
    let loaded: Vec<Particles> = messages
        .iter()
        .map(|set| serde_json::from_str(&serde_json::to_string(set).unwrap()).unwrap())
        .collect();
    let product = |messages: &[Particles]| {
        let mut stream = Stream::new(0, 0, Purpose::Belief, 0);
        Particles::product(Messages::new(messages, &[0, 1, 2]), &ParticlesForm::default(), &mut stream)
            .unwrap()
    };
    assert_eq!(product(&messages), product(&loaded));
}

#[test]
fn a_resumed_particle_run_equals_the_uninterrupted_one() {
    let form = AnyForm::particles(200);
    let mut graph: FactorGraph<AnyMessage> = FactorGraph::new();
    for (k, with_sample) in [true, false].into_iter().enumerate() {
        let x = graph.variable(format!("x{k}"), space()).unwrap();
        graph.set_belief_form(x, form).unwrap();
        let prior = AnyMessage::gaussian(&space(), &[0.5, 0.0], &[3.0, 1.0, 1.0, 2.0]).unwrap();
        graph.set_prior(x, prior).unwrap();
        if with_sample {
            let says = Says(AnyMessage::from_particles(cloud(4, 200)));
            graph.factor("sample", Box::new(says), &[x]).unwrap();
        }
        for _ in 0..2 {
            let half = graph.factor("half", Box::new(Half), &[x]).unwrap();
            graph.set_edge_form(half, 0, form).unwrap();
        }
    }
    let options = |max_iterations| Options { seed: 5, max_iterations, tolerance: 0.0, ..Options::default() };
    let saved = |engine: &Engine<'_, AnyMessage>| serde_json::to_string(&engine.checkpoint()).unwrap();
    let mut whole = Engine::new(&graph, options(6)).unwrap();
    whole.run(&mut Flooding).unwrap();
    for split in [1, 3] {
        let mut first = Engine::new(&graph, options(split)).unwrap();
        first.run(&mut Flooding).unwrap();
        let part: Checkpoint<AnyMessage> = serde_json::from_str(&saved(&first)).unwrap();
        let mut second = Engine::resume(&graph, options(6 - split), part).unwrap();
        second.run(&mut Flooding).unwrap();
        assert_eq!(saved(&second), saved(&whole), "split after {split}");
    }
    let belief = whole.belief(graph.find("x1").unwrap());
    assert!(belief.is_proper() && belief.moments().unwrap().mean[0] > 0.0, "the half-plane was cut");
}
