//! How a scenario file spells the form of an edge.
//!
//! | spelling | form |
//! |---|---|
//! | `"gaussian"` | a Gaussian, nonlinear factors expanded to first order |
//! | `{ gaussian = "sigma-points" }` | a Gaussian, nonlinear factors made linear over sigma points |
//! | `{ particles = 1000 }` | 1000 weighted particles |
//! | `{ mixture = 50 }` | a mixture of at most 50 Gaussians |
//! | `{ mixture = 50, product = "multiscale-gibbs", bandwidth = "silverman", samples = 500 }` | the same, a belief of this form multiplied by that method from that many points, particles read with kernels of that rule |
//! | `{ particles = 1000, senders = 100, proposal = "prediction" }` | the same, messages averaged over 100 of the sender's particles, predicted states drawn from the motion alone |

use std::fmt;

use serde::de::{Error, MapAccess, Visitor};
use serde::ser::SerializeMap;
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use sumprod_messages::{
    AnyForm, BandwidthChoice, GaussianForm, Linearisation, MixtureForm, ParticlesForm, ProductChoice,
    Proposal,
};

use crate::error::PositioningError;

/// The names that a form starts with.
const NAMES: &[&str] = &["gaussian", "mixture", "particles"];

/// The keys of a form's table.
const KEYS: &[&str] =
    &["gaussian", "mixture", "particles", "senders", "proposal", "product", "bandwidth", "samples"];

/// A form as a scenario file spells it.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct FormSpec(pub AnyForm);

impl FormSpec {
    /// Gaussian messages, linearised to first order.
    pub fn gaussian() -> Self {
        Self(AnyForm::gaussian())
    }

    /// Particles that are averaged over `senders` of the sender's, all if none is given.
    pub fn particles(count: usize, senders: Option<usize>, proposal: Proposal) -> Self {
        Self(AnyForm::Particles(ParticlesForm { count, senders, proposal }))
    }

    /// The same, particles that say nothing of senders averaging over this many.
    #[must_use]
    pub(crate) fn with_senders(self, senders: Option<usize>) -> Self {
        match self.0 {
            AnyForm::Particles(form) => {
                Self(AnyForm::Particles(ParticlesForm { senders: form.senders.or(senders), ..form }))
            }
            _ => self,
        }
    }

    /// Mixtures of at most `components` Gaussians.
    pub fn mixture(components: usize) -> Self {
        Self(AnyForm::mixture(components))
    }

    /// Checks the numbers; `key` is the dotted path under which the form was read.
    ///
    /// # Errors
    /// [`PositioningError::Setting`] for no particles or senders, no component or sample.
    pub fn validate(&self, key: &str) -> Result<(), PositioningError> {
        match &self.0 {
            AnyForm::Gaussian(_) | AnyForm::Categorical(_) => Ok(()),
            AnyForm::Particles(form) => {
                at_least_one(&format!("{key}.particles"), form.count, "particle")?;
                form.senders
                    .map_or(Ok(()), |senders| at_least_one(&format!("{key}.senders"), senders, "sender"))
            }
            AnyForm::Mixture(form) => {
                at_least_one(&format!("{key}.mixture"), form.components, "component")?;
                at_least_one(&format!("{key}.samples"), form.samples, "sample")
            }
        }
    }
}

/// What to tell of product methods that were chosen for edges (by kind) and are not used, since the belief that `carried`
/// holds is no mixture: its points weigh the messages instead.
pub(crate) fn unused_products(carried: &AnyForm, edges: &[(&str, AnyForm)]) -> Option<String> {
    if matches!(carried, AnyForm::Mixture(_)) {
        return None;
    }
    let chosen = edges.iter().filter_map(|(kind, form)| match form {
        AnyForm::Mixture(form) if form.product != ProductChoice::Auto => {
            Some(format!("{} on {kind} edges", form.product.method().name()))
        }
        _ => None,
    });
    let chosen: Vec<String> = chosen.collect();
    (!chosen.is_empty()).then(|| {
        format!(
            "product method not used ({}): the beliefs are held by {}, which multiply mixtures point by point; give \
             the richest form to a mixture, or leave `product` out",
            chosen.join(", "),
            carried.name()
        )
    })
}

/// Refuses a count of zero; `what` names one of the things counted.
///
/// # Errors
/// [`PositioningError::Setting`].
pub(crate) fn at_least_one(key: &str, count: usize, what: &str) -> Result<(), PositioningError> {
    if count == 0 {
        return Err(PositioningError::setting(key, format!("is 0; at least 1 {what} is needed")));
    }
    Ok(())
}

/// What a summary of a graph calls the form, for instance `particles 1000`.
impl fmt::Display for FormSpec {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match &self.0 {
            AnyForm::Gaussian(GaussianForm { linearisation: Linearisation::Jacobian }) => {
                f.write_str("gaussian")
            }
            AnyForm::Gaussian(GaussianForm { linearisation: Linearisation::SigmaPoints }) => {
                f.write_str("gaussian (sigma points)")
            }
            AnyForm::Particles(form) => {
                write!(f, "particles {}", form.count)?;
                form.senders.map_or(Ok(()), |senders| write!(f, " ({senders} senders)"))
            }
            AnyForm::Mixture(form) => {
                write!(f, "mixture {}", form.components)?;
                match form.product {
                    ProductChoice::Auto => Ok(()),
                    other => write!(f, " ({})", other.method().name()),
                }
            }
            AnyForm::Categorical(_) => f.write_str("categorical"),
        }
    }
}

