//! Plots as inline SVG: colours come from the page's style, so that they follow its light or dark scheme.

mod bars;
mod frame;
mod front;
mod lines;
mod scale;

pub use bars::{Bar, Columns, bars};
pub use front::{Front, Point};
pub use lines::{Line, Lines, Mark, Scatter, Spot};
pub use scale::Axis;

use maud::{Markup, html};

/// Colours that the style knows, used in turn.
const COLOURS: usize = 6;

/// The class of colour number `k`.
fn colour(k: usize) -> String {
    format!("c{}", k % COLOURS)
}

/// A coordinate or length: finite, with one decimal.
fn px(value: f64) -> String {
    format!("{:.1}", if value.is_finite() { value } else { 0.0 })
}

/// A drawing of this size with its title, and with a legend of more than one series.
fn figure(title: &str, legend: &[&str], [width, height]: [f64; 2], drawing: &Markup) -> Markup {
    html! {
        figure class="plot" {
            figcaption {
                (title)
                @if legend.len() > 1 {
                    span class="legend" {
                        @for (k, name) in legend.iter().enumerate() {
                            span { i class=(colour(k)) {} (name) }
                        }
                    }
                }
            }
            svg viewBox={ "0 0 " (px(width)) " " (px(height)) } role="img" aria-label=(title) { (drawing) }
        }
    }
}
