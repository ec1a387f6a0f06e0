//! The host's check of a run: counters, pairs and loss, which arrive with the last iteration before it.

use super::error::Result;
use super::loss::Loss;
use crate::gpu::{Device, Readback, Recording, Timings};
use crate::render::{BackwardCounts, TrainingRenderer};

/// Words of [`TrainingRenderer::counters`]: two of the backward passes, two of the pairs. The loss's sums follow them.
const COUNTERS: usize = 4;
const SUMS: usize = 4;

/// Host memory for the results of a check.
pub(super) struct HostCheck {
    readback: Readback<u32>,
}

/// Results of a check.
pub(super) struct Seen {
    /// Counters of the backward passes since [`HostCheck::begin`].
    pub counts: BackwardCounts,
    /// Largest number of pairs that a picture needed since then.
    pub pairs: u32,
    /// Sums of the last loss.
    pub sums: [f32; SUMS],
    /// Time of the submission that brought these results.
    pub timings: Timings,
}

impl HostCheck {
    pub fn new(device: &Device) -> Result<Self> {
        Ok(Self { readback: device.readback("look", COUNTERS + SUMS)? })
    }

    /// Records the reset of all counters, before the first iteration.
    pub fn begin(recording: &mut Recording, renderer: &TrainingRenderer) {
        renderer.reset_backward_counts(recording);
        renderer.reset_overflow(recording);
    }

    /// Submits the last iteration before the check.
    pub fn submit(
        &mut self,
        device: &Device,
        recording: Recording,
        renderer: &TrainingRenderer,
        loss: &Loss,
    ) -> Result<()> {
        let sums = loss.sums().cast();
        let [guards, pairs] = renderer.counters();
        self.readback.submit(device, recording, &[guards, pairs, (&sums, SUMS)])?;
        Ok(())
    }

    /// Waits for that submission.
    pub fn wait(&mut self) -> Result<Seen> {
        let (words, timings) = self.readback.wait()?;
        let (counters, sums) = words.split_at(COUNTERS);
        let sums = std::array::from_fn(|k| f32::from_bits(sums[k]));
        Ok(Seen { counts: BackwardCounts::of(counters), pairs: counters[3], sums, timings })
    }
}