impl From<FormSpec> for AnyForm {
    fn from(spec: FormSpec) -> Self {
        spec.0
    }
}

impl Serialize for FormSpec {
    fn serialize<S: Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        match &self.0 {
            AnyForm::Gaussian(GaussianForm { linearisation: Linearisation::Jacobian }) => {
                serializer.serialize_str("gaussian")
            }
            AnyForm::Gaussian(GaussianForm { linearisation }) => {
                let mut map = serializer.serialize_map(Some(1))?;
                map.serialize_entry("gaussian", linearisation)?;
                map.end()
            }
            AnyForm::Particles(form) => {
                let mut map = serializer.serialize_map(None)?;
                map.serialize_entry("particles", &form.count)?;
                if let Some(senders) = form.senders {
                    map.serialize_entry("senders", &senders)?;
                }
                map.serialize_entry("proposal", &form.proposal)?;
                map.end()
            }
            AnyForm::Mixture(form) => {
                let mut map = serializer.serialize_map(None)?;
                map.serialize_entry("mixture", &form.components)?;
                map.serialize_entry("product", &form.product)?;
                map.serialize_entry("bandwidth", &form.bandwidth)?;
                map.serialize_entry("samples", &form.samples)?;
                map.end()
            }
            AnyForm::Categorical(form) => {
                let mut map = serializer.serialize_map(Some(1))?;
                map.serialize_entry("categorical", &form.temperature)?;
                map.end()
            }
        }
    }
}

impl<'de> Deserialize<'de> for FormSpec {
    fn deserialize<D: Deserializer<'de>>(deserializer: D) -> Result<Self, D::Error> {
        deserializer.deserialize_any(Spelling)
    }
}

struct Spelling;

impl<'de> Visitor<'de> for Spelling {
    type Value = FormSpec;

    fn expecting(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str("\"gaussian\" or a table such as { particles = 1000 }")
    }

