//! Counts of the host's requests to a device.

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
