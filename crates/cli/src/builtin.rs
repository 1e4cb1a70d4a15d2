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
    #[cfg(test)]
    Builtin { name: "walk", text: include_str!("testing/walk.toml") },
];

/// The built-in scenario of this name.
pub fn find(name: &str) -> Option<&'static Builtin> {
    BUILTINS.iter().find(|builtin| builtin.name == name)
}
