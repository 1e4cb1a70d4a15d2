//! The book's code blocks and the README's, compiled and run as doctests.

macro_rules! chapters {
    ($($chapter:ident: $path:literal),* $(,)?) => {$(
        #[doc = include_str!($path)]
        struct $chapter;
    )*};
}

chapters! {
    Readme: "../../../README.md",
    Introduction: "../../../docs/src/introduction.md",
    GettingStarted: "../../../docs/src/getting-started.md",
    Graphs: "../../../docs/src/graphs.md",
    Messages: "../../../docs/src/messages.md",
    Products: "../../../docs/src/products.md",
    Rules: "../../../docs/src/rules.md",
    Schedules: "../../../docs/src/schedules.md",
    Time: "../../../docs/src/time.md",
    Filters: "../../../docs/src/filters.md",
    Exact: "../../../docs/src/exact.md",
    Observability: "../../../docs/src/observability.md",
    Discrete: "../../../docs/src/discrete.md",
    Reproducibility: "../../../docs/src/reproducibility.md",
    Diagnostics: "../../../docs/src/diagnostics.md",
    Extending: "../../../docs/src/extending.md",
    Scenarios: "../../../docs/src/scenarios.md",
    Data: "../../../docs/src/data.md",
    PMpa: "../../../docs/src/p-mpa.md",
    Kcpf: "../../../docs/src/kcpf.md",
    Qgpf: "../../../docs/src/qgpf.md",
    Fusion: "../../../docs/src/fusion.md",
    Association: "../../../docs/src/association.md",
    Cooperation: "../../../docs/src/cooperation.md",
    RangeSlam: "../../../docs/src/range-slam.md",
    Underwater: "../../../docs/src/underwater.md",
    Decisions: "../../../docs/src/decisions.md",
}
