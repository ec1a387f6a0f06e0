//! Records of a sweep: `sweep.json`, schema 1, and its lines as `sweep.csv`.

use super::axis::Axis;
use super::timing::{Spread, Timed};
use crate::gpu::TunedDevice;
use serde::Serialize;
use std::collections::BTreeMap;

/// Rungs whose times differ by less than this factor count as equally fast.
const EQUALLY_FAST: f64 = 1.15;

/// Share by which times of equal work may differ.
const ALIKE: f64 = 0.03;

/// The contents of `sweep.json`.
#[derive(Clone, Debug, Serialize)]
pub struct SweepRecord {
    /// Version of this layout.
    pub schema: u32,
    /// Version of the program.
    pub version: &'static str,
    /// The device.
    pub device: TunedDevice,
    /// Number of threads of the host's rungs.
    pub host_threads: usize,
    /// Subject of the measurements.
    pub subject: Described,
    /// The axes, in the order of the request.
    pub axes: Vec<AxisRecord>,
    /// Total seconds.
    pub seconds: f64,
}

/// Description of a sweep's subject.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Described {
    /// Scene or model, as given on the command line.
    pub path: String,
    /// Origin of model, views and responses, in a sentence.
    pub origin: String,
    /// Gaussians of the model of the light axes; 0 if no light axis was requested.
    pub gaussians: usize,
    /// SH degree of that model.
    pub degree: usize,
    /// Views that pictures were taken from.
    pub views: usize,
    /// Largest of these, width and height in pixels.
    pub size: [u32; 2],
}

/// Direction in which accuracy improves.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum Better {
    /// Lower is better: errors.
    Lower,
    /// Higher is better: scores.
    Higher,
}

/// One step of an axis.
#[derive(Clone, Debug, Default, Serialize)]
pub struct RungRecord {
    /// Its name, as in `--axis NAME=`.
    pub name: String,
    /// True if it is the engine's default.
    pub default: bool,
    /// True if no rung is both faster and at least as accurate, nor as fast and more accurate.
    pub front: bool,
    /// Accuracy by the axis's measure; null if undefined, such as the PSNR of equal pictures.
    pub accuracy: Option<f64>,
    /// True if it equals the reference of accuracy.
    pub exact: bool,
    /// Time in the axis's unit: by the device's timestamps if it did the work, otherwise by the host's clock.
    pub time: Option<Spread>,
    /// Time by the host's clock, in the same unit.
    pub wall: Option<Spread>,
    /// Further figures.
    pub figures: BTreeMap<&'static str, f64>,
}

impl RungRecord {
    /// Its mark in tables.
    pub fn mark(&self) -> &'static str {
        match (self.default, self.front) {
            (true, true) => "default, on the front",
            (true, false) => "default",
            (false, true) => "on the front",
            (false, false) => "",
        }
    }

    /// The rung with these times; one second is `per_second` of the axis's units.
    #[must_use]
    pub fn timed(mut self, timed: &Timed, per_second: f64) -> Self {
        let unit =
            |s: Spread| Spread { median: s.median * per_second, q1: s.q1 * per_second, q3: s.q3 * per_second, ..s };
        self.time = timed.device.or(timed.wall).map(unit);
        self.wall = timed.wall.map(unit);
        self
    }

    /// Distance from exact, for comparisons: lower is better.
    fn badness(&self, better: Better) -> Option<f64> {
        match (self.accuracy, better) {
            (Some(a), Better::Lower) => Some(a),
            (Some(a), Better::Higher) => Some(-a),
            (None, _) if self.exact => Some(f64::NEG_INFINITY),
            (None, _) => None,
        }
    }

    fn seconds(&self) -> Option<f64> {
        self.time.map(|t| t.median)
    }

    /// True if the difference of its time from another's may be noise.
    fn overlaps(&self, other: &Self) -> bool {
        self.time.zip(other.time).is_some_and(|(a, b)| a.samples > 1 && a.overlaps(&b))
    }
}

