//! The axes of a sweep: one table, and the parser of `--axis`.

use super::rung::{Formula, Regularisation, Rung, Solver, culling, fraction, rungs, share, stop, sums, switch};
use super::{AxisRecord, Context, epsilon, gradients, overlap, pictures, solver};
use crate::lab::compare::Arm;
use crate::pipeline::Error;
use crate::pipeline::config::Pruning;
use crate::qirf::dense::LIBRARIES;
use crate::qirf::participation::Eigensolver;
use crate::wording::unknown;
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

/// Measures the named rungs of an axis on one model.
type Measure = fn(&Context<'_>, &[String]) -> Result<AxisRecord, Error>;

/// An axis's row of the table.
struct Row {
    axis: Axis,
    name: &'static str,
    /// The default rungs, the most exact first; for effects they depend on the scene.
    rungs: &'static [&'static str],
    /// The engine's own rung.
    default: &'static str,
    /// Description of other names that are rungs, for an error message.
    hint: Option<&'static str>,
    /// Fails if a name is not a rung, with a specific reason or none.
    check: fn(&str) -> Result<(), Option<String>>,
    /// The measurement; `None` if rungs are whole trainings.
    measure: Option<Measure>,
}

/// A name is a rung if it has a value.
fn known<T>(value: Option<T>) -> Result<(), Option<String>> {
    value.map(|_| ()).ok_or(None)
}

/// The table, in the order of the variants.
const TABLE: [Row; 10] = [
    Row {
        axis: Axis::Solver,
        name: "solver",
        rungs: &["dsygvd", "low-rank", "low-rank-f32", "device"],
        default: "low-rank",
        hint: None,
        check: |name| known(Solver::of(name)),
        measure: Some(|context, names| solver::measure(context, &rungs(names, Solver::of))),
    },
    Row {
        axis: Axis::Overlap,
        name: "overlap",
        rungs: &["qr-f64", "qr", "determinant"],
        default: "qr",
        hint: None,
        check: |name| known(Formula::of(name)),
        measure: Some(|context, names| overlap::measure(context, &rungs(names, Formula::of))),
    },
    Row {
        axis: Axis::Epsilon,
        name: "epsilon",
        rungs: &["1e-6", "1e-5", "1e-4", "1e-3", "1e-2", "t=0.1", "t=0.3", "t=0.5"],
        default: "1e-4",
        hint: Some("write an epsilon such as 1e-4, or a dilation such as t=0.3"),
        check: |name| known(Regularisation::of(name)),
        measure: Some(|context, names| epsilon::measure(context, &rungs(names, Regularisation::of))),
    },
    Row {
        axis: Axis::Culling,
        name: "culling",
        rungs: &["off", "exact", "3-sigma"],
        default: "exact",
        hint: None,
        check: |name| known(culling(name)),
        measure: Some(|context, names| pictures::culling(context, &rungs(names, culling))),
    },
    Row {
        axis: Axis::Stop,
        name: "stop",
        rungs: &["0", "1e-4", "1e-3", "1e-2"],
        default: "1e-4",
        hint: Some("write a transmittance of 0 or more, below 1, such as 1e-3"),
        check: |name| known(stop(name)),
        measure: Some(|context, names| pictures::stop(context, &rungs(names, stop))),
    },
    Row {
        axis: Axis::Gradients,
        name: "gradients",
        rungs: &["ordered", "atomics"],
        default: "ordered",
        hint: None,
        check: |name| known(sums(name)),
        measure: Some(|context, names| gradients::measure(context, &rungs(names, sums))),
    },
    Row {
        axis: Axis::Keep,
        name: "keep",
        rungs: &["1", "0.5", "0.28", "0.2", "0.1", "0.05"],
        default: "0.28",
        hint: Some("write a share above 0 and up to 1, such as 0.28"),
        check: |name| known(share(name)),
        measure: None,
    },
    Row {
        axis: Axis::Selector,
        name: "selector",
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
        default: "default",
        hint: None,
        check: |name| Arm::parse(name, &Pruning::default()).map(|_| ()).map_err(Some),
        measure: None,
    },
    Row {
        axis: Axis::Iterations,
        name: "iterations",
        rungs: &["1", "1/2", "1/4", "1/8", "1/16"],
        default: "1",
        hint: Some("write a share of the run, such as 1/4 or 0.5"),
        check: |name| known(fraction(name)),
        measure: None,
    },
    Row {
        axis: Axis::Effects,
        name: "effects",
        rungs: &[],
        default: "default",
        hint: None,
        check: |name| switch(name).map(|_| ()).map_err(Some),
        measure: None,
    },
];

