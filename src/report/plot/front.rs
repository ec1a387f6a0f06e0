//! Labelled points, such as time and accuracy: a line joins the Pareto front, the default is ringed, and whiskers show
//! spreads.

use super::frame::{Frame, SIZE};
use super::scale::Axis;
use super::{Drawing, colour, point, px};
use maud::{Markup, html};

/// Least distance of two labels, in pixels.
const LINE: f64 = 13.0;

/// A labelled point.
pub struct Point {
    /// Its label.
    pub label: String,
    /// Its tooltip.
    pub told: String,
    /// x and y.
    pub at: [f64; 2],
    /// Quartiles of x; if both equal x, there is no whisker.
    pub spread: [f64; 2],
    /// True if it is on the front, which the line joins.
    pub front: bool,
    /// True if it is the engine's default.
    pub default: bool,
}

/// Positions of accuracies on the vertical axis. Exact results have no position on a logarithmic or decibel axis: they
/// are drawn one step beyond all others.
#[derive(Clone, Copy, Debug)]
pub struct Accuracies {
    log: bool,
    /// Position of exact results.
    pub beyond: f64,
}

impl Accuracies {
    /// Positions for measured accuracies; `lower` is true if lower is better.
    pub fn new(measured: &[f64], lower: bool) -> Self {
        let least = measured.iter().copied().filter(|v| *v > 0.0).fold(f64::INFINITY, f64::min);
        let (low, high) = measured.iter().fold((f64::INFINITY, f64::NEG_INFINITY), |(l, h), v| (l.min(*v), h.max(*v)));
        let log = lower && least.is_finite();
        let beyond = match () {
            () if log => 0.1 * least,
            () if lower || measured.is_empty() => 0.0,
            () => high + (0.25 * (high - low)).max(1.0),
        };
        Self { log, beyond }
    }

    /// A rung's position; `None` if it is neither measured nor exact.
    pub fn place(self, accuracy: Option<f64>, exact: bool) -> Option<f64> {
        match accuracy {
            Some(a) if self.log && a <= 0.0 => Some(self.beyond),
            Some(a) => Some(a),
            None => exact.then_some(self.beyond),
        }
    }

    /// The vertical axis.
    pub fn axis(self, title: &str) -> Axis<'_> {
        if self.log { Axis::log(title) } else { Axis::new(title) }
    }
}

/// Labelled points between two axes.
pub struct Front<'a> {
    /// Title of the plot.
    pub title: &'a str,
    /// Horizontal axis.
    pub x: Axis<'a>,
    /// Vertical axis.
    pub y: Axis<'a>,
    /// Legend of the points on the line, and of the others; empty for none.
    pub legend: &'a [&'a str],
    /// The points; those that the axes cannot show are left out.
    pub points: Vec<Point>,
}

