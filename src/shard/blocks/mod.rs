//! Training a scene in blocks: who trains what, which views show a block, what a block hands on, and the stages of the whole.

mod begin;
mod blend;
mod derived;
mod first;
mod layout;
mod meeting;
mod members;
mod run;
mod score;
mod seen;
mod share;

pub use blend::{Copies, copies};
pub use layout::{Block, Crop, GROWN, Layout};
pub use meeting::Meeting;
pub use members::{Members, joined, owned, with_tail};
pub use run::{BlockRun, BlockState};
pub use seen::{BlockVisibility, Seen, seen};
