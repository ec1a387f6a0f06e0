//! Labelled points, such as time and accuracy: a line joins the Pareto front, the default is ringed, and whiskers show
//! spreads.

use super::frame::{Frame, SIZE};
use super::scale::Axis;
use super::{Drawing, colour, point, px};
use maud::html;

/// Distance of the baselines of two labels, of a label's baseline above its point, and of its beginning beside the point, in pixels.
const LINE: f64 = 15.0;
const ABOVE: f64 = 6.0;
const BESIDE: f64 = 12.0;
/// Width of a label's letter, and half of the size of a point, in pixels.
const LETTER: f64 = 7.0;
const DOT: f64 = 5.0;

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

/// Positions of accuracies on the vertical axis. Exact results have no position on a logarithmic or decibel axis: they lie beyond a
/// break of it ([`Axis::exact`]).
#[derive(Clone, Copy, Debug)]
pub struct Accuracies {
    log: bool,
    /// The value of exact results: an error of zero, or an infinite score.
    pub beyond: f64,
}

impl Accuracies {
    /// Positions for measured accuracies; `lower` is true if lower is better.
    pub fn new(measured: &[f64], lower: bool) -> Self {
        let log = lower && measured.iter().any(|v| *v > 0.0 && v.is_finite());
        Self { log, beyond: if lower { 0.0 } else { f64::INFINITY } }
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
    /// The points; exact ones lie beyond a break of the vertical axis, others that the axes cannot show are left out.
    pub points: Vec<Point>,
}

impl Front<'_> {
    /// The plot, for a page or a sheet.
    pub fn drawing(&self) -> Drawing {
        let shown = |p: &&Point| self.x.shows(p.at[0]) && (self.y.shows(p.at[1]) || self.y.exact(p.at[1]));
        let mut points: Vec<&Point> = self.points.iter().filter(shown).collect();
        points.sort_by(|a, b| a.at[0].total_cmp(&b.at[0]));
        let spreads = points.iter().flat_map(|p| p.spread).filter(|v| self.x.shows(*v));
        let ys: Vec<f64> = points.iter().map(|p| p.at[1]).collect();
        let frame = Frame::with_exact(&self.x, &self.y, points.iter().map(|p| p.at[0]).chain(spreads), &ys);
        let places: Vec<[f64; 2]> = points.iter().map(|p| [frame.x.at(p.at[0]), frame.height(p.at[1])]).collect();
        let whiskers: Vec<[f64; 2]> = points.iter().map(|p| p.spread.map(|v| frame.x.at(v))).collect();
        let front: Vec<String> = points
            .iter()
            .zip(&places)
            .filter(|(p, _)| p.front)
            .map(|(_, [x, y])| format!("{},{}", px(*x), px(*y)))
            .collect();
        let drawing = html! {
            (frame.draw(None))
            @if front.len() > 1 { polyline class={ "line " (colour(0)) } points=(front.join(" ")) {} }
            @for ((p, [x, y]), [from, to]) in points.iter().zip(&places).zip(&whiskers) {
                line class="axis" x1=(px(*from)) x2=(px(*to)) y1=(px(*y)) y2=(px(*y)) {}
                (point(usize::from(!p.front && !self.legend.is_empty()), [*x, *y], 4.5, &p.told))
                @if p.default { circle class="ring" cx=(px(*x)) cy=(px(*y)) r="8" {} }
            }
            @for (p, ([from, to], y)) in points.iter().zip(labels(&points, &places, &whiskers)) {
                @let at_right = from > frame.x.at(p.at[0]);
                text class={ "label" @if !at_right { " end" } } y=(px(y)) x=(px(if at_right { from } else { to })) { (p.label) }
            }
        };
        Drawing::new(self.title, self.legend, SIZE, drawing)
    }
}

