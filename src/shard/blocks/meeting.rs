//! Meetings, which synchronise the blocks: all Gaussians, and the rows each block trains next.

use super::layout::{Block, GROWN, Layout};
use super::members::{inside, select, with_margin};
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

    /// The rows that block number `b` trains together with its margin: its own, then those of other blocks in its grown
    /// cell, rising.
    pub(super) fn trained_by(&self, layout: &Layout, b: usize) -> Vec<usize> {
        let own = self.rows(b);
        let mut rows: Vec<usize> = own.clone().collect();
        if self.trains(layout, b).is_some() {
            let inside = inside(&layout.cells, b, GROWN, &self.collected);
            rows.extend(inside.into_iter().filter(|i| !own.contains(i)));
        }
        rows
    }

    /// The state of block number `b` as it came, followed by those of `rows` that other blocks contributed, rising.
    pub(super) fn with(&self, came: Came<'_>, b: usize, rows: &[usize]) -> Result<Snapshot, Error> {
        let mut state = came(b)?;
        for other in (0..self.starts.len()).filter(|other| *other != b) {
            let of_other = self.rows(other);
            let rows: Vec<usize> = rows.iter().filter(|i| of_other.contains(i)).map(|i| i - of_other.start).collect();
            if !rows.is_empty() {
                state = with_margin(state, &select(&came(other)?, &rows));
            }
        }
        Ok(state)
    }
}
