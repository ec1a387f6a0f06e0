//! Plots as SVG: inline on a page, whose style gives their colours, or as separate files. Both follow the reader's
//! light or dark scheme.

mod bars;
mod frame;
mod front;
mod lines;
mod scale;
mod sheet;

pub use bars::{Bar, Columns, bars};
pub use front::{Accuracies, Front, Point};
pub use lines::{Line, Lines, Mark};
pub use scale::Axis;
pub use sheet::sheet;

use maud::{Markup, html};

/// Number of colours in the style, and of shapes of points, used in turn.
const COLOURS: usize = 6;

/// The CSS class of colour number `k`.
fn colour(k: usize) -> String {
    format!("c{}", k % COLOURS)
}

/// A point of series number `k`, with a tooltip if `told` says something: each colour has a shape of its own, for those who cannot tell colours apart.
fn point(k: usize, [x, y]: [f64; 2], radius: f64, told: &str) -> Markup {
    // Corners as shares of the radius: about as much area as the circle.
    let corners: &[[f64; 2]] = match k % COLOURS {
        1 => &[[-0.9, -0.9], [0.9, -0.9], [0.9, 0.9], [-0.9, 0.9]],
        2 => &[[0.0, -1.3], [1.25, 0.9], [-1.25, 0.9]],
        3 => &[[0.0, -1.3], [1.3, 0.0], [0.0, 1.3], [-1.3, 0.0]],
        4 => &[[0.0, 1.3], [1.25, -0.9], [-1.25, -0.9]],
        5 => &[[-1.2, -1.2], [0.0, -0.5], [1.2, -1.2], [0.5, 0.0], [1.2, 1.2], [0.0, 0.5], [-1.2, 1.2], [-0.5, 0.0]],
        _ => &[],
    };
    let path: Vec<String> =
        corners.iter().map(|[u, v]| format!("{},{}", px(x + u * radius), px(y + v * radius))).collect();
    let tooltip = html! { @if !told.is_empty() { title { (told) } } };
    html! {
        @if path.is_empty() {
            circle class={ "dot " (colour(k)) } cx=(px(x)) cy=(px(y)) r=(px(radius)) { (tooltip) }
        } @else {
            polygon class={ "dot " (colour(k)) } points=(path.join(" ")) { (tooltip) }
        }
    }
}

/// A coordinate or length: finite, with one decimal.
fn px(value: f64) -> String {
    format!("{:.1}", if value.is_finite() { value } else { 0.0 })
}

/// A plot, for a page or a sheet.
pub struct Drawing {
    title: String,
    /// Names of the series; a legend is shown for more than one.
    legend: Vec<String>,
    size: [f64; 2],
    marks: Markup,
}

impl Drawing {
    fn new(title: &str, legend: &[&str], size: [f64; 2], marks: Markup) -> Self {
        Self { title: title.to_owned(), legend: legend.iter().map(|&name| name.to_owned()).collect(), size, marks }
    }

    /// The plot for a page, whose style gives the colours.
    pub fn figure(&self) -> Markup {
        let [width, height] = self.size;
        html! {
            figure class="plot" {
                figcaption {
                    (self.title)
                    @if self.legend.len() > 1 {
                        span class="legend" {
                            @for (k, name) in self.legend.iter().enumerate() {
                                span { svg viewBox="0 0 12 12" { (point(k, [6.0; 2], 4.0, "")) } (name) }
                            }
                        }
                    }
                }
                svg viewBox={ "0 0 " (px(width)) " " (px(height)) } role="img" aria-label=(self.title) { (self.marks) }
            }
        }
    }
}
