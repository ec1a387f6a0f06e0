//! Effects: that those which are off cost nothing, and that those which are on help.

mod depth_order;
mod exposure;
mod worth;
