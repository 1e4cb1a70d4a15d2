//! Products with recorded exact answers (shared/data/mixture_products_golden), to that record's tolerances.

use crate::common::{assert_close, stream};
use serde_json::Value;
use std::path::PathBuf;
use sumprod_graph::Space;
use sumprod_messages::{Evaluator, Exact, Mixture, ProductChoice, ProductMethod, modes};

const FILES: [&str; 7] = [
    "d1_separated_L2_N5",
    "d1_overlap_L3_N20",
    "d1_many_L6_N5",
    "d1_conflict_L4_N20",
    "d2_separated_L2_N5",
    "d2_two_rings_L2_N120",
    "d2_full_cov_L6_N5",
];

struct Record {
    inputs: Vec<Mixture>,
    golden: Value,
}

/// The recorded product, or none (said on stdout) where the data are absent.
fn recorded(name: &str) -> Option<Record> {
    let root = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../..");
    let data = std::env::var_os("SUMPROD_DATA").map_or_else(|| root.join("../shared/data"), PathBuf::from);
    let file = data.join("mixture_products_golden").join(name).with_extension("json");
    let Ok(text) = std::fs::read_to_string(&file) else {
        println!("skipped: {} is absent; set SUMPROD_DATA to the folder of the data", file.display());
        return None;
    };
    let mut record: Value = serde_json::from_str(&text).unwrap();
    let space = Space::real(record["dimension"].as_u64().unwrap() as usize);
    let inputs = record["mixtures"].as_array().unwrap().iter().map(|mixture| {
        let weights = numbers(&mixture["weights"]).iter().map(|weight| weight.ln()).collect();
        Mixture::new(&space, weights, numbers(&mixture["means"]), numbers(&mixture["covariances"])).unwrap()
    });
    Some(Record { inputs: inputs.collect(), golden: record["golden"].take() })
}

/// All numbers of a nested array, in order.
fn numbers(value: &Value) -> Vec<f64> {
    match value {
        Value::Array(values) => values.iter().flat_map(numbers).collect(),
        number => vec![number.as_f64().unwrap()],
    }
}

/// The points of the recorded grid, first axis slowest.
fn grid(golden: &Value) -> Vec<f64> {
    let axes: Vec<Vec<f64>> = golden["grid"]["axes"]
        .as_array()
        .unwrap()
        .iter()
        .map(|axis| {
            let (start, stop) = (axis["start"].as_f64().unwrap(), axis["stop"].as_f64().unwrap());
            let count = axis["count"].as_u64().unwrap();
            (0..count).map(|i| start + (stop - start) * i as f64 / (count - 1) as f64).collect()
        })
        .collect();
    match axes.as_slice() {
        [one] => one.clone(),
        [first, second] => first.iter().flat_map(|x| second.iter().flat_map(move |y| [*x, *y])).collect(),
        _ => panic!("grids of one or two axes"),
    }
}

#[test]
fn the_exact_product_is_exact() {
    for name in FILES {
        let Some(Record { inputs, golden }) = recorded(name) else { return };
        let references: Vec<&Mixture> = inputs.iter().collect();
        let (product, log_normaliser) = Exact::default().mixture(&references).unwrap();
        let moments = product.moments();
        assert_close(&[log_normaliser], &numbers(&golden["log_normaliser"]), 1e-10);
        assert_close(&moments.mean, &numbers(&golden["mean"]), 1e-10);
        assert_close(&moments.covariance, &numbers(&golden["covariance"]), 1e-10);
        let d = product.dimension();
        for (k, exact) in numbers(&golden["third_central_moments"]).iter().enumerate() {
            let third: f64 = (0..product.len())
                .map(|i| {
                    let offset = product.mean_of(i)[k] - moments.mean[k];
                    let variance = product.covariance_of(i)[k * d + k];
                    product.log_weights()[i].exp() * (offset.powi(3) + 3.0 * offset * variance)
                })
                .sum();
            assert!(
                (third - exact).abs() < 1e-8 * moments.covariance_at(k, k).powf(1.5),
                "{name}: {third} {exact}"
            );
        }
        let (points, exact) = (grid(&golden), numbers(&golden["grid"]["pdf"]));
        let mut found = vec![0.0; exact.len()];
        Evaluator::new(&product).log_densities_within(&points, 1e-12, &mut found).unwrap();
        let highest = exact.iter().copied().fold(0.0, f64::max);
        for (log, exact) in found.iter().zip(&exact) {
            assert!((log.exp() - exact).abs() < 1e-8 * highest, "{name}: {} {exact}", log.exp());
        }
    }
}

