//! Connected parts of a problem, and the effect of a direction on a factor.

use crate::Problem;
use sumprod_models::Expansion;

impl Problem<'_> {
    /// The connected components, each a list of variables' numbers; both in the order of the graph. Near-linear time.
    pub fn components(&self) -> Vec<Vec<u32>> {
        let count = self.variable_count();
        let mut root: Vec<u32> = (0..count as u32).collect();
        fn find(root: &mut [u32], mut x: u32) -> u32 {
            while root[x as usize] != x {
                root[x as usize] = root[root[x as usize] as usize];
                x = root[x as usize];
            }
            x
        }
        for factor in 0..self.factor_count() {
            let Some((&first, rest)) = self.ports(factor).split_first() else { continue };
            for &other in rest {
                let (a, b) = (find(&mut root, first), find(&mut root, other));
                root[a.max(b) as usize] = a.min(b);
            }
        }
        let mut slot = vec![u32::MAX; count];
        let mut components: Vec<Vec<u32>> = Vec::new();
        for variable in 0..count as u32 {
            let own = find(&mut root, variable) as usize;
            if slot[own] == u32::MAX {
                slot[own] = components.len() as u32;
                components.push(Vec::new());
            }
            components[slot[own] as usize].push(variable);
        }
        components
    }

    /// J v of a factor's expansion for a vector over all local coordinates, each multiplied by its scale.
    pub(crate) fn image(
        &self,
        factor: usize,
        expansion: &Expansion,
        vector: &[f64],
        scale: &[f64],
        image: &mut Vec<f64>,
    ) {
        let rows = expansion.residual.len();
        image.clear();
        image.resize(rows, 0.0);
        let wide = expansion.jacobian.len() / rows.max(1);
        let mut column = 0;
        for &variable in self.ports(factor) {
            for row in self.layout().freedoms(variable as usize) {
                let x = vector[row] * scale[row];
                for (k, image) in image.iter_mut().enumerate() {
                    *image += expansion.jacobian[k * wide + column] * x;
                }
                column += 1;
            }
        }
    }
}