impl Front<'_> {
    /// The plot.
    pub fn draw(&self) -> Markup {
        self.drawing().figure()
    }

    /// The plot, for a page or a sheet.
    pub fn drawing(&self) -> Drawing {
        let mut points: Vec<&Point> =
            self.points.iter().filter(|p| self.x.shows(p.at[0]) && self.y.shows(p.at[1])).collect();
        points.sort_by(|a, b| a.at[0].total_cmp(&b.at[0]));
        let spreads = points.iter().flat_map(|p| p.spread).filter(|v| self.x.shows(*v));
        let frame =
            Frame::new(&self.x, &self.y, points.iter().map(|p| p.at[0]).chain(spreads), points.iter().map(|p| p.at[1]));
        let [left, right] = Frame::across();
        let places: Vec<[f64; 2]> = points.iter().map(|p| [frame.x.at(p.at[0]), frame.y.at(p.at[1])]).collect();
        let front: Vec<String> = points
            .iter()
            .zip(&places)
            .filter(|(p, _)| p.front)
            .map(|(_, [x, y])| format!("{},{}", px(*x), px(*y)))
            .collect();
        let at_right = |x: f64| x < left + 0.65 * (right - left);
        let labels = labels(&points, &places, at_right);
        let drawing = html! {
            (frame.draw(None))
            @if front.len() > 1 { polyline class={ "line " (colour(0)) } points=(front.join(" ")) {} }
            @for (p, [x, y]) in points.iter().zip(&places) {
                @let [from, to] = p.spread.map(|v| frame.x.at(v));
                line class="axis" x1=(px(from)) x2=(px(to)) y1=(px(*y)) y2=(px(*y)) {}
                (point(usize::from(!p.front && !self.legend.is_empty()), [*x, *y], 4.5, &p.told))
                @if p.default { circle class="ring" cx=(px(*x)) cy=(px(*y)) r="8" {} }
            }
            @for ((p, [x, _]), label) in points.iter().zip(&places).zip(&labels) {
                @let at_right = at_right(*x);
                text class={ "label" @if !at_right { " end" } } y=(px(*label))
                    x=(px(if at_right { x + BESIDE } else { x - BESIDE })) { (p.label) }
            }
        };
        Drawing::new(self.title, self.legend, SIZE, drawing)
    }
}

/// Distance of a label from its point, and width of its letters, in pixels.
const BESIDE: f64 = 12.0;
const LETTER: f64 = 6.6;

/// Heights of labels: one that would lie on another is placed below it.
fn labels(points: &[&Point], places: &[[f64; 2]], at_right: impl Fn(f64) -> bool) -> Vec<f64> {
    let mut out: Vec<f64> = places.iter().map(|[_, y]| y + 4.0).collect();
    let mut order: Vec<usize> = (0..places.len()).collect();
    order.sort_by(|a, b| places[*a][1].total_cmp(&places[*b][1]).then(a.cmp(b)));
    let across = |i: usize| {
        let (x, width) = (places[i][0], points[i].label.chars().count() as f64 * LETTER);
        if at_right(x) { [x + BESIDE, x + BESIDE + width] } else { [x - BESIDE - width, x - BESIDE] }
    };
    for (k, &i) in order.iter().enumerate() {
        let [from, to] = across(i);
        let beside: Vec<usize> =
            order[..k].iter().copied().filter(|j| from < across(*j)[1] && across(*j)[0] < to).collect();
        // Each step leaves one of them above for good.
        while let Some(on) = beside.iter().find(|j| (out[i] - out[**j]).abs() < LINE - 0.5) {
            out[i] = out[*on] + LINE;
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    fn point(label: &str, at: [f64; 2]) -> Point {
        let spread = [at[0], f64::NAN];
        Point { label: label.into(), told: String::new(), at, spread, front: true, default: true }
    }

    #[test]
    fn labels_do_not_lie_on_each_other() {
        let named = ["a", "b", "c", "d", "a rung with a long name, two"].map(|label| point(label, [0.0; 2]));
        let places = [[10.0, 50.0], [12.0, 50.0], [14.0, 51.0], [400.0, 50.0], [200.0, 52.0]];
        let out = labels(&named.iter().collect::<Vec<_>>(), &places, |x| x < 200.0);
        assert_eq!(out, [54.0, 67.0, 80.0, 54.0, 93.0]);
    }

    #[test]
    fn whatever_comes_is_drawn() {
        let points = [[0.0, 1.0], [f64::NAN, 0.0], [3.0, f64::INFINITY], [2.0, 5.0]].map(|at| point("<a>", at)).into();
        let front = |points| Front { title: "t", x: Axis::log("x"), y: Axis::new("y"), legend: &["a", "b"], points };
        let text = front(points).draw().into_string();
        assert!(!text.contains("NaN") && !text.contains("inf") && text.contains("&lt;a&gt;"), "{text}");
        assert!(front(Vec::new()).draw().into_string().contains("svg"));
    }
}
