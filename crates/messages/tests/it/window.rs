//! A window over a linear-Gaussian chain is the Kalman filter, the fixed-lag smoother and the batch smoother.

use crate::linear::{Linear, constant_velocity, noise, position};
use nalgebra::{Matrix2, RowVector2, Vector2};
use sumprod_graph::schedule::{ForwardBackward, Sliced};
use sumprod_graph::{Engine, FactorGraph, Options, Schedule, Space, Window, WindowVariable};
use sumprod_messages::{Gaussian, GaussianForm};

const STEPS: usize = 25;
const VARIANCE: f64 = 0.3;

/// Uneven steps: measurements come when they come.
fn interval(k: usize) -> f64 {
    0.5 + 0.25 * (k % 3) as f64
}

fn measured(k: usize) -> f64 {
    0.4 * k as f64 + noise(5, k as u64)
}

fn prior() -> (Vector2<f64>, Matrix2<f64>) {
    (Vector2::new(0.5, 0.0), Matrix2::new(4.0, 0.5, 0.5, 1.0))
}

/// The Kalman filter in moments, Joseph form: filtered moments, step by step.
fn kalman() -> Vec<(Vector2<f64>, Matrix2<f64>)> {
    let (mut x, mut p) = prior();
    let h = RowVector2::new(1.0, 0.0);
    let mut all = Vec::new();
    for k in 0..STEPS {
        if k > 0 {
            let (f, q) = constant_velocity(interval(k));
            (x, p) = (f * x, f * p * f.transpose() + q);
        }
        let gain = p * h.transpose() / ((h * p * h.transpose())[0] + VARIANCE);
        x += gain * (measured(k) - x[0]);
        let keep = Matrix2::identity() - gain * h;
        p = keep * p * keep.transpose() + gain * VARIANCE * gain.transpose();
        all.push((x, p));
    }
    all
}

/// Rauch, Tung and Striebel (1965) from the filtered moments up to step `last`, back to step `first`.
fn smoothed(first: usize, last: usize) -> (Vector2<f64>, Matrix2<f64>) {
    let filtered = kalman();
    let (mut x, mut p) = filtered[last];
    for k in (first..last).rev() {
        let (f, q) = constant_velocity(interval(k + 1));
        let (own, spread) = filtered[k];
        let predicted = f * spread * f.transpose() + q;
        let gain = spread * f.transpose() * predicted.try_inverse().unwrap();
        (x, p) = (own + gain * (x - f * own), spread + gain * (p - predicted) * gain.transpose());
    }
    (x, p)
}

fn assert_equal(belief: &Gaussian<2>, exact: &(Vector2<f64>, Matrix2<f64>), place: &str) {
    let (mean, covariance) = belief.moments().unwrap();
    assert!((mean - exact.0).amax() < 1e-9, "{place}: {mean} instead of {}", exact.0);
    assert!((covariance - exact.1).amax() < 1e-9, "{place}: {covariance} instead of {}", exact.1);
}

/// Runs the window slice by slice; `check` sees it after each.
fn track(
    lag: usize,
    schedule: &mut dyn Schedule,
    mut check: impl FnMut(usize, &Window<Gaussian<2>, Linear<2>>),
) {
    let mut window = Window::new(lag, Options { tolerance: 0.0, ..Options::default() }).unwrap();
    let form = GaussianForm::default();
    let (mut time, mut last): (f64, Option<WindowVariable>) = (0.0, None);
    for k in 0..STEPS {
        time += if k > 0 { interval(k) } else { 0.0 };
        window.begin(time).unwrap();
        let x = window.variable(format!("x{k}"), Space::real(2)).unwrap();
        match last {
            None => {
                let (mean, covariance) = prior();
                window.set_prior(x, Gaussian::from_moments(mean, covariance).unwrap()).unwrap();
            }
            Some(last) => {
                let (f, q) = constant_velocity(interval(k));
                window.factor("motion", Linear::transition(f, q), &[(last, form), (x, form)]).unwrap();
            }
        }
        window.factor("position", position(measured(k), VARIANCE), &[(x, form)]).unwrap();
        last = Some(x);
        window.run(schedule).unwrap();
        check(k, &window);
    }
}

#[test]
fn a_window_of_one_slice_is_the_kalman_filter() {
    let exact = kalman();
    let schedules: [&mut dyn Schedule; 2] = [&mut ForwardBackward::new(), &mut Sliced::new(1)];
    for schedule in schedules {
        track(1, schedule, |k, window| {
            let newest = window.slice(0)[0];
            assert_equal(window.belief(newest).unwrap(), &exact[k], &format!("step {k}"));
        });
    }
}

#[test]
fn a_window_of_several_is_the_fixed_lag_smoother() {
    let schedules: [&mut dyn Schedule; 2] = [&mut ForwardBackward::new(), &mut Sliced::new(1).smoothing()];
    for schedule in schedules {
        for lag in [2, 4] {
            track(lag, schedule, |k, window| {
                for back in 0..window.slice_count() {
                    let belief = window.belief(window.slice(back)[0]).unwrap();
                    assert_equal(
                        belief,
                        &smoothed(k - back, k),
                        &format!("lag {lag}, step {k}, {back} back"),
                    );
                }
            });
        }
    }
}

