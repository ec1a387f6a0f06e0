//! The backward pass: its options, its counters, and the data passed between its stages.

use super::atomic_sums::AtomicSums;
use super::bin;
use super::frame::{Frame, Launch};
use super::slot_sums::SlotSums;
use crate::gpu::Buffer;
use crate::primitives::Pairs;

/// Options of a backward pass.
#[derive(Clone, Copy)]
#[expect(clippy::struct_excessive_bools, reason = "switches of a pass, each on its own")]
pub struct Backward<'a> {
    /// True if the image gradient's fourth component is each pixel's residual instead of a gradient by alpha. The slots
    /// then also hold the contributions weighted by it, see [`super::TrainingRenderer::slots`]; the renderer needs room for them
    /// ([`super::TrainingRenderer::make_room_for_responses`]). Atomic sums support no residual.
    pub residual: bool,
    /// Adds up each Gaussian's gradients by float atomics, in the arbitrary order of the device's threads, instead of
    /// in the order of its slots; the baseline for ordered sums. The slots are not valid afterwards.
    pub atomics: Option<&'a AtomicSums>,
    /// True if the gradient by the view direction is passed on to the mean.
    pub through_direction: bool,
    /// n x (sum of the 2D mean's gradient norms in NDC units, number of views that saw it), used by density control.
    /// The pass adds to it, if given.
    pub growth: Option<&'a Buffer<[f32; 2]>>,
    /// True if gradients count there by their size in each tile, so that tiles do not cancel.
    pub absolute: bool,
    /// True if the picture's reds are the Gaussians' depths along the camera's axis, and all else in its colours is 0: red's
    /// gradient reaches the mean, and the rows are added to those of the pass before.
    pub depths: bool,
}

impl Default for Backward<'_> {
    fn default() -> Self {
        Self { residual: false, atomics: None, through_direction: true, growth: None, absolute: false, depths: false }
    }
}

/// Counters of the backward passes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BackwardCounts {
    /// Rows skipped because a gradient is not finite, summed over passes.
    pub skipped_rows: u32,
    /// Passes whose pairs fitted.
    pub passes: u32,
}

impl BackwardCounts {
    /// The counts from the words of their buffer, the first of [`super::TrainingRenderer::counters`].
    ///
    /// # Panics
    /// If there are fewer words.
    pub fn of(words: &[u32]) -> Self {
        Self { skipped_rows: words[0], passes: words[1] }
    }
}

/// Data shared by the stages of one backward pass.
pub(super) struct Pass<'a> {
    pub launch: &'a Launch,
    pub frame: &'a Frame,
    /// Gradient by the picture's pixels.
    pub image_gradient: &'a Buffer<[f32; 4]>,
    /// Tiles of the picture.
    pub tiles: u32,
    pub options: Backward<'a>,
}

impl<'a> Pass<'a> {
    /// The picture's slots by tile, nearest first.
    pub fn sorted(&self) -> &'a Pairs {
        bin::sorted(self.frame, self.tiles)
    }
}

/// Location of a Gaussian's sums over pixels: `counts` of `rows`, starting at `first`.
pub(super) struct Sums<'a> {
    pub counts: &'a Buffer<u32>,
    pub first: &'a Buffer<u32>,
    pub rows: &'a SlotSums,
}
