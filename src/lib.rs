//! Train, prune and measure 3D Gaussian Splatting scenes with Vulkan compute.
//!
//! Modules are floors: imports only go down the list. A stage has one name everywhere: shader (`glsl/`), host room,
//! float64 twin (`reference/`), debug label, profiler scope and benchmark.

pub mod gpu;
#[doc(hidden)]
pub mod kernels;

pub mod primitives;

pub mod effects;
pub mod gaussians;
pub mod metrics;
pub mod qirf;
pub mod random;
pub mod reference;
pub mod render;
pub mod response;
pub mod scene;
pub mod synth;
pub mod train;

pub mod cli;
pub mod error;
pub mod pipeline;
pub mod report;
pub mod selftest;
