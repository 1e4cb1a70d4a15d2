//! How many pairs are right, and how far off the biases are.

use sumprod_fusion::association::Pair;

use super::world::Scene;
use crate::results::MethodRun;

/// How the declared pairs compare with the truth.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Judgement {
    /// Correctly declared share of the targets that both sensors see; `None` where there is no such target.
    pub correct: Option<f64>,
    /// Wrong share of the declared pairs; `None` where none is declared.
    pub wrong: Option<f64>,
}

impl Scene {
    /// Judges declared pairs.
    pub fn judge(&self, pairs: &[Pair]) -> Judgement {
        let right = |pair: &&Pair| {
            let [first, second] = [self.first_targets.get(pair.first), self.second_targets.get(pair.second)];
            matches!((first, second), (Some(Some(a)), Some(Some(b))) if a == b)
        };
        let correct = pairs.iter().filter(right).count() as f64;
        let share = |part: f64, whole: usize| (whole > 0).then(|| part / whole as f64);
        Judgement {
            correct: share(correct, self.common()),
            wrong: share(pairs.len() as f64 - correct, pairs.len()),
        }
    }
}

/// Reports `association.correct` and `association.false`, where they exist.
pub(super) fn pairs(scene: &Scene, pairs: &[Pair], out: &mut MethodRun) {
    let judgement = scene.judge(pairs);
    for (name, share) in [("association.correct", judgement.correct), ("association.false", judgement.wrong)]
    {
        if let Some(share) = share {
            out.diagnose(name, share);
        }
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
