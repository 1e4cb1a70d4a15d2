use std::collections::VecDeque;

use sumprod_fusion::{
    Communication, Direction, FusionNode, InformationSet, Intersection, Item, Known, Outcome, Rule,
};
use sumprod_graph::{Message, Space};
use sumprod_messages::{Categorical, DynamicGaussian, Gaussian, Mixture, MixtureForm, MixtureMessage};

use crate::support::{Random, World, below, mixture_distance, random};

/// Nodes on these edges, all with the common prior.
fn network<M: World>(
    count: usize,
    edges: &[(usize, usize)],
    space: &Space,
    rule: Rule,
) -> Vec<FusionNode<M>> {
    let mut nodes: Vec<_> =
        (0..count).map(|k| FusionNode::new(format!("{k}"), space.clone(), M::known(), rule)).collect();
    for &(a, b) in edges {
        nodes[a].connect(b, Direction::Both, M::known());
        nodes[b].connect(a, Direction::Both, M::known());
    }
    nodes
}

fn tree(random: &mut Random, count: usize) -> Vec<(usize, usize)> {
    (1..count).map(|k| (below(random, k), k)).collect()
}

/// A step of a still world.
fn still<M: Clone>(belief: &M, _: f64) -> Result<M, sumprod_graph::MessageError> {
    Ok(belief.clone())
}

/// Random trees whose messages are delayed, lost, repeated and overtaken: at any time every belief is the posterior of
/// what it says that it holds, and all hold everything in the end.
fn asynchronous<M: World>(space: &Space, tolerance: f64, seeds: u64) {
    for seed in 0..seeds {
        let mut random = random(seed);
        let count = 2 + below(&mut random, 6);
        let edges = tree(&mut random, count);
        let mut nodes = network::<M>(count, &edges, space, Rule::Removal);
        let mut numbers = vec![0; count];
        let mut under_way: VecDeque<Communication<M>> = VecDeque::new();
        let check = |node: &FusionNode<M>| {
            let error = node.belief().distance(&M::posterior(node.information()));
            assert!(error < tolerance, "seed {seed}, node {}: {error:e}", node.name());
        };
        for _ in 0..300 {
            match below(&mut random, 4) {
                0 => {
                    let k = below(&mut random, count);
                    nodes[k]
                        .observe(
                            Item::new(k as u32, numbers[k]),
                            &M::likelihood(Item::new(k as u32, numbers[k])),
                        )
                        .unwrap();
                    numbers[k] += 1;
                }
                1 | 2 if !edges.is_empty() => {
                    let (a, b) = edges[below(&mut random, edges.len())];
                    let (from, to) = if below(&mut random, 2) == 0 { (a, b) } else { (b, a) };
                    under_way.push_back(nodes[from].send(from, to).unwrap());
                }
                _ if !under_way.is_empty() => {
                    // Any of those under way; half of them will come again, and a fifth is lost.
                    let place = below(&mut random, under_way.len());
                    let message = under_way[place].clone();
                    if below(&mut random, 2) == 0 {
                        under_way.remove(place);
                    }
                    if below(&mut random, 5) > 0 {
                        nodes[message.to].receive(&message, still).unwrap();
                        check(&nodes[message.to]);
                    }
                }
                _ => {}
            }
        }
        for _ in 0..count {
            for &(a, b) in edges.iter().chain(edges.iter().rev()) {
                for (from, to) in [(a, b), (b, a)] {
                    let message = nodes[from].send(from, to).unwrap();
                    nodes[to].receive(&message, still).unwrap();
                }
            }
        }
        let all = (0..count as u32)
            .flat_map(|k| (0..numbers[k as usize]).map(move |number| Item::new(k, number)))
            .chain([Item::PRIOR]);
        let all = InformationSet::of(all);
        for node in &nodes {
            assert_eq!(*node.information(), all, "seed {seed}");
            check(node);
        }
    }
}

#[test]
fn gaussian_trees_are_exact_whatever_happens_to_messages() {
    asynchronous::<Gaussian<2>>(&Space::real(2), 1e-10, 60);
}

#[test]
fn categorical_trees_are_exact_whatever_happens_to_messages() {
    asynchronous::<Categorical>(&Space::Finite(3), 1e-10, 40);
}

#[test]
fn a_repeated_message_changes_nothing() {
    let mut nodes = network::<Gaussian<2>>(2, &[(0, 1)], &Space::real(2), Rule::Removal);
    nodes[0].observe(Item::new(0, 0), &World::likelihood(Item::new(0, 0))).unwrap();
    let old = nodes[0].send(0, 1).unwrap();
    nodes[0].observe(Item::new(0, 1), &World::likelihood(Item::new(0, 1))).unwrap();
    let new = nodes[0].send(0, 1).unwrap();
    assert_eq!(nodes[1].receive(&new, still).unwrap(), Outcome::Adopted);
    let before = *nodes[1].belief();
    for message in [&new, &old, &new] {
        assert_eq!(nodes[1].receive(message, still).unwrap(), Outcome::Held);
    }
    assert_eq!(*nodes[1].belief(), before);
    assert!(!nodes[0].observe(Item::new(0, 1), &World::likelihood(Item::new(0, 1))).unwrap());
}

