//! The keys `[method.ID]`: what is heard of neighbours, and the form of each kind of edge.

use serde::{Deserialize, Serialize};
use sumprod_messages::{AnyForm, Proposal};

use super::network::{ANCHOR, Neighbours, PREDICTION, Plan, RANGE};
use crate::error::PositioningError;
use crate::form::{FormSpec, at_least_one};

/// The keys `[method.ID]`.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Method {
    /// Whether all agents are one variable, held as a Gaussian: the centralised filter.
    #[serde(default)]
    pub joint: bool,
    /// What an agent hears from its neighbours: `extrinsic`, `broadcast`, `plug-in` or `ignored`.
    #[serde(default)]
    pub neighbours: Neighbours,
    /// Rounds of messages within a slice.
    #[serde(default = "two")]
    pub rounds: usize,
    /// Whether the anchors are heard once before the first round.
    #[serde(default)]
    pub anchors_first: bool,
    /// Number of particles of every edge whose form is not given; without it such edges are Gaussian.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub particles: Option<usize>,
    /// Number of the sender's particles that a message averages over, unless a form gives its own; all without it.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub senders: Option<usize>,
    /// Where predicted particles are drawn from: `informed` (the default) or `prediction`.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub proposal: Option<Proposal>,
    /// Forms by kind of edge.
    #[serde(default)]
    pub form: Forms,
}

/// The keys `[method.ID.form]`.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Forms {
    /// Messages from one slice to the next.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub prediction: Option<FormSpec>,
    /// Messages among agents.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub range: Option<FormSpec>,
    /// Messages from anchors; as those among agents where not given.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub anchor: Option<FormSpec>,
}

impl Default for Method {
    fn default() -> Self {
        Self {
            joint: false,
            neighbours: Neighbours::default(),
            rounds: two(),
            anchors_first: false,
            particles: None,
            senders: None,
            proposal: None,
            form: Forms::default(),
        }
    }
}

fn two() -> usize {
    2
}

impl Method {
    /// Checks every value of method `id`.
    ///
    /// # Errors
    /// [`PositioningError::Setting`] naming the key.
    pub fn validate(&self, id: &str) -> Result<(), PositioningError> {
        let key = |name: &str| format!("method.{id}.{name}");
        at_least_one(&key("rounds"), self.rounds, "round")?;
        if let Some(particles) = self.particles {
            at_least_one(&key("particles"), particles, "particle")?;
        }
        if let Some(senders) = self.senders {
            at_least_one(&key("senders"), senders, "sender")?;
        }
        let forms =
            [(PREDICTION, self.form.prediction), (RANGE, self.form.range), (ANCHOR, self.form.anchor)];
        for (kind, form) in forms {
            if let Some(form) = form {
                form.validate(&key(&format!("form.{kind}")))?;
            }
        }
        let given = [
            ("particles", self.particles.is_some()),
            ("senders", self.senders.is_some()),
            ("proposal", self.proposal.is_some()),
        ];
        if self.joint {
            self.refuse_beside_joint(&key, &given)?;
        } else if self.particles.is_none()
            && let Some((name, _)) = given.iter().find(|(_, given)| *given)
        {
            let problem = format!(
                "is about particles, of which this method has none; set {} as well, or give it within a form",
                key("particles")
            );
            return Err(PositioningError::setting(key(name), problem));
        }
        let plan = self.plan();
        if matches!(plan.prediction, AnyForm::Particles(form) if form.proposal == Proposal::Optimal) {
            let name = if self.form.prediction.is_some() { "form.prediction.proposal" } else { "proposal" };
            let problem = "is `optimal`, which needs exact Gaussian evidence; choose informed or prediction";
            return Err(PositioningError::setting(key(name), problem));
        }
        Ok(())
    }

    fn refuse_beside_joint(
        &self,
        key: &impl Fn(&str) -> String,
        given: &[(&str, bool)],
    ) -> Result<(), PositioningError> {
        let more = [
            ("form", self.form != Forms::default()),
            ("anchors_first", self.anchors_first),
            ("neighbours", self.neighbours != Neighbours::default()),
        ];
        match given.iter().chain(&more).find(|(_, given)| *given) {
            None => Ok(()),
            Some((name, _)) => {
                let problem = "does not apply to the joint filter, which holds all agents in one Gaussian; leave it out";
                Err(PositioningError::setting(key(name), problem))
            }
        }
    }

    /// How the network is filtered.
    pub fn plan(&self) -> Plan {
        let otherwise = match self.particles {
            Some(count) => FormSpec::particles(count, self.senders, self.proposal.unwrap_or_default()),
            None => FormSpec::gaussian(),
        };
        let form = |given: Option<FormSpec>| given.map(|form| form.with_senders(self.senders));
        let range = form(self.form.range).unwrap_or(otherwise);
        Plan {
            prediction: form(self.form.prediction).unwrap_or(otherwise).0,
            range: range.0,
            anchor: form(self.form.anchor).unwrap_or(range).0,
            rounds: self.rounds,
            anchors_first: self.anchors_first,
            neighbours: self.neighbours,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refused(json: &str) -> String {
        let method: Method = serde_json::from_str(json).unwrap();
        method.validate("m").unwrap_err().to_string()
    }

    #[test]
    fn forms_fall_back_from_the_kind_to_the_method() {
        let read = |json: &str| serde_json::from_str::<Method>(json).unwrap().plan();
        assert_eq!(read("{}"), Plan::default());
        let plan = read(r#"{"form": {"range": {"particles": 300}}}"#);
        assert_eq!((plan.prediction.name(), plan.range, plan.anchor), ("gaussian", plan.anchor, plan.range));
        assert_eq!(plan.range.name(), "particles");
        let plan = read(r#"{"particles": 50, "senders": 20, "form": {"range": {"particles": 300}}}"#);
        assert_eq!(plan.range, FormSpec::particles(300, Some(20), Proposal::Informed).0);
        let plan = read(r#"{"particles": 50, "senders": 20, "form": {"anchor": "gaussian"}}"#);
        let expected = FormSpec::particles(50, Some(20), Proposal::Informed).0;
        assert_eq!((plan.prediction, plan.range, plan.anchor), (expected, expected, AnyForm::gaussian()));
    }

    #[test]
    fn wrong_values_are_refused_by_their_key() {
        for (json, part) in [
            (r#"{"rounds": 0}"#, "`method.m.rounds` is 0; at least 1 round is needed"),
            (r#"{"particles": 0}"#, "`method.m.particles` is 0; at least 1 particle"),
            (r#"{"particles": 9, "senders": 0}"#, "`method.m.senders` is 0"),
            (r#"{"form": {"range": {"particles": 0}}}"#, "`method.m.form.range.particles` is 0"),
            (r#"{"senders": 5}"#, "`method.m.senders` is about particles"),
            (r#"{"proposal": "prediction"}"#, "`method.m.proposal` is about particles"),
            (r#"{"joint": true, "particles": 5}"#, "`method.m.particles` does not apply to the joint filter"),
            (r#"{"joint": true, "form": {"range": "gaussian"}}"#, "`method.m.form` does not apply"),
            (r#"{"particles": 9, "proposal": "optimal"}"#, "`method.m.proposal` is `optimal`"),
        ] {
            assert!(refused(json).contains(part), "{json}: {}", refused(json));
        }
    }
}
