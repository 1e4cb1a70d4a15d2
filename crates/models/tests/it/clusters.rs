//! A cluster against its parts, and against the exact joint.

use crate::support::{
    Draw, Joint, assert_close, assert_moments, information_of, moments_of, rows, send_gaussian,
};
use nalgebra::{DMatrix, DVector};
use sumprod_graph::schedule::ForwardBackward;
use sumprod_graph::{Engine, FactorGraph, MessageError, Options, Space};
use sumprod_messages::{AnyForm, AnyMessage, DynamicGaussian, Particles, ParticlesForm, Role};
use sumprod_models::library::{AnchorRange, LinearGaussian, Range, RangeBearing};
use sumprod_models::{AddModel, Block, Cluster, Model, Noise};

fn noise(dimension: usize) -> Noise {
    Noise::isotropic(dimension, 0.2).unwrap()
}

fn pair() -> Range {
    Range::new(4.0, [3, 2], [[0, 1], [0, 1]], noise(1)).unwrap()
}

/// A pose at 0..3, a point at 3..5.
fn clusters() -> (Cluster, Vec<Cluster>) {
    let (pose, point) = (Block::new(0, 3), Block::new(3, 2));
    let mut whole = Cluster::new(5);
    let mut parts: Vec<Cluster> = (0..4).map(|_| Cluster::new(5)).collect();
    let heavy = noise(1).student_t(3.0).unwrap();
    for one in [0, 1] {
        let target = if one == 0 { &mut whole } else { &mut parts[0] };
        target.add(pair(), &[pose, point]).unwrap();
        let target = if one == 0 { &mut whole } else { &mut parts[1] };
        target.add(RangeBearing::new(5.0, 3.0, 2, noise(2)).unwrap(), &[pose, point]).unwrap();
        let target = if one == 0 { &mut whole } else { &mut parts[2] };
        target.add(AnchorRange::new(7.0, [9.0, 9.0], 2, [0, 1], heavy.clone()).unwrap(), &[point]).unwrap();
        let target = if one == 0 { &mut whole } else { &mut parts[3] };
        let turn = LinearGaussian::new(&[&[0.0, 0.0, 1.0]], &[0.4], noise(1)).unwrap();
        target.add(turn, &[pose]).unwrap();
    }
    assert_eq!((whole.len(), parts[0].len(), whole.is_empty()), (4, 1, false));
    (whole, parts)
}

#[test]
fn a_cluster_is_the_sum_of_its_parts() {
    let mut draw = Draw::new(800);
    let (whole, parts) = clusters();
    let whole = Model(whole);
    let parts: Vec<_> = parts.into_iter().map(Model).collect();
    for _ in 0..50 {
        let belief = moments_of(&(draw.vector(5) * 3.0), &draw.covariance(5));
        let (information, vector) =
            information_of(&send_gaussian(&whole, 0, std::slice::from_ref(&belief)).unwrap());
        let (mut sum, mut vectors) = (DMatrix::zeros(5, 5), DVector::zeros(5));
        for part in &parts {
            let (own, eta) = information_of(&send_gaussian(part, 0, std::slice::from_ref(&belief)).unwrap());
            sum += own;
            vectors += eta;
        }
        assert_close(&information, &sum, 1e-12, "information");
        assert!((vector - &vectors).amax() < 1e-10 * (1.0 + vectors.amax()));
    }
}

