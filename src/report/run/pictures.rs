//! Photo, dense and final model of a few held-out views, and where the last is wrong.

use crate::pipeline::evaluate::exhibits::exhibits;
use crate::pipeline::records::{RunRecord, ViewScores};
use crate::report::compare::{Layer, Stack, compare};
use crate::report::format::decimals;
use crate::report::page::absent;
use crate::report::picture::{data_uri, difference, read};
use maud::{Markup, html};
use std::path::Path;

/// How often the error is magnified.
const GAIN: u8 = 4;
/// What there may be of a view, in order.
const PHOTO: usize = 0;
const DENSE: usize = 1;
const LAST: usize = 2;
const ERROR: usize = 3;

/// The pictures below the folder `renders` that are shown; those that are absent are left out.
pub fn stacks(results: &RunRecord, renders: &Path) -> Vec<Stack> {
    let names: Vec<&str> = results.views.iter().map(|v| v.name.as_str()).collect();
    let mut out = Vec::new();
    for exhibit in exhibits(&names) {
        let [photo, last] = [&exhibit.photo, &exhibit.last].map(|file| read(&renders.join(file)));
        // A dense picture of an earlier run may lie there still.
        let dense = if results.prunes.is_empty() { None } else { read(&renders.join(&exhibit.dense)) };
        let error = photo.as_ref().zip(last.as_ref()).and_then(|(a, b)| difference(a, b, GAIN));
        let Some(size) = [&last, &photo, &dense].into_iter().flatten().next().map(|p| p.dimensions().into()) else {
            continue;
        };
        let layers = [(PHOTO, photo), (DENSE, dense), (LAST, last), (ERROR, error)]
            .into_iter()
            .filter_map(|(choice, picture)| Some(Layer { choice, uri: data_uri(&picture?)? }))
            .collect();
        out.push(Stack { name: exhibit.name, note: note(&results.views[exhibit.view]), size, layers });
    }
    out
}

fn note(view: &ViewScores) -> String {
    let psnr = view.scores.psnr.map_or("identical".to_owned(), |v| format!("PSNR {} dB", decimals(v, 2)));
    let lpips = view.scores.lpips_vgg.map(|v| format!(", LPIPS {}", decimals(v, 4)));
    format!("{psnr}, SSIM {}{}", decimals(view.scores.ssim, 4), lpips.unwrap_or_default())
}

pub fn body(results: &RunRecord, stacks: &[Stack]) -> Markup {
    if stacks.is_empty() {
        return absent("No view is held out, so there is no picture to compare.");
    }
    let last = if results.prunes.is_empty() { "trained" } else { "compressed" };
    html! {
        p class="hint" {
            "Drag over a picture to move the border between left and right. The error is the absolute difference of photo and "
            (last) " model, times " (GAIN) "."
        }
        (compare(&["ground truth", "dense", last, "error"], [PHOTO, LAST], stacks))
    }
}
