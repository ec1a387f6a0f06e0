//! The backward pass: how it goes, what it counts, and what its stages hand on.

use super::atomic_sums::AtomicSums;
use super::bin;
use super::frame::{Frame, Launch, SlotSums};
use crate::gpu::Buffer;
use crate::primitives::Pairs;

/// How a backward pass goes.
#[derive(Clone, Copy)]
pub struct Backward<'a> {
    /// Whether the image gradient's fourth component is each pixel's residual instead of a gradient by alpha: the slots then
    /// also hold the contributions weighed by it, see [`super::Renderer::slots`]. Atomic sums take no residual.
    pub residual: bool,
    /// Adds each Gaussian's gradients up by float atomics, in whatever order the device's threads come, instead of in the
    /// order of its slots: what the ordered sums are measured against. The slots hold nothing afterwards.
    pub atomics: Option<&'a AtomicSums>,
    /// Whether the view direction's gradient reaches the mean.
    pub through_direction: bool,
    /// n x (sum of the 2D mean's gradient norms in NDC units, views that saw it): what density control decides by. Added
    /// to, where given.
    pub growth: Option<&'a Buffer<[f32; 2]>>,
}

impl Default for Backward<'_> {
    fn default() -> Self {
        Self { residual: false, atomics: None, through_direction: true, growth: None }
    }
}

/// What backward passes count.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct BackwardCounts {
    /// Rows void because a gradient is not finite, summed over passes.
    pub skipped_rows: u32,
    /// Passes that counted: those whose pairs fitted.
    pub passes: u32,
}

/// What the stages of one backward pass share.
pub(super) struct Pass<'a> {
    pub launch: &'a Launch,
    pub frame: &'a Frame,
    /// By the picture's pixels.
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

/// Where a Gaussian's sums over pixels lie: `counts` of `rows` from `first` on.
pub(super) struct Sums<'a> {
    pub counts: &'a Buffer<u32>,
    pub first: &'a Buffer<u32>,
    pub rows: &'a SlotSums,
}
