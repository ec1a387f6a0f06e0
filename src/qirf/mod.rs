//! Selection of the Gaussians to prune, by the QIRF method and other selectors.

pub mod assemble;
pub mod batch;
pub mod dense;
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

/// Number of rendering channels of a response, which come first, before those of optimisation.
pub const RENDERING: usize = crate::kernels::constants::responses::RENDERING as usize;

/// One Gaussian's responses, or a row of H or W made of them.
pub type Row = [f64; CHANNELS];
