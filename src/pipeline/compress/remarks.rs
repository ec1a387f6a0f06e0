//! Remarks on a compression, which say what its figures mean for the user.

use super::fit::megabytes;
use crate::extension::has_extension;
use crate::gaussians::formats;
use crate::job::records::{Aim, CompressRecord, FineTuning, Truth};
use crate::metrics::Scores;
use std::path::Path;

/// PSNR in dB below which a file is called a poor copy.
const POOR: f64 = 40.0;
/// Excess over the wanted PSNR, in dB, that is reported.
const ABOVE: f64 = 0.1;
/// Excess of a file's PSNR in the pictures that chose it over that in the held-out ones, in dB, that is reported.
const APART: f64 = 2.0;
/// Loss in dB by fine-tuning that is reported.
const WORSE: f64 = 0.01;
/// Loss in dB by packing alone that a compressed file does not need.
const PACKED: f64 = 3.0;

/// A line for the user.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Remark {
    /// A note for the user.
    Note(String),
    /// A warning that the file may not be what the user wanted.
    Warning(String),
}

/// Remarks that a file has more or less than was requested, or lacks its fine-tuning; without a request, that packing
/// ruined it or fine-tuning made it worse.
pub fn remarks(figures: &CompressRecord) -> Vec<Remark> {
    let CompressRecord { aim, input, output, test, .. } = figures;
    let of_aim = match aim.as_ref().map(|aim| (aim.aim, aim.chosen.psnr)) {
        Some((Aim::Bytes(size), _)) if aim.as_ref().is_some_and(|aim| aim.original) => Some(Remark::Note(format!(
            "the input already has this format and at most {}: its own bytes were written",
            megabytes(size as f64, 1)
        ))),
        Some((Aim::Bytes(size), _)) if output.gaussians == input.gaussians && 20 * output.bytes < 19 * size => {
            let [own, size] = [output.bytes, size].map(|bytes| megabytes(bytes as f64, 1));
            let is_finest = aim.as_ref().is_some_and(|aim| aim.chosen.rung + 1 == aim.rungs);
            let other = if is_finest {
                format!("no larger file, up to {size}, is better")
            } else {
                format!("no better file of up to {size} was found")
            };
            Some(Remark::Note(format!("the whole model takes {own} in this format: {other}")))
        }
        Some((Aim::Bytes(size), _))
            if output.gaussians < input.gaussians
                && (1..=size).contains(&input.bytes)
                && !has_extension(&input.path, &["json", "gltf"]) =>
        // files with parts elsewhere
        {
            Some(Remark::Note(format!(
                "the input holds all Gaussians in {}, no more bytes than requested: this format needs more for each Gaussian",
                megabytes(input.bytes as f64, 1)
            )))
        }
        Some((Aim::Psnr(wanted), Some(psnr))) if psnr < wanted => Some(Remark::Warning(format!(
            "no file tried in this format reaches {wanted} dB: the best one has {psnr:.2} dB"
        ))),
        Some((Aim::Psnr(_), Some(psnr))) if psnr.is_infinite() => {
            Some(Remark::Note("no smaller file was found: the pictures of this one equal the model's".to_owned()))
        }
        Some((Aim::Psnr(wanted), Some(psnr))) if psnr > wanted + ABOVE => Some(Remark::Note(format!(
            "no smaller file was found that reaches {wanted} dB: this one is {:.1} dB above",
            psnr - wanted
        ))),
        _ => None,
    };
    let tuned = aim.as_ref().and_then(|aim| aim.fine_tuning).filter(|tuning| !tuning.written);
    let shown = |psnr: f64| if psnr.is_finite() { format!("{psnr:.2}") } else { "equal pictures".to_owned() };
    let left_out = tuned.map(|FineTuning { psnr, psnr_without, .. }| {
        let without = shown(psnr_without);
        Remark::Note(format!("fine-tuning made the file worse ({psnr:.2} dB, {without} without), so it was left out"))
    });
    let psnr = |scores: &Option<Scores>| scores.as_ref().map(|scores| scores.psnr.unwrap_or(f64::INFINITY));
    let tuning = psnr(&test.pruned).zip(psnr(&test.fine_tuned)).filter(|(without, tuned)| tuned + WORSE < *without);
    let worse = tuning.filter(|_| aim.is_none()).map(|(without, tuned)| {
        Remark::Note(format!(
            "fine-tuning made the model worse ({tuned:.2} dB, {} without): use more iterations, or leave out --fine-tune",
            shown(without)
        ))
    });
    let packing = psnr(test.fine_tuned.as_ref().map_or(&test.pruned, |_| &test.fine_tuned)).zip(psnr(&test.written));
    let ruined = packing.filter(|(before, written)| aim.is_none() && before - written > PACKED);
    let clipped = formats::clip_warning(&output.path, figures.clipped).into_iter();
    let clipped = clipped.chain(formats::size_warning(&output.path, figures.outsized)).map(Remark::Warning);
    let notes = of_aim.into_iter().chain(few_views(figures)).chain(left_out).chain(worse);
    notes.chain(ruined.and_then(|(_, written)| poor(&output.path, written))).chain(clipped).collect()
}

/// The note that a file made for a size is much better in the pictures that chose it than in others.
fn few_views(figures: &CompressRecord) -> Option<Remark> {
    let CompressRecord { aim, output, protocol, test, .. } = figures;
    let aim = aim.as_ref().filter(|aim| matches!(aim.aim, Aim::Bytes(_)))?;
    // There are no more photos, and pages have no --views.
    if protocol.truth == Truth::Photos || has_extension(&output.path, &["html"]) {
        return None;
    }
    let written = test.written.as_ref()?.psnr.unwrap_or(f64::INFINITY);
    let (chosen, held_out) = (aim.chosen.psnr?, aim.fine_tuning.map_or(written, |tuning| tuning.psnr_without));
    (chosen - held_out > APART).then(|| {
        let chosen = if chosen.is_finite() { format!("{chosen:.1} dB") } else { "no loss".to_owned() };
        Remark::Note(format!(
            "few views: the file has {chosen} in the pictures by which it was chosen, and {held_out:.1} dB in the \
             held-out ones; give more --views"
        ))
    })
}

/// The warning of a poor copy, with the PSNR of its pictures.
pub fn poor(path: &Path, psnr: f64) -> Option<Remark> {
    (psnr < POOR).then(|| {
        Remark::Warning(format!(
            "{} is a poor copy: its pictures have {psnr:.1} dB against the model's; .ply and .glb lose nothing",
            path.display()
        ))
    })
}
