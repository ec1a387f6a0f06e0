//! Effects: kernels against their twins; an effect that is off costs nothing.

mod depth_order;
mod dropout;
pub mod exposure;
pub mod poses;
