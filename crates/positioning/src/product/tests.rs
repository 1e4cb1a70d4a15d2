use std::path::PathBuf;

use super::*;

const METHODS: &str = r#"{"method": {"exact": {"product": "exact"}, "gibbs": {"product": "gibbs", "samples": 500},
    "auto": {"samples": 200}}}"#;

fn scenario(methods: &str) -> Product {
    serde_json::from_str(methods).unwrap()
}

/// A file of its own for one test, removed when dropped.
struct File(PathBuf);

impl File {
    fn new(name: &str, text: &str) -> Self {
        let path = std::env::temp_dir().join(format!("sumprod-{}-{name}.json", std::process::id()));
        std::fs::write(&path, text).unwrap();
        Self(path)
    }
}

impl Drop for File {
    fn drop(&mut self) {
        let _ = std::fs::remove_file(&self.0);
    }
}

/// Two mixtures on the line whose product has the weights 1 : e^-½ at ±½ and kernels of variance ½.
const PAIR: &str = r#"{"dimension": 1, "mixtures": [
    {"weights": [0.5, 0.5], "means": [[-1.0], [1.0]], "covariances": [[[1.0]], [[1.0]]]},
    {"weights": [1.0], "means": [[0.0]], "covariances": [[[1.0]]]}],
    "golden": {"log_normaliser": -1.5155121234846454, "mean": [0.0], "covariance": [[0.75]]}}"#;

#[test]
fn a_file_is_multiplied_and_held_against_its_record() {
    let file = File::new("pair", PAIR);
    let scenario = scenario(METHODS);
    let prepared = scenario.prepare(1, Some(&file.0)).unwrap();
    let methods = scenario.methods();
    let request = RunRequest { seed: 1, run: 0, methods: &methods };
    let result = scenario.run(&prepared, request).unwrap();
    let of = |method: &MethodRun, name: &str| {
        method.diagnostics.iter().find(|diagnostic| diagnostic.name == name).map(|found| found.value).unwrap()
    };
    for method in &result.methods {
        for name in ["error.mean", "error.covariance", "error.log_evidence"] {
            assert!(of(method, name) < 1e-12, "{} {name}: {}", method.id, of(method, name));
        }
    }
    assert!(result.methods[2].notes[0].starts_with("chose exact: "), "{:?}", result.methods[2].notes);
    let names: Vec<&str> = result.files.iter().map(|file| file.name.as_str()).collect();
    assert_eq!(
        names,
        [
            "product-exact.json",
            "samples-exact.csv",
            "product-gibbs.json",
            "samples-gibbs.csv",
            "product-auto.json",
            "samples-auto.csv"
        ]
    );
    assert_eq!(result.files[3].contents.lines().count(), 501);
    let record: serde_json::Value = serde_json::from_str(&result.files[4].contents).unwrap();
    assert_eq!(record["chosen_method"], "exact");
    assert!((record["covariance"][0][0].as_f64().unwrap() - 0.75).abs() < 1e-12);
    // A later run leaves no files, and other points.
    let later = scenario.run(&prepared, RunRequest { run: 1, ..request }).unwrap();
    assert!(later.files.is_empty());
}

#[test]
fn the_graph_is_one_variable() {
    let file = File::new("graph", PAIR);
    let scenario = scenario(METHODS);
    let prepared = scenario.prepare(1, Some(&file.0)).unwrap();
    let summary = &scenario.check(&prepared, 1, &["gibbs".to_owned()]).unwrap()[0];
    assert_eq!((summary.variables, summary.factors, summary.edges, summary.loops), (1, 2, 2, 0));
    assert_eq!(summary.forms.iter().map(|form| form.edges).sum::<usize>(), 2);
}

