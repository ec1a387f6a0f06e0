//! Plots as one self-contained SVG file: with its own style, and its own background, since a page that shows it may be
//! dark when the reader's scheme is light.

use super::{COLOURS, Drawing, colour, point, px};
use maud::{PreEscaped, html};

/// The page's style, which gives the colours.
const PAGE: &str = include_str!("../style.css");

/// Margin around a drawing, and the heights of its title and of its legend.
const MARGIN: f64 = 16.0;
const TITLE: f64 = 22.0;
const LEGEND: f64 = 20.0;
/// Width of a legend's letter, and the gap between its names.
const LETTER: f64 = 6.4;
const APART: f64 = 30.0;

/// The drawings in rows of `columns`; `title` is for readers who cannot see them.
pub fn sheet(title: &str, drawings: &[Drawing], columns: usize) -> String {
    let columns = columns.clamp(1, drawings.len().max(1));
    let width = drawings.iter().map(|d| d.size[0]).fold(0.0, f64::max) + 2.0 * MARGIN;
    let rows: Vec<&[Drawing]> = drawings.chunks(columns).collect();
    let heights: Vec<f64> = rows.iter().map(|row| row.iter().map(height).fold(0.0, f64::max) + MARGIN).collect();
    let size = [columns as f64 * width, heights.iter().sum::<f64>() + MARGIN];
    let top = |row: usize| MARGIN + heights[..row].iter().sum::<f64>();
    let [all_width, all_height] = size.map(px);
    let drawn = html! {
        svg xmlns="http://www.w3.org/2000/svg" viewBox={ "0 0 " (all_width) " " (all_height) } width=(all_width) height=(all_height)
            role="img" aria-label=(title) {
            style { (PreEscaped(style())) }
            rect class="card" x="0.5" y="0.5" width=(px(size[0] - 1.0)) height=(px(size[1] - 1.0)) rx="8" {}
            @for (row, drawings) in rows.iter().enumerate() {
                @for (column, drawing) in drawings.iter().enumerate() {
                    @let left = column as f64 * width + MARGIN;
                    g transform={ "translate(" (px(left)) " " (px(top(row))) ")" } {
                        text class="name" x="4" y="14" { (drawing.title) }
                        @for (k, (name, at)) in legend(drawing).enumerate() {
                            (point(k, [at + 8.0, TITLE + 6.0], 4.0, ""))
                            text class="mark" x=(px(at + 16.0)) y=(px(TITLE + 10.0)) { (name) }
                        }
                        g transform={ "translate(0 " (px(height(drawing) - drawing.size[1])) ")" } { (drawing.marks) }
                    }
                }
            }
        }
    };
    drawn.into_string() + "\n"
}

fn height(drawing: &Drawing) -> f64 {
    TITLE + if drawing.legend.len() > 1 { LEGEND } else { 0.0 } + drawing.size[1]
}

/// Names with their positions.
fn legend(drawing: &Drawing) -> impl Iterator<Item = (&str, f64)> {
    let shown = if drawing.legend.len() > 1 { &drawing.legend[..] } else { &[] };
    shown.iter().scan(0.0, |at, name| {
        let own = *at;
        *at += name.chars().count() as f64 * LETTER + APART;
        Some((name.as_str(), own))
    })
}

/// The value of `--name` in the page's style, in the light or the dark scheme.
fn page_colour(name: &str, dark: bool) -> &'static str {
    let key = format!("--{name}: ");
    let mut values = PAGE.split(key.as_str()).skip(1).filter_map(|rest| rest.split(';').next());
    let light = values.next().unwrap_or("#888888");
    if dark { values.next().unwrap_or(light) } else { light }
}

fn style() -> String {
    let colours = |dark: bool| {
        let of = |name: &str| page_colour(name, dark);
        let mut text = format!(
            ".card{{fill:{card};stroke:{rule}}}.label{{stroke:{card}}}text{{fill:{text}}}.rule{{stroke:{rule}}}.axis{{stroke:{muted}}}\
             .mark,.title,.above{{fill:{muted}}}.ring{{stroke:{text}}}line.event{{stroke:{event}}}text.event{{fill:{event}}}",
            card = of("card"),
            rule = of("rule"),
            text = of("text"),
            muted = of("muted"),
            event = of("event"),
        );
        for k in 0..COLOURS {
            let (class, own) = (colour(k), of(&colour(k)));
            text += &format!(".{class}{{fill:{own}}}.line.{class}{{stroke:{own}}}");
        }
        text
    };
    format!(
        "text{{font:12px system-ui,\"Segoe UI\",Roboto,\"DejaVu Sans\",sans-serif}}.name{{font-size:14px;font-weight:600}}\
         .above{{font-size:10.5px}}.end{{text-anchor:end}}.middle{{text-anchor:middle}}.ring{{fill:none;stroke-width:1.5}}\
         .label{{paint-order:stroke;stroke-width:3px;stroke-linejoin:round}}line.event{{stroke-dasharray:4 3}}{}@media(prefers-color-scheme:dark){{{}}}\
         .line[class]{{fill:none;stroke-width:2;stroke-linejoin:round}}",
        colours(false),
        colours(true)
    )
}

#[cfg(test)]
mod tests {
    use super::super::{Axis, Bar, Line, Lines, bars};
    use super::*;

    #[test]
    fn a_sheet_stands_alone() {
        let bars = bars("<bars>", &[Bar { name: "a & b".into(), value: 1.0, text: "1".into() }]);
        let line = |name| Line { name, points: vec![[0.0, 1.0], [2.0, f64::NAN], [3.0, 4.0]] };
        let (x, y) = (Axis::new("x"), Axis::from_zero("y"));
        let lines = Lines { title: "lines", x, y, lines: vec![line("one"), line("two")], marks: Vec::new() }.drawing();
        let text = sheet("both", &[bars, lines], 2);
        assert!(text.starts_with("<svg xmlns=") && text.ends_with("</svg>\n"));
        for there in ["&lt;bars&gt;", "a &amp; b", ">two<", "prefers-color-scheme:dark", "#1d2128", "#2f6fd0"] {
            assert!(text.contains(there), "{there}");
        }
        for absent in ["NaN", "var(", "#888888"] {
            assert!(!text.contains(absent), "{absent}");
        }
        assert!(sheet("nothing", &[], 3).contains("</svg>"));
    }
}