/// A table beside an axis's plot.
#[derive(Clone, Debug, Serialize)]
pub struct Table {
    /// Its title.
    pub title: String,
    /// Titles of the columns; the first column is text.
    pub columns: Vec<&'static str>,
    /// Cells, as text.
    pub rows: Vec<Vec<String>>,
}

/// An axis, measured.
#[derive(Clone, Debug, Serialize)]
pub struct AxisRecord {
    /// The axis.
    #[serde(flatten)]
    pub axis: &'static Axis,
    /// The rungs.
    pub rungs: Vec<RungRecord>,
    /// The cost of the next more exact rung, in a sentence.
    pub sentence: String,
    /// Ranges in which the axis is flat, with reasons; empty if there are none.
    pub flat: Vec<String>,
    /// Notes for the reader.
    pub notes: Vec<String>,
    /// Further tables.
    pub tables: Vec<Table>,
    /// Seconds spent measuring.
    pub seconds: f64,
}

impl AxisRecord {
    /// An axis without rungs.
    pub fn new(axis: &'static Axis) -> Self {
        Self {
            axis,
            rungs: Vec::new(),
            sentence: String::new(),
            flat: Vec::new(),
            notes: Vec::new(),
            tables: Vec::new(),
            seconds: 0.0,
        }
    }

    /// A rung of the axis, without measurements.
    pub fn rung(&self, name: &str) -> RungRecord {
        RungRecord { name: name.to_owned(), default: name == self.axis.default, ..RungRecord::default() }
    }

