//! The laboratory: comparison of pruning methods, measurement of the engine, and training methods of other papers. No
//! product command depends on it.

pub mod compare;
pub mod methods;
pub mod sweep;
