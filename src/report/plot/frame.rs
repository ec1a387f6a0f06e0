//! The axes around a plot's marks.

use super::px;
use super::scale::{Axis, Scale};
use maud::{Markup, html};

/// Width and height of a plot with axes, in pixels.
pub const SIZE: [f64; 2] = [540.0, 290.0];
/// Left, right, upper and lower edges of the plot area.
const FIELD: [f64; 4] = [56.0, 524.0, 30.0, 244.0];
/// Distances of exact results from the edge of the plot area, and of the scale from them: the axis is broken between the two.
const ROW: [f64; 2] = [10.0, 26.0];

/// Both scales with their titles.
pub struct Frame<'a> {
    /// Along the lower edge.
    pub x: Scale,
    /// Along the left edge.
    pub y: Scale,
    titles: [&'a str; 2],
    exact: Option<Exact>,
}

/// The row of exact results, for which the scale has no place.
#[derive(Clone, Copy)]
struct Exact {
    /// The value of these results: zero or infinity.
    value: f64,
    /// The row's height in pixels.
    at: f64,
    /// The end of the scale beside it, in pixels.
    scale: f64,
    /// True if no other result has a place on the scale, so that its numbers would mean nothing.
    alone: bool,
}

impl<'a> Frame<'a> {
    /// A frame for these values.
    pub fn new(x: &Axis<'a>, y: &Axis<'a>, xs: impl Iterator<Item = f64>, ys: impl Iterator<Item = f64>) -> Self {
        let [left, right, upper, lower] = FIELD;
        let (x, y, titles) = (Scale::new(x, xs, [left, right]), Scale::new(y, ys, [lower, upper]), [x.title, y.title]);
        Self { x, y, titles, exact: None }
    }

    /// A frame for these values, of which exact ones ([`Axis::exact`]) lie beyond a break of the vertical axis, in a row of their own.
    pub fn with_exact(x: &Axis<'a>, y: &Axis<'a>, xs: impl Iterator<Item = f64>, ys: &[f64]) -> Self {
        let frame = Self::new(x, y, xs, ys.iter().copied());
        let Some(value) = ys.iter().copied().find(|v| y.exact(*v)) else { return frame };
        let ([_, _, upper, lower], [edge, apart]) = (FIELD, ROW);
        let (at, scale, pixels) = if y.log {
            (lower - edge, lower - edge - apart, [lower - edge - apart, upper])
        } else {
            (upper + edge, upper + edge + apart, [lower, upper + edge + apart])
        };
        let alone = !ys.iter().any(|v| y.shows(*v));
        Self { y: Scale::new(y, ys.iter().copied(), pixels), exact: Some(Exact { value, at, scale, alone }), ..frame }
    }

    /// The height of a value that the vertical axis shows, or of an exact one.
    pub fn height(&self, value: f64) -> f64 {
        self.exact.filter(|row| row.value == value).map_or_else(|| self.y.at(value), |row| row.at)
    }

    /// Left and right edges.
    pub fn across() -> [f64; 2] {
        [FIELD[0], FIELD[1]]
    }

    /// Upper and lower edges.
    pub fn along() -> [f64; 2] {
        [FIELD[2], FIELD[3]]
    }

    /// Grid lines, numbers and titles; `columns` replace the numbers below.
    pub fn draw(&self, columns: Option<&[(f64, &str)]>) -> Markup {
        let [left, right, _, lower] = FIELD.map(px);
        let below: Vec<(f64, String)> = match columns {
            Some(columns) => columns.iter().map(|(at, text)| (*at, (*text).to_owned())).collect(),
            None => self.x.marks(),
        };
        let numbers = if self.exact.is_some_and(|row| row.alone) { Vec::new() } else { self.y.marks() };
        let exact = self.exact.map(|row| (row.at, "exact".to_owned()));
        html! {
            @for (at, text) in numbers.into_iter().chain(exact) {
                line class="rule" x1=(left) x2=(right) y1=(px(at)) y2=(px(at)) {}
                text class="mark end" x=(px(FIELD[0] - 7.0)) y=(px(at + 4.0)) { (text) }
            }
            @if let Some(row) = self.exact.filter(|row| !row.alone) { (broken(row)) }
            line class="axis" x1=(left) x2=(right) y1=(lower) y2=(lower) {}
            @for (at, text) in &below {
                @if columns.is_none() {
                    line class="axis" x1=(px(*at)) x2=(px(*at)) y1=(lower) y2=(px(FIELD[3] + 4.0)) {}
                }
                text class="mark middle" x=(px(*at)) y=(px(FIELD[3] + 18.0)) { (text) }
            }
            text class="title" x=(px(4.0)) y=(px(FIELD[2] - 16.0)) { (self.titles[1]) }
            text class="title middle" x=(px(f64::midpoint(FIELD[0], FIELD[1]))) y=(px(SIZE[1] - 8.0)) { (self.titles[0]) }
        }
    }
}

/// The break of the axis between the scale and the row of exact results: two strokes across it.
fn broken(row: Exact) -> Markup {
    let (x, middle) = (FIELD[0], f64::midpoint(row.at, row.scale));
    let gap = 2.5 * (row.scale - row.at).signum();
    html! {
        @for (from, to) in [(row.at, middle - gap), (middle + gap, row.scale)] {
            line class="axis" x1=(px(x)) x2=(px(x)) y1=(px(from)) y2=(px(to)) {}
        }
        @for at in [middle - gap, middle + gap] {
            line class="axis" x1=(px(x - 5.0)) x2=(px(x + 5.0)) y1=(px(at + 2.5)) y2=(px(at - 2.5)) {}
        }
    }
}
