//! A method's answer: written as JSON, and held against the exact one.

use crate::results::{MethodRun, StateLayout};
use serde_json::{Map, Value, json};
use sumprod_exact::Answer;
use sumprod_exact::read::GraphFile;
use sumprod_graph::Space;

/// Nothing of a graph is scored against a truth.
pub(super) fn layout() -> StateLayout {
    StateLayout::default()
}

/// By variable: mean, covariance by rows, and of poses what the covariance's rows stand for.
pub(super) fn json(answer: &Answer, file: &GraphFile) -> String {
    let mut all = Map::new();
    for (number, variable) in file.variables.iter().enumerate() {
        let mut own = Map::new();
        own.insert("mean".into(), json!(answer.values.at(number)));
        if let Some(covariance) = answer.covariances.as_ref().and_then(|all| all.get(number)) {
            let d = variable.space.degrees_of_freedom().max(1);
            own.insert("covariance".into(), Value::from_iter(covariance.chunks(d).map(|row| json!(row))));
        }
        let order: &[&str] = match variable.space {
            Space::Se2 => &["x", "y", "theta"],
            Space::Se3 => &["x", "y", "z", "rx", "ry", "rz"],
            _ => &[],
        };
        if !order.is_empty() {
            own.insert("order".into(), json!(order));
        }
        all.insert(variable.name.clone(), Value::Object(own));
    }
    let mut text = Value::Object(all).to_string();
    text.push('\n');
    text
}

/// Adds to each method how far it is from `exact`, the id and answer of a joint solve.
pub(super) fn compare(exact: &(String, Answer), answers: &[(String, Answer)], methods: &mut [MethodRun]) {
    for ((id, answer), run) in answers.iter().zip(methods) {
        let Some(deviation) = answer.deviation_from(&exact.1).filter(|_| *id != exact.0) else { continue };
        run.diagnose("error_to_exact.mean_sd", deviation.mean_sd);
        if let Some(relative) = deviation.covariance_relative {
            run.diagnose("error_to_exact.covariance_relative", relative);
        }
    }
}
