//! Parts of training a scene in blocks: who trains what, which views show a block, and what a block hands on.

mod layout;
mod members;
mod seen;

pub use layout::{Block, Crop, GROWN, Layout};
pub use members::{Members, joined, owned, with_tail};
pub use seen::{Seen, Shown, seen};
