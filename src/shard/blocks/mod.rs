//! Training a scene in blocks: which Gaussians each trains, which views show it, which Gaussians it passes on, and the
//! stages of the whole run.

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
pub use members::{joined, owned, with_tail};
pub use run::{BlockRun, BlockState, Leg};
pub use seen::{BlockVisibility, Seen, seen};
