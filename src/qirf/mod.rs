//! Floor 6: which Gaussians a scene can do without (the QIRF method and the selectors beside it).

pub mod assemble;
pub mod low_rank;
pub mod overlap;
pub mod response;
pub mod rrdm;
pub mod score;

/// Response channels of a Gaussian: four of rendering, then four of optimisation.
pub const CHANNELS: usize = 8;
