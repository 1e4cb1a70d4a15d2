//! The `[method.ID]` tables.

use serde::{Deserialize, Serialize};

use super::settings::WorldSettings;
use crate::PositioningError;

/// What a method makes of the sound it hears.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Algorithm {
    /// Pseudo-ranges; position, velocity and clock are estimated together.
    OneWay,
    /// The same in a window of frames whose states are solved for together, with those of other nodes.
    Window,
    /// Round trips to a node that moves before it replies.
    TwoWay,
    /// Half round trips taken for ranges at the emission.
    Jsl,
    /// Pseudo-ranges corrected by a clock that was set once.
    TwoStep,
    /// Pseudo-ranges taken for ranges.
    Direct,
}

/// One `[method.ID]` table.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct MethodSettings {
    /// What it makes of the sound.
    pub algorithm: Algorithm,
    /// Takes all emissions of a frame to be sent at its end.
    #[serde(default)]
    pub simultaneous: bool,
    /// Takes nodes to stand still while sound is under way.
    #[serde(default)]
    pub frozen_flight: bool,
    /// Frames that a window looks back.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub lag: Option<u32>,
    /// Frames that a window waits before it tells its estimate, at most its lag.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub delay: Option<u32>,
    /// Whether a window hears other nodes.
    #[serde(default)]
    pub cooperative: bool,
}

impl MethodSettings {
    /// Frames that a window looks back.
    pub fn lag(&self) -> usize {
        self.lag.unwrap_or(5) as usize
    }

    /// Frames that a window waits.
    pub fn delay(&self) -> usize {
        self.delay.unwrap_or(0) as usize
    }

    /// Whether the state has a clock.
    pub fn has_clock(&self) -> bool {
        matches!(self.algorithm, Algorithm::OneWay | Algorithm::Window)
    }

    /// Checks the values of method `id`.
    ///
    /// # Errors
    /// [`PositioningError::Setting`] naming the key.
    pub fn validate(&self, id: &str, world: &WorldSettings) -> Result<(), PositioningError> {
        let wrong = |key: &str, problem: String| {
            Err(PositioningError::setting(format!("method.{id}.{key}"), problem))
        };
        if self.algorithm != Algorithm::Window {
            for (key, given) in [
                ("lag", self.lag.is_some()),
                ("delay", self.delay.is_some()),
                ("cooperative", self.cooperative),
            ] {
                if given {
                    return wrong(key, "is for algorithm = \"window\" alone; leave it out".into());
                }
            }
        } else if self.simultaneous {
            return wrong("simultaneous", "is not for algorithm = \"window\"; leave it out".into());
        }
        if self.lag == Some(0) {
            return wrong("lag", "is 0; a window must look back at least 1 frame".into());
        }
        if self.delay() > self.lag() {
            let problem = format!("is {}; the window forgets after {} frames", self.delay(), self.lag());
            return wrong("delay", problem);
        }
        let least = world.least_clock_density();
        if self.algorithm == Algorithm::Window && world.clock_density < least {
            let problem = format!(
                "is \"window\", but with `world.clock_density` = {} m²/s³ clocks hardly move from one emission to the next, \
                 and its equations are singular; set that to {least:.1e} or more, or leave the slots longer",
                world.clock_density
            );
            return wrong("algorithm", problem);
        }
        if self.cooperative && world.heard_nodes == 0 {
            let problem = "is true, but no node hears another; set `world.heard_nodes`";
            return wrong("cooperative", problem.into());
        }
        if self.frozen_flight && !self.has_clock() {
            return wrong("frozen_flight", "is for pseudo-ranges with a clock alone; leave it out".into());
        }
        Ok(())
    }
}
