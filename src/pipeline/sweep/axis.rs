//! The axes by name, their rungs, and how the command line asks for them.

use crate::effects::{Effect, Overrides};
use crate::pipeline::arm::Arm;
use crate::pipeline::config::Compression;
use serde::Serialize;

/// A place where the engine can be more exact or faster.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Axis {
    /// How the eigenproblem is solved.
    Solver,
    /// How overlaps are computed.
    Overlap,
    /// What is added to the metric, and how much Gaussians are widened for it.
    Epsilon,
    /// Which tiles a Gaussian is listed in.
    Culling,
    /// The transmittance at which blending ends.
    Stop,
    /// How SH coefficients are stored.
    Storage,
    /// How a Gaussian's gradients are added up.
    Gradients,
    /// Share of the Gaussians that a prune keeps.
    Keep,
    /// What a prune ranks by, and how it divides its count.
    Selector,
    /// Length of the run.
    Iterations,
    /// What is simulated.
    Effects,
}

impl Axis {
    /// All, in the order of the design's table.
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

    /// Its name on the command line and in files.
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

    /// Whether its rungs are whole trainings.
    pub const fn heavy(self) -> bool {
        matches!(self, Self::Keep | Self::Selector | Self::Iterations | Self::Effects)
    }

    /// Its rungs where none are asked for, the most exact first; the effects' depend on the scene and are found there.
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
                "default:per-block",
                "default:global",
                "gnso",
                "ordinary",
                "lowdin",
                "importance",
                "css",
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

    /// The rung that the engine takes unless asked otherwise.
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

    /// Whether there is such a rung.
    fn check(self, rung: &str) -> Result<(), String> {
        let share = |text: &str| text.parse::<f64>().ok().is_some_and(|v| v > 0.0 && v <= 1.0);
        let not_negative = |text: &str| text.parse::<f64>().ok().is_some_and(|v| (0.0..1e6).contains(&v));
        let wrong = |what: &str| Err(format!("axis {}: '{rung}' is no rung; {what}", self.name()));
        match self {
            Self::Epsilon if not_negative(rung.strip_prefix("t=").unwrap_or(rung)) => Ok(()),
            Self::Epsilon => wrong("write an epsilon such as 1e-4, or a dilation such as t=0.3"),
            Self::Stop if rung.parse::<f64>().is_ok_and(|v| (0.0..1.0).contains(&v)) => Ok(()),
            Self::Stop => wrong("write a transmittance of 0 or more, below 1, such as 1e-3"),
            Self::Keep if share(rung) => Ok(()),
            Self::Keep => wrong("write a share above 0 and up to 1, such as 0.28"),
            Self::Iterations if fraction(rung).is_some() => Ok(()),
            Self::Iterations => wrong("write a share of the run, such as 1/4 or 0.5"),
            Self::Selector => Arm::parse(rung, &Compression::default()).map(|_| ()),
            Self::Effects if rung == "default" => Ok(()),
            Self::Effects => match Overrides::parse(rung)? {
                (Effect::Cameras, _) => wrong("this effect cannot be switched"),
                _ => Ok(()),
            },
            _ if self.rungs().contains(&rung) => Ok(()),
            _ => wrong(&format!("there are {}", self.rungs().join(", "))),
        }
    }
}

/// `1/4` or `0.25`: above 0 and up to 1.
pub(super) fn fraction(text: &str) -> Option<f64> {
    let value = match text.split_once('/') {
        Some((a, b)) => a.parse::<f64>().ok()? / b.parse::<f64>().ok()?,
        None => text.parse().ok()?,
    };
    (value > 0.0 && value <= 1.0).then_some(value)
}

/// An axis with the rungs to climb.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Asked {
    /// The axis.
    pub axis: Axis,
    /// Its rungs; none for the axis's own.
    pub rungs: Vec<String>,
}

impl Asked {
    /// All rungs of an axis.
    pub fn whole(axis: Axis) -> Self {
        Self { axis, rungs: axis.rungs().iter().map(ToString::to_string).collect() }
    }

    /// The axes that do not train: what is climbed where nothing is asked for.
    pub fn light() -> Vec<Self> {
        Axis::ALL.into_iter().filter(|a| !a.heavy()).map(Self::whole).collect()
    }

    /// Reads `NAME` or `NAME=RUNG,...`.
    ///
    /// # Errors
    /// A sentence that says what is wrong.
    pub fn parse(text: &str) -> Result<Self, String> {
        let (name, rungs) = text.split_once('=').map_or((text, None), |(n, r)| (n, Some(r)));
        let names = || Axis::ALL.map(Axis::name).join(", ");
        let axis = Axis::ALL.into_iter().find(|a| a.name() == name.trim());
        let axis = axis.ok_or_else(|| format!("there is no axis '{name}'; choose {}", names()))?;
        let Some(rungs) = rungs else { return Ok(Self::whole(axis)) };
        let rungs: Vec<String> = rungs.split(',').map(|r| r.trim().to_owned()).collect();
        for (i, rung) in rungs.iter().enumerate() {
            axis.check(rung)?;
            if rungs[..i].contains(rung) {
                return Err(format!("axis {}: {rung} is there twice", axis.name()));
            }
        }
        Ok(Self { axis, rungs })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn axes_by_name() {
        for axis in Axis::ALL {
            assert_eq!(Asked::parse(axis.name()), Ok(Asked::whole(axis)));
            assert!(axis.rungs().iter().all(|r| axis.check(r).is_ok()), "{axis:?}");
            assert!(axis == Axis::Effects || axis.rungs().contains(&axis.default_rung()), "{axis:?}");
        }
        assert_eq!(Asked::parse("epsilon=1e-3,t=0.3").unwrap().rungs, ["1e-3", "t=0.3"]);
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