/// One synchronous exchange along all edges.
fn exchange<M: World>(nodes: &mut [FusionNode<M>], edges: &[(usize, usize)]) -> Vec<Outcome> {
    let both = edges.iter().flat_map(|&(a, b)| [(a, b), (b, a)]);
    let messages: Vec<_> = both.map(|(from, to)| nodes[from].send(from, to).unwrap()).collect();
    let outcomes = messages.iter().map(|m| nodes[m.to].receive(m, still).unwrap()).collect();
    nodes.iter_mut().for_each(FusionNode::end_round);
    outcomes
}

#[test]
fn on_a_path_without_noise_the_edge_rule_is_the_removal_rule() {
    let path: Vec<_> = (1..6).map(|k| (k - 1, k)).collect();
    let mut all =
        [Rule::Removal, Rule::Edge].map(|rule| network::<Gaussian<2>>(6, &path, &Space::real(2), rule));
    for number in 0..20 {
        for nodes in &mut all {
            for (k, node) in nodes.iter_mut().enumerate() {
                let item = Item::new(k as u32, number);
                node.observe(item, &World::likelihood(item)).unwrap();
            }
            exchange(nodes, &path);
        }
        for (k, (a, b)) in all[0].iter().zip(&all[1]).enumerate() {
            // All that neighbours know by now, and what is farther with a delay of one exchange a hop.
            let lag = |other: usize| k.abs_diff(other).saturating_sub(1) as u64;
            let held = (0..6).flat_map(|other| {
                (0..(number + 1).saturating_sub(lag(other))).map(move |n| Item::new(other as u32, n))
            });
            let held = InformationSet::of(held.chain([Item::PRIOR]));
            assert_eq!(*a.information(), held);
            let exact = Gaussian::<2>::posterior(&held);
            assert!(a.belief().distance(&exact) < 1e-11);
            assert!(b.belief().distance(&exact) < 1e-11);
        }
    }
}

#[test]
fn a_ring_is_noticed_and_what_follows_claims_no_more_than_there_is() {
    let ring: Vec<_> = (0..6).map(|k| (k, (k + 1) % 6)).collect();
    let rule = Rule::Automatic(Intersection::default());
    let mut nodes = network::<Gaussian<2>>(6, &ring, &Space::real(2), rule);
    let mut first = None;
    for number in 0..10 {
        for (k, node) in nodes.iter_mut().enumerate() {
            let item = Item::new(k as u32, number);
            node.observe(item, &World::likelihood(item)).unwrap();
        }
        for outcome in exchange(&mut nodes, &ring) {
            if let Outcome::Intersected { looped: Some(looped), .. } = outcome {
                first.get_or_insert((number, looped));
            }
        }
        for node in &nodes {
            let exact = Gaussian::<2>::posterior(node.information());
            if first.is_none() {
                assert!(node.belief().distance(&exact) < 1e-11);
            }
            // No direction of the claimed information exceeds what is there.
            let excess = exact.information() - node.belief().information();
            assert!(excess.symmetric_eigenvalues().min() > -1e-9 * exact.information().norm());
        }
    }
    // The observations of the opposite node arrive from both sides in the fourth exchange at the latest.
    let (number, looped) = first.unwrap();
    assert!((2..=3).contains(&number), "noticed at exchange {number}");
    assert!(looped.iter().all(|item| item != Item::PRIOR));
    assert!(nodes.iter().all(FusionNode::is_bounded));
}

#[test]
fn mixtures_are_fused_where_what_is_shared_is_one_gaussian() {
    let space = Space::real(1);
    let gaussian = DynamicGaussian::from_moments(&[0.0], &[25.0]).unwrap();
    let prior = MixtureMessage::from_gaussian(space.coordinates().unwrap(), &gaussian);
    let known = Known::new(InformationSet::prior(), prior.clone());
    let two = |means: [f64; 2]| -> MixtureMessage {
        Mixture::new(&space, vec![0.0, -0.5], means.to_vec(), vec![1.0, 0.5]).unwrap().into()
    };
    let likelihoods = [two([-2.0, 2.0]), two([1.5, 4.0])];
    let mut nodes: Vec<_> = (0..2)
        .map(|k| {
            let mut node = FusionNode::new(format!("{k}"), space.clone(), known.clone(), Rule::Removal)
                .with_form(MixtureForm::new(8), 1);
            node.connect(1 - k, Direction::Both, known.clone());
            node.observe(Item::new(k as u32, 0), &likelihoods[k]).unwrap();
            node
        })
        .collect();
    let message = nodes[0].send(0, 1).unwrap();
    assert_eq!(nodes[1].receive(&message, still).unwrap(), Outcome::Removed { terms: 1 });
    let edges = [0, 1, 2];
    let all = [prior, likelihoods[0].clone(), likelihoods[1].clone()];
    let mut stream = sumprod_graph::Stream::new(1, 0, sumprod_graph::Purpose::Belief, 0);
    let exact = MixtureMessage::product(
        sumprod_graph::Messages::new(&all, &edges),
        &MixtureForm::new(8),
        &mut stream,
    )
    .unwrap();
    assert!(mixture_distance(nodes[1].belief(), &exact) < 1e-6);
}
