//! Floor 6: which Gaussians to keep, decided in function space.

pub mod assemble;
pub mod overlap;
pub mod response;
pub mod rrdm;
pub mod score;
