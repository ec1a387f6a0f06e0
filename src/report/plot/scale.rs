//! Scales: from values to positions along an axis, with round numbers as marks.

use crate::report::format::short;

/// Approximate number of marks along an axis.
const MARKS: f64 = 5.0;
/// Largest number of powers of ten that are marked.
const MOST_DECADES: i32 = 6;
/// Values that span more than this factor get a logarithmic axis.
const WIDE: f64 = 8.0;
/// Values beyond this are not drawn: their differences would overflow.
const FAR: f64 = 1e30;

/// Title and kind of an axis.
#[derive(Clone, Copy, Debug, Default)]
pub struct Axis<'a> {
    /// Its title with the unit.
    pub title: &'a str,
    /// True for a logarithmic axis.
    pub log: bool,
    /// True if zero is always shown; on a linear axis only.
    pub zero: bool,
}

impl<'a> Axis<'a> {
    /// A linear axis around its values.
    pub fn new(title: &'a str) -> Self {
        Self { title, log: false, zero: false }
    }

    /// A linear axis from zero.
    pub fn from_zero(title: &'a str) -> Self {
        Self { zero: true, ..Self::new(title) }
    }

    /// A logarithmic axis.
    pub fn log(title: &'a str) -> Self {
        Self { log: true, ..Self::new(title) }
    }

    /// This axis, or a logarithmic one with the same title if the values span a wide range.
    #[must_use]
    pub fn or_log(self, values: &[f64]) -> Self {
        let positive = values.iter().filter(|v| **v > 0.0);
        let (low, high) = positive.fold((f64::INFINITY, 0.0_f64), |(l, h), v| (l.min(*v), h.max(*v)));
        if high > WIDE * low { Self::log(self.title) } else { self }
    }

    /// Returns true if the axis can show a value.
    pub fn shows(&self, value: f64) -> bool {
        value.is_finite() && value.abs() < FAR && (!self.log || value > 0.0)
    }

    /// Returns true for the value of an exact result that the axis cannot show: an error of zero on a logarithmic axis, an infinite PSNR
    /// on a linear one.
    pub fn exact(&self, value: f64) -> bool {
        value == if self.log { 0.0 } else { f64::INFINITY }
    }
}

/// An axis with its range, between two positions in pixels.
#[derive(Clone, Copy, Debug)]
pub struct Scale {
    low: f64,
    high: f64,
    step: f64,
    log: bool,
    pixels: [f64; 2],
}

impl Scale {
    /// A range of round numbers that contains all values that the axis shows.
    pub fn new(axis: &Axis<'_>, values: impl Iterator<Item = f64>, pixels: [f64; 2]) -> Self {
        let at = |v: f64| if axis.log { v.log10() } else { v };
        let zero = (axis.zero && !axis.log).then_some(0.0);
        let shown = values.filter(|v| axis.shows(*v)).map(at).chain(zero);
        let (mut low, mut high) = shown.fold((f64::MAX, f64::MIN), |(l, h), v| (l.min(v), h.max(v)));
        if low > high {
            (low, high) = (0.0, 1.0);
        }
        if high - low < 1e-9 * high.abs().max(1e-9) {
            let half = if axis.log { 0.5 } else { (0.05 * high.abs()).max(0.5) };
            (low, high) = (if zero.is_some() && low >= 0.0 { low } else { low - half }, high + half);
        }
        let step = if axis.log { 1.0 } else { round_step((high - low) / MARKS) };
        let (low, high) = ((low / step + 1e-9).floor() * step, (high / step - 1e-9).ceil() * step);
        Self { low, high, step, log: axis.log, pixels }
    }

    /// The position of a value; clamped to the ends.
    pub fn at(&self, value: f64) -> f64 {
        let value = if self.log { value.max(f64::MIN_POSITIVE).log10() } else { value };
        let share = ((value - self.low) / (self.high - self.low)).clamp(0.0, 1.0);
        let [from, to] = self.pixels;
        let place = from + share * (to - from);
        if place.is_finite() { place } else { from }
    }

    /// The position at which the axis begins.
    pub fn start(&self) -> f64 {
        self.pixels[0]
    }

