//! What a method reports about itself: what conversions between forms cost, and how many particles count.

use std::collections::BTreeMap;

use sumprod_graph::{Message, Quality};

use crate::results::MethodRun;

/// Averages over messages, beliefs and steps.
#[derive(Debug, Default)]
pub(crate) struct Costs {
    /// Divergence (nats) and number of the converted messages, by kind of edge.
    losses: BTreeMap<String, (f64, u32)>,
    /// Sum and number of the beliefs' effective sample sizes.
    effective: (f64, u32),
    unbounded: bool,
    /// Sum and number of the beliefs' components.
    components: (f64, u32),
    /// How often each method found a belief's product, and why it was chosen where nobody had.
    methods: BTreeMap<(&'static str, Option<&'static str>), u32>,
    /// Sum and number of the products' divergences (nats), and of the label changes of those that were sampled.
    divergences: (f64, u32),
    label_changes: (f64, u32),
    /// Sum and number of the beliefs' modes.
    modes: (f64, u32),
    /// Of the messages along edges of a kind.
    edges: BTreeMap<String, EdgeCosts>,
}

/// Sums and numbers of what is known of the messages along edges of one kind.
#[derive(Debug, Default)]
struct EdgeCosts {
    effective: (f64, u32),
    components: (f64, u32),
    modes: (f64, u32),
}

fn add(mean: &mut (f64, u32), value: Option<f64>) {
    if let Some(value) = value.filter(|value| value.is_finite()) {
        *mean = (mean.0 + value, mean.1 + 1);
    }
}

impl Costs {
    /// Takes in a message along an edge of this kind.
    pub(crate) fn message<M: Message>(&mut self, kind: &str, message: &M) {
        let quality = message.quality();
        if quality.effective_sample_size.or(quality.components.map(|count| count as f64)).is_some() {
            if !self.edges.contains_key(kind) {
                self.edges.insert(kind.to_owned(), EdgeCosts::default());
            }
            if let Some(edge) = self.edges.get_mut(kind) {
                add(&mut edge.effective, quality.effective_sample_size);
                add(&mut edge.components, quality.components.map(|count| count as f64));
                add(&mut edge.modes, quality.modes.map(|count| count as f64));
            }
        }
        self.lose(kind, quality);
    }

    /// Takes in a belief.
    pub(crate) fn belief<M: Message>(&mut self, belief: &M) {
        let quality = belief.quality();
        add(&mut self.effective, quality.effective_sample_size);
        add(&mut self.components, quality.components.map(|count| count as f64));
        add(&mut self.modes, quality.modes.map(|count| count as f64));
        if let Some(product) = quality.product {
            *self.methods.entry((product.method, product.reason)).or_default() += 1;
            add(&mut self.divergences, product.divergence);
            add(&mut self.label_changes, product.label_change);
        }
        self.lose("belief", quality);
    }

    fn lose(&mut self, kind: &str, quality: Quality) {
        match quality.conversion_loss {
            Some(loss) if loss.is_finite() => {
                // Looked up first, since nearly every kind is there already.
                if let Some((sum, count)) = self.losses.get_mut(kind) {
                    (*sum, *count) = (*sum + loss, *count + 1);
                } else {
                    self.losses.insert(kind.to_owned(), (loss, 1));
                }
            }
            Some(_) => self.unbounded = true,
            None => {}
        }
    }

    /// Writes `n_eff`, `components`, `modes`, `product_quality.divergence` and `.label_change` of the beliefs with the
    /// share of products found by each method (`product_share.METHOD`), and by kind of edge `edge_quality.KIND.n_eff`, `.components`, `.modes` and `conversion_loss.KIND`; how products were
    /// found and why so, and a loss that no number bounds, are told in words.
    pub(crate) fn report(self, method: &mut MethodRun) {
        let means = [
            ("n_eff", self.effective),
            ("components", self.components),
            ("modes", self.modes),
            ("product_quality.divergence", self.divergences),
            ("product_quality.label_change", self.label_changes),
        ];
        for (name, (sum, count)) in means.into_iter().filter(|(_, (_, count))| *count > 0) {
            method.diagnose(name, sum / f64::from(count));
        }
        for (kind, edge) in self.edges {
            let means = [("n_eff", edge.effective), ("components", edge.components), ("modes", edge.modes)];
            for (name, (sum, count)) in means.into_iter().filter(|(_, (_, count))| *count > 0) {
                method.diagnose(&format!("edge_quality.{kind}.{name}"), sum / f64::from(count));
            }
        }
        if !self.methods.is_empty() {
            let total: u32 = self.methods.values().sum();
            let mut found = Vec::new();
            for ((name, reason), count) in self.methods {
                method.diagnose(&format!("product_share.{name}"), f64::from(count) / f64::from(total));
                found.push(reason.map_or(name.to_owned(), |reason| format!("{name} ({reason})")));
            }
            method.notes.push(format!("products of mixtures found by: {}", found.join(", ")));
        }
        for (kind, (sum, count)) in self.losses {
            method.diagnose(&format!("conversion_loss.{kind}"), sum / f64::from(count));
        }
        if self.unbounded {
            let note = "some conversions were to fewer particles than a state has components; their loss is not known";
            method.notes.push(note.to_owned());
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::results::StateLayout;
    use sumprod_graph::{MessageError, Messages, Space, Stream};

    #[derive(Clone)]
    struct Known(Option<f64>, Option<f64>);

    impl Message for Known {
        type Form = ();

        fn vacuous(_: &Space) -> Self {
            Self(None, None)
        }

        fn product(incoming: Messages<'_, Self>, (): &(), _: &mut Stream) -> Result<Self, MessageError> {
            Ok(incoming.iter().next().cloned().unwrap_or(Self(None, None)))
        }

        fn change(&self, _: &Self) -> f64 {
            0.0
        }

        fn quality(&self) -> Quality {
            Quality { effective_sample_size: self.0, conversion_loss: self.1, ..Quality::default() }
        }
    }

    #[test]
    fn what_is_known_is_averaged_by_kind() {
        let mut costs = Costs::default();
        for loss in [Some(0.25), None, Some(0.75), Some(f64::INFINITY)] {
            costs.message("range", &Known(None, loss));
        }
        costs.message("self", &Known(None, None));
        costs.belief(&Known(Some(100.0), Some(0.5)));
        costs.belief(&Known(Some(300.0), None));
        let mut method = MethodRun::new("a", StateLayout::planar_position());
        costs.report(&mut method);
        let found: Vec<(&str, f64)> = method
            .diagnostics
            .iter()
            .map(|diagnostic| (diagnostic.name.as_str(), diagnostic.value))
            .collect();
        assert_eq!(
            found,
            [("n_eff", 200.0), ("conversion_loss.belief", 0.5), ("conversion_loss.range", 0.5)]
        );
        assert_eq!(method.notes.len(), 1);
    }
}
