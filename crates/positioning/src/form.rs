//! How a scenario file spells the form of an edge.
//!
//! | spelling | form |
//! |---|---|
//! | `"gaussian"` | a Gaussian, nonlinear factors expanded to first order |
//! | `{ gaussian = "sigma-points" }` | a Gaussian, nonlinear factors made linear over sigma points |
//! | `{ particles = 1000 }` | 1000 weighted particles |
//! | `{ particles = 1000, senders = 100, proposal = "prediction" }` | the same, messages averaged over 100 of the sender's particles, predicted states drawn from the motion alone |

use std::fmt;

use serde::de::{Error, MapAccess, Visitor};
use serde::ser::SerializeMap;
use serde::{Deserialize, Deserializer, Serialize, Serializer};
use sumprod_messages::{AnyForm, GaussianForm, Linearisation, ParticlesForm, Proposal};

use crate::error::PositioningError;

/// The names that a form starts with.
const NAMES: &[&str] = &["gaussian", "particles"];

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

    /// Checks the numbers; `key` is the dotted path under which the form was read.
    ///
    /// # Errors
    /// [`PositioningError::Setting`] for no particles or no senders.
    pub fn validate(&self, key: &str) -> Result<(), PositioningError> {
        if let AnyForm::Particles(form) = &self.0 {
            at_least_one(&format!("{key}.particles"), form.count, "particle")?;
            if let Some(senders) = form.senders {
                at_least_one(&format!("{key}.senders"), senders, "sender")?;
            }
        }
        Ok(())
    }
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
            other => Err(unknown(other)),
        }
    }

    fn visit_map<A: MapAccess<'de>>(self, mut map: A) -> Result<FormSpec, A::Error> {
        let (mut linearisation, mut count, mut senders, mut proposal) = (None, None, None, None);
        while let Some(key) = map.next_key::<String>()? {
            match key.as_str() {
                "gaussian" => linearisation = Some(map.next_value()?),
                "particles" => count = Some(map.next_value()?),
                "senders" => senders = Some(map.next_value()?),
                "proposal" => proposal = Some(map.next_value()?),
                other => return Err(unknown(other)),
            }
        }
        match (linearisation, count) {
            (Some(linearisation), None) if senders.is_none() && proposal.is_none() => {
                Ok(FormSpec(AnyForm::Gaussian(GaussianForm { linearisation })))
            }
            (None, Some(count)) => Ok(FormSpec::particles(count, senders, proposal.unwrap_or_default())),
            (Some(_), Some(_)) => Err(A::Error::custom("a form is either gaussian or particles, not both")),
            (Some(_), None) => Err(A::Error::custom("senders and proposal belong to particles")),
            (None, None) => {
                Err(A::Error::custom("a form names its family, as in { particles = 1000 } or \"gaussian\""))
            }
        }
    }
}

fn unknown<E: Error>(name: &str) -> E {
    if name == "mixture" {
        return E::custom("mixtures are not available as a form yet; choose gaussian or particles");
    }
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
            (r#""gausian""#, "unknown variant `gausian`, expected `gaussian` or `particles`"),
            (r#""mixture""#, "mixtures are not available"),
            (r#"{"mixture": 50}"#, "mixtures are not available"),
            (r#""particles""#, "as in { particles = 1000 }"),
            (r#"{"particles": 5, "gaussian": "jacobian"}"#, "not both"),
            (r#"{"gaussian": "jacobian", "senders": 3}"#, "belong to particles"),
            (r#"{"senders": 3}"#, "names its family"),
            (r#"{"particles": -3}"#, "invalid value: integer `-3`"),
            ("7", "expected \"gaussian\" or a table"),
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
    }

    #[test]
    fn summaries_name_the_form() {
        assert_eq!(FormSpec::gaussian().to_string(), "gaussian");
        let spec = FormSpec::particles(1000, Some(50), Proposal::Informed);
        assert_eq!(spec.to_string(), "particles 1000 (50 senders)");
    }
}