/// Masses agree to the noise of two thousand systematic points and to what is called a basin.
#[test]
fn the_modes_are_found_with_their_masses() {
    for name in FILES {
        let Some(Record { inputs, golden }) = recorded(name) else { return };
        let references: Vec<&Mixture> = inputs.iter().collect();
        let product = Exact::default().product(&references, 2000, &mut stream(1)).unwrap();
        let found = modes(&references, &product.particles).unwrap();
        for mode in golden["modes"].as_array().unwrap() {
            let (location, mass) = (numbers(&mode["location"]), mode["mass"].as_f64().unwrap());
            let distance =
                |other: &[f64]| other.iter().zip(&location).map(|(a, b)| (a - b).powi(2)).sum::<f64>();
            let nearest =
                found.iter().min_by(|a, b| distance(&a.location).total_cmp(&distance(&b.location))).unwrap();
            assert!(distance(&nearest.location) < 0.03f64.powi(2), "{name}: {location:?} {found:?}");
            let density = (nearest.log_density - product.log_normaliser.unwrap()).exp();
            assert!((density / mode["pdf"].as_f64().unwrap() - 1.0).abs() < 1e-3, "{name}: {density}");
            // The record's basins are of steepest ascent on a grid; between two maxima of one ring the paths differ.
            assert!((nearest.mass - mass).abs() < 0.03, "{name}: {} {mass}", nearest.mass);
        }
    }
}

/// Methods that are exact up to noise: the mean within four standard errors at the effective sample size (a
/// failure once in 1,600 seeds over all files and axes), and total variation from the recorded grid, in bins of a
/// hundredth of the points each, as independent draws have it.
#[test]
fn samplers_agree_with_the_record() {
    use ProductChoice::{Auto, Exact, MixtureImportance, Pairwise};
    for name in FILES {
        let Some(Record { inputs, golden }) = recorded(name) else { return };
        let references: Vec<&Mixture> = inputs.iter().collect();
        let (mean, covariance) = (numbers(&golden["mean"]), numbers(&golden["covariance"]));
        for choice in [Auto, Exact, Pairwise, MixtureImportance] {
            let product = choice.method().product(&references, 5000, &mut stream(2)).unwrap();
            let effective = product.quality.effective_sample_size.min(5000.0);
            if choice == MixtureImportance && effective < 500.0 {
                // Where the product lies in the inputs' tails the method starves, and says so.
                assert!(
                    !product.quality.warnings.is_empty() || effective > 100.0,
                    "{name}: {:?}",
                    product.quality
                );
                continue;
            }
            assert!(effective > 500.0, "{name}, {choice:?}: {effective}");
            let found = product.particles.moments();
            for k in 0..mean.len() {
                let d = mean.len();
                let error = (found.mean[k] - mean[k]).abs() / (covariance[k * d + k] / effective).sqrt();
                assert!(error < 4.0, "{name}, {choice:?}: mean {k} is {error} standard errors off");
                let error = found.covariance[k * d + k] / covariance[k * d + k] - 1.0;
                // Kurtosis at most that of a Gaussian or of two equal clusters; heavier tails are not in the files.
                assert!(
                    error.abs() < 4.0 * (3.0 / effective).sqrt(),
                    "{name}, {choice:?}: variance {k}: {error}"
                );
            }
            let log_normaliser = golden["log_normaliser"].as_f64().unwrap();
            let error = (product.log_normaliser.unwrap() - log_normaliser).abs();
            let allowed =
                4.0 * (product.particles.len() as f64 / effective - 1.0).max(1e-12).sqrt() / 70.0 + 1e-6;
            assert!(
                choice == MixtureImportance || error < allowed,
                "{name}, {choice:?}: ln Z is {error} off"
            );
        }
    }
}

/// Gibbs samplers are within four standard errors of the record's mean and variances, or say that they are biased;
/// multiscale sampling always is. (Seventeen means and variances, three methods: a failure by chance once in 300
/// seeds.)
#[test]
fn gibbs_samplers_agree_with_the_record_or_say_that_they_do_not() {
    use ProductChoice::{AnnealedGibbs, Gibbs, MultiscaleGibbs};
    let mut biased = 0;
    for name in FILES {
        let Some(Record { inputs, golden }) = recorded(name) else { return };
        let references: Vec<&Mixture> = inputs.iter().collect();
        let (mean, covariance) = (numbers(&golden["mean"]), numbers(&golden["covariance"]));
        for choice in [Gibbs, AnnealedGibbs, MultiscaleGibbs] {
            let product = choice.method().product(&references, 5000, &mut stream(3)).unwrap();
            let found = product.particles.moments();
            let d = mean.len();
            let worst = (0..d)
                .flat_map(|k| {
                    let exact = covariance[k * d + k];
                    let mean = (found.mean[k] - mean[k]) / (exact / 5000.0).sqrt();
                    // Kurtosis as above.
                    let variance = (found.covariance[k * d + k] / exact - 1.0) / (3.0f64 / 5000.0).sqrt();
                    [mean.abs(), variance.abs()]
                })
                .fold(0.0, f64::max);
            let said = product.quality.warnings.iter().any(|text| text.contains("those of their start"));
            assert!(
                worst < 4.0 || said,
                "{name}, {choice:?}: {worst} standard errors, {:?}",
                product.quality
            );
            assert!(choice != MultiscaleGibbs || !said, "{name}: {:?}", product.quality);
            biased += usize::from(said);
        }
    }
    // Where modes are separated plain and annealed sampling are biased.
    assert!(biased >= 4, "{biased}");
}
