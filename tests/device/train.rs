//! Training: the loss, Adam, density control, the loop, and initial models; device against float64 and plain host code.

pub mod adam;
mod attrition;
mod crop;
pub mod density;
mod depth_loss;
mod growth;
mod halve;
mod learnt_mask;
mod loss;
mod mask;
mod mcmc;
mod mean;
mod memory;
mod prune;
pub(crate) mod runs;
pub mod smoothing;
mod tail;
