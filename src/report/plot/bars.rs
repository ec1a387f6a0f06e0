//! Horizontal bars, one per row, and vertical columns, one per bin.

use super::frame::{Frame, SIZE};
use super::scale::Axis;
use super::{Drawing, px};
use crate::report::format::short;
use maud::{Markup, html};

/// Width of a plot of bars.
const WIDTH: f64 = 540.0;
/// Height of a row, the baseline of its text, and the upper edge and the height of its bar below.
const ROW: f64 = 34.0;
const TEXT: f64 = 14.0;
const BAR: f64 = 19.0;
const THICK: f64 = 9.0;
/// Largest number of columns with values above them.
const NUMBERED: usize = 12;

/// A labelled bar.
pub struct Bar {
    /// Its label.
    pub name: String,
    /// Its length, from zero.
    pub value: f64,
    /// Its value as text.
    pub text: String,
}

/// Bars below each other, in the given order, each under its label and its value; the longest takes the full width.
pub fn bars(title: &str, bars: &[Bar]) -> Drawing {
    let positive = |v: f64| if v.is_finite() { v.max(0.0) } else { 0.0 };
    let longest = bars.iter().map(|b| positive(b.value)).fold(0.0, f64::max);
    let drawing = html! {
        @for (k, bar) in bars.iter().enumerate() {
            @let top = k as f64 * ROW;
            @let length = if longest > 0.0 { positive(bar.value) / longest * WIDTH } else { 0.0 };
            text class="mark" x="0" y=(px(top + TEXT)) { (bar.name) }
            text class="end" x=(px(WIDTH)) y=(px(top + TEXT)) { (bar.text) }
            line class="rule" x1="0" x2=(px(WIDTH)) y1=(px(top + BAR + THICK)) y2=(px(top + BAR + THICK)) {}
            rect class="bar c0" x="0" y=(px(top + BAR)) width=(px(length)) height=(px(THICK)) rx="2" {}
        }
    };
    Drawing::new(title, &[], [WIDTH, bars.len().max(1) as f64 * ROW], drawing)
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
    /// Standard deviation of each value, drawn as a whisker; empty for none.
    pub spreads: &'a [f64],
    /// Text above a column.
    pub text: fn(f64) -> String,
}

impl Columns<'_> {
    /// The plot.
    pub fn draw(&self) -> Markup {
        let x = Axis::new(self.x);
        let spread = |k: usize| self.spreads.get(k).copied().filter(|s| s.is_finite() && *s > 0.0);
        let ends = self.bins.iter().enumerate().flat_map(|(k, (_, v))| [*v, v + spread(k).unwrap_or(0.0)]);
        let frame = Frame::new(&x, &self.y, std::iter::empty(), ends);
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
                    @let whisker = spread(k).map(|s| [value - s, value + s].map(|end| frame.y.at(end)));
                    @if let Some([low, high]) = whisker {
                        line class="ring" x1=(px(middle(k))) x2=(px(middle(k))) y1=(px(low)) y2=(px(high)) {}
                    }
                    @if self.bins.len() <= NUMBERED {
                        @let above = whisker.map_or(top, |[_, high]| high.min(top)) - 4.0;
                        text class="above middle" x=(px(middle(k))) y=(px(above)) { ((self.text)(*value)) }
                    }
                }
            }
        };
        Drawing::new(self.title, &[], SIZE, drawing).figure()
    }
}
