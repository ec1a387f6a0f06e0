//! Floor 6: which Gaussians a scene can do without (the QIRF method and the selectors beside it).

pub mod assemble;
pub mod batch;
mod lapack;
pub mod normalise;
pub mod overlap;
pub mod participation;
pub mod partition;
pub mod response;
pub mod rrdm;
pub mod score;
pub mod select;
pub mod study;

/// Response channels of a Gaussian: four of rendering, then four of optimisation.
pub const CHANNELS: usize = 8;

/// One Gaussian's responses, or a row of H or W made of them.
pub type Row = [f64; CHANNELS];
