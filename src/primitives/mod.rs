//! Parallel building blocks independent of splats: counts on the device, prefix sum, stable radix sort,
//! compaction, gather and reduction. All run at subgroup sizes of 4 to 128.

mod compact;
mod count;
mod gather;
mod reduce;
mod scan;
mod sort;

pub use compact::compact;
pub use count::Count;
pub use gather::gather;
pub use reduce::reduce;
pub use scan::{Scan, Words};
pub use sort::{Pairs, Sort};

/// Default number of invocations of a workgroup.
pub const WORKGROUP: u32 = 256;
