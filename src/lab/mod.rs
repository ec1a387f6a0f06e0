//! The laboratory: what compares ways of pruning and measures the engine. No product command depends on it.

pub mod compare;
pub mod sweep;
