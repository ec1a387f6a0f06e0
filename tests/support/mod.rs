//! Shared by the three test programs: devices, small scenes, golden cases, input files, and the location of shared
//! data.
#![allow(dead_code, unused_imports)] // each program uses its own part

#[cfg(unix)]
pub mod browser;
mod device;
mod documented;
pub mod files;
pub mod golden;
pub mod gradient_bounds;
pub mod mutants;
pub mod no_nan;
mod numbers;
pub mod rounding;
pub mod runs;
mod shared;
pub mod synthetic;

pub use device::{device, finish, new_device, opened, options, plain, repeats};
pub use documented::documented;
pub use numbers::{Random, greatest_difference, relative, seed};
pub use shared::{content, shared, shared_as_well, skip, source};
