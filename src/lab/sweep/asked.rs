//! The request for an axis: the table of all rungs, and the parser of `--axis`.

use super::axis::Axis;
use super::rung::{Formula, Regularisation, Rung, Solver, culling, fraction, rungs, share, stop, sums, switch};
use crate::job::config::Pruning;
use crate::lab::compare::Arm;
use crate::qirf::dense::LIBRARIES;
use crate::qirf::participation::Eigensolver;
use crate::wording::unknown;

/// An axis's row of the table.
struct Row {
    /// The default rungs, the most exact first; for effects they depend on the scene.
    rungs: &'static [&'static str],
    /// Description of other names that are rungs, for an error message.
    hint: Option<&'static str>,
    /// Fails if a name is not a rung, with a specific reason or none.
    check: fn(&str) -> Result<(), Option<String>>,
}

/// A name is a rung if it has a value.
fn known<T>(value: Option<T>) -> Result<(), Option<String>> {
    value.map(|_| ()).ok_or(None)
}

const ROW: Row = Row { rungs: &[], hint: None, check: |_| Ok(()) };

/// The table, in the order of the variants.
const TABLE: [Row; Axis::ALL.len()] = [
    Row { rungs: &["dsygvd", "low-rank", "low-rank-f32", "device"], check: |name| known(Solver::of(name)), ..ROW },
    Row { rungs: &["qr-f64", "qr", "determinant"], check: |name| known(Formula::of(name)), ..ROW },
    Row {
        rungs: &["1e-6", "1e-5", "1e-4", "1e-3", "1e-2", "t=0.1", "t=0.3", "t=0.5"],
        hint: Some("write an epsilon such as 1e-4, or a dilation such as t=0.3"),
        check: |name| known(Regularisation::of(name)),
    },
    Row { rungs: &["off", "exact", "3-sigma"], check: |name| known(culling(name)), ..ROW },
    Row {
        rungs: &["0", "1e-4", "1e-3", "1e-2"],
        hint: Some("write a transmittance of 0 or more, below 1, such as 1e-3"),
        check: |name| known(stop(name)),
    },
    Row { rungs: &["ordered", "atomics"], check: |name| known(sums(name)), ..ROW },
    Row {
        rungs: &["1", "0.5", "0.28", "0.2", "0.1", "0.05"],
        hint: Some("write a share above 0 and up to 1, such as 0.28"),
        check: |name| known(share(name)),
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
        check: |name| Arm::parse(name, &Pruning::default()).map(|_| ()).map_err(Some),
        ..ROW
    },
    Row {
        rungs: &["1", "1/2", "1/4", "1/8", "1/16"],
        hint: Some("write a share of the run, such as 1/4 or 0.5"),
        check: |name| known(fraction(name)),
    },
    Row { check: |name| switch(name).map(|_| ()).map_err(Some), ..ROW },
];

impl Axis {
    fn row(self) -> &'static Row {
        &TABLE[self as usize]
    }

    /// Checks that a name is one of its rungs.
    fn check(self, name: &str) -> Result<(), String> {
        let Row { rungs, hint, check } = self.row();
        let there = || hint.map_or_else(|| format!("there are {}", rungs.join(", ")), ToOwned::to_owned);
        check(name).map_err(|why| why.unwrap_or_else(|| format!("axis {self}: '{name}' is not a rung; {}", there())))
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
            assert!(axis == Axis::Effects || row.rungs.contains(&axis.default_rung()), "{axis}");
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
