//! Loss by a format: the pictures of a packed model against those of the original.

use super::fit::Target;
use crate::gaussians::Gaussians;
use crate::gaussians::formats;
use crate::job::{Error, Session};
use crate::pipeline::eval;
use crate::render::Style;

/// PSNR in dB of a file's pictures that suffices.
const FINE: f64 = 44.0;

/// Packs a whole model, and measures the PSNR of its pictures in dB; none if they are equal. The settings are the format's
/// usual ones, or finer ones if the loss is visible.
pub fn pack(
    session: &Session<'_>,
    model: &Gaussians,
    style: Style,
    target: &Target<'_>,
) -> Result<(Vec<u8>, Option<f64>), Error> {
    let usual = target.usual(model);
    let ladder = target.ladder(model);
    let rungs: Vec<_> = ladder.rungs.iter().map(|rung| rung.with_all_means()).collect();
    let from = rungs.iter().position(|rung| *rung == usual).unwrap_or(rungs.len());
    let finer = ladder.steps.iter().filter(|step| **step > from).map(|step| rungs[*step]).filter(|rung| *rung != usual);
    let mut measured = measure(session, model, style, target, usual)?;
    for rung in finer {
        if measured.1.is_none_or(|psnr| psnr >= FINE) {
            break;
        }
        measured = measure(session, model, style, target, rung)?;
    }
    Ok(measured)
}

fn measure(
    session: &Session<'_>,
    model: &Gaussians,
    style: Style,
    target: &Target<'_>,
    precision: formats::Precision,
) -> Result<(Vec<u8>, Option<f64>), Error> {
    let packed = target.pack(model, style.mode(), precision)?;
    let read = formats::read_bytes(&packed, target.format).map_err(Error::writing)?;
    let scores = eval::against(session, [(&read.gaussians, style), (model, style)], [0.0; 3])?;
    Ok((packed, scores.mean().and_then(|mean| mean.psnr)))
}
