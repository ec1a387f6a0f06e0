//! The parser of `--axis`.

use super::axis::Axis;
use super::rung::{Formula, Regularisation, Rung, Solver, Sums, culling, fraction, share, stop, sums, switch};
use crate::effects::{Choice, Effect};
use crate::lab::compare::Arm;
use crate::pipeline::config::Pruning;
use crate::render::Culling;
use crate::wording::unknown;

/// An axis with the rungs to measure.
#[derive(Clone, Debug, PartialEq)]
pub enum Asked {
    /// [`Axis::Solver`].
    Solver(Vec<Rung<Solver>>),
    /// [`Axis::Overlap`].
    Overlap(Vec<Rung<Formula>>),
    /// [`Axis::Epsilon`].
    Epsilon(Vec<Rung<Regularisation>>),
    /// [`Axis::Culling`].
    Culling(Vec<Rung<Culling>>),
    /// [`Axis::Stop`].
    Stop(Vec<Rung<f32>>),
    /// [`Axis::Gradients`].
    Gradients(Vec<Rung<Sums>>),
    /// [`Axis::Keep`]: shares.
    Keep(Vec<Rung<f64>>),
    /// [`Axis::Selector`]: names of arms, parsed when the run's own compression is known.
    Selector(Vec<Rung<()>>),
    /// [`Axis::Iterations`]: shares of the run.
    Iterations(Vec<Rung<f64>>),
    /// [`Axis::Effects`]; if empty, the scene determines which effects are switched.
    Effects(Vec<Rung<Option<(Effect, Choice)>>>),
}

impl Asked {
    /// The axis.
    pub const fn axis(&self) -> Axis {
        match self {
            Self::Solver(_) => Axis::Solver,
            Self::Overlap(_) => Axis::Overlap,
            Self::Epsilon(_) => Axis::Epsilon,
            Self::Culling(_) => Axis::Culling,
            Self::Stop(_) => Axis::Stop,
            Self::Gradients(_) => Axis::Gradients,
            Self::Keep(_) => Axis::Keep,
            Self::Selector(_) => Axis::Selector,
            Self::Iterations(_) => Axis::Iterations,
            Self::Effects(_) => Axis::Effects,
        }
    }

    /// The given rungs of an axis.
    fn new(axis: Axis, names: Vec<String>) -> Result<Self, String> {
        fn rungs<T>(names: Vec<String>, read: impl Fn(&str) -> Result<T, String>) -> Result<Vec<Rung<T>>, String> {
            names.into_iter().map(|name| Ok(Rung { value: read(&name)?, name })).collect()
        }
        fn known<T>(axis: Axis, names: Vec<String>, read: fn(&str) -> Option<T>) -> Result<Vec<Rung<T>>, String> {
            let wrong = |name: &str| format!("axis {}: '{name}' is no rung; {}", axis.name(), axis.hint());
            rungs(names, |name| read(name).ok_or_else(|| wrong(name)))
        }
        Ok(match axis {
            Axis::Solver => Self::Solver(known(axis, names, Solver::of)?),
            Axis::Overlap => Self::Overlap(known(axis, names, Formula::of)?),
            Axis::Epsilon => Self::Epsilon(known(axis, names, Regularisation::of)?),
            Axis::Culling => Self::Culling(known(axis, names, culling)?),
            Axis::Stop => Self::Stop(known(axis, names, stop)?),
            Axis::Gradients => Self::Gradients(known(axis, names, sums)?),
            Axis::Keep => Self::Keep(known(axis, names, share)?),
            Axis::Selector => Self::Selector(rungs(names, |name| Arm::parse(name, &Pruning::default()).map(|_| ()))?),
            Axis::Iterations => Self::Iterations(known(axis, names, fraction)?),
            Axis::Effects => Self::Effects(rungs(names, switch)?),
        })
    }

    /// All rungs of the axes without training: the default of a sweep.
    pub fn light() -> Vec<Self> {
        Axis::ALL.into_iter().filter(|a| !a.heavy()).filter_map(|axis| Self::new(axis, axis.rungs()).ok()).collect()
    }

    /// Reads `NAME` or `NAME=RUNG,...`.
    ///
    /// # Errors
    /// A sentence that names the fault.
    pub fn parse(text: &str) -> Result<Self, String> {
        let (name, rungs) = text.split_once('=').map_or((text, None), |(n, r)| (n, Some(r)));
        let name = name.trim();
        let axis = Axis::ALL.into_iter().find(|a| a.name() == name);
        let axis = axis.ok_or_else(|| unknown(name, "an axis", Axis::ALL.map(Axis::name)))?;
        let Some(rungs) = rungs else { return Self::new(axis, axis.rungs()) };
        let rungs: Vec<String> = rungs.split(',').map(|rung| rung.trim().to_owned()).collect();
        if let Some(twice) = (1..rungs.len()).find(|i| rungs[..*i].contains(&rungs[*i])) {
            return Err(format!("axis {}: {} is there twice", axis.name(), rungs[twice]));
        }
        Self::new(axis, rungs)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn axes_by_name() {
        for axis in Axis::ALL {
            assert_eq!(Asked::parse(axis.name()).unwrap().axis(), axis);
            assert!(axis == Axis::Effects || axis.rungs().iter().any(|rung| rung == axis.default_rung()), "{axis:?}");
        }
        assert_eq!(Asked::light().len(), 6);
        let rung = |name: &str, value| Rung { name: name.to_owned(), value };
        let both = [rung("1e-3", Regularisation::Epsilon(1e-3)), rung("t=0.3", Regularisation::Dilation(0.3))];
        assert_eq!(Asked::parse("epsilon=1e-3,t=0.3"), Ok(Asked::Epsilon(both.to_vec())));
        let exposure = Rung { name: "exposure=on".to_owned(), value: Some((Effect::Exposure, Choice::On)) };
        let default = Rung { name: "default".to_owned(), value: None };
        assert_eq!(Asked::parse("effects=exposure=on,default"), Ok(Asked::Effects(vec![exposure, default])));
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
