//! The axes around a plot's marks.

use super::px;
use super::scale::{Axis, Scale};
use maud::{Markup, html};

/// Width and height of a plot with axes, in pixels.
pub const SIZE: [f64; 2] = [540.0, 290.0];
/// Left, right, upper and lower edges of the plot area.
const FIELD: [f64; 4] = [56.0, 524.0, 30.0, 244.0];

/// Both scales with their titles.
pub struct Frame<'a> {
    /// Along the lower edge.
    pub x: Scale,
    /// Along the left edge.
    pub y: Scale,
    titles: [&'a str; 2],
}

impl<'a> Frame<'a> {
    /// A frame for these values.
    pub fn new(x: &Axis<'a>, y: &Axis<'a>, xs: impl Iterator<Item = f64>, ys: impl Iterator<Item = f64>) -> Self {
        let [left, right, upper, lower] = FIELD;
        Self { x: Scale::new(x, xs, [left, right]), y: Scale::new(y, ys, [lower, upper]), titles: [x.title, y.title] }
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
        html! {
            @for (at, text) in self.y.marks() {
                line class="rule" x1=(left) x2=(right) y1=(px(at)) y2=(px(at)) {}
                text class="mark end" x=(px(FIELD[0] - 7.0)) y=(px(at + 4.0)) { (text) }
            }
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
