//! Counts of the host's requests to a device.

use std::sync::atomic::{AtomicU64, Ordering};

/// The host's requests to the device so far.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Traffic {
    /// Submissions to the queue.
    pub submissions: u64,
    /// Submissions that the host waited for at once, leaving the device idle until the next.
    pub round_trips: u64,
    /// Buffers made; large ones have memory of their own, for which the driver is asked.
    pub buffers: u64,
}

/// The counters of [`Traffic`].
#[derive(Default)]
pub(super) struct Counters {
    pub submissions: AtomicU64,
    pub round_trips: AtomicU64,
    pub buffers: AtomicU64,
}

impl Counters {
    pub fn read(&self) -> Traffic {
        let all = [&self.submissions, &self.round_trips, &self.buffers];
        let [submissions, round_trips, buffers] = all.map(|n| n.load(Ordering::Relaxed));
        Traffic { submissions, round_trips, buffers }
    }
}
