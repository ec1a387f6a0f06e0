//! Effects: kernels against their twins, and that an effect that is off costs nothing.

mod depth_order;
mod exposure;
