//! The file of a fine-tuned model, or the one from before fine-tuning if that is better.

use super::fit::{self, Judge, Target};
use super::scoring::Scoring;
use crate::gaussians::Gaussians;
use crate::gaussians::formats::{self, RenderMode};
use crate::job::Error;
use crate::job::records::{Aim, AimRecord, FineTuning, Point};
use crate::metrics::{self, Scores};

/// A packed model.
pub struct Packed {
    /// The model.
    pub model: Gaussians,
    /// The model in its format.
    pub bytes: Vec<u8>,
    /// Scores of its pictures in the held-out views.
    pub scores: Vec<Scores>,
}

/// Packs a tuned model into the size of the file that a search found before tuning, and returns that of both files with the higher PSNR; the
/// record tells which.
pub fn better(
    scoring: &mut Scoring<'_>,
    judge: &Judge<'_>,
    untuned: Packed,
    mut model: Gaussians,
    record: &mut AimRecord,
    (target, mode): (&Target<'_>, RenderMode),
) -> Result<Packed, Error> {
    let most = if let Aim::Bytes(size) = record.aim { size } else { target.length(&untuned.bytes) };
    let (bytes, rung, precision) = fit::within(&mut model, mode, most, record.chosen.rung, target)?;
    // Packing may have removed Gaussians or bands, so the file is read back in every format.
    let scores = scoring.scores_of(&formats::read_bytes(&bytes, target.format).map_err(Error::writing)?.gaussians)?;
    let tuned = Packed { model, bytes, scores };
    let psnr = |file: &Packed| match metrics::mean(&file.scores) {
        Some(mean) => Ok(mean.psnr.unwrap_or(f64::INFINITY)),
        None => judge.psnr(&file.bytes, target.format),
    };
    let (with, without) = (psnr(&tuned)?, psnr(&untuned)?);
    let written = with >= without;
    record.fine_tuning = Some(FineTuning { written, psnr: with, psnr_without: without });
    record.written = Some(Point { psnr: None, ..record.chosen });
    if !written {
        return Ok(untuned);
    }
    let (gaussians, size) = (tuned.model.len(), target.length(&tuned.bytes));
    record.written = Some(Point { rung, gaussians, bytes: size, psnr: None });
    record.precision = precision;
    Ok(tuned)
}
