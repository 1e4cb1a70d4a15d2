//! Trees of linear-Gaussian factors of one to three variables of mixed dimensions against the dense joint.

use crate::support::{Draw, HasMoments, Joint, assert_moments, rows, variables};
use nalgebra::{DMatrix, DVector};
use sumprod_graph::schedule::{Flooding, ForwardBackward};
use sumprod_graph::{Engine, Factor, FactorGraph, Options, Schedule};
use sumprod_messages::{AnyMessage, DynamicGaussian};
use sumprod_models::library::LinearGaussian;
use sumprod_models::{AddModel, Model, Noise, ResidualModel};

struct Piece {
    variables: Vec<usize>,
    matrices: Vec<DMatrix<f64>>,
    target: DVector<f64>,
    covariance: DMatrix<f64>,
}

#[derive(Default)]
struct Tree {
    dimensions: Vec<usize>,
    pieces: Vec<Piece>,
}

impl Tree {
    fn piece(&mut self, draw: &mut Draw, variables: Vec<usize>, matrices: Vec<DMatrix<f64>>) {
        let rows = matrices[0].nrows();
        let (target, covariance) = (draw.vector(rows) * 3.0, draw.covariance(rows));
        self.pieces.push(Piece { variables, matrices, target, covariance });
    }

    /// Only the root and every second child of a ternary factor have priors: what leaves send is improper.
    fn random(draw: &mut Draw, count: usize) -> Self {
        let mut tree = Self { dimensions: vec![1 + draw.below(4)], ..Self::default() };
        let root = tree.dimensions[0];
        tree.piece(draw, vec![0], vec![DMatrix::identity(root, root)]);
        while tree.dimensions.len() < count {
            let parent = draw.below(tree.dimensions.len());
            let (first, d) = (tree.dimensions.len(), 1 + draw.below(4));
            tree.dimensions.push(d);
            let mut ports = vec![parent, first];
            let own = draw.matrix(d, d) * 0.3 + DMatrix::identity(d, d);
            let mut matrices = vec![draw.matrix(d, tree.dimensions[parent]), own];
            if draw.below(3) == 0 {
                let other = 1 + draw.below(3);
                tree.dimensions.push(other);
                ports.push(first + 1);
                matrices.push(draw.matrix(d, other));
                tree.piece(draw, vec![first + 1], vec![DMatrix::identity(other, other)]);
            }
            let turn = draw.below(ports.len());
            ports.rotate_left(turn);
            matrices.rotate_left(turn);
            tree.piece(draw, ports, matrices);
            if draw.below(2) == 0 {
                let row = draw.matrix(1, d);
                tree.piece(draw, vec![first], vec![row]);
            }
        }
        tree
    }

    fn check<M: HasMoments>(&self, schedule: &mut dyn Schedule)
    where
        Model<ResidualModel<LinearGaussian>>: Factor<M>,
    {
        let mut joint = Joint::new(&self.dimensions);
        let mut graph = FactorGraph::<M>::new();
        let x = variables(&mut graph, &self.dimensions);
        for piece in &self.pieces {
            joint.add(&piece.variables, &piece.matrices, &piece.target, &piece.covariance);
            let matrices: Vec<Vec<f64>> = piece.matrices.iter().map(rows).collect();
            let matrices: Vec<&[f64]> = matrices.iter().map(Vec::as_slice).collect();
            let noise = Noise::gaussian(&rows(&piece.covariance)).unwrap();
            let factor = LinearGaussian::new(&matrices, piece.target.as_slice(), noise).unwrap();
            let ports: Vec<_> = piece.variables.iter().map(|&k| x[k]).collect();
            graph.add("linear", factor, &ports).unwrap();
        }
        assert_eq!(graph.loop_count(), 0);
        let options = Options { tolerance: 0.0, max_iterations: 60, ..Options::default() };
        let mut engine = Engine::new(&graph, options).unwrap();
        engine.run(schedule).unwrap();
        for (&x, (mean, covariance)) in x.iter().zip(&joint.marginals()) {
            assert_moments(&engine.belief(x).belief_moments(), mean, covariance, 1e-9);
        }
    }
}

#[test]
fn random_trees_equal_the_joint() {
    for entity in 0..40 {
        let tree = Tree::random(&mut Draw::new(200 + entity), 20);
        tree.check::<DynamicGaussian>(&mut ForwardBackward::new());
        tree.check::<AnyMessage>(&mut ForwardBackward::new());
        tree.check::<DynamicGaussian>(&mut Flooding);
    }
}
