//! Horizontal bars, one per row, and vertical columns, one per bin.

use super::frame::{Frame, SIZE};
use super::scale::Axis;
use super::{Drawing, px};
use crate::report::format::short;
use maud::{Markup, html};

/// Width of a plot of bars, and the left and right ends of the bars.
const WIDTH: f64 = 540.0;
const BEGIN: f64 = 176.0;
const END: f64 = 430.0;
/// Height of a row and of its bar.
const ROW: f64 = 24.0;
const THICK: f64 = 15.0;
/// Number of characters of a name that fit before the bars.
const NAME: usize = 26;
/// Largest number of columns with values above them.
const NUMBERED: usize = 12;

/// A labelled bar.
pub struct Bar {
    /// Its label.
    pub name: String,
    /// Its length, from zero.
    pub value: f64,
    /// Text at its end.
    pub text: String,
}

/// Bars below each other, in the given order; the longest takes the full width.
pub fn bars(title: &str, bars: &[Bar]) -> Markup {
    drawing_of_bars(title, bars).figure()
}

/// Like `bars`, for a page or a sheet.
pub fn drawing_of_bars(title: &str, bars: &[Bar]) -> Drawing {
    let positive = |v: f64| if v.is_finite() { v.max(0.0) } else { 0.0 };
    let longest = bars.iter().map(|b| positive(b.value)).fold(0.0, f64::max);
    let drawing = html! {
        @for (k, bar) in bars.iter().enumerate() {
            @let top = k as f64 * ROW + 4.0;
            @let length = if longest > 0.0 { positive(bar.value) / longest * (END - BEGIN) } else { 0.0 };
            @let base = px(top + THICK / 2.0 + 4.0);
            text class="mark end" x=(px(BEGIN - 8.0)) y=(base) { title { (bar.name) } (cut(&bar.name)) }
            rect class="bar c0" x=(px(BEGIN)) y=(px(top)) width=(px(length)) height=(px(THICK)) rx="2" {}
            text class="label" x=(px(BEGIN + length + 7.0)) y=(base) { (bar.text) }
        }
    };
    Drawing::new(title, &[], [WIDTH, bars.len().max(1) as f64 * ROW + 6.0], drawing)
}

/// A name, truncated if it is too long.
fn cut(name: &str) -> String {
    if name.chars().count() <= NAME {
        return name.to_owned();
    }
    name.chars().take(NAME - 1).chain(['…']).collect()
}

/// Columns over bins: a histogram if the values are counts.
pub struct Columns<'a> {
    /// Title of the plot.
    pub title: &'a str,
    /// Title of the horizontal axis.
    pub x: &'a str,
    /// Vertical axis; values that it cannot show have no column.
    pub y: Axis<'a>,
    /// Each bin's name and value.
    pub bins: &'a [(String, f64)],
    /// Text above a column.
    pub text: fn(f64) -> String,
}

impl Columns<'_> {
    /// The plot.
    pub fn draw(&self) -> Markup {
        let x = Axis::new(self.x);
        let frame = Frame::new(&x, &self.y, std::iter::empty(), self.bins.iter().map(|(_, v)| *v));
        let [left, right] = Frame::across();
        let width = (right - left) / self.bins.len().max(1) as f64;
        let middle = |k: usize| left + (k as f64 + 0.5) * width;
        // Only every `stride`-th column is named, so that the names fit.
        let stride = self.bins.len().div_ceil(NUMBERED).max(1);
        let names: Vec<(f64, &str)> =
            self.bins.iter().enumerate().step_by(stride).map(|(k, (name, _))| (middle(k), name.as_str())).collect();
        let drawing = html! {
            (frame.draw(Some(&names)))
            @for (k, (name, value)) in self.bins.iter().enumerate() {
                @if self.y.shows(*value) && *value != 0.0 {
                    @let top = frame.y.at(*value);
                    rect class="bar c0" x=(px(middle(k) - 0.41 * width)) width=(px(0.82 * width)) y=(px(top))
                        height=(px((frame.y.start() - top).max(0.5))) rx="2" {
                        title { (name) ": " (short(*value)) }
                    }
                    @if self.bins.len() <= NUMBERED {
                        text class="above middle" x=(px(middle(k))) y=(px(top - 4.0)) { ((self.text)(*value)) }
                    }
                }
            }
        };
        Drawing::new(self.title, &[], SIZE, drawing).figure()
    }
}
