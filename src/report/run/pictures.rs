//! Photo, dense model, final model and error of a few held-out views.

use crate::job::records::{RunRecord, ViewScores};
use crate::pipeline::evaluate::exhibits::{Exhibit, exhibits};
use crate::report::format::decimals;
use crate::report::page::absent;
use crate::report::picture::{data_uri, difference, read};
use crate::report::slider::{Layer, Stack, compare};
use maud::{Markup, html};
use rayon::prelude::*;
use std::path::Path;

/// Factor by which the error is magnified.
const GAIN: u8 = 4;
/// The pictures of a view, in order; each may be missing.
const PHOTO: usize = 0;
const DENSE: usize = 1;
const LAST: usize = 2;
const ERROR: usize = 3;

/// The pictures to show from the folder `renders`; missing ones are left out.
pub fn stacks(results: &RunRecord, renders: &Path) -> Vec<Stack> {
    let names: Vec<&str> = results.views.iter().map(|v| v.name.as_str()).collect();
    exhibits(&names).into_par_iter().filter_map(|exhibit| stack(exhibit, results, renders)).collect()
}

/// The pictures of one view; `None` if all are missing.
fn stack(exhibit: Exhibit, results: &RunRecord, renders: &Path) -> Option<Stack> {
    let [photo, last] = [&exhibit.photo, &exhibit.last].map(|file| read(&renders.join(file)));
    // The folder may still contain a dense picture of an earlier run.
    let dense = if results.prunes.is_empty() { None } else { read(&renders.join(&exhibit.dense)) };
    let error = photo.as_ref().zip(last.as_ref()).and_then(|(a, b)| difference(a, b, GAIN));
    let size = [&last, &photo, &dense].into_iter().flatten().next()?.dimensions().into();
    let layers = [(PHOTO, photo), (DENSE, dense), (LAST, last), (ERROR, error)]
        .into_par_iter()
        .filter_map(|(choice, picture)| Some(Layer { choice, uri: data_uri(&picture?)? }))
        .collect();
    Some(Stack { name: exhibit.name, note: note(&results.views[exhibit.view]), size, layers })
}

fn note(view: &ViewScores) -> String {
    if !view.scores.counts() {
        return view.scores.notes.join("; ");
    }
    let psnr = view.scores.psnr.map_or("identical".to_owned(), |v| format!("PSNR {} dB", decimals(v, 2)));
    let lpips = view.scores.lpips_vgg.map(|v| format!(", LPIPS {}", decimals(v, 4)));
    format!("{psnr}, SSIM {}{}", decimals(view.scores.ssim, 4), lpips.unwrap_or_default())
}

pub fn body(results: &RunRecord, stacks: &[Stack]) -> Markup {
    if stacks.is_empty() {
        return absent("No view was held out, so there are no pictures to compare.");
    }
    let last = if results.prunes.is_empty() { "trained" } else { "compressed" };
    html! {
        p class="hint" {
            "Drag across a picture to move the border between left and right. The error is the absolute difference between the photo \
             and the " (last) " model, times " (GAIN) "."
        }
        (compare(&["ground truth", "dense", last, "error"], [PHOTO, LAST], stacks))
    }
}
