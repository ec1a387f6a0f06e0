//! Hard cases, stage by stage: what `qirf-vk selftest` runs, here with validation layers, poisoned memory and fences; random
//! ones from a printed seed; and what the formulas that we do not use would give (docs/numerics.md).

#[path = "../common/mod.rs"]
mod common;
mod guards;
mod naive;
mod overlap;
mod project;
mod random;
mod rooms;
