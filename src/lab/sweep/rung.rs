//! The rungs of the axes: their values, and the parsers of their names.

use crate::effects::{Choice, Effect, Overrides, Trigger};
use crate::qirf::dense::{LIBRARIES, Library, serving};
use crate::qirf::overlap::Method;
use crate::qirf::participation::Eigensolver;
use crate::qirf::study::Basis;
use crate::render::{Culling, Settings};

/// The name of the engine's own transmittance at which blending stops.
pub(super) const STOP: &str = "1e-4";

/// The name of the unchanged run among effects.
pub(super) const UNCHANGED: &str = "default";

/// A rung: its name and its value.
#[derive(Clone, Debug, PartialEq)]
pub struct Rung<T> {
    /// Its name, on the command line and in files.
    pub name: String,
    /// The value to measure.
    pub value: T,
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
    pub(super) fn of(name: &str) -> Option<Self> {
        match name {
            "qr-f64" => Some(Self::Twin),
            "qr" => Some(Self::Device(Method::Qr)),
            "determinant" => Some(Self::Device(Method::Determinant)),
            _ => None,
        }
    }
}

/// The engine's basis with another epsilon, or as `t=0.3` with a dilation of every Gaussian, in median scales.
pub(super) fn basis(name: &str) -> Option<Basis> {
    let value = |text: &str| text.parse::<f64>().ok().filter(|v| (0.0..1e6).contains(v));
    Some(match name.strip_prefix("t=") {
        Some(t) => Basis { dilate: value(t)?, ..Basis::default() },
        None => Basis { epsilon: value(name)?, ..Basis::default() },
    })
}

pub(super) fn culling(name: &str) -> Option<Culling> {
    match name {
        "off" => Some(Culling::Off),
        "exact" => Some(Culling::Exact),
        "3-sigma" => Some(Culling::ThreeSigma),
        _ => None,
    }
}

/// The transmittance of a rung; the default has a margin that avoids ties: see [`Settings`].
pub(super) fn stop(name: &str) -> Option<f32> {
    if name == STOP {
        return Some(Settings::default().stop);
    }
    name.parse().ok().filter(|v| (0.0..1.0).contains(v))
}

/// A rung of the solver axis.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Solver {
    /// The solver, including its precision.
    pub eigensolver: Eigensolver,
    /// The library for the linear algebra of the host's solvers.
    pub library: &'static dyn Library,
}

impl Solver {
    /// `low-rank`, with the serving library, or `low-rank@faer`.
    pub(super) fn of(name: &str) -> Option<Self> {
        let named = |library: &str| LIBRARIES.iter().copied().find(|l| l.name() == library);
        let (name, library) = match name.split_once('@') {
            Some((name, library)) => (name, named(library).filter(|_| name != Eigensolver::Device.name())?),
            None => (name, serving()),
        };
        let eigensolver = Eigensolver::ALL.into_iter().find(|solver| solver.name() == name)?;
        Some(Self { eigensolver, library })
    }

    /// The host's solvers with libraries other than the serving one, as `SOLVER@LIBRARY`.
    pub(super) fn elsewhere() -> Vec<String> {
        let others = LIBRARIES.iter().skip(1).map(|library| library.name());
        others.flat_map(|name| Eigensolver::HOST.map(|solver| format!("{solver}@{name}"))).collect()
    }
}

/// True for gradient sums by float atomics, false for those in slot order, which have the same bits in every run.
pub(super) fn sums(name: &str) -> Option<bool> {
    match name {
        "ordered" => Some(false),
        "atomics" => Some(true),
        _ => None,
    }
}

/// A number above 0 and up to 1.
pub(super) fn share(name: &str) -> Option<f64> {
    name.parse().ok().filter(|v| *v > 0.0 && *v <= 1.0)
}

/// `1/4` or `0.25`: above 0 and up to 1.
pub(super) fn fraction(name: &str) -> Option<f64> {
    let value = match name.split_once('/') {
        Some((a, b)) => a.parse::<f64>().ok()? / b.parse::<f64>().ok()?,
        None => name.parse().ok()?,
    };
    (value > 0.0 && value <= 1.0).then_some(value)
}

/// An effect and its choice; `None` for the unchanged run.
pub type Switch = Option<(Effect, Choice)>;

/// A rung of the effects axis.
pub(super) fn switch(name: &str) -> Result<Switch, String> {
    if name == UNCHANGED {
        return Ok(None);
    }
    match Overrides::parse(name)? {
        (effect, _) if effect.trigger() == Trigger::Always => {
            Err(format!("axis effects: '{name}' is not a rung; this effect cannot be switched"))
        }
        other => Ok(Some(other)),
    }
}
