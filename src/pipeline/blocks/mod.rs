//! Parts of training a scene in blocks: who trains what, which views show a block, and what a block hands on.

mod members;
mod seen;

pub use members::{Members, joined, owned, with_tail};
pub use seen::{Seen, Shown, seen};
