//! The axes of a sweep, as rows of one table. A new axis is a row, and a function that measures it.

use super::asked::Asked;
use super::heavy::{self, Training};
use super::records::{AxisRecord, Better};
use super::rung::{Formula, STOP, Solver, UNCHANGED, basis, culling, fraction, share, stop, sums, switch};
use super::subject::Context;
use super::{epsilon, gradients, overlap, pictures, solver};
use crate::job::Error;
use crate::job::config::Pruning;
use crate::lab::compare::{Arm, ArmRecord};
use crate::qirf::select::budget::Keep;
use Measure::{Forked, Light, Run};
use serde::Serialize;

/// A part of the engine that trades accuracy for time. Its record begins with the fields up to `abscissa`.
#[derive(Debug, Serialize)]
pub struct Axis {
    /// Its name, on the command line and in files.
    #[serde(rename = "axis")]
    pub name: &'static str,
    /// Title: the varied quantity.
    pub title: &'static str,
    /// The measure of accuracy, with its unit.
    pub accuracy: &'static str,
    /// Direction in which accuracy improves.
    pub better: Better,
    /// The reference of accuracy.
    pub against: &'static str,
    /// The unit of times.
    pub time: &'static str,
    /// The figure that the plot shows instead of time, if any.
    pub abscissa: Option<&'static str>,
    /// The engine's default rung.
    #[serde(skip)]
    pub default: &'static str,
    /// The rungs that are measured unless some are named, the most exact first; for effects they depend on the scene.
    #[serde(skip)]
    pub rungs: &'static [&'static str],
    /// Further such rungs, which depend on the build.
    #[serde(skip)]
    pub(super) more: fn() -> Vec<String>,
    /// Description of other names that are rungs, for an error message.
    #[serde(skip)]
    hint: Option<&'static str>,
    /// Fails if a name is not a rung, with a specific reason or none.
    #[serde(skip)]
    check: fn(&str) -> Result<(), Option<String>>,
    /// Explanation if its times hardly differ.
    #[serde(skip)]
    pub(super) flat_times: &'static str,
    /// Explanation if its rungs are equally accurate.
    #[serde(skip)]
    pub(super) flat_accuracy: &'static str,
    #[serde(skip)]
    pub(super) measure: Measure,
}

