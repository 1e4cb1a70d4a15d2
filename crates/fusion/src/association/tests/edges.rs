use super::super::{
    AssociationError, BiasField, BiasPrior, CoherentDrift, Mixture, Start, Tails, Tracks, associate,
    global_nearest, nearest,
};
use super::{SENSORS, Scene, by_bias, by_drift, gaussian, paper, prior};

fn all(first: &Tracks, second: &Tracks) -> Vec<usize> {
    let mut counts = Vec::new();
    for mixture in [Mixture::default(), paper(), gaussian()] {
        let mut drift = CoherentDrift::new(3.0, 3.0).unwrap();
        let mut bias = BiasField::new(SENSORS, prior()).unwrap();
        for found in [
            associate(first, second, &mut drift, &mixture).unwrap(),
            associate(first, second, &mut bias, &mixture).unwrap(),
        ] {
            assert!(found.report.objective.iter().all(|value| value.is_finite()));
            assert!(found.probabilities.iter().all(|pair| (0.0..=1.0 + 1e-12).contains(&pair.probability)));
            assert!(found.displaced.coordinates().iter().all(|value| value.is_finite()));
            counts.push(found.pairs.len());
        }
        assert!(bias.posterior().unwrap().covariance.iter().all(|value| value.is_finite()));
    }
    counts.push(nearest(first, second, 1000.0).unwrap().len());
    counts.push(global_nearest(first, second, 1000.0).unwrap().len());
    counts
}

#[test]
fn sets_of_no_track_have_no_pair() {
    let (none, some) = (Tracks::planar(&[]).unwrap(), Tracks::planar(&[[1.0, 2.0], [9e3, 8e3]]).unwrap());
    for (first, second) in [(&none, &none), (&none, &some), (&some, &none)] {
        assert_eq!(all(first, second), [0; 8]);
    }
    let mut field = BiasField::new(SENSORS, prior()).unwrap();
    associate(&none, &some, &mut field, &Mixture::default()).unwrap();
    let (mean, covariance) = field.posterior().unwrap().scan(0).unwrap();
    assert_eq!(mean, prior().mean);
    assert!((covariance - prior().covariance).amax() < 1e-6 * prior().covariance.amax());
}

#[test]
fn sets_of_one_track_are_paired_if_they_may_be() {
    let at = |x: f64| Tracks::planar(&[[30e3 + x, 50e3]]).unwrap();
    assert_eq!(all(&at(0.0), &at(50.0)), [1; 8]);
    assert_eq!(all(&at(0.0), &at(0.0)), [1; 8]);
    // At a sensor a track has no azimuth.
    let sensor = Tracks::planar(&[[0.0, 0.0]]).unwrap();
    all(&sensor, &sensor);
    all(&sensor, &at(0.0));
}

#[test]
fn sets_without_a_common_target_are_mostly_left_alone() {
    let (mut declared, mut tracks) = (0, 0);
    for seed in 0..20 {
        let scene = Scene::new(seed, 0, 15, &[[0.0; 4]]);
        let spread = |tracks: &Tracks| {
            let wide = tracks.coordinates().iter().enumerate();
            let wide = wide.map(|(i, x)| if i % 2 == 0 { 6.0 * x } else { 20e3 + 6.0 * (x - 20e3) });
            Tracks::new(2, 1, wide.collect()).unwrap()
        };
        let (first, second) = (spread(&scene.first), spread(&scene.second));
        all(&first, &second);
        let mut field = BiasField::new(SENSORS, prior()).unwrap();
        let found = associate(&first, &second, &mut field, &Mixture::default()).unwrap();
        assert!(found.report.largest_fall() <= 1e-6);
        declared += found.pairs.len();
        tracks += first.len();
    }
    // Four free biases can always bring two chance pairs together, and often four.
    assert!(declared * 3 < tracks, "{declared} pairs of {tracks} tracks");
}