    /// Marks the Pareto front, and fills in the cost of exactness and the flat ranges.
    #[must_use]
    pub fn judged(mut self) -> Self {
        let Axis { better, flat_times, flat_accuracy, .. } = *self.axis;
        let points: Vec<Option<[f64; 2]>> =
            self.rungs.iter().map(|r| Some([r.seconds()?, r.badness(better)?])).collect();
        for (k, rung) in self.rungs.iter_mut().enumerate() {
            let Some([time, bad]) = points[k] else { continue };
            let beats = |o: &[f64; 2]| o[0] <= time && o[1] <= bad && (o[0] < time || o[1] < bad);
            rung.front = !points.iter().flatten().any(beats);
        }
        let range = |values: Vec<f64>| {
            values.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(*v), h.max(*v)))
        };
        if self.rungs.len() > 1 {
            let (low, high) = range(self.rungs.iter().filter_map(RungRecord::seconds).collect());
            let times: Vec<Spread> = self.rungs.iter().filter_map(|r| r.time).filter(|t| t.samples > 1).collect();
            let together = times.len() == self.rungs.len() && times.iter().all(|a| times.iter().all(|b| a.overlaps(b)));
            let once = self.rungs.iter().all(|r| r.time == self.rungs[0].time);
            if !once && low > 0.0 && (high / low < EQUALLY_FAST || together) {
                self.flat.push(if high / low < EQUALLY_FAST {
                    format!("Times hardly differ (medians within {:.0} %): {flat_times}", 100.0 * (high / low - 1.0))
                } else {
                    "Times vary too much from one measurement to the next to tell the rungs apart.".to_owned()
                });
            }
            let bad: Vec<f64> = self.rungs.iter().filter_map(|r| r.badness(better)).collect();
            if bad.len() == self.rungs.len() && bad.iter().all(|b| *b == bad[0]) {
                self.flat.push(format!("Accuracy is the same on every rung: {flat_accuracy}"));
            }
        }
        self.sentence = self.cost();
        self
    }

    /// The cost of the next more exact rung, or a note that there is none.
    fn cost(&self) -> String {
        let Some(default) = self.rungs.iter().find(|r| r.default) else {
            return format!("The default, {}, was not among the rungs.", self.axis.default);
        };
        let Some(own) = default.badness(self.axis.better) else {
            return format!("The accuracy of the default, {}, could not be measured.", default.name);
        };
        let of = |r: &RungRecord| Some((r.badness(self.axis.better)?, r.seconds()?));
        let others = || self.rungs.iter().filter(|r| !r.default).filter_map(|r| Some((r, of(r)?)));
        let next = others().filter(|(_, (bad, _))| *bad < own).max_by(|(_, a), (_, b)| {
            // The smallest step; among equal ones the faster.
            a.0.total_cmp(&b.0).then(b.1.total_cmp(&a.1))
        });
        if let Some((rung, _)) = next {
            // Equal to the last digit, the times are those of one measurement.
            let once = rung.time == default.time;
            let cost = if once { String::new() } else { format!("it {}, and ", self.change(rung, default)) };
            return format!(
                "The next rung that is more exact than the default, {}, is {}: {cost}its accuracy ({}) is {} instead of {}.",
                default.name,
                rung.name,
                self.axis.accuracy,
                self.shown(rung),
                self.shown(default),
            );
        }
        let from = default.seconds().unwrap_or(f64::NAN);
        let faster = others()
            .filter(|(rung, (_, time))| *time < (1.0 - ALIKE) * from && !rung.overlaps(default))
            .min_by(|(_, a), (_, b)| a.0.total_cmp(&b.0));
        let rest = match faster {
            None if others().all(|(rung, _)| rung.time == default.time) => String::new(),
            None if others().any(|(_, (_, time))| time < (1.0 - ALIKE) * from) => {
                "; no other is faster beyond the spread".to_owned()
            }
            None => "; no other is faster".to_owned(),
            Some((rung, _)) => format!(
                "; {}, the most exact of the faster ones, {}, and its {} is {}",
                rung.name,
                self.change(rung, default),
                self.axis.accuracy,
                self.shown(rung)
            ),
        };
        let shown = self.shown(default);
        format!("No rung is more exact than the default, {} ({}: {shown}){rest}.", default.name, self.axis.accuracy)
    }

    /// The difference of a rung's time from another's, as text.
    fn change(&self, rung: &RungRecord, from: &RungRecord) -> String {
        let (Some(a), Some(b)) = (rung.time, from.time) else { return "has a time that was not measured".to_owned() };
        let figures = format!("{} instead of {} {}", figure(a.median), figure(b.median), self.axis.time);
        let words = match a.median / b.median {
            r if (1.0 - ALIKE..1.0 + ALIKE).contains(&r) => "takes equally long".to_owned(),
            _ if rung.overlaps(from) => "takes equally long within the spread".to_owned(),
            r if r >= 2.0 => format!("takes {r:.1} times as long"),
            r if r > 1.0 => format!("takes {:.0} % longer", 100.0 * (r - 1.0)),
            r => format!("takes {:.0} % less time", 100.0 * (1.0 - r)),
        };
        format!("{words} ({figures})")
    }

    /// A rung's accuracy as text.
    pub fn shown(&self, rung: &RungRecord) -> String {
        match rung.accuracy {
            Some(a) => figure(a),
            None if rung.exact => "exact".to_owned(),
            None => "unknown".to_owned(),
        }
    }
}

/// A number with three digits.
pub fn figure(v: f64) -> String {
    let size = v.abs();
    match size {
        _ if v == 0.0 => "0".to_owned(),
        s if !(1e-3..1e6).contains(&s) => format!("{v:.1e}"),
        s if s >= 100.0 => format!("{v:.0}"),
        s if s >= 10.0 => format!("{v:.1}"),
        s if s >= 1.0 => format!("{v:.2}"),
        _ => format!("{v:.4}"),
    }
}

impl SweepRecord {
    /// One comma-separated line per rung; figures without a column are in the last one as NAME=VALUE, separated by
    /// semicolons.
    pub fn csv(&self) -> String {
        let mut text = "axis,rung,default,front,accuracy,exact,accuracy_unit,time,time_q1,time_q3,samples,time_unit,wall,figures\n"
            .to_owned();
        let cell = |v: Option<f64>| v.map(|v| v.to_string()).unwrap_or_default();
        for AxisRecord { axis, rungs, .. } in &self.axes {
            for r in rungs {
                let times = r.time.map(|t| [t.median, t.q1, t.q3]);
                let at = |k: usize| cell(times.map(|t| t[k]));
                let samples = r.time.map(|t| t.samples.to_string()).unwrap_or_default();
                let figures: Vec<String> = r.figures.iter().map(|(k, v)| format!("{k}={v}")).collect();
                let cells = [
                    axis.name.to_owned(),
                    r.name.clone(),
                    r.default.to_string(),
                    r.front.to_string(),
                    cell(r.accuracy),
                    r.exact.to_string(),
                    axis.accuracy.replace(',', ";"),
                    at(0),
                    at(1),
                    at(2),
                    samples,
                    axis.time.replace(',', ";"),
                    cell(r.wall.map(|w| w.median)),
                    figures.join(";"),
                ];
                text += &cells.join(",");
                text.push('\n');
            }
        }
        text
    }
}

