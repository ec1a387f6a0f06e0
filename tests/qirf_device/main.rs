//! The device half of QIRF: overlaps, density matrices and responses, against expectation and float64 twins.

#[path = "../common/mod.rs"]
mod common;
mod low_rank;
mod overlap;
mod response;
#[path = "../synthetic/mod.rs"]
mod synthetic;
mod twin;
