//! The axes by name, and the names of their rungs.

use crate::qirf::dense::LIBRARIES;
use crate::qirf::participation::Eigensolver;
use serde::Serialize;

/// A part of the engine that trades accuracy for time.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Axis {
    /// Method that solves the eigenproblem.
    Solver,
    /// Formula of the overlaps.
    Overlap,
    /// Regularisation: the term added to the metric, or the dilation of Gaussians.
    Epsilon,
    /// Rule that lists a Gaussian in tiles.
    Culling,
    /// The transmittance at which blending ends.
    Stop,
    /// Summation of a Gaussian's gradients.
    Gradients,
    /// Share of the Gaussians that a prune keeps.
    Keep,
    /// Selector of a prune, and the division of its count.
    Selector,
    /// Length of the run.
    Iterations,
    /// Simulated effects.
    Effects,
}

impl Axis {
    /// All axes, in the order of the design's table.
    pub const ALL: [Self; 10] = [
        Self::Solver,
        Self::Overlap,
        Self::Epsilon,
        Self::Culling,
        Self::Stop,
        Self::Gradients,
        Self::Keep,
        Self::Selector,
        Self::Iterations,
        Self::Effects,
    ];

    /// The axis's name on the command line and in files.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Solver => "solver",
            Self::Overlap => "overlap",
            Self::Epsilon => "epsilon",
            Self::Culling => "culling",
            Self::Stop => "stop",
            Self::Gradients => "gradients",
            Self::Keep => "keep",
            Self::Selector => "selector",
            Self::Iterations => "iterations",
            Self::Effects => "effects",
        }
    }

    /// Returns true if its rungs are whole trainings.
    pub const fn heavy(self) -> bool {
        matches!(self, Self::Keep | Self::Selector | Self::Iterations | Self::Effects)
    }

    /// Its default rungs, the most exact first; those of the effects depend on the scene and are found there. Solvers of
    /// other libraries than the serving one follow as `SOLVER@LIBRARY`.
    pub fn rungs(self) -> Vec<String> {
        let own: &[&str] = match self {
            Self::Solver => &["dsygvd", "low-rank", "low-rank-f32", "device"],
            Self::Overlap => &["qr-f64", "qr", "cholesky", "determinant"],
            Self::Epsilon => &["1e-6", "1e-5", "1e-4", "1e-3", "1e-2", "t=0.1", "t=0.3", "t=0.5"],
            Self::Culling => &["off", "exact", "3-sigma"],
            Self::Stop => &["0", "1e-4", "1e-3", "1e-2"],
            Self::Gradients => &["ordered", "atomics"],
            Self::Keep => &["1", "0.5", "0.28", "0.2", "0.1", "0.05"],
            Self::Selector => &[
                "default",
                "importance+attrition+rewarm",
                "css:hybrid+merge",
                "css:global+merge",
                "css",
                "gnso",
                "ordinary",
                "lowdin",
                "importance",
                "removal",
                "radsplat",
                "lightgaussian",
                "contribution",
                "opacity",
                "random",
            ],
            Self::Iterations => &["1", "1/2", "1/4", "1/8", "1/16"],
            Self::Effects => &[],
        };
        let mut rungs: Vec<String> = own.iter().map(|&rung| rung.to_owned()).collect();
        if self == Self::Solver {
            let others = LIBRARIES.iter().skip(1).map(|library| library.name());
            rungs.extend(others.flat_map(|name| Eigensolver::HOST.map(|solver| format!("{solver}@{name}"))));
        }
        rungs
    }

    /// The engine's default rung.
    pub const fn default_rung(self) -> &'static str {
        match self {
            Self::Solver => "low-rank",
            Self::Overlap => "qr",
            Self::Epsilon | Self::Stop => "1e-4",
            Self::Culling => "exact",
            Self::Gradients => "ordered",
            Self::Keep => "0.28",
            Self::Selector | Self::Effects => "default",
            Self::Iterations => "1",
        }
    }

    /// A hint on valid rungs, for an error message.
    pub(super) fn hint(self) -> String {
        match self {
            Self::Epsilon => "write an epsilon such as 1e-4, or a dilation such as t=0.3".to_owned(),
            Self::Stop => "write a transmittance of 0 or more, below 1, such as 1e-3".to_owned(),
            Self::Keep => "write a share above 0 and up to 1, such as 0.28".to_owned(),
            Self::Iterations => "write a share of the run, such as 1/4 or 0.5".to_owned(),
            _ => format!("there are {}", self.rungs().join(", ")),
        }
    }
}
