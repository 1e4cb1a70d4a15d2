//! The one list of systems: which Rust type reads and runs the scenario files of which `system`.

use sumprod_positioning::association::Association;
use sumprod_positioning::cooperation::Cooperation;
use sumprod_positioning::fusion::Fusion;
use sumprod_positioning::graphs::Graphs;
use sumprod_positioning::kcpf::growth::Growth;
use sumprod_positioning::kcpf::turn::Turn;
use sumprod_positioning::pmpa::PMpa;
use sumprod_positioning::product::Product;
use sumprod_positioning::range_slam::RangeSlam;
use sumprod_positioning::robots::mrclam::Mrclam;
use sumprod_positioning::robots::plaza::Plaza;
use sumprod_positioning::scenario::Scenario;
use sumprod_positioning::seafloor::Seafloor;
use sumprod_positioning::static_network::StaticNetwork;
use sumprod_positioning::underwater::Underwater;
use sumprod_positioning::walk::Walk as RadioWalk;
use sumprod_positioning::wsn::Wsn;

use crate::document::Document;
use crate::failure::Failure;

/// Something to do with a scenario, whichever its system.
pub trait Action {
    /// What it yields.
    type Output;

    /// Does it.
    fn on<S: Scenario>(self, document: &Document) -> Result<Self::Output, Failure>;
}

/// Names of the systems.
pub const SYSTEMS: &[&str] = &[
    PMpa::SYSTEM,
    Cooperation::SYSTEM,
    StaticNetwork::SYSTEM,
    Mrclam::SYSTEM,
    Plaza::SYSTEM,
    Product::SYSTEM,
    RangeSlam::SYSTEM,
    Growth::SYSTEM,
    Turn::SYSTEM,
    RadioWalk::SYSTEM,
    Graphs::SYSTEM,
    Wsn::SYSTEM,
    Fusion::SYSTEM,
    Association::SYSTEM,
    Underwater::SYSTEM,
    Seafloor::SYSTEM,
    #[cfg(test)]
    crate::testing::Walk::SYSTEM,
];

/// Does `action` with the system that the scenario names. A new system is one arm here and one name above.
pub fn dispatch<A: Action>(document: &Document, action: A) -> Result<A::Output, Failure> {
    match document.system()? {
        PMpa::SYSTEM => action.on::<PMpa>(document),
        Cooperation::SYSTEM => action.on::<Cooperation>(document),
        StaticNetwork::SYSTEM => action.on::<StaticNetwork>(document),
        Mrclam::SYSTEM => action.on::<Mrclam>(document),
        Plaza::SYSTEM => action.on::<Plaza>(document),
        Product::SYSTEM => action.on::<Product>(document),
        RangeSlam::SYSTEM => action.on::<RangeSlam>(document),
        Growth::SYSTEM => action.on::<Growth>(document),
        Turn::SYSTEM => action.on::<Turn>(document),
        RadioWalk::SYSTEM => action.on::<RadioWalk>(document),
        Graphs::SYSTEM => action.on::<Graphs>(document),
        Wsn::SYSTEM => action.on::<Wsn>(document),
        Fusion::SYSTEM => action.on::<Fusion>(document),
        Association::SYSTEM => action.on::<Association>(document),
        Underwater::SYSTEM => action.on::<Underwater>(document),
        Seafloor::SYSTEM => action.on::<Seafloor>(document),
        #[cfg(test)]
        crate::testing::Walk::SYSTEM => action.on::<crate::testing::Walk>(document),
        unknown => {
            let problem =
                format!("is \"{unknown}\", which does not exist; choose one of {}", SYSTEMS.join(", "));
            Err(document.wrong("system", &problem))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    struct Name;

    impl Action for Name {
        type Output = &'static str;

        fn on<S: Scenario>(self, _: &Document) -> Result<&'static str, Failure> {
            Ok(S::SYSTEM)
        }
    }

    #[test]
    fn every_listed_system_is_dispatched_to_itself() {
        for system in SYSTEMS {
            let document = Document::parse("file.toml", &format!("system = \"{system}\""), &[]).unwrap();
            assert_eq!(dispatch(&document, Name).unwrap(), *system);
        }
    }

    #[test]
    fn an_unknown_system_is_named() {
        let document = Document::parse("file.toml", "runs = 1\nsystem = \"moon\"", &[]).unwrap();
        let failure = dispatch(&document, Name).unwrap_err();
        assert!(failure.sentence().starts_with("file.toml:2: `system` is \"moon\", which does not exist"));
        assert_eq!(failure.status(), 2);
    }
}
