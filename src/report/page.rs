//! The shell of every page (style, script, headings) and the parts of its sections (tiles, tables, lists).

use super::format::NONE;
use maud::{DOCTYPE, Markup, PreEscaped, html};

/// The page loads nothing from outside.
const POLICY: &str =
    "default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src 'unsafe-inline'; worker-src blob:";

/// A part of a page under a heading: the anchor of links, the heading and the content.
pub struct Section(pub &'static str, pub &'static str, pub Markup);

/// A whole page in one self-contained file.
pub fn page(title: &str, subtitle: &str, sections: &[Section]) -> String {
    html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta http-equiv="Content-Security-Policy" content=(POLICY);
                meta name="viewport" content="width=device-width, initial-scale=1";
                meta name="color-scheme" content="light dark";
                title { (title) }
                style { (PreEscaped(include_str!("style.css"))) }
            }
            body {
                header {
                    h1 { (title) }
                    p { (subtitle) }
                    nav { @for Section(id, title, _) in sections { a href={ "#" (id) } { (title) } " " } }
                }
                main {
                    @for Section(id, title, body) in sections {
                        section id=(id) {
                            h2 { (title) }
                            (body)
                        }
                    }
                }
                script { (PreEscaped(include_str!("script.js"))) }
            }
        }
    }
    .into_string()
}

/// A large figure: its name, its value with the unit, and a value or a note for comparison.
pub type Tile = (&'static str, String, String);

/// Tiles side by side.
pub fn tiles(tiles: &[Tile]) -> Markup {
    html! {
        div class="tiles" {
            @for (label, value, note) in tiles {
                div class="tile" {
                    div class="label" { (label) }
                    div class="value" { (value) }
                    div class="note" { (note) }
                }
            }
        }
    }
}

/// A column of a table.
#[derive(Clone, Copy)]
pub enum Column<'a> {
    /// Text, aligned left.
    Text(&'a str),
    /// Numbers, aligned right.
    Number(&'a str),
}

impl Column<'_> {
    fn title(&self) -> &str {
        match self {
            Self::Text(title) | Self::Number(title) => title,
        }
    }

    fn class(&self) -> Option<&'static str> {
        matches!(self, Self::Number(_)).then_some("number")
    }
}

/// A table; `foot` is a last row of another kind, such as means. Columns after the first in which no row has a value are left out. Long
/// tables scroll.
pub fn table(columns: &[Column<'_>], rows: &[Vec<String>], foot: Option<&[String]>) -> Markup {
    let says = |k: usize| rows.iter().any(|row| row.get(k).is_some_and(|cell| !cell.is_empty() && cell != NONE));
    let shown: Vec<(usize, &Column<'_>)> =
        columns.iter().enumerate().filter(|(k, _)| *k == 0 || rows.is_empty() || says(*k)).collect();
    let cells = |row: &[String]| {
        html! { tr { @for (k, column) in &shown { td class=[column.class()] { (row.get(*k).map_or("", String::as_str)) } } } }
    };
    html! {
        div class="table" {
            table {
                thead { tr { @for (_, column) in &shown { th scope="col" class=[column.class()] { (column.title()) } } } }
                tbody { @for row in rows { (cells(row)) } }
                @if let Some(row) = foot { tfoot { (cells(row)) } }
            }
        }
    }
}

/// A column, and what it says of a thing.
pub type Said<'a, T> = (Column<'a>, &'a dyn Fn(&T) -> String);

/// A table of things.
pub fn list<T>(things: &[T], columns: &[Said<'_, T>]) -> Markup {
    let titles: Vec<Column<'_>> = columns.iter().map(|(column, _)| *column).collect();
    let row = |thing| columns.iter().map(|(_, of)| of(thing)).collect();
    table(&titles, &things.iter().map(row).collect::<Vec<_>>(), None)
}

/// A list of names and values.
pub fn facts(facts: &[(&str, String)]) -> Markup {
    html! {
        dl class="facts" { @for (name, value) in facts { div { dt { (name) } dd { (value) } } } }
    }
}

/// Plots or other blocks, side by side if there is room.
pub fn side_by_side(blocks: &[Markup]) -> Markup {
    html! { div class="grid" { @for block in blocks { (block) } } }
}

/// A sentence that replaces missing content.
pub fn absent(sentence: &str) -> Markup {
    html! { p class="absent" { (sentence) } }
}

#[cfg(test)]
mod tests {
    use super::Column::{Number, Text};
    use super::*;

    #[test]
    fn columns_without_a_value_are_left_out() {
        let rows = [["a", NONE, "1", ""], ["b", NONE, NONE, ""]].map(|row| row.map(str::to_owned).to_vec());
        let columns = [Text("name"), Number("before"), Number("after"), Text("note")];
        let text = table(&columns, &rows, Some(&rows[0])).into_string();
        assert!(text.contains("name") && text.contains("after") && text.matches("<td").count() == 6, "{text}");
        assert!(!text.contains("before") && !text.contains("note"), "{text}");
        assert!(table(&columns, &[], None).into_string().contains("before"));
    }
}