    /// Marks: their positions and labels.
    pub fn marks(&self) -> Vec<(f64, String)> {
        let steps = ((self.high - self.low) / self.step).round() as i32;
        let stride = if self.log { steps / MOST_DECADES + 1 } else { 1 };
        let values: Vec<f64> = (0..=steps)
            .step_by(stride.max(1) as usize)
            .map(|k| self.low + f64::from(k) * self.step)
            // Avoids a rounding error in place of zero.
            .map(|v| if v.abs() < 1e-9 * self.step { 0.0 } else { v })
            .collect();
        if self.log {
            return values.iter().map(|v| (self.at(10_f64.powf(*v)), power(v.round() as i32))).collect();
        }
        let mut labels: Vec<String> = values.iter().map(|v| short(*v)).collect();
        if labels.windows(2).any(|pair| pair[0] == pair[1]) {
            // A narrow range needs the digits of its step.
            let places = (-self.step.log10().floor()).clamp(0.0, 12.0) as usize;
            labels = values.iter().map(|v| format!("{v:.places$}").replace('-', "−")).collect();
        }
        values.iter().map(|v| self.at(*v)).zip(labels).collect()
    }
}

/// 1, 2 or 5 times a power of ten, not less than `rough`.
fn round_step(rough: f64) -> f64 {
    let unit = 10_f64.powf(rough.max(1e-30).log10().floor());
    [1.0, 2.0, 5.0, 10.0].into_iter().map(|k| k * unit).find(|s| *s >= rough * (1.0 - 1e-9)).unwrap_or(10.0 * unit)
}

/// The label of a power of ten, in exponent form if it is far from one.
fn power(exponent: i32) -> String {
    if (-3..=4).contains(&exponent) {
        return if exponent < 0 {
            format!("{:.*}", exponent.unsigned_abs() as usize, 10_f64.powi(exponent))
        } else {
            short(10_f64.powi(exponent))
        };
    }
    let raised = |c: char| "⁻⁰¹²³⁴⁵⁶⁷⁸⁹".chars().nth("-0123456789".find(c).unwrap_or(0)).unwrap_or(c);
    format!("10{}", exponent.to_string().chars().map(raised).collect::<String>())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn labels(axis: Axis<'_>, values: &[f64]) -> Vec<String> {
        Scale::new(&axis, values.iter().copied(), [0.0, 100.0]).marks().into_iter().map(|(_, text)| text).collect()
    }

    #[test]
    fn marks_are_round_and_hold_the_values() {
        assert_eq!(labels(Axis::new(""), &[17.3, 27.9]), ["15", "20", "25", "30"]);
        assert_eq!(labels(Axis::from_zero(""), &[0.0, 10.0]), ["0", "2", "4", "6", "8", "10"]);
        assert_eq!(labels(Axis::log(""), &[0.0, 0.00002, 0.9]), ["10⁻⁵", "10⁻⁴", "0.001", "0.01", "0.1", "1"]);
        assert_eq!(labels(Axis::new(""), &[29.46, 29.51]), ["29.46", "29.47", "29.48", "29.49", "29.50", "29.51"]);
        assert_eq!(labels(Axis::new(""), &[-123_456.0, -123_455.0]).len(), 6);
        assert_eq!(labels(Axis::new(""), &[]), ["0", "0.2", "0.4", "0.6", "0.8", "1"]);
    }

    #[test]
    fn whatever_comes_places_are_finite_and_within() {
        let wild = [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 0.0, -0.0, 1e300, -1e29, 1e29, 5e-324, 1.0];
        for axis in [Axis::new(""), Axis::from_zero(""), Axis::log("")] {
            for n in 0..=wild.len() {
                for skip in 0..n {
                    let scale = Scale::new(&axis, wild[skip..n].iter().copied(), [90.0, 10.0]);
                    for v in wild {
                        assert!((10.0..=90.0).contains(&scale.at(v)), "{axis:?} {:?} {v}", &wild[skip..n]);
                    }
                    let marks = scale.marks();
                    assert!((1..=12).contains(&marks.len()), "{marks:?} of {:?}", &wild[skip..n]);
                    assert!(marks.iter().all(|(at, text)| (10.0..=90.0).contains(at) && !text.contains("NaN")));
                }
            }
        }
    }
}