#[test]
fn tracks_that_coincide_do_not_make_the_density_infinite() {
    let scene = Scene::new(3, 30, 0, &[[0.0; 4]]);
    for mixture in [Mixture::default(), Mixture { least_deviation: 1e-6, ..paper() }] {
        let mut drift = CoherentDrift::new(3.0, 3.0).unwrap();
        let found = associate(&scene.first, &scene.first, &mut drift, &mixture).unwrap();
        assert!(found.pairs.iter().all(|pair| pair.first == pair.second));
        assert!(found.report.variance > 0.0 && found.report.objective.iter().all(|value| value.is_finite()));
    }
}

#[test]
fn wrong_tracks_and_parameters_are_named() {
    let sentence = |result: Result<Tracks, AssociationError>| result.unwrap_err().to_string();
    assert!(
        sentence(Tracks::planar(&[[0.0, 1.0], [2.0, f64::NAN]])).contains("coordinate 1 of track 1 is NaN")
    );
    assert!(sentence(Tracks::new(2, 1, vec![0.0; 3])).contains("3 numbers"));
    assert!(sentence(Tracks::new(0, 1, vec![])).contains("at least 1"));

    let scene = Scene::new(1, 5, 0, &[[0.0; 4]]);
    let mut field = CoherentDrift::new(3.0, 3.0).unwrap();
    let default = Mixture::default();
    for (mixture, name) in [
        (Mixture { outlier_weight: 1.0, ..default.clone() }, "outlier_weight"),
        (Mixture { tails: Tails::Student(0.0), ..default.clone() }, "degrees_of_freedom"),
        (Mixture { start: Start::Deviation(-1.0), ..default.clone() }, "start"),
        (Mixture { gate: f64::NAN, ..default.clone() }, "gate"),
        (Mixture { tolerance: f64::NAN, ..default.clone() }, "tolerance"),
        (Mixture { iterations: 0, ..default.clone() }, "iterations"),
        (Mixture { neighbours: 0, ..default.clone() }, "neighbours"),
        (Mixture { miss_probability: 1.0, ..default.clone() }, "miss_probability"),
        (Mixture { least_deviation: 0.0, ..default.clone() }, "least_deviation"),
        (Mixture { outlier_weight: 0.0, ..default.clone() }, "refine"),
    ] {
        let error = associate(&scene.first, &scene.second, &mut field, &mixture).unwrap_err();
        assert!(error.to_string().contains(&format!("`{name}`")), "{error}");
    }
    assert!(CoherentDrift::new(0.0, 1.0).is_err() && CoherentDrift::new(1.0, f64::INFINITY).is_err());
    assert!(BiasField::new(SENSORS, BiasPrior::independent(0.0, 1.0)).is_err());
    assert!(BiasField::new(SENSORS, prior().with_walk(-1.0, 1.0)).is_err());

    let solid = Tracks::new(3, 1, vec![0.0; 6]).unwrap();
    let error = associate(&scene.first, &solid, &mut field, &default).unwrap_err();
    assert!(matches!(error, AssociationError::Shapes { first: [1, 2], second: [1, 3] }));
    let mut bias = BiasField::new(SENSORS, prior()).unwrap();
    assert!(associate(&solid, &solid, &mut bias, &default).is_err());
    assert!(associate(&solid, &solid, &mut field, &default).is_ok());
}

#[test]
fn distant_axes_and_large_biases_do_no_harm() {
    let scene = Scene::new(4, 30, 3, &[[0.0; 4]]);
    let far = |tracks: &Tracks| {
        Tracks::new(2, 1, tracks.coordinates().iter().map(|x| x + 6.4e6).collect()).unwrap()
    };
    let there = Scene { first: far(&scene.first), second: far(&scene.second), ..scene };
    assert!(there.correct(&by_drift(&there, &gaussian())) > 0.9);
    by_bias(&there, &Mixture::default());
}

#[test]
fn a_crowd_of_equal_tracks_is_refused() {
    let tracks = Tracks::planar(&[[30e3, 40e3]; 1001]).unwrap();
    let mut field = BiasField::new(SENSORS, prior()).unwrap();
    let error = associate(&tracks, &tracks, &mut field, &Mixture::default()).unwrap_err();
    assert!(
        matches!(error, AssociationError::Tracks { .. }) && error.to_string().contains("coincide"),
        "{error}"
    );
    assert!(Tracks::new(usize::MAX, 2, vec![]).is_err());
}
