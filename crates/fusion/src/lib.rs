//! Fusion of beliefs that share information, and association of the tracks that they describe.