#[test]
fn particles_of_a_cluster_are_weighed_by_all_parts() {
    let mut draw = Draw::new(801);
    let space = Space::real(5);
    let points: Vec<f64> = (0..200).map(|_| draw.normal()).collect();
    let carrier = Particles::equally_weighted(&space, points).unwrap();
    let (whole, parts) = clusters();
    let values = |cluster: Cluster| {
        let belief = [carrier.clone()];
        let form = ParticlesForm::new(40);
        let message: Particles = crate::support::send(&Model(cluster), 0, &belief, &belief, &form).unwrap();
        assert!(message.role() == Role::Likelihood && message.same_support(&carrier));
        message.log_weights().to_vec()
    };
    let all = values(whole);
    let mut sum = vec![0.0; 40];
    for part in parts {
        sum.iter_mut().zip(values(part)).for_each(|(sum, value)| *sum += value);
    }
    assert!(all.iter().zip(&sum).all(|(all, sum)| (all - sum).abs() < 1e-10 * sum.abs()));
    let flat = AnyMessage::from_gaussian(&space, DynamicGaussian::flat(5)).unwrap();
    let (whole, _) = clusters();
    let error = crate::support::send(
        &Model(whole),
        0,
        std::slice::from_ref(&flat),
        std::slice::from_ref(&flat),
        &AnyForm::particles(9),
    );
    assert!(error.unwrap_err().to_string().contains("give it a prior"));
}

/// Linear parts in a loop: messages among separate variables are approximate, the joint variable is exact.
#[test]
fn a_cluster_with_loops_equals_the_joint() {
    let mut draw = Draw::new(802);
    let dimensions = [2, 3, 2];
    let starts = [0, 2, 5];
    let mut joint = Joint::new(&dimensions);
    let mut cluster = Cluster::new(7);
    for variables in [vec![0, 1], vec![1, 2], vec![2, 0], vec![0, 1, 2]] {
        let matrices: Vec<_> = variables.iter().map(|&k| draw.matrix(2, dimensions[k])).collect();
        let (target, covariance) = (draw.vector(2), draw.covariance(2));
        joint.add(&variables, &matrices, &target, &covariance);
        let entries: Vec<_> = matrices.iter().map(rows).collect();
        let entries: Vec<&[f64]> = entries.iter().map(Vec::as_slice).collect();
        let noise = Noise::gaussian(&rows(&covariance)).unwrap();
        let factor = LinearGaussian::new(&entries, target.as_slice(), noise).unwrap();
        let blocks: Vec<_> = variables.iter().map(|&k| Block::new(starts[k], dimensions[k])).collect();
        cluster.add(factor, &blocks).unwrap();
    }
    for (k, &d) in dimensions.iter().enumerate() {
        joint.add(&[k], &[DMatrix::identity(d, d)], &DVector::zeros(d), &(DMatrix::identity(d, d) * 9.0));
    }
    let mut graph = FactorGraph::<DynamicGaussian>::new();
    let all = graph.unnamed_variable(Space::real(7));
    graph.set_prior(all, moments_of(&DVector::zeros(7), &(DMatrix::identity(7, 7) * 9.0))).unwrap();
    graph.add_cluster("all", cluster, all).unwrap();
    let mut engine = Engine::new(&graph, Options::default()).unwrap();
    engine.run(&mut ForwardBackward::new()).unwrap();
    let found = engine.belief(all).moments().unwrap();
    for ((&start, &d), (mean, covariance)) in starts.iter().zip(&dimensions).zip(&joint.marginals()) {
        let own = sumprod_messages::Moments {
            mean: found.mean[start..start + d].to_vec(),
            covariance: (0..d)
                .flat_map(|row| (0..d).map(move |column| (row, column)))
                .map(|(row, column)| found.covariance_at(start + row, start + column))
                .collect(),
        };
        assert_moments(&own, mean, covariance, 1e-9);
    }
}

#[test]
fn blocks_that_do_not_fit_are_refused() {
    let mut cluster = Cluster::new(5);
    let wrong = |error: Result<(), MessageError>, what: &str| {
        assert!(matches!(error, Err(MessageError::Dimension { what: said, .. }) if said == what));
    };
    wrong(cluster.add(pair(), &[Block::new(0, 3)]), "the list of blocks");
    wrong(cluster.add(pair(), &[Block::new(0, 3), Block::new(3, 1)]), "a block");
    wrong(cluster.add(pair(), &[Block::new(0, 3), Block::new(4, 2)]), "the end of a block");
    wrong(cluster.add(pair(), &[Block::new(0, 3), Block::new(usize::MAX, 2)]), "the end of a block");
    assert!(cluster.is_empty());
}
