//! What the tests share.

use serde_json::Value;
use std::path::PathBuf;

/// A recorded file, or none (said on stdout) where the data are absent.
pub fn recorded(name: &str) -> Option<PathBuf> {
    let root = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("../..");
    let data = std::env::var_os("SUMPROD_DATA").map_or_else(|| root.join("../shared/data"), PathBuf::from);
    let file = data.join(name);
    if file.exists() {
        return Some(file);
    }
    println!("skipped: {} is absent; set SUMPROD_DATA to the folder of the data", file.display());
    None
}

pub fn json(path: &std::path::Path) -> Value {
    serde_json::from_str(&std::fs::read_to_string(path).unwrap()).unwrap()
}

pub fn numbers(value: &Value) -> Vec<f64> {
    match value.as_array() {
        Some(entries) => entries.iter().flat_map(numbers).collect(),
        None => vec![value.as_f64().unwrap()],
    }
}

#[track_caller]
pub fn assert_close(found: &[f64], expected: &[f64], tolerance: f64, what: &str) {
    assert_eq!(found.len(), expected.len(), "{what}");
    let scale = expected.iter().fold(1e-300, |most: f64, x| most.max(x.abs()));
    for (k, (a, b)) in found.iter().zip(expected).enumerate() {
        assert!((a - b).abs() <= tolerance * scale, "{what}, entry {k}: {a} expected {b}");
    }
}
