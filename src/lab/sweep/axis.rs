//! The axes of a sweep: one table, and the parser of `--axis`.

use super::rung::{Formula, Regularisation, Rung, Solver, culling, fraction, rungs, share, stop, sums, switch};
use super::{AxisRecord, Context, epsilon, gradients, overlap, pictures, solver};
use crate::job::Error;
use crate::job::config::Pruning;
use crate::lab::compare::Arm;
use crate::qirf::dense::LIBRARIES;
use crate::qirf::participation::Eigensolver;
use crate::wording::{named, unknown};
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

/// Measures the named rungs of an axis on one model.
type Measure = fn(&Context<'_>, &[String]) -> Result<AxisRecord, Error>;

/// An axis's row of the table; without more, its rungs are a list, and each is a whole training.
struct Row {
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

const ROW: Row = Row { rungs: &[], default: "default", hint: None, check: |_| Ok(()), measure: None };

/// The table, in the order of the variants.
const TABLE: [Row; Axis::ALL.len()] = [
    Row {
        rungs: &["dsygvd", "low-rank", "low-rank-f32", "device"],
        default: "low-rank",
        check: |name| known(Solver::of(name)),
        measure: Some(|context, names| solver::measure(context, &rungs(names, Solver::of))),
        ..ROW
    },
    Row {
        rungs: &["qr-f64", "qr", "determinant"],
        default: "qr",
        check: |name| known(Formula::of(name)),
        measure: Some(|context, names| overlap::measure(context, &rungs(names, Formula::of))),
        ..ROW
    },
    Row {
        rungs: &["1e-6", "1e-5", "1e-4", "1e-3", "1e-2", "t=0.1", "t=0.3", "t=0.5"],
        default: "1e-4",
        hint: Some("write an epsilon such as 1e-4, or a dilation such as t=0.3"),
        check: |name| known(Regularisation::of(name)),
        measure: Some(|context, names| epsilon::measure(context, &rungs(names, Regularisation::of))),
    },
    Row {
        rungs: &["off", "exact", "3-sigma"],
        default: "exact",
        check: |name| known(culling(name)),
        measure: Some(|context, names| pictures::culling(context, &rungs(names, culling))),
        ..ROW
    },
    Row {
        rungs: &["0", "1e-4", "1e-3", "1e-2"],
        default: "1e-4",
        hint: Some("write a transmittance of 0 or more, below 1, such as 1e-3"),
        check: |name| known(stop(name)),
        measure: Some(|context, names| pictures::stop(context, &rungs(names, stop))),
    },
    Row {
        rungs: &["ordered", "atomics"],
        default: "ordered",
        check: |name| known(sums(name)),
        measure: Some(|context, names| gradients::measure(context, &rungs(names, sums))),
        ..ROW
    },
    Row {
        rungs: &["1", "0.5", "0.28", "0.2", "0.1", "0.05"],
        default: "0.28",
        hint: Some("write a share above 0 and up to 1, such as 0.28"),
        check: |name| known(share(name)),
        ..ROW
    },
    Row {
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
        check: |name| Arm::parse(name, &Pruning::default()).map(|_| ()).map_err(Some),
        ..ROW
    },
    Row {
        rungs: &["1", "1/2", "1/4", "1/8", "1/16"],
        default: "1",
        hint: Some("write a share of the run, such as 1/4 or 0.5"),
        check: |name| known(fraction(name)),
        ..ROW
    },
    Row { rungs: &[], default: "default", check: |name| switch(name).map(|_| ()).map_err(Some), ..ROW },
];

impl Axis {
    fn row(self) -> &'static Row {
        &TABLE[self as usize]
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
        let Row { rungs, hint, check, .. } = self.row();
        let there = || hint.map_or_else(|| format!("there are {}", rungs.join(", ")), ToOwned::to_owned);
        check(name).map_err(|why| why.unwrap_or_else(|| format!("axis {self}: '{name}' is no rung; {}", there())))
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
    fn all(axis: Axis) -> Self {
        let mut rungs: Vec<String> = axis.row().rungs.iter().map(|name| (*name).to_owned()).collect();
        if axis == Axis::Solver {
            let others = LIBRARIES.iter().skip(1).map(|library| library.name());
            rungs.extend(others.flat_map(|name| Eigensolver::HOST.map(|solver| format!("{solver}@{name}"))));
        }
        Self { axis, rungs }
    }

    /// All rungs of the axes without training: the default of a sweep.
    pub fn light() -> Vec<Self> {
        Axis::ALL.into_iter().filter(|axis| !axis.heavy()).map(Self::all).collect()
    }

    /// Reads `NAME` or `NAME=RUNG,...`.
    pub fn parse(text: &str) -> Result<Self, String> {
        let (name, rungs) = text.split_once('=').map_or((text, None), |(n, r)| (n, Some(r)));
        let axis = Axis::ALL.into_iter().find(|axis| axis.name() == name.trim());
        let axis = axis.ok_or_else(|| unknown(name.trim(), "an axis", Axis::ALL.map(Axis::name)))?;
        let Some(rungs) = rungs else { return Ok(Self::all(axis)) };
        let rungs: Vec<String> = rungs.split(',').map(|name| name.trim().to_owned()).collect();
        if let Some(twice) = (1..rungs.len()).find(|i| rungs[..*i].contains(&rungs[*i])) {
            return Err(format!("axis {axis}: {} is there twice", rungs[twice]));
        }
        rungs.iter().try_for_each(|name| axis.check(name))?;
        Ok(Self { axis, rungs })
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
        for axis in Axis::ALL {
            let (row, asked) = (axis.row(), Asked::parse(axis.name()).unwrap());
            assert!(asked.axis == axis && asked.rungs.iter().zip(row.rungs).all(|(got, row)| got == row));
            asked.rungs.iter().try_for_each(|name| axis.check(name)).unwrap();
            assert!(axis == Axis::Effects || row.rungs.contains(&row.default), "{axis}");
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
