//! Training: the loss, Adam, density control, the loop, and initial models; device against float64 and plain host code.

pub mod adam;
mod attrition;
mod cloak;
mod crop;
pub mod density;
mod explore;
mod growth;
mod halve;
mod loss;
mod mask;
mod mean;
mod memory;
mod prune;
pub(crate) mod runs;
pub mod smoothing;
mod tail;