#[test]
fn a_window_of_all_slices_is_the_batch_smoother() {
    let mut graph: FactorGraph<Gaussian<2>, Linear<2>> = FactorGraph::new();
    let x: Vec<_> = (0..STEPS).map(|_| graph.unnamed_variable(Space::real(2))).collect();
    let (mean, covariance) = prior();
    graph.set_prior(x[0], Gaussian::from_moments(mean, covariance).unwrap()).unwrap();
    for k in 0..STEPS {
        if k > 0 {
            let (f, q) = constant_velocity(interval(k));
            graph.factor("motion", Linear::transition(f, q), &[x[k - 1], x[k]]).unwrap();
        }
        graph.factor("position", position(measured(k), VARIANCE), &[x[k]]).unwrap();
    }
    let mut batch = Engine::new(&graph, Options::default()).unwrap();
    batch.run(&mut ForwardBackward::new()).unwrap();
    track(STEPS, &mut ForwardBackward::new(), |k, window| {
        if k + 1 == STEPS {
            assert_eq!(window.slice_count(), STEPS);
            for (step, &variable) in x.iter().enumerate() {
                let own = window.belief(window.slice(STEPS - 1 - step)[0]).unwrap();
                assert_equal(own, &smoothed(step, STEPS - 1), &format!("step {step}"));
                assert_equal(batch.belief(variable), &smoothed(step, STEPS - 1), "the batch graph");
            }
        }
    });
}

#[test]
fn variables_appear_and_disappear() {
    // A second target lives from step 3 to step 6 and is seen relative to the first.
    let form = GaussianForm::default();
    let relative = || {
        let h = RowVector2::new(1.0, 0.0);
        Linear::pair([-h, h], nalgebra::Vector1::new(2.0), nalgebra::Matrix1::new(4.0))
    };
    let born = || Gaussian::from_moments(Vector2::new(2.0, 0.0), Matrix2::identity() * 9.0).unwrap();
    let (f, q) = constant_velocity(1.0);
    for lag in [1, 3] {
        let mut window = Window::<Gaussian<2>, Linear<2>>::new(lag, Options::default()).unwrap();
        let (mut first, mut second) = (None, None);
        let mut visitor = None;
        for k in 0..11 {
            window.begin(k as f64).unwrap();
            let x = window.variable(format!("x{k}"), Space::real(2)).unwrap();
            match first {
                Some(last) => {
                    window.factor("motion", Linear::transition(f, q), &[(last, form), (x, form)]).unwrap()
                }
                None => window.set_prior(x, born()).unwrap(),
            }
            window.factor("position", position(measured(k), VARIANCE), &[(x, form)]).unwrap();
            first = Some(x);
            if (3..=6).contains(&k) {
                let y = window.variable(format!("y{k}"), Space::real(2)).unwrap();
                match second {
                    Some(last) => {
                        window.factor("motion", Linear::transition(f, q), &[(last, form), (y, form)]).unwrap()
                    }
                    None => window.set_prior(y, born()).unwrap(),
                }
                // One sighting: with more the two chains would form loops.
                if k == 4 {
                    window.factor("relative", relative(), &[(x, form), (y, form)]).unwrap();
                }
                (second, visitor) = (Some(y), Some(y));
            } else {
                second = None;
            }
            window.run(&mut ForwardBackward::new()).unwrap();
            let expected = usize::from((3..=6).contains(&k)) + 1;
            assert_eq!(window.slice(0).len(), expected, "lag {lag}, step {k}");
            if k == 4 {
                // Prior, one step without measurement, then the sighting relative to the filtered first.
                let there = f * Matrix2::identity() * 9.0 * f.transpose() + q;
                let (_, here) = window_filtered(k);
                let innovation = there[(0, 0)] + here + 0.25;
                let exact = there[(0, 0)] - there[(0, 0)].powi(2) / innovation;
                let own = window.belief(visitor.unwrap()).unwrap().moments().unwrap().1[(0, 0)];
                assert!((own - exact).abs() < 1e-9, "lag {lag}: {own} instead of {exact}");
            }
        }
        assert!(window.belief(visitor.unwrap()).is_none(), "the second target has left the window");
    }
}

/// Position mean and variance of the first target of [`variables_appear_and_disappear`] after step `k`, alone.
fn window_filtered(k: usize) -> (f64, f64) {
    let (f, q) = constant_velocity(1.0);
    let (mut x, mut p) = (Vector2::new(2.0, 0.0), Matrix2::identity() * 9.0);
    for step in 0..=k {
        if step > 0 {
            (x, p) = (f * x, f * p * f.transpose() + q);
        }
        let gain = p.column(0) / (p[(0, 0)] + VARIANCE);
        x += gain * (measured(step) - x[0]);
        p -= gain * p.row(0).clone_owned();
    }
    (x[0], p[(0, 0)])
}