/// Left and right end, and baseline, of each label: beside its point, above the whisker, and moved down or up to where it meets neither
/// another label nor another point, nor any whisker, of which the ends are given.
fn labels(points: &[&Point], places: &[[f64; 2]], whiskers: &[[f64; 2]]) -> Vec<([f64; 2], f64)> {
    let across = |i: usize| {
        let (x, width) = (places[i][0], points[i].label.chars().count() as f64 * LETTER);
        let from = if x + BESIDE + width <= SIZE[0] { x + BESIDE } else { x - BESIDE - width };
        [from, from + width]
    };
    let mut out: Vec<([f64; 2], f64)> = (0..places.len()).map(|i| (across(i), places[i][1] - ABOVE)).collect();
    let mut order: Vec<usize> = (0..places.len()).collect();
    order.sort_by(|a, b| places[*a][1].total_cmp(&places[*b][1]).then(a.cmp(b)));
    let [upper, lower] = Frame::along();
    for (k, &i) in order.iter().enumerate() {
        let ([from, to], own) = out[i];
        let label = |j: usize, at: f64| {
            let ([left, right], other) = out[j];
            from < right && left < to && (at - other).abs() < LINE - 0.5
        };
        let dot = |j: usize, at: f64| {
            let [x, y] = places[j];
            from < x + DOT && x - DOT < to && (at - 0.3 * LINE - y).abs() < 0.3 * LINE + DOT
        };
        let whisker = |j: usize, at: f64| {
            let ([left, right], y) = (whiskers[j], places[j][1]);
            from < right && left < to && at - 0.7 * LINE < y && y < at + 2.0
        };
        let free = |at: &f64| {
            (upper..lower).contains(at)
                && !order[..k].iter().any(|j| label(*j, *at))
                && !order.iter().any(|j| (*j != i && dot(*j, *at)) || whisker(*j, *at))
        };
        let steps = (0..=places.len()).map(|n| n as f64 * LINE);
        out[i].1 = steps.flat_map(|step| [own + step, own - step]).find(free).unwrap_or(own);
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
    fn labels_do_not_lie_on_each_other_nor_on_points() {
        let named = ["a", "b", "c", "d", "a rung with a long name, two"].map(|label| point(label, [0.0; 2]));
        let places = [[100.0, 150.0], [115.0, 140.0], [104.0, 151.0], [500.0, 243.0], [490.0, 243.0]];
        let points: Vec<&Point> = named.iter().collect();
        let none = places.map(|[x, _]| [x; 2]);
        let out = labels(&points, &places, &none);
        let baselines: Vec<f64> = out.iter().map(|(_, at)| *at).collect();
        assert_eq!(baselines, [159.0, 134.0, 130.0, 237.0, 237.0]);
        // The last one does not fit to the right of its point.
        assert!(out[4].0[1] < 490.0 && out[3].0[0] > 500.0, "{out:?}");
        // The first one lay on its own whisker.
        let mut long = none;
        long[0][1] += 60.0;
        let at = labels(&points, &places, &long)[0].1;
        assert!(!(148.0..160.5).contains(&at), "{at}");
    }

    #[test]
    fn whatever_comes_is_drawn() {
        let points = [[0.0, 1.0], [f64::NAN, 0.0], [3.0, f64::INFINITY], [2.0, 5.0]].map(|at| point("<a>", at)).into();
        let front = |points| Front { title: "t", x: Axis::log("x"), y: Axis::new("y"), legend: &["a", "b"], points };
        let text = front(points).drawing().figure().into_string();
        assert!(!text.contains("NaN") && !text.contains("inf") && text.contains("&lt;a&gt;"), "{text}");
        assert!(front(Vec::new()).drawing().figure().into_string().contains("svg"));
    }

    #[test]
    fn exact_results_lie_beyond_a_break_and_have_no_number() {
        let draw = |measured: &[f64], lower| {
            let accuracies = Accuracies::new(measured, lower);
            let at = [measured.first().copied(), None].map(|a| accuracies.place(a, true)).into_iter().flatten();
            let points = at.map(|y| point("a", [1.0, y])).collect();
            let front = Front { title: "t", x: Axis::new("x"), y: accuracies.axis("y"), legend: &[], points };
            front.drawing().figure().into_string()
        };
        for (measured, lower, row, number) in [(&[59.0][..], false, 40.0, "60"), (&[1e-3], true, 234.0, "0.001")] {
            let text = draw(measured, lower);
            assert!(text.contains(&format!("cy=\"{row:.1}\"")) && text.contains(">exact</text>"), "{text}");
            assert!(text.contains(&format!(">{number}</text>")), "{text}");
        }
        let alone = draw(&[], false);
        assert_eq!(alone.matches("class=\"mark end\"").count(), 1, "no numbers without measurements: {alone}");
    }
}
