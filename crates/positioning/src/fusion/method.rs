//! The `[method.ID]` tables.

use serde::{Deserialize, Serialize};
use sumprod_fusion::{Criterion, Intersection, IntersectionKind, Rule};

use super::structure::StructureKind;
use super::world::WorldSettings;
use crate::error::PositioningError;

/// How nodes fuse what they receive.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum FusionRule {
    /// Every measurement in one filter.
    Centralised,
    /// What both hold is divided out, found by the identity of messages; a loop is an error.
    Removal,
    /// What the edge carried before is divided out, whatever came by others.
    Edge,
    /// What the sender observed itself is multiplied in.
    Private,
    /// Everything is multiplied in.
    Naive,
    /// An intersection.
    Intersection,
    /// Removal until a loop is noticed, then an intersection.
    Automatic,
}

/// Who sends to whom in an exchange.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Exchange {
    /// From the lowest nodes to the top, which alone is scored.
    #[default]
    Collect,
    /// And back from the top to the lowest.
    CollectAndDistribute,
    /// Every node once to each of its neighbours, all at the same time.
    Neighbours,
}

/// Which links are used.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Links {
    /// A spanning tree of the neighbours; of a hierarchy all.
    #[default]
    Tree,
    /// All, loops included.
    All,
}

/// One `[method.ID]` table.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MethodSettings {
    /// How nodes fuse what they receive.
    pub rule: FusionRule,
    /// Who sends to whom.
    #[serde(default)]
    pub exchange: Exchange,
    /// Which links are used.
    #[serde(default)]
    pub links: Links,
    /// Which intersection, of the rules that use one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub intersection: Option<IntersectionKind>,
    /// What the intersection makes small.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub criterion: Option<Criterion>,
}

impl MethodSettings {
    /// Checks the values of method `id`.
    ///
    /// # Errors
    /// [`PositioningError::Setting`] naming the key.
    pub fn validate(&self, id: &str, world: &WorldSettings) -> Result<(), PositioningError> {
        let wrong = |key: &str, problem: &str| {
            Err(PositioningError::setting(format!("method.{id}.{key}"), problem.to_owned()))
        };
        let intersects = matches!(self.rule, FusionRule::Intersection | FusionRule::Automatic);
        if self.intersection.is_some() && !intersects {
            return wrong("intersection", "is given, but this rule intersects nothing; leave it out");
        }
        if self.criterion.is_some() && !intersects {
            return wrong("criterion", "is given, but this rule intersects nothing; leave it out");
        }
        if self.links == Links::All && self.exchange != Exchange::Neighbours {
            return wrong("links", "is \"all\", but only exchange = \"neighbours\" has loops; leave it out");
        }
        if self.links == Links::All
            && self.rule == FusionRule::Removal
            && world.structure == StructureKind::Ring
        {
            return wrong(
                "rule",
                "is \"removal\", which a loop makes wrong; choose links = \"tree\", or rule = \"automatic\", which falls back",
            );
        }
        if world.message_loss > 0.0 && self.exchange != Exchange::Collect {
            let looped = world.structure == StructureKind::Hierarchy
                && matches!(self.rule, FusionRule::Removal | FusionRule::Naive);
            if looped {
                return wrong(
                    "exchange",
                    "distributes past lost messages, so that the shared sensor closes a loop; choose rule = \"automatic\", \
                     exchange = \"collect\", or world.message_loss = 0",
                );
            }
            if self.rule == FusionRule::Edge {
                return wrong(
                    "rule",
                    "is \"edge\", which trusts that both ends keep the same separator, and lost messages break that; \
                     choose \"removal\", which goes by the messages' identity, or world.message_loss = 0",
                );
            }
        }
        if self.rule == FusionRule::Private && self.exchange != Exchange::Neighbours {
            return wrong("rule", "is \"private\", which is for exchange = \"neighbours\" alone");
        }
        Ok(())
    }

    fn intersection(&self, usual: IntersectionKind) -> Intersection {
        Intersection {
            kind: self.intersection.unwrap_or(usual),
            criterion: self.criterion.unwrap_or_default(),
        }
    }

    /// The nodes' rule; none where there is one filter alone.
    pub(super) fn node_rule(&self) -> Option<Rule> {
        match self.rule {
            FusionRule::Centralised => None,
            FusionRule::Removal => Some(Rule::Removal),
            FusionRule::Edge => Some(Rule::Edge),
            FusionRule::Private => Some(Rule::Private),
            FusionRule::Naive => Some(Rule::Naive),
            FusionRule::Intersection => {
                Some(Rule::Intersection(self.intersection(IntersectionKind::Covariance)))
            }
            FusionRule::Automatic => Some(Rule::Automatic(self.intersection(IntersectionKind::Split))),
        }
    }
}
