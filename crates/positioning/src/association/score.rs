//! How many pairs are right, and how far off the biases are.

use sumprod_fusion::association::Pair;

use super::world::Scene;
use crate::results::MethodRun;

/// Reports `association.correct` where some target is common, and `association.false` where a pair is declared.
pub(super) fn pairs(scene: &Scene, pairs: &[Pair], out: &mut MethodRun) {
    let right = |pair: &&Pair| {
        let [first, second] = [scene.first_targets.get(pair.first), scene.second_targets.get(pair.second)];
        matches!((first, second), (Some(Some(a)), Some(Some(b))) if a == b)
    };
    let correct = pairs.iter().filter(right).count();
    let common = scene.common();
    if common > 0 {
        out.diagnose("association.correct", correct as f64 / common as f64);
    }
    if !pairs.is_empty() {
        out.diagnose("association.false", (pairs.len() - correct) as f64 / pairs.len() as f64);
    }
}

/// Reports the root mean square errors of ranges and azimuths.
pub(super) fn biases(truth: &[f64; 4], mean: &[f64], out: &mut MethodRun) {
    for (name, first) in [("bias_error.range_m", 0), ("bias_error.azimuth_rad", 1)] {
        let errors =
            truth.iter().zip(mean).skip(first).step_by(2).map(|(truth, mean)| (mean - truth).powi(2));
        out.diagnose(name, (0.5 * errors.sum::<f64>()).sqrt());
    }
}