impl Axis {
    fn row(self) -> &'static Row {
        &TABLE[self as usize]
    }

    /// The axis's name on the command line and in files.
    pub fn name(self) -> &'static str {
        self.row().name
    }

    /// Returns true if its rungs are whole trainings.
    pub fn heavy(self) -> bool {
        self.row().measure.is_none()
    }

    /// The engine's default rung.
    pub fn default_rung(self) -> &'static str {
        self.row().default
    }

    /// The measurement of its rungs on one model; `None` if they are whole trainings.
    pub(super) fn measure(self) -> Option<Measure> {
        self.row().measure
    }

    /// Checks that a name is one of its rungs.
    fn check(self, name: &str) -> Result<(), String> {
        let Row { name: axis, rungs, hint, check, .. } = self.row();
        let there = || hint.map_or_else(|| format!("there are {}", rungs.join(", ")), ToOwned::to_owned);
        check(name).map_err(|why| why.unwrap_or_else(|| format!("axis {axis}: '{name}' is no rung; {}", there())))
    }
}

/// An axis with the names of the rungs to measure.
#[derive(Clone, Debug, PartialEq)]
pub struct Asked {
    /// The axis.
    pub axis: Axis,
    /// Rungs, each once. For effects, an empty list means that the scene determines which are switched.
    pub rungs: Vec<String>,
}

impl Asked {
    /// All default rungs of an axis, followed by solvers of libraries other than the serving one as `SOLVER@LIBRARY`.
    fn all(row: &Row) -> Self {
        let mut rungs: Vec<String> = row.rungs.iter().map(|name| (*name).to_owned()).collect();
        if row.axis == Axis::Solver {
            let others = LIBRARIES.iter().skip(1).map(|library| library.name());
            rungs.extend(others.flat_map(|name| Eigensolver::HOST.map(|solver| format!("{solver}@{name}"))));
        }
        Self { axis: row.axis, rungs }
    }

    /// All rungs of the axes without training: the default of a sweep.
    pub fn light() -> Vec<Self> {
        TABLE.iter().filter(|row| row.measure.is_some()).map(Self::all).collect()
    }

    /// Reads `NAME` or `NAME=RUNG,...`.
    ///
    /// # Errors
    /// A sentence that names the fault.
    pub fn parse(text: &str) -> Result<Self, String> {
        let (name, rungs) = text.split_once('=').map_or((text, None), |(n, r)| (n, Some(r)));
        let row = TABLE.iter().find(|row| row.name == name.trim());
        let row = row.ok_or_else(|| unknown(name.trim(), "an axis", TABLE.each_ref().map(|row| row.name)))?;
        let Some(rungs) = rungs else { return Ok(Self::all(row)) };
        let rungs: Vec<String> = rungs.split(',').map(|name| name.trim().to_owned()).collect();
        if let Some(twice) = (1..rungs.len()).find(|i| rungs[..*i].contains(&rungs[*i])) {
            return Err(format!("axis {}: {} is there twice", row.name, rungs[twice]));
        }
        rungs.iter().try_for_each(|name| row.axis.check(name))?;
        Ok(Self { axis: row.axis, rungs })
    }

    /// The rungs with their values.
    pub(super) fn values<T>(&self, read: impl Fn(&str) -> Option<T>) -> Vec<Rung<T>> {
        rungs(&self.rungs, read)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn axes_by_name() {
        for (at, row) in TABLE.iter().enumerate() {
            assert_eq!(row.axis as usize, at);
            let asked = Asked::parse(row.name).unwrap();
            assert!(asked.axis == row.axis && asked.rungs.iter().zip(row.rungs).all(|(got, row)| got == row));
            asked.rungs.iter().try_for_each(|name| row.axis.check(name)).unwrap();
            assert!(row.axis == Axis::Effects || row.rungs.contains(&row.default), "{}", row.name);
        }
        assert_eq!(Asked::light().len(), 6);
        let both = Asked::parse("epsilon=1e-3,t=0.3").unwrap().values(Regularisation::of);
        assert_eq!([both[0].value, both[1].value], [Regularisation::Epsilon(1e-3), Regularisation::Dilation(0.3)]);
        assert_eq!(Asked::parse("effects=exposure=on,default").unwrap().rungs, ["exposure=on", "default"]);
        for wrong in [
            "",
            "speed",
            "solver=",
            "solver=qr",
            "epsilon=-1",
            "epsilon=t=",
            "stop=1",
            "keep=0",
            "keep=2",
            "iterations=1/0",
            "iterations=3/2",
            "selector=none",
            "effects=rain=on",
            "effects=cameras=on",
            "overlap=qr,qr",
        ] {
            assert!(Asked::parse(wrong).is_err(), "{wrong}");
        }
    }
}
