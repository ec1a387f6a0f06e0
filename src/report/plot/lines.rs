//! Lines between two axes.

use super::frame::{Frame, SIZE};
use super::scale::Axis;
use super::{Drawing, colour, point, px};
use crate::report::format::short;
use maud::html;

/// A named series of points.
pub struct Line<'a> {
    /// Its name in the legend.
    pub name: &'a str,
    /// x and y of each point; an infinite y lies beyond a break of a linear axis, others that the axes cannot show are left out.
    pub points: Vec<[f64; 2]>,
}

/// A vertical line at some x.
pub struct Mark {
    /// Its position.
    pub x: f64,
    /// The event there.
    pub label: String,
}

/// Lines through points.
pub struct Lines<'a> {
    /// Title of the plot.
    pub title: &'a str,
    /// Horizontal axis.
    pub x: Axis<'a>,
    /// Vertical axis.
    pub y: Axis<'a>,
    /// The lines.
    pub lines: Vec<Line<'a>>,
    /// Vertical lines; the first is labelled, the others show their labels as tooltips.
    pub marks: Vec<Mark>,
}

impl Lines<'_> {
    /// The plot, for a page or a sheet.
    pub fn drawing(&self) -> Drawing {
        // Zeros on a logarithmic axis are not exact results here.
        let shown = |p: &&[f64; 2]| self.x.shows(p[0]) && (self.y.shows(p[1]) || p[1] > 0.0 && self.y.exact(p[1]));
        let points = || self.lines.iter().flat_map(|l| l.points.iter().filter(shown));
        let ys: Vec<f64> = points().map(|p| p[1]).collect();
        let frame = Frame::with_exact(&self.x, &self.y, points().map(|p| p[0]), &ys);
        let marks: Vec<&Mark> = self.marks.iter().filter(|m| self.x.shows(m.x)).collect();
        let [upper, lower] = Frame::along();
        let [left, right] = Frame::across();
        let drawing = html! {
            (frame.draw(None))
            @for (k, mark) in marks.iter().enumerate() {
                @let at = frame.x.at(mark.x);
                @let beyond_middle = at > f64::midpoint(left, right);
                line class="event" x1=(px(at)) x2=(px(at)) y1=(px(upper)) y2=(px(lower)) { title { (mark.label) } }
                @if k == 0 {
                    text class={ "event" @if beyond_middle { " end" } } y=(px(upper - 5.0))
                        x=(px(if beyond_middle { at + 4.0 } else { at - 4.0 })) { (mark.label) }
                }
            }
            @for (k, line) in self.lines.iter().enumerate() {
                @let places: Vec<(&[f64; 2], [f64; 2])> = line.points.iter().filter(shown)
                    .map(|p| (p, [frame.x.at(p[0]), frame.height(p[1])])).collect();
                polyline class={ "line " (colour(k)) } points=(path(&places)) {}
                @for (p, at) in &places {
                    @let value = if p[1].is_finite() { short(p[1]) } else { "exact".to_owned() };
                    (point(k, *at, 3.0, &format!("{}: {value} at {}", line.name, short(p[0]))))
                }
            }
        };
        let names: Vec<&str> = self.lines.iter().map(|l| l.name).collect();
        Drawing::new(self.title, &names, SIZE, drawing)
    }
}

fn path(places: &[(&[f64; 2], [f64; 2])]) -> String {
    places.iter().map(|(_, [x, y])| format!("{},{}", px(*x), px(*y))).collect::<Vec<_>>().join(" ")
}
