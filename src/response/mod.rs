//! Responses of pictures and losses to each Gaussian in eight channels, and the scores that other pruning
//! methods rank by (docs/method.md).
//!
//! | channel | |
//! |---|---|
//! | 0 | 1 if any pixel blends it |
//! | 1 | mean of T alpha over all pixels |
//! | 2 | mean of T alpha times the residual over all pixels |
//! | 3 | mean of alpha over all pixels |
//! | 4 | norm of dL/dmean in units of its own axes |
//! | 5 | norm of dL/dlog-scale |
//! | 6 | abs dL/dlogit |
//! | 7 | norm of dL/dSH over all bands |

mod full_pass;
mod high_pass;
mod residual;
mod respond;
mod score;
mod sums;

pub use full_pass::{CHUNK, Term, Views, Wanted, full_pass, renderer};
pub use high_pass::HighPass;
pub use residual::{Target, record_residual};
pub use respond::{Gather, KEEP, ResidentResponses};
pub use score::{ResidentScores, Score};

use crate::scene::camera::Camera;

/// Response channels of a Gaussian: four of rendering, then four of optimisation.
pub const CHANNELS: usize = crate::kernels::constants::responses::CHANNELS as usize;

/// Names of the channels.
pub const CHANNEL_NAMES: [&str; CHANNELS] = [
    "visibility",
    "contribution",
    "contribution times residual",
    "opacity",
    "gradient by mean",
    "gradient by scale",
    "gradient by opacity",
    "gradient by colour",
];

/// Responses of the pictures to each Gaussian, on the host.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Responses {
    /// The eight channels, n; empty if not requested.
    pub channels: Vec<[f32; CHANNELS]>,
    /// Scores, n; empty if not requested.
    pub scores: Vec<Score>,
    /// Cameras of the views of the scores.
    pub cameras: Vec<Camera>,
    /// Variance in square pixels that rendering adds to every Gaussian.
    pub dilation: f32,
}
