//! Training: the loss, Adam, density control, the loop, and where it starts; device against float64 and plain host code.

#[path = "../common/mod.rs"]
mod common;
#[path = "../synthetic/mod.rs"]
mod synthetic;

mod adam;
mod density;
mod halve;
mod initialise;
mod loss;
mod memory;
mod prune;
mod runs;
mod smoothing;
