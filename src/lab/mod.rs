//! The laboratory: what compares ways of pruning, measures the engine, and trains by methods of other papers. No product command depends on it.

pub mod compare;
pub mod methods;
pub mod sweep;
