//! The built-in scenarios: files that are compiled in.

/// A scenario that needs no file.
pub struct Builtin {
    /// Its name on the command line.
    pub name: &'static str,
    /// Its TOML text.
    pub text: &'static str,
}

/// The built-in scenarios in the order of `sumprod list`.
pub const BUILTINS: &[Builtin] = &[
    Builtin { name: "pmpa-track", text: include_str!("../scenarios/pmpa-track.toml") },
    Builtin { name: "pmpa-cdf", text: include_str!("../scenarios/pmpa-cdf.toml") },
    Builtin { name: "coop-c3", text: include_str!("../scenarios/coop-c3.toml") },
    Builtin { name: "coop-c10", text: include_str!("../scenarios/coop-c10.toml") },
    Builtin { name: "coop-c10-forms", text: include_str!("../scenarios/coop-c10-forms.toml") },
    Builtin { name: "coop-c100", text: include_str!("../scenarios/coop-c100.toml") },
    Builtin { name: "coop-static", text: include_str!("../scenarios/coop-static.toml") },
    Builtin { name: "mrclam", text: include_str!("../scenarios/mrclam.toml") },
    Builtin { name: "qgpf", text: include_str!("../scenarios/qgpf.toml") },
    Builtin { name: "qgpf-degeneracy", text: include_str!("../scenarios/qgpf-degeneracy.toml") },
    Builtin { name: "wsn-energy", text: include_str!("../scenarios/wsn-energy.toml") },
    Builtin { name: "wsn-loss", text: include_str!("../scenarios/wsn-loss.toml") },
    Builtin { name: "plaza", text: include_str!("../scenarios/plaza.toml") },
    Builtin { name: "product", text: include_str!("../scenarios/product.toml") },
    Builtin { name: "range-slam-small", text: include_str!("../scenarios/range-slam-small.toml") },
    Builtin { name: "kcpf-growth", text: include_str!("../scenarios/kcpf-growth.toml") },
    Builtin { name: "kcpf-turn", text: include_str!("../scenarios/kcpf-turn.toml") },
    Builtin { name: "wsn-walk", text: include_str!("../scenarios/wsn-walk.toml") },
    Builtin { name: "fusion-star", text: include_str!("../scenarios/fusion-star.toml") },
    Builtin { name: "fusion-hierarchy", text: include_str!("../scenarios/fusion-hierarchy.toml") },
    Builtin { name: "fusion-ring", text: include_str!("../scenarios/fusion-ring.toml") },
    Builtin { name: "underwater", text: include_str!("../scenarios/underwater.toml") },
    Builtin { name: "seafloor", text: include_str!("../scenarios/seafloor.toml") },
    Builtin { name: "graph", text: include_str!("../scenarios/graph.toml") },
    Builtin { name: "association", text: include_str!("../scenarios/association.toml") },
    #[cfg(test)]
    Builtin { name: "walk", text: include_str!("testing/walk.toml") },
];

/// The built-in scenario of this name.
pub fn find(name: &str) -> Option<&'static Builtin> {
    BUILTINS.iter().find(|builtin| builtin.name == name)
}