#[test]
fn wrong_files_are_refused_in_one_sentence() {
    let mixture = |weights: &str, means: &str, covariances: &str| {
        format!(
            r#"{{"dimension": 1, "mixtures": [{{"weights": {weights}, "means": {means}, "covariances": {covariances}}}]}}"#
        )
    };
    for (text, part) in [
        ("{".to_owned(), "EOF while parsing"),
        (r#"{"dimension": 1}"#.to_owned(), "missing field `mixtures`"),
        (r#"{"dimension": 0, "mixtures": []}"#.to_owned(), "`dimension` is 0"),
        (r#"{"dimension": 1, "mixtures": []}"#.to_owned(), "at least one mixture"),
        (mixture("[]", "[]", "[]"), "mixture 1: `weights` is empty"),
        (mixture("[1]", "[]", "[[[1]]]"), "`means` has 0 entries, `weights` 1"),
        (mixture("[-1]", "[[0]]", "[[[1]]]"), "weight 1 is -1"),
        (mixture("[0]", "[[0]]", "[[[1]]]"), "every weight is zero"),
        (mixture("[1]", "[[0, 1]]", "[[[1]]]"), "component 1: the mean has 2 numbers, `dimension` is 1"),
        (mixture("[1]", "[[0]]", "[[[1, 2]]]"), "a row of the covariance has 2 numbers"),
        (mixture("[1]", "[[0]]", "[[[-1]]]"), "component 1: a covariance of a mixture is not positive"),
        (mixture("[1]", "[[1e999]]", "[[[1]]]"), "number out of range"),
    ] {
        let file = File::new("wrong", &text);
        let error = scenario(METHODS).prepare(1, Some(&file.0)).unwrap_err();
        assert!(error.is_input());
        let sentence = error.to_string();
        assert!(sentence.contains(part) && sentence.contains("wrong.json"), "{sentence}");
    }
    let folder = scenario(METHODS).prepare(1, Some(&std::env::temp_dir())).unwrap_err().to_string();
    assert!(folder.contains("this is a folder"), "{folder}");
}

#[test]
fn contradictions_and_products_too_large_are_the_inputs_fault() {
    let apart = PAIR.replace("[[0.0]]", "[[1e3]]");
    let file = File::new("apart", &apart);
    let scenario = scenario(METHODS);
    let prepared = scenario.prepare(1, Some(&file.0)).unwrap();
    let methods = scenario.methods();
    let error = scenario.run(&prepared, RunRequest { seed: 1, run: 0, methods: &methods }).unwrap_err();
    assert!(error.is_input() && error.to_string().contains("disjoint supports"), "{error}");
    let space = sumprod_graph::Space::real(1);
    let means: Vec<f64> = (0..400).map(f64::from).collect();
    let many = Mixture::with_shared_covariance(&space, vec![0.0; 400], means, vec![4.0]).unwrap();
    let large = Prepared { path: PathBuf::from("large.json"), inputs: vec![many; 3], recorded: None };
    let request = |methods| RunRequest { seed: 1, run: 0, methods };
    let error = scenario.run(&large, request(&methods)).unwrap_err();
    assert!(
        error.to_string().starts_with("`method.exact.product` is \"exact\", which enumerates"),
        "{error}"
    );
    assert!(scenario.check(&large, 1, &methods).unwrap_err().is_input());
    assert!(scenario.run(&large, request(&methods[2..])).is_ok());
}

#[test]
fn wrong_methods_are_refused_with_their_key() {
    for (method, part) in [
        (r#"{"samples": 0}"#, "`method.a.samples` is 0"),
        (r#"{"samples": 100000000}"#, "`method.a.samples` is 100000000; at most"),
        (r#"{"product": "gibbs", "sweeps": 0}"#, "`method.a.sweeps` is 0"),
        (r#"{"sweeps": 3}"#, "`method.a.sweeps` belongs to the Gibbs samplers, and `product` is \"auto\""),
    ] {
        let scenario = scenario(&format!(r#"{{"method": {{"a": {method}}}}}"#));
        let sentence = scenario.validate().unwrap_err().to_string();
        assert!(sentence.starts_with(part), "{sentence}");
    }
}
