//! Plots as SVG: inline on a page, whose style gives their colours, or as separate files. Both follow the reader's
//! light or dark scheme.

mod bars;
mod frame;
mod front;
mod lines;
mod scale;
mod sheet;

pub use bars::{Bar, Columns, bars, drawing_of_bars};
pub use front::{Accuracies, Front, Point};
pub use lines::{Line, Lines, Mark, Scatter, Spot};
pub use scale::Axis;
pub use sheet::sheet;

use maud::{Markup, html};

/// Number of colours in the style, used in turn.
const COLOURS: usize = 6;

/// The CSS class of colour number `k`.
fn colour(k: usize) -> String {
    format!("c{}", k % COLOURS)
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
                                span { i class=(colour(k)) {} (name) }
                            }
                        }
                    }
                }
                svg viewBox={ "0 0 " (px(width)) " " (px(height)) } role="img" aria-label=(self.title) { (self.marks) }
            }
        }
    }
}
