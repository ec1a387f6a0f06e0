//! Numbers of floaters.

use crate::edit::Reason;
use serde::Serialize;
use std::fmt;

/// Numbers of floaters by rule.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct FloaterCounts {
    /// The photos that see them disagree with them.
    pub disagree: usize,
    /// They are close to a single camera.
    pub near_one: usize,
    /// No photo needs them, and they are isolated.
    pub alone: usize,
}

impl FloaterCounts {
    /// Counts of the floaters that were found, by rule.
    pub fn of(found: &[Option<Reason>]) -> Self {
        let count = |reason: Reason| found.iter().filter(|f| **f == Some(reason)).count();
        Self { disagree: count(Reason::Disagrees), near_one: count(Reason::NearOne), alone: count(Reason::Alone) }
    }

    /// The counts in words, without photos.
    pub fn without_photos(&self) -> String {
        format!("{} close to a single camera, {} isolated", self.near_one, self.alone)
    }
}

impl fmt::Display for FloaterCounts {
    /// The counts in words, of floaters found by photos.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { disagree, near_one, alone } = self;
        write!(
            f,
            "photos disagree with {disagree}, {near_one} close to a single camera, {alone} isolated and not needed"
        )
    }
}