/// The way to measure an axis; functions fill in its record.
#[derive(Debug)]
pub(super) enum Measure {
    /// On one model.
    Light(fn(&Context<'_>, &Asked, AxisRecord) -> Result<AxisRecord, Error>),
    /// By arms of one comparison, which share a checkpoint: the arm of a rung, and an arm's time in the axis's unit.
    Forked { arm: fn(&str, Keep) -> String, time: fn(&ArmRecord) -> Option<f64> },
    /// By separate runs.
    Run(fn(&Training<'_>, &Asked, AxisRecord) -> Result<AxisRecord, Error>),
}

impl Axis {
    /// Returns true if its rungs are whole trainings.
    pub fn heavy(&self) -> bool {
        !matches!(self.measure, Light(_))
    }

    pub(super) fn check_rung(&self, name: &str) -> Result<(), String> {
        let there = || self.hint.map_or_else(|| format!("there are {}", self.rungs.join(", ")), ToOwned::to_owned);
        let refusal = || format!("axis {}: '{name}' is not a rung; {}", self.name, there());
        (self.check)(name).map_err(|why| why.unwrap_or_else(refusal))
    }
}

/// A name is a rung if it has a value.
fn known<T>(value: Option<T>) -> Result<(), Option<String>> {
    value.map(|_| ()).ok_or(None)
}

/// The fields that most rows share. Each row fills in the others.
const ROW: Axis = Axis {
    name: "",
    title: "",
    accuracy: "",
    better: Better::Lower,
    against: "",
    time: "",
    abscissa: None,
    default: "",
    rungs: &[],
    more: Vec::new,
    hint: None,
    check: |_| Ok(()),
    flat_times: "",
    flat_accuracy: "",
    measure: Light(|_, _, axis| Ok(axis)),
};

/// All axes: the light ones, in the order of a sweep without `--axis`, then the heavy ones.
pub static AXES: &[Axis] = &[
    Axis {
        name: "solver",
        title: "Eigensolver of the blocks",
        accuracy: "largest relative error of q",
        against: "low-rank in float64, block by block",
        time: "ms for all blocks measured",
        default: "low-rank",
        rungs: &["dsygvd", "low-rank", "low-rank-f32", "device"],
        more: Solver::elsewhere,
        check: |name| known(Solver::of(name)),
        flat_times: "all solvers are bound by the same factorisation.",
        flat_accuracy: "rounding decides nothing at this size.",
        measure: Light(|context, asked, axis| solver::measure(context, &asked.values(Solver::of), axis)),
        ..ROW
    },
    Axis {
        name: "overlap",
        title: "Overlap of two Gaussians",
        accuracy: "largest error of an overlap, a NaN counting as 1",
        against: "QR in float64, pair by pair",
        time: "ms per million pairs",
        default: "qr",
        rungs: &["qr-f64", "qr", "determinant"],
        check: |name| known(Formula::of(name)),
        flat_times: "the device spends its time on reading pairs.",
        flat_accuracy: "no pair is thin enough to tell the formulas apart.",
        measure: Light(|context, asked, axis| overlap::measure(context, &asked.values(Formula::of), axis)),
        ..ROW
    },
    Axis {
        name: "epsilon",
        title: "Regularisation of the metric",
        accuracy: "Jaccard distance of the kept set",
        against: "the set kept at epsilon 1e-6 without dilation",
        time: "ms to assemble and solve the scene",
        abscissa: Some("condition"),
        default: "1e-4",
        rungs: &["1e-6", "1e-5", "1e-4", "1e-3", "1e-2", "t=0.1", "t=0.3", "t=0.5"],
        hint: Some("write an epsilon such as 1e-4, or a dilation such as t=0.3"),
        check: |name| known(basis(name)),
        flat_times: "the arithmetic does not depend on epsilon.",
        flat_accuracy: "overlaps are too sparse for epsilon to change an order.",
        measure: Light(|context, asked, axis| epsilon::measure(context, &asked.values(basis), axis)),
        ..ROW
    },
    Axis {
        name: "culling",
        title: "Culling: the tiles that a Gaussian is added to",
        accuracy: "largest error of a pixel",
        against: "every Gaussian in every tile",
        time: "ms per frame",
        default: "exact",
        rungs: &["off", "exact", "3-sigma"],
        check: |name| known(culling(name)),
        flat_times: "Gaussians are so small that every way lists the same few tiles.",
        flat_accuracy: "no rung drops what could be seen in these views.",
        measure: Light(|context, asked, axis| pictures::culling(context, &asked.values(culling), axis)),
        ..ROW
    },
    Axis {
        name: "stop",
        title: "Transmittance at which blending stops",
        accuracy: "PSNR / dB",
        better: Better::Higher,
        against: "blending every Gaussian, however little light is left",
        time: "ms per frame",
        default: STOP,
        rungs: &["0", STOP, "1e-3", "1e-2"],
        hint: Some("write a transmittance of 0 or more, below 1, such as 1e-3"),
        check: |name| known(stop(name)),
        flat_times: "few pixels of these views are opaque before their last Gaussian, so stopping early saves little.",
        flat_accuracy: "no pixel of these views has so little light left.",
        measure: Light(|context, asked, axis| pictures::stop(context, &asked.values(stop), axis)),
        ..ROW
    },
    Axis {
        name: "gradients",
        title: "How a Gaussian's gradients are added up",
        accuracy: "largest difference between two runs, of the largest gradient",
        against: "the same gradients computed again",
        time: "ms per iteration",
        default: "ordered",
        rungs: &["ordered", "atomics"],
        check: |name| known(sums(name)),
        flat_times: "summation is a small part of an iteration, in any order.",
        flat_accuracy: "no gradient differed between the two runs.",
        measure: Light(|context, asked, axis| gradients::measure(context, &asked.values(sums), axis)),
        ..ROW
    },
    Axis {
        name: "keep",
        title: "Share of the Gaussians that is kept",
        accuracy: "PSNR / dB",
        better: Better::Higher,
        against: "held-out photos",
        time: "ms per frame",
        default: "0.28",
        rungs: &["1", "0.5", "0.28", "0.2", "0.1", "0.05"],
        hint: Some("write a share above 0 and up to 1, such as 0.28"),
        check: |name| known(share(name)),
        flat_times: "these rungs differ in the kept Gaussians, not in the amount of work.",
        flat_accuracy: "the held-out views cannot tell these rungs apart.",
        measure: Forked { arm: heavy::keeping, time: |arm| arm.fps.map(|f| 1.0 / f * 1e3) },
        ..ROW
    },
    Axis {
        name: "selector",
        title: "What a prune ranks by",
        accuracy: "PSNR / dB",
        better: Better::Higher,
        against: "held-out photos, at equal count",
        time: "s to select and prune",
        default: "default",
        rungs: &[
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
        check: |name| Arm::parse(name, &Pruning::default()).map(|_| ()).map_err(Some),
        flat_times: "these rungs differ in the kept Gaussians, not in the amount of work.",
        flat_accuracy: "the held-out views cannot tell these rungs apart.",
        measure: Forked {
            arm: |name, _| name.to_owned(),
            time: |arm| (!arm.prunes.is_empty()).then(|| heavy::pruning(arm)),
        },
        ..ROW
    },
    Axis {
        name: "iterations",
        title: "Length of the run",
        accuracy: "PSNR / dB",
        better: Better::Higher,
        against: "held-out photos",
        time: "s of training",
        default: "1",
        rungs: &["1", "1/2", "1/4", "1/8", "1/16"],
        hint: Some("write a share of the run, such as 1/4 or 0.5"),
        check: |name| known(fraction(name)),
        flat_times: "every rung trained for as long.",
        flat_accuracy: "the held-out views cannot tell these lengths apart.",
        measure: Run(|training, asked, axis| heavy::iterations(training, &asked.values(fraction), axis)),
        ..ROW
    },
    Axis {
        name: "effects",
        title: "What is simulated",
        accuracy: "PSNR / dB",
        better: Better::Higher,
        against: "held-out photos",
        time: "ms per iteration",
        default: UNCHANGED,
        check: |name| switch(name).map(|_| ()).map_err(Some),
        flat_times: "none of these effects is a large part of an iteration on this scene.",
        flat_accuracy: "the scene calls for none of these effects.",
        measure: Run(|training, asked, axis| heavy::effects(training, &asked.values(|name| switch(name).ok()), axis)),
        ..ROW
    },
];
