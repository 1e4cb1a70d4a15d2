//! A resampler chosen by name, as scenario files do.

use serde::{Deserialize, Serialize};
use sumprod_graph::FastStream;

use crate::reselection::Reselection;
use crate::{Multinomial, Residual, Ssp, Stratified, Systematic};

/// The classical resamplers by name: `multinomial`, `residual`, `stratified`, `systematic`, `ssp`.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Scheme {
    /// [`Multinomial`].
    Multinomial,
    /// [`Residual`].
    Residual,
    /// [`Stratified`].
    Stratified,
    /// [`Systematic`].
    #[default]
    Systematic,
    /// [`Ssp`].
    Ssp,
}

impl Scheme {
    /// All of them.
    pub const ALL: [Self; 5] =
        [Self::Multinomial, Self::Residual, Self::Stratified, Self::Systematic, Self::Ssp];
}

impl Reselection for Scheme {
    fn choose(&self, shares: &[f64], count: usize, random: &mut FastStream) -> Vec<usize> {
        match self {
            Self::Multinomial => Multinomial.choose(shares, count, random),
            Self::Residual => Residual.choose(shares, count, random),
            Self::Stratified => Stratified.choose(shares, count, random),
            Self::Systematic => Systematic.choose(shares, count, random),
            Self::Ssp => Ssp.choose(shares, count, random),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_are_read_back() {
        let names = Scheme::ALL.map(|scheme| serde_json::to_string(&scheme).unwrap());
        assert_eq!(names, ["\"multinomial\"", "\"residual\"", "\"stratified\"", "\"systematic\"", "\"ssp\""]);
        let read = names.map(|name| serde_json::from_str::<Scheme>(&name).unwrap());
        assert_eq!(read, Scheme::ALL);
    }
}