    fn visit_str<E: Error>(self, name: &str) -> Result<FormSpec, E> {
        match name {
            "gaussian" => Ok(FormSpec::gaussian()),
            "particles" => Err(E::custom("particles need their number, as in { particles = 1000 }")),
            "mixture" => Err(E::custom("a mixture needs its number of components, as in { mixture = 50 }")),
            other => Err(unknown(other)),
        }
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<FormSpec, A::Error> {
        let mut parts = Parts::default();
        while let Some(key) = map.next_key::<String>()? {
            match key.as_str() {
                "gaussian" => parts.gaussian = Some(map.next_value()?),
                "particles" => parts.particles = Some(map.next_value()?),
                "mixture" => parts.mixture = Some(map.next_value()?),
                "senders" => parts.senders = Some(map.next_value()?),
                "proposal" => parts.proposal = Some(map.next_value()?),
                "product" => parts.product = Some(map.next_value()?),
                "bandwidth" => parts.bandwidth = Some(map.next_value()?),
                "samples" => parts.samples = Some(map.next_value()?),
                other => return Err(A::Error::unknown_field(other, KEYS)),
            }
        }
        parts.form()
    }
}

/// The keys of a form's table.
#[derive(Default)]
struct Parts {
    gaussian: Option<Linearisation>,
    particles: Option<usize>,
    mixture: Option<usize>,
    senders: Option<usize>,
    proposal: Option<Proposal>,
    product: Option<ProductChoice>,
    bandwidth: Option<BandwidthChoice>,
    samples: Option<usize>,
}

impl Parts {
    fn form<E: Error>(self) -> Result<FormSpec, E> {
        let of_particles = [("senders", self.senders.is_some()), ("proposal", self.proposal.is_some())];
        let of_mixtures = [
            ("product", self.product.is_some()),
            ("bandwidth", self.bandwidth.is_some()),
            ("samples", self.samples.is_some()),
        ];
        let refuse = |keys: &[(&str, bool)], family: &str| match keys.iter().find(|(_, given)| *given) {
            Some((key, _)) => Err(E::custom(format!("{key} belongs to {family}"))),
            None => Ok(()),
        };
        match (self.gaussian, self.particles, self.mixture) {
            (Some(linearisation), None, None) => {
                refuse(&of_particles, "particles")?;
                refuse(&of_mixtures, "mixtures")?;
                Ok(FormSpec(AnyForm::Gaussian(GaussianForm { linearisation })))
            }
            (None, Some(count), None) => {
                refuse(&of_mixtures, "mixtures")?;
                Ok(FormSpec::particles(count, self.senders, self.proposal.unwrap_or_default()))
            }
            (None, None, Some(components)) => {
                refuse(&of_particles, "particles")?;
                let default = MixtureForm::new(components);
                Ok(FormSpec(AnyForm::Mixture(MixtureForm {
                    product: self.product.unwrap_or(default.product),
                    bandwidth: self.bandwidth.unwrap_or(default.bandwidth),
                    samples: self.samples.unwrap_or(default.samples),
                    ..default
                })))
            }
            (None, None, None) => Err(E::custom(
                "a form names its family, as in { particles = 1000 }, { mixture = 50 } or \"gaussian\"",
            )),
            _ => Err(E::custom("a form is gaussian, particles or a mixture, only one of them")),
        }
    }
}

fn unknown<E: Error>(name: &str) -> E {
    E::unknown_variant(name, NAMES)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(json: &str) -> Result<FormSpec, String> {
        serde_json::from_str(json).map_err(|error| error.to_string())
    }

    #[test]
    fn every_spelling_is_read_and_written_back() {
        let sigma = AnyForm::Gaussian(GaussianForm { linearisation: Linearisation::SigmaPoints });
        for (json, form) in [
            (r#""gaussian""#, FormSpec::gaussian()),
            (r#"{"gaussian": "sigma-points"}"#, FormSpec(sigma)),
            (r#"{"gaussian": "jacobian"}"#, FormSpec::gaussian()),
            (r#"{"particles": 300}"#, FormSpec::particles(300, None, Proposal::Informed)),
            (r#"{"mixture": 50}"#, FormSpec::mixture(50)),
            (
                r#"{"mixture": 50, "product": "multiscale-gibbs", "bandwidth": "silverman", "samples": 9}"#,
                FormSpec(AnyForm::Mixture(MixtureForm {
                    components: 50,
                    product: ProductChoice::MultiscaleGibbs,
                    bandwidth: BandwidthChoice::Silverman,
                    samples: 9,
                })),
            ),
            (
                r#"{"particles": 300, "senders": 50, "proposal": "prediction"}"#,
                FormSpec::particles(300, Some(50), Proposal::Prediction),
            ),
        ] {
            assert_eq!(read(json).as_ref(), Ok(&form), "{json}");
            assert_eq!(read(&serde_json::to_string(&form).unwrap()), Ok(form));
        }
    }

    #[test]
    fn wrong_spellings_say_what_there_is() {
        for (json, part) in [
            (r#""gausian""#, "unknown variant `gausian`, expected one of `gaussian`, `mixture`, `particles`"),
            (r#""mixture""#, "as in { mixture = 50 }"),
            (r#"{"mixture": 50, "senders": 3}"#, "senders belongs to particles"),
            (r#"{"mixture": 50, "product": "gibs"}"#, "unknown variant `gibs`"),
            (r#"{"particles": 50, "product": "gibbs"}"#, "product belongs to mixtures"),
            (r#""particles""#, "as in { particles = 1000 }"),
            (r#"{"particles": 5, "gaussian": "jacobian"}"#, "only one of them"),
            (r#"{"gaussian": "jacobian", "senders": 3}"#, "senders belongs to particles"),
            (r#"{"senders": 3}"#, "names its family"),
            (r#"{"particles": -3}"#, "invalid value: integer `-3`"),
            ("7", "expected \"gaussian\" or a table"),
            (r#"{"mixture": 50, "produt": "gibbs"}"#, "unknown field `produt`, expected one of `gaussian`"),
        ] {
            let message = read(json).unwrap_err();
            assert!(message.contains(part), "{json}: {message}");
        }
    }

    #[test]
    fn a_form_without_particles_is_refused_by_its_key() {
        let spec = FormSpec::particles(0, None, Proposal::Informed);
        let message = spec.validate("method.a.form.range").unwrap_err().to_string();
        assert_eq!(message, "`method.a.form.range.particles` is 0; at least 1 particle is needed");
        let spec = FormSpec::particles(10, Some(0), Proposal::Informed);
        assert!(spec.validate("m").unwrap_err().to_string().contains("`m.senders` is 0"));
        let message = FormSpec::mixture(0).validate("m").unwrap_err().to_string();
        assert_eq!(message, "`m.mixture` is 0; at least 1 component is needed");
    }

    #[test]
    fn a_product_that_a_belief_of_points_has_no_use_for_is_told() {
        let chosen = read(r#"{"mixture": 50, "product": "gibbs"}"#).unwrap().0;
        let told = unused_products(&AnyForm::particles(1000), &[("range", chosen)]).unwrap();
        assert!(told.starts_with(
            "product method not used (gibbs on range edges): the beliefs are held by particles"
        ));
        assert_eq!(unused_products(&chosen, &[("range", chosen)]), None);
        assert_eq!(unused_products(&AnyForm::particles(9), &[("range", AnyForm::mixture(5))]), None);
    }

    #[test]
    fn summaries_name_the_form() {
        assert_eq!(FormSpec::gaussian().to_string(), "gaussian");
        let spec = FormSpec::particles(1000, Some(50), Proposal::Informed);
        assert_eq!(spec.to_string(), "particles 1000 (50 senders)");
    }
}
