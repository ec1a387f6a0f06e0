//! The laboratory: comparison of pruning methods, measurement of the engine, curves of quality against bytes, and training
//! methods of other papers. No product command depends on it.

pub mod compare;
pub mod curve;
mod figures;
pub mod methods;
pub mod sweep;
