//! The request for an axis, and the parser of `--axis`.

use super::axis::{AXES, Axis};
use super::rung::Rung;
use crate::wording::unknown;

/// An axis with the names of the rungs to measure.
#[derive(Clone, Debug)]
pub struct Asked {
    /// The axis.
    pub axis: &'static Axis,
    /// Rungs, each once. For effects, an empty list means that the scene determines which are switched.
    pub rungs: Vec<String>,
}

impl Asked {
    /// The rungs of an axis that are measured unless some are named.
    fn all(axis: &'static Axis) -> Self {
        let rungs = axis.rungs.iter().map(|name| (*name).to_owned()).chain((axis.more)()).collect();
        Self { axis, rungs }
    }

    /// All rungs of the axes without training: the default of a sweep.
    pub fn light() -> Vec<Self> {
        AXES.iter().filter(|axis| !axis.heavy()).map(Self::all).collect()
    }

    /// Reads `NAME` or `NAME=RUNG,...`.
    pub fn parse(text: &str) -> Result<Self, String> {
        let (name, rungs) = text.split_once('=').map_or((text, None), |(n, r)| (n, Some(r)));
        let axis = AXES.iter().find(|axis| axis.name == name.trim());
        let axis = axis.ok_or_else(|| unknown(name.trim(), "an axis", AXES.iter().map(|axis| axis.name)))?;
        let Some(rungs) = rungs else { return Ok(Self::all(axis)) };
        let rungs: Vec<String> = rungs.split(',').map(|name| name.trim().to_owned()).collect();
        if let Some(twice) = (1..rungs.len()).find(|i| rungs[..*i].contains(&rungs[*i])) {
            return Err(format!("axis {}: {} is given twice", axis.name, rungs[twice]));
        }
        rungs.iter().try_for_each(|name| axis.check_rung(name))?;
        Ok(Self { axis, rungs })
    }

    /// The rungs with their values; a name without a value, which the parser of `--axis` refuses, is left out.
    pub(super) fn values<T>(&self, read: impl Fn(&str) -> Option<T>) -> Vec<Rung<T>> {
        self.rungs.iter().filter_map(|name| Some(Rung { name: name.clone(), value: read(name)? })).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::super::rung::basis;
    use super::*;

    #[test]
    fn axes_by_name() {
        for axis in AXES {
            let (name, asked) = (axis.name, Asked::parse(axis.name).unwrap());
            assert!(asked.axis.name == name && asked.rungs.iter().zip(axis.rungs).all(|(got, row)| got == row));
            asked.rungs.iter().try_for_each(|name| axis.check_rung(name)).unwrap();
            assert!(name == "effects" || axis.rungs.contains(&axis.default), "{name}");
            let texts = [axis.title, axis.accuracy, axis.against, axis.time, axis.flat_times, axis.flat_accuracy];
            assert!(texts.iter().all(|text| !text.is_empty()), "{name}");
        }
        assert_eq!(Asked::light().len(), 6);
        let both = Asked::parse("epsilon=1e-3,t=0.3").unwrap().values(basis);
        assert_eq!((both[0].value.epsilon, both[1].value.dilate), (1e-3, 0.3));
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
