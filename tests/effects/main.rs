//! Effects: what scenes call for, that those which are off cost nothing, and that those which are on help.

#[path = "../common/mod.rs"]
mod common;
mod depth_order;
mod detectors;
mod exposure;
mod worth;
