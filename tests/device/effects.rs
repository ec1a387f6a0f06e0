//! Effects: kernels against their twins; an effect that is off costs nothing.

mod depth_order;
pub mod exposure;
pub mod poses;
