//! Spherical harmonics and sizes that a format cuts off.

use std::path::Path;

use rayon::prelude::*;

use super::{Format, ply, spz, written_as};
use crate::extension::has_extension;
use crate::gaussians::Gaussians;
use crate::wording::counted;

/// The format of the model in a file of this name, and the greatest magnitudes of SH coefficients that it stores, in band 0 and above it;
/// none if it stores any.
fn limits(path: &Path) -> Option<(Format, [f32; 2])> {
    // A page contains an SPZ.
    let format = if has_extension(path, &["html"]) { Some(Format::Spz) } else { written_as(path) };
    match format? {
        Format::Spz => Some((Format::Spz, spz::SH_LIMITS)),
        Format::CompressedPly => Some((Format::CompressedPly, [f32::INFINITY, ply::SH_LIMIT])),
        _ => None,
    }
}

/// The number of Gaussians with an SH coefficient that is cut off in a file of this name: a model file, or a page.
pub fn clipped(path: &Path, model: &Gaussians) -> usize {
    let Some((_, limits)) = limits(path) else { return 0 };
    let is_clipped = |i: &usize| {
        model.sh.iter().enumerate().any(|(l, band)| {
            let (width, most) = (Gaussians::band_width(l), limits[usize::from(l > 0)]);
            band.get(i * width..(i + 1) * width).is_some_and(|row| row.iter().any(|value| value.abs() > most))
        })
    };
    (0..model.len()).into_par_iter().filter(is_clipped).count()
}

/// The number of Gaussians one of whose two larger axes is beyond those that a file of this name stores, by more than a step: SPZ gives
/// them the nearest size. A page contains a model that is scaled to fit.
pub fn outsized(path: &Path, model: &Gaussians) -> usize {
    const STEP: f32 = 1.0 / 16.0;
    if written_as(path) != Some(Format::Spz) {
        return 0;
    }
    let stored = spz::LOG_SCALES.start() - STEP..=spz::LOG_SCALES.end() + STEP;
    let is_outsized = |scales: &&[f32; 3]| {
        let mut sorted = **scales;
        sorted.sort_by(f32::total_cmp);
        sorted[1..].iter().any(|size| !stored.contains(size))
    };
    model.log_scales.par_iter().filter(is_outsized).count()
}

/// The warning of a file in which this many Gaussians get another size, as [`outsized`] counts them; none if there are none.
pub fn size_warning(path: &Path, gaussians: usize) -> Option<String> {
    let [low, high] = [spz::LOG_SCALES.start(), spz::LOG_SCALES.end()].map(|size| size.exp());
    let (are, get) = if gaussians == 1 { ("is", "gets") } else { ("are", "get") };
    (gaussians > 0).then(|| {
        format!(
            "{}: {} {are} smaller or larger than the {low:.1e} to {high:.1e} that SPZ stores, and {get} the nearest size; scale the \
             model, or write .sog or .ply",
            path.display(),
            counted(gaussians, "Gaussian")
        )
    })
}

/// The warning of a file in which the colours of `gaussians` Gaussians are cut off, as [`clipped()`] counts them; none if there are none.
pub fn clip_warning(path: &Path, gaussians: usize) -> Option<String> {
    let (format, [colours, above]) = limits(path).filter(|_| gaussians > 0)?;
    let colours = if colours.is_finite() { format!(" (+-{colours:.1} in band 0)") } else { String::new() };
    let (have, their) = if gaussians == 1 { ("has", "its") } else { ("have", "their") };
    Some(format!(
        "{}: {} {have} spherical harmonics beyond the +-{above} that {format} stores{colours}; {their} colours are cut off; \
         .sog and uncompressed .ply files keep them",
        path.display(),
        counted(gaussians, "Gaussian")
    ))
}
