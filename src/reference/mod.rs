//! Float64 twins of the kernels: slow and obvious, the oracle of tests and of the accuracy axis.
//!
//! Each stage is one file, named as on the device; [`render`] and [`gradients`] run the stages in order.

pub mod adam;
pub mod bin;
pub mod densify;
pub mod depth_loss;
pub mod dropout;
pub mod exposure;
pub mod frame;
pub mod halve;
pub mod high_pass;
pub mod learnt_mask;
pub mod loss;
pub mod mask;
pub mod mcmc;
pub mod overlap;
pub mod params;
pub mod participation;
pub mod poses;
pub mod project;
pub mod project_backward;
pub mod rasterise;
pub mod rasterise_backward;
pub mod residual;
pub mod respond;
pub mod rrdm;
pub mod score;
pub mod smoothing;

pub use frame::{Gradients, Rendered, Settings, gradients, render};
pub use params::Params;
