//! Errors of held-out photos' cameras: each camera is moved until the model's picture fits half of the photo best, and the
//! other half is scored before and after. The model is the witness: no point or track is needed.

use super::camera_fit::{CameraFit, SIDE};
use super::evaluator::truth;
use crate::gaussians::Gaussians;
use crate::pipeline::depth::DepthPainter;
use crate::pipeline::draw_source::DrawSource;
use crate::pipeline::{Error, Session, budget};
use crate::render::{Painter, Settings};
use crate::scene::{Photo, camera, median};
use serde::Serialize;

/// Largest number of held-out views that are looked at, evenly spread.
const VIEWS: usize = 8;
/// Median error in pixels, and gain in dB, from which a run says that the poses limit it.
const TOLD: (f64, f64) = (0.3, 0.3);

/// Errors of the cameras of held-out photos, as a model shows them.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct CameraErrors {
    /// Number of photos looked at.
    pub views: usize,
    /// Median over the photos of how far the fitted camera moves the picture, in pixels (root mean square over a photo).
    pub pixels: f64,
    /// Mean PSNR of every other square of 8 x 8 pixels with the given cameras, in dB.
    pub psnr: f64,
    /// The same with cameras fitted to the other squares.
    pub fitted_psnr: f64,
}

impl CameraErrors {
    /// A sentence for a user whose poses limit the result; none if they do not.
    pub fn note(&self, corrected: bool) -> Option<String> {
        let Self { pixels, psnr, fitted_psnr, .. } = *self;
        let (least, gain) = TOLD;
        let advice = if corrected { "" } else { "; --effect poses=on corrects those of the training photos" };
        (pixels >= least && fitted_psnr - psnr >= gain).then(|| {
            format!(
                "the poses are inaccurate: held-out photos have {psnr:.2} dB, and {fitted_psnr:.2} dB if their cameras \
                 move by {pixels:.1} pixels (median){advice}"
            )
        })
    }
}

/// Measures how well the given cameras of held-out photos fit a model's pictures; none without any, or without a Gaussian.
///
/// # Errors
/// Device memory; device errors; photos that cannot be read; [`Error::Interrupted`].
pub fn camera_errors(
    session: &Session<'_>,
    model: &Gaussians,
    photos: &[&Photo],
    (settings, fits_exposure): (Settings, bool),
) -> Result<Option<CameraErrors>, Error> {
    let wide = |photo: &&Photo| photo.camera.width.max(photo.camera.height) > SIDE as u32;
    let wide: Vec<&Photo> = photos.iter().copied().filter(wide).collect();
    let count = wide.len().min(VIEWS);
    if count == 0 || model.is_empty() {
        return Ok(None);
    }
    let photos: Vec<&Photo> = (0..count).map(|k| wide[k * wide.len() / count]).collect();
    let size = camera::largest(photos.iter().map(|photo| &photo.camera));
    let whole = budget::for_pictures(session.device, model, size, settings.style)?.whole;
    let depths = {
        let mut painter = DepthPainter::new(session.device, model, (settings, size, whole))?;
        let draw = |photo: &&Photo| Ok(painter.draw(&photo.camera)?.expected);
        photos.iter().map(draw).collect::<Result<Vec<_>, Error>>()?
    };
    let shown = DrawSource::new(session, model, whole)?;
    let mut painter = Painter::of(session.device, settings, shown.source(), size)?;
    let mut found = Vec::with_capacity(count);
    for (photo, depths) in photos.into_iter().zip(&depths) {
        session.watcher.unless_stopped()?;
        let background = settings.background;
        let fit = CameraFit { photo, truth: truth(photo, background)?, depths, background, fits_exposure };
        found.push(fit.run(&mut |camera| Ok(painter.render(shown.source(), camera)?))?);
    }
    let mean = |k: usize| found.iter().map(|fitted| fitted.psnr[k]).sum::<f64>() / count as f64;
    let mut moved: Vec<f64> = found.iter().map(|fitted| fitted.pixels).collect();
    let pixels = median(&mut moved).unwrap_or_default();
    Ok(Some(CameraErrors { views: count, pixels, psnr: mean(0), fitted_psnr: mean(1) }))
}
