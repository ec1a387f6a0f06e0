//! Pictures of one view, stacked, with a slider between any two of them.

use maud::{Markup, html};

/// A picture and its choice.
pub struct Layer {
    /// Index of its choice.
    pub choice: usize,
    /// The picture as a `data:` URI.
    pub uri: String,
}

/// Pictures of one view, all of the same size.
pub struct Stack {
    /// The view's name.
    pub name: String,
    /// Caption beside the name.
    pub note: String,
    /// Width and height in pixels.
    pub size: [u32; 2],
    /// The pictures.
    pub layers: Vec<Layer>,
}

/// Stacks below one row of choices per side; `at_first` are the choices shown left and right of the slider at first.
/// Choices that no stack has are left out.
pub fn compare(choices: &[&str], at_first: [usize; 2], stacks: &[Stack]) -> Markup {
    let there = |choice: usize| stacks.iter().any(|s| s.layers.iter().any(|l| l.choice == choice));
    let offered: Vec<usize> = (0..choices.len()).filter(|c| there(*c)).collect();
    let [left, right] = at_first.map(|c| if there(c) { c } else { offered.first().copied().unwrap_or(0) });
    let row = |side: &str, shown: usize| {
        html! {
            div class="choices" role="group" aria-label={ (side) " of the slider" } {
                span { (side) }
                @for &c in &offered {
                    button type="button" data-side=(side) data-choice=(c) aria-pressed=(c == shown) { (choices[c]) }
                }
            }
        }
    };
    let class = |choice: usize| match (choice == left, choice == right) {
        (true, true) => "left right",
        (true, false) => "left",
        (false, true) => "right",
        _ => "",
    };
    html! {
        div class="compare" {
            div class="controls" { (row("left", left)) (row("right", right)) }
            div class="grid" {
                @for stack in stacks {
                    figure {
                        div class="stack" style={ "aspect-ratio:" (stack.size[0]) "/" (stack.size[1]) } {
                            @for layer in &stack.layers {
                                img class=(class(layer.choice)) data-choice=(layer.choice) src=(layer.uri)
                                    alt={ (stack.name) ": " (choices[layer.choice]) };
                            }
                            span class="line" {}
                            span class="tag" data-side="left" { (choices[left]) }
                            span class="tag" data-side="right" { (choices[right]) }
                            input type="range" min="0" max="100" step="0.1" value="50"
                                aria-label={ (stack.name) ": position of the border" };
                        }
                        figcaption { (stack.name) " " span class="note" { (stack.note) } }
                    }
                }
            }
        }
    }
}