#[cfg(test)]
mod tests {
    use super::super::asked::Asked;
    use super::*;

    fn axis(points: &[(&str, f64, f64)]) -> AxisRecord {
        let mut axis = AxisRecord::new(Asked::parse("epsilon").unwrap().axis);
        for (name, time, error) in points {
            let time = Spread { median: *time, q1: *time, q3: *time, samples: 3 };
            axis.rungs.push(RungRecord { accuracy: Some(*error), time: Some(time), ..axis.rung(name) });
        }
        axis.judged()
    }

    #[test]
    fn the_front_and_what_exactness_costs() {
        let axis = axis(&[("0", 9.0, 0.0), ("1e-4", 4.0, 0.1), ("1e-3", 5.0, 0.2), ("1e-2", 3.0, 0.4)]);
        assert_eq!(axis.rungs.iter().map(|r| r.front).collect::<Vec<_>>(), [true, true, false, true]);
        let said = "The next rung that is more exact than the default, 1e-4, is 0: it takes 2.2 times as long (9.00 instead of 4.00 ms \
                    to assemble and solve the scene), and its accuracy (Jaccard distance of the kept set) is 0 instead of 0.1000.";
        assert_eq!(axis.sentence, said);
        assert!(axis.flat.is_empty());
    }

    #[test]
    fn flat_axes_and_exact_defaults_are_said_to_be_so() {
        let flat = axis(&[("1e-4", 4.0, 0.0), ("1e-3", 4.1, 0.0)]);
        assert_eq!(flat.flat.len(), 2, "{:?}", flat.flat);
        assert!(flat.sentence.starts_with("No rung is more exact"), "{}", flat.sentence);
        assert!(axis(&[("0", 4.0, 0.0)]).sentence.contains("was not among"));
    }

    #[test]
    fn rungs_with_one_time_are_not_compared_by_it() {
        let better = axis(&[("1e-6", 4.0, 0.0), ("1e-4", 4.0, 0.1)]);
        let said = "The next rung that is more exact than the default, 1e-4, is 1e-6: its accuracy (Jaccard distance of the kept set) is 0 \
                    instead of 0.1000.";
        assert_eq!((better.sentence.as_str(), better.flat.len()), (said, 0));
        let exact = axis(&[("1e-4", 4.0, 0.0), ("1e-3", 4.0, 0.1)]);
        let said = "No rung is more exact than the default, 1e-4 (Jaccard distance of the kept set: 0).";
        assert_eq!((exact.sentence.as_str(), exact.flat.len()), (said, 0));
    }

    #[test]
    fn what_may_be_noise_is_not_called_faster() {
        let mut axis = axis(&[("1e-4", 9.0, 0.0), ("1e-3", 7.0, 0.1)]);
        assert!(axis.sentence.contains("1e-3, the most exact of the faster ones, takes 22 % less time"));
        for rung in &mut axis.rungs {
            rung.time = rung.time.map(|t| Spread { q1: t.median - 2.0, q3: t.median + 2.0, ..t });
        }
        let mut axis = axis.judged();
        assert!(axis.sentence.ends_with("; no other is faster beyond the spread."));
        for rung in &mut axis.rungs {
            rung.time = rung.time.map(|t| Spread { median: 9.0, ..t });
        }
        assert!(axis.judged().sentence.ends_with("; no other is faster."));
    }
}
