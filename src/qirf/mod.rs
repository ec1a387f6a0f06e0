//! Selection of the Gaussians to prune, by the QIRF method and other selectors.

pub mod assemble;
pub mod batch;
mod lapack;
pub mod measured;
pub mod normalise;
pub mod overlap;
pub mod pairs;
pub mod participation;
pub mod partition;
pub mod plan;
pub mod rrdm;
pub mod select;
pub mod study;

pub use crate::response::CHANNELS;

/// One Gaussian's responses, or a row of H or W made of them.
pub type Row = [f64; CHANNELS];
