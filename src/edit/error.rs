//! Errors of edits.

use crate::gaussians::formats::RenderMode;
use std::path::PathBuf;

/// Errors of an edit.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[expect(missing_docs, reason = "fields are parts of the message")]
pub enum Error {
    /// A matrix that is no similarity: Gaussians would stay Gaussians, but their colours are functions of directions, which it bends.
    #[error("the matrix scales its axes by {}, {} and {}, or shears: use only rotations, reflections, translations and a uniform scale", six_digits(.0[0]), six_digits(.0[1]), six_digits(.0[2]))]
    NotSimilar([f64; 3]),
    /// A matrix or vector without the numbers that it needs.
    #[error("{0}")]
    Numbers(String),
    /// Positions or sizes beyond float32.
    #[error("{count} of {of} Gaussians leave the range of float32; move or scale by less")]
    Overflow { count: usize, of: usize },
    /// Models to be merged that are to be drawn differently.
    #[error("{} is {} and {} is {}: one model cannot be drawn in both ways", .0.0.display(), .0.1, .1.0.display(), .1.1)]
    Modes(Box<(PathBuf, RenderMode)>, Box<(PathBuf, RenderMode)>),
}

/// A number with six significant digits or more.
fn six_digits(x: f64) -> String {
    if x == 0.0 || (0.1..1e6).contains(&x.abs()) { format!("{x:.6}") } else { format!("{x:.5e}") }
}
