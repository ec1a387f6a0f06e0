//! Meetings, which synchronise the blocks: all Gaussians, and the rows each block trains next.

use super::layout::{Block, GROWN, Layout};
use super::members::{select, with_margin};
use crate::gaussians::Gaussians;
use crate::job::Error;
use crate::train::checkpoint::Snapshot;
use std::ops::Range;

/// The Gaussians of all blocks at a meeting.
pub struct Meeting {
    /// All Gaussians, in the order of the blocks.
    pub collected: Gaussians,
    /// The first row of each block in it.
    pub starts: Vec<usize>,
}

/// A block at a meeting.
#[derive(Clone, Copy)]
pub struct AtMeeting<'a> {
    /// All blocks.
    pub layout: &'a Layout,
    /// The block's number.
    pub b: usize,
    /// The meeting.
    pub meeting: &'a Meeting,
}

/// Returns a block's state as it came to a meeting.
pub(super) type Came<'a> = &'a dyn Fn(usize) -> Result<Snapshot, Error>;

impl Meeting {
    /// The rows that block number `b` contributed.
    pub(super) fn rows(&self, b: usize) -> Range<usize> {
        self.starts[b]..self.starts.get(b + 1).copied().unwrap_or(self.collected.len())
    }

    /// Block number `b`, if photos show it and it has Gaussians of its own.
    pub(super) fn trains<'a>(&self, layout: &'a Layout, b: usize) -> Option<&'a Block> {
        layout.blocks.get(b).filter(|block| !block.crops.is_empty() && !self.rows(b).is_empty())
    }

    /// Other blocks' rows in the grown cell of block number `b`, rising.
    pub(super) fn margin(&self, layout: &Layout, b: usize) -> Vec<usize> {
        let own = self.rows(b);
        let grown = layout.cells.grown(b, GROWN);
        (0..self.collected.len()).filter(|i| !own.contains(i) && grown.contains(self.collected.means[*i])).collect()
    }

    /// The rows that block number `b` trains together with its margin: its own, then the margin's.
    pub(super) fn trained_by(&self, layout: &Layout, b: usize) -> Vec<usize> {
        let margin = if self.trains(layout, b).is_some() { self.margin(layout, b) } else { Vec::new() };
        self.rows(b).chain(margin).collect()
    }

    /// The state of block number `b` as it came, followed by these collected rows of other blocks, rising.
    pub(super) fn with(&self, came: Came<'_>, b: usize, margin: &[usize]) -> Result<Snapshot, Error> {
        let mut state = came(b)?;
        for other in 0..self.starts.len() {
            let of_other = self.rows(other);
            let rows: Vec<usize> = margin.iter().filter(|i| of_other.contains(i)).map(|i| i - of_other.start).collect();
            if !rows.is_empty() {
                state = with_margin(state, &select(&came(other)?, &rows));
            }
        }
        Ok(state)
    }
}
