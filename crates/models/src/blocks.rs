//! Independent motions of the parts of one joint state.

use crate::{Motion, ProcessNoise, Real};

/// Motions of consecutive blocks of one joint state (the robots of a team, say), with independent noise.
///
/// The first motion moves the first coordinates, and so on; the dimension is the sum of the motions'.
#[derive(Clone, Debug)]
pub struct Blocks<T>(pub Vec<T>);

impl<T: Motion> Motion for Blocks<T> {
    fn dimension(&self) -> usize {
        self.0.iter().map(Motion::dimension).sum()
    }

    fn step<N: Real>(&self, state: &[N], next: &mut [N]) {
        let mut start = 0;
        for motion in &self.0 {
            let own = start..start + motion.dimension();
            motion.step(&state[own.clone()], &mut next[own.clone()]);
            start = own.end;
        }
    }

    fn noise(&self, state: &[f64]) -> ProcessNoise {
        let mut start = 0;
        let parts: Vec<ProcessNoise> = self
            .0
            .iter()
            .map(|motion| {
                let own = start..start + motion.dimension();
                start = own.end;
                motion.noise(&state[own])
            })
            .collect();
        let sources: usize = parts.iter().map(ProcessNoise::sources).sum();
        let mut factor = vec![0.0; start * sources];
        let (mut row, mut column) = (0, 0);
        for part in &parts {
            for own in part.factor().chunks_exact(part.sources().max(1)) {
                factor[row * sources + column..][..own.len()].copy_from_slice(own);
                row += 1;
            }
            column += part.sources();
        }
        ProcessNoise::from_factor(start, &factor)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::library::Unicycle;

    #[test]
    fn blocks_move_and_blur_as_they_do_alone() {
        let motions = [
            Unicycle::new(0.3, 0.1, [0.01, 0.02, 0.003]).unwrap(),
            Unicycle::new(-0.2, 0.4, [0.04, 0.0, 0.001]).unwrap(),
        ];
        let joint = Blocks(motions.to_vec());
        let state = [1.0, 2.0, 0.5, -3.0, 4.0, -1.0];
        let mut next = [0.0; 6];
        joint.step(&state, &mut next);
        let covariance = joint.noise(&state).covariance();
        for (k, motion) in motions.iter().enumerate() {
            let mut alone = [0.0; 3];
            motion.step(&state[3 * k..3 * k + 3], &mut alone);
            assert_eq!(next[3 * k..3 * k + 3], alone);
            let own = motion.noise(&state[3 * k..3 * k + 3]).covariance();
            for row in 0..3 {
                for column in 0..6 {
                    let inside = column / 3 == k;
                    let expected = if inside { own[row * 3 + column % 3] } else { 0.0 };
                    assert_eq!(covariance[(3 * k + row) * 6 + column], expected);
                }
            }
        }
        assert_eq!(joint.dimension(), 6);
    }
}
