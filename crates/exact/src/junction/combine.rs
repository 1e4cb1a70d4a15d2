//! Products of functions of some variables, and sums over variables, by logarithms.

/// A function by the logarithms of its values, the last variable running fastest.
pub(super) struct Part<'a> {
    pub(super) variables: &'a [usize],
    pub(super) logs: &'a [f64],
}

/// Steps through the joint states of `variables`, the last running fastest, and keeps the place in a function of some of
/// them.
struct Walk {
    states: Vec<usize>,
    /// By variable: how far the place moves with its state.
    strides: Vec<usize>,
    digits: Vec<usize>,
    place: usize,
}

impl Walk {
    fn new(states: &[usize], variables: &[usize], of: &[usize]) -> Self {
        let mut strides = vec![0; variables.len()];
        let mut stride = 1;
        for &variable in of.iter().rev() {
            // A variable of one state may be in no clique; it moves nothing.
            if let Some(at) = variables.iter().position(|&own| own == variable) {
                strides[at] = stride;
            }
            stride *= states[variable];
        }
        let states = variables.iter().map(|&variable| states[variable]).collect();
        Self { states, strides, digits: vec![0; variables.len()], place: 0 }
    }

    /// To the next joint state of all variables but the last.
    fn next_row(&mut self) {
        for at in (0..self.digits.len() - 1).rev() {
            self.digits[at] += 1;
            self.place += self.strides[at];
            if self.digits[at] < self.states[at] {
                return;
            }
            self.place -= self.strides[at] * self.states[at];
            self.digits[at] = 0;
        }
    }
}

/// The logarithms of a product over the joint states of `variables`, into `out`.
pub(super) fn combine<'a>(
    states: &[usize],
    variables: &[usize],
    parts: impl Iterator<Item = Part<'a>>,
    out: &mut Vec<f64>,
) {
    let entries = variables.iter().map(|&variable| states[variable]).product();
    out.clear();
    out.resize(entries, 0.0);
    for part in parts {
        multiply(states, variables, &part, 1.0, out);
    }
}

/// Takes a factor that is nowhere zero out of a product.
pub(super) fn divide(states: &[usize], variables: &[usize], part: &Part<'_>, product: &mut [f64]) {
    multiply(states, variables, part, -1.0, product);
}

/// The product with a power of a function.
fn multiply(states: &[usize], variables: &[usize], part: &Part<'_>, power: f64, product: &mut [f64]) {
    let Some(&last) = variables.last() else { return };
    let mut walk = Walk::new(states, variables, part.variables);
    let along = walk.strides[variables.len() - 1];
    for row in product.chunks_exact_mut(states[last].max(1)) {
        if along == 0 {
            let log = power * part.logs[walk.place];
            row.iter_mut().for_each(|entry| *entry += log);
        } else {
            let own = part.logs[walk.place..].iter().step_by(along);
            row.iter_mut().zip(own).for_each(|(entry, log)| *entry += power * log);
        }
        walk.next_row();
    }
}

/// The logarithms of the sums over all of `variables` but `onto`, in the order of `onto`.
pub(super) fn project(states: &[usize], variables: &[usize], logs: &[f64], onto: &[usize]) -> Vec<f64> {
    let entries = onto.iter().map(|&variable| states[variable]).product();
    let Some(&last) = variables.last() else { return vec![0.0; entries] };
    let mut largest = vec![f64::NEG_INFINITY; entries];
    let visit = |take: &mut dyn FnMut(usize, f64)| {
        let mut walk = Walk::new(states, variables, onto);
        let along = walk.strides[variables.len() - 1];
        for row in logs.chunks_exact(states[last].max(1)) {
            for (state, &log) in row.iter().enumerate() {
                take(walk.place + along * state, log);
            }
            walk.next_row();
        }
    };
    visit(&mut |place, log| largest[place] = largest[place].max(log));
    let mut sums = vec![0.0; entries];
    visit(&mut |place, log| {
        if log > f64::NEG_INFINITY {
            sums[place] += (log - largest[place]).exp();
        }
    });
    sums.iter()
        .zip(&largest)
        .map(|(sum, largest)| if *sum > 0.0 { largest + sum.ln() } else { *largest })
        .collect()
}
