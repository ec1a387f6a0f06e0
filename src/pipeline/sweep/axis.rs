//! The axes by name, their rungs, and the parser of `--axis`.

use crate::effects::{Choice, Effect, Overrides, Trigger};
use crate::pipeline::arm::Arm;
use crate::pipeline::config::Pruning;
use crate::qirf::overlap::Method;
use crate::qirf::participation::Eigensolver;
use crate::render::{Culling, Settings};
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
    /// Precision of stored SH coefficients.
    Storage,
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
    pub const ALL: [Self; 11] = [
        Self::Solver,
        Self::Overlap,
        Self::Epsilon,
        Self::Culling,
        Self::Stop,
        Self::Storage,
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
            Self::Storage => "storage",
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

    /// Its default rungs, the most exact first; those of the effects depend on the scene and are found there.
    pub const fn rungs(self) -> &'static [&'static str] {
        match self {
            Self::Solver => &["dsygvd", "low-rank", "low-rank-f32", "device-low-rank-f32"],
            Self::Overlap => &["qr-f64", "qr", "cholesky", "determinant"],
            Self::Epsilon => &["1e-6", "1e-5", "1e-4", "1e-3", "1e-2", "t=0.1", "t=0.3", "t=0.5"],
            Self::Culling => &["off", "exact", "box", "3-sigma"],
            Self::Stop => &["0", "1e-4", "1e-3", "1e-2"],
            Self::Storage => &["f32", "f16"],
            Self::Gradients => &["ordered", "atomics", "compare-and-swap"],
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
                "elimination",
                "css-measured",
                "gnso-measured",
                "radsplat",
                "lightgaussian",
                "contribution",
                "opacity",
                "random",
            ],
            Self::Iterations => &["1", "1/2", "1/4", "1/8", "1/16"],
            Self::Effects => &[],
        }
    }

    /// The engine's default rung.
    pub const fn default_rung(self) -> &'static str {
        match self {
            Self::Solver => "low-rank",
            Self::Overlap => "qr",
            Self::Epsilon | Self::Stop => "1e-4",
            Self::Culling => "exact",
            Self::Storage => "f32",
            Self::Gradients => "ordered",
            Self::Keep => "0.28",
            Self::Selector | Self::Effects => "default",
            Self::Iterations => "1",
        }
    }

    /// A hint on valid rungs, for an error message.
    fn hint(self) -> String {
        match self {
            Self::Epsilon => "write an epsilon such as 1e-4, or a dilation such as t=0.3".to_owned(),
            Self::Stop => "write a transmittance of 0 or more, below 1, such as 1e-3".to_owned(),
            Self::Keep => "write a share above 0 and up to 1, such as 0.28".to_owned(),
            Self::Iterations => "write a share of the run, such as 1/4 or 0.5".to_owned(),
            _ => format!("there are {}", self.rungs().join(", ")),
        }
    }
}

/// A rung of the solver axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Solver {
    /// One of the host's solvers.
    Host(Eigensolver),
    /// The device's solver.
    Device,
}

impl Solver {
    fn of(name: &str) -> Option<Self> {
        let host = Eigensolver::ALL.into_iter().find(|solver| solver.to_string() == name).map(Self::Host);
        host.or((name == "device-low-rank-f32").then_some(Self::Device))
    }
}

/// A rung of the overlap axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Formula {
    /// The host's twin, in float64.
    Twin,
    /// One of the device's formulas.
    Device(Method),
}

impl Formula {
    fn of(name: &str) -> Option<Self> {
        match name {
            "qr-f64" => Some(Self::Twin),
            "qr" => Some(Self::Device(Method::Qr)),
            "cholesky" => Some(Self::Device(Method::CholeskyOfSum)),
            "determinant" => Some(Self::Device(Method::Determinant)),
            _ => None,
        }
    }
}

/// A rung of the epsilon axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Regularisation {
    /// Added to the metric's diagonal.
    Epsilon(f64),
    /// Width added to every Gaussian, in median scales.
    Dilation(f64),
}

impl Regularisation {
    fn of(name: &str) -> Option<Self> {
        let (text, make): (_, fn(f64) -> Self) = match name.strip_prefix("t=") {
            Some(t) => (t, Self::Dilation),
            None => (name, Self::Epsilon),
        };
        text.parse().ok().filter(|v| (0.0..1e6).contains(v)).map(make)
    }
}

/// A rung of the storage axis.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Storage {
    /// Four bytes a coefficient.
    Single,
    /// Two bytes a coefficient.
    Half,
}

/// A rung of the axis of gradient sums.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Sums {
    /// In slot order: the same bits in every run.
    Ordered,
    /// By float atomics.
    Atomics,
    /// By compare-and-swap of words.
    CompareAndSwap,
}

