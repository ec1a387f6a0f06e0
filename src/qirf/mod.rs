//! Floor 6: which Gaussians a scene can do without (the QIRF method and the selectors beside it).

pub mod batch;
mod lapack;
pub mod normalise;
pub mod partition;
pub mod select;
pub mod solve;

/// Response channels of a Gaussian: four of rendering, then four of optimisation.
pub const CHANNELS: usize = 8;

/// One Gaussian's responses, or a row of H or W made of them.
pub type Row = [f64; CHANNELS];
