//! The axes of a sweep.

use crate::wording::named;
use serde::Serialize;

named! {
    /// A part of the engine that trades accuracy for time.
    #[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
    #[serde(rename_all = "kebab-case")]
    pub enum Axis {
        /// Method that solves the eigenproblem.
        Solver = "solver",
        /// Formula of the overlaps.
        Overlap = "overlap",
        /// Regularisation: the term added to the metric, or the dilation of Gaussians.
        Epsilon = "epsilon",
        /// Rule that lists a Gaussian in tiles.
        Culling = "culling",
        /// The transmittance at which blending ends.
        Stop = "stop",
        /// Summation of a Gaussian's gradients.
        Gradients = "gradients",
        /// Share of the Gaussians that a prune keeps.
        Keep = "keep",
        /// Selector of a prune, and the division of its count.
        Selector = "selector",
        /// Length of the run.
        Iterations = "iterations",
        /// Simulated effects.
        Effects = "effects",
    }
}

impl Axis {
    /// Returns true if its rungs are whole trainings.
    pub fn heavy(self) -> bool {
        matches!(self, Self::Keep | Self::Selector | Self::Iterations | Self::Effects)
    }

    /// The engine's default rung.
    pub fn default_rung(self) -> &'static str {
        match self {
            Self::Solver => "low-rank",
            Self::Overlap => "qr",
            Self::Epsilon | Self::Stop => "1e-4",
            Self::Culling => "exact",
            Self::Gradients => "ordered",
            Self::Keep => "0.28",
            Self::Iterations => "1",
            Self::Selector | Self::Effects => "default",
        }
    }
}