fn culling(name: &str) -> Option<Culling> {
    match name {
        "off" => Some(Culling::Off),
        "exact" => Some(Culling::Exact),
        "box" => Some(Culling::Box),
        "3-sigma" => Some(Culling::ThreeSigma),
        _ => None,
    }
}

/// The transmittance of a rung; that of the default has a margin that avoids ties: see [`Settings`].
fn stop(name: &str) -> Option<f32> {
    if name == Axis::Stop.default_rung() {
        return Some(Settings::default().stop);
    }
    name.parse().ok().filter(|v| (0.0..1.0).contains(v))
}

fn storage(name: &str) -> Option<Storage> {
    match name {
        "f32" => Some(Storage::Single),
        "f16" => Some(Storage::Half),
        _ => None,
    }
}

fn sums(name: &str) -> Option<Sums> {
    match name {
        "ordered" => Some(Sums::Ordered),
        "atomics" => Some(Sums::Atomics),
        "compare-and-swap" => Some(Sums::CompareAndSwap),
        _ => None,
    }
}

fn share(name: &str) -> Option<f64> {
    name.parse().ok().filter(|v| *v > 0.0 && *v <= 1.0)
}

/// `1/4` or `0.25`: above 0 and up to 1.
fn fraction(name: &str) -> Option<f64> {
    let value = match name.split_once('/') {
        Some((a, b)) => a.parse::<f64>().ok()? / b.parse::<f64>().ok()?,
        None => name.parse().ok()?,
    };
    (value > 0.0 && value <= 1.0).then_some(value)
}

/// An effect and its choice; none for the unchanged run.
fn switch(name: &str) -> Result<Option<(Effect, Choice)>, String> {
    if name == Axis::Effects.default_rung() {
        return Ok(None);
    }
    match Overrides::parse(name)? {
        (effect, _) if effect.trigger() == Trigger::Always => {
            Err(format!("axis effects: '{name}' is no rung; this effect cannot be switched"))
        }
        other => Ok(Some(other)),
    }
}

/// A rung: its name and its value.
#[derive(Clone, Debug, PartialEq)]
pub struct Rung<T> {
    /// Its name, on the command line and in files.
    pub name: String,
    /// The value to measure.
    pub value: T,
}

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
    /// [`Axis::Storage`].
    Storage(Vec<Rung<Storage>>),
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
            Self::Storage(_) => Axis::Storage,
            Self::Gradients(_) => Axis::Gradients,
            Self::Keep(_) => Axis::Keep,
            Self::Selector(_) => Axis::Selector,
            Self::Iterations(_) => Axis::Iterations,
            Self::Effects(_) => Axis::Effects,
        }
    }

    /// The given rungs of an axis.
    fn new(axis: Axis, names: &[&str]) -> Result<Self, String> {
        fn rungs<T>(names: &[&str], read: impl Fn(&str) -> Result<T, String>) -> Result<Vec<Rung<T>>, String> {
            names.iter().map(|name| Ok(Rung { name: (*name).to_owned(), value: read(name)? })).collect()
        }
        fn known<T>(axis: Axis, names: &[&str], read: fn(&str) -> Option<T>) -> Result<Vec<Rung<T>>, String> {
            let wrong = |name: &str| format!("axis {}: '{name}' is no rung; {}", axis.name(), axis.hint());
            rungs(names, |name| read(name).ok_or_else(|| wrong(name)))
        }
        Ok(match axis {
            Axis::Solver => Self::Solver(known(axis, names, Solver::of)?),
            Axis::Overlap => Self::Overlap(known(axis, names, Formula::of)?),
            Axis::Epsilon => Self::Epsilon(known(axis, names, Regularisation::of)?),
            Axis::Culling => Self::Culling(known(axis, names, culling)?),
            Axis::Stop => Self::Stop(known(axis, names, stop)?),
            Axis::Storage => Self::Storage(known(axis, names, storage)?),
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
        let rungs: Vec<&str> = rungs.split(',').map(str::trim).collect();
        if let Some(twice) = (1..rungs.len()).find(|i| rungs[..*i].contains(&rungs[*i])) {
            return Err(format!("axis {}: {} is there twice", axis.name(), rungs[twice]));
        }
        Self::new(axis, &rungs)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn axes_by_name() {
        for axis in Axis::ALL {
            assert_eq!(Asked::parse(axis.name()).unwrap().axis(), axis);
            assert!(axis == Axis::Effects || axis.rungs().contains(&axis.default_rung()), "{axis:?}");
        }
        assert_eq!(Asked::light().len(), 7);
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
