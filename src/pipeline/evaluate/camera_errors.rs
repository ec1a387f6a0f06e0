//! Errors of held-out photos' cameras: each camera is moved until the model's picture fits half of the photo best, and the
//! other half is scored before and after. The model is the witness: no point or track is needed.

use super::assess::mean;
use super::camera_fit::{CameraFit, SIDE, is_fitted};
use super::evaluator::{Comparison, counts, truth, weights};
use crate::gaussians::Gaussians;
use crate::job::records::CameraErrors;
use crate::job::{Error, Session};
use crate::pipeline::budget;
use crate::pipeline::depth::DepthPainter;
use crate::pipeline::draw_source::DrawSource;
use crate::render::{Painter, Settings};
use crate::sample::spread;
use crate::scene::{Photo, camera, median};

/// Largest number of held-out views that are looked at, evenly spread.
const VIEWS: usize = 8;

/// Measures how well the given cameras of held-out photos fit a model's pictures; none without any, or without a Gaussian.
pub fn camera_errors(
    session: &Session<'_>,
    model: &Gaussians,
    photos: &[&Photo],
    settings: Settings,
    fits_exposure: bool,
) -> Result<Option<CameraErrors>, Error> {
    let is_wide = |photo: &&Photo| photo.camera.width.max(photo.camera.height) > SIDE as u32;
    let mut usable = Vec::new();
    for photo in photos.iter().copied().filter(is_wide) {
        // Something must count both where cameras are fitted and where they are scored.
        if counts(photo, is_fitted)? && counts(photo, |x, y| !is_fitted(x, y))? {
            usable.push(photo);
        }
    }
    let photos = spread(&usable, VIEWS);
    let count = photos.len();
    if count == 0 || model.is_empty() {
        return Ok(None);
    }
    let size = camera::largest(photos.iter().map(|photo| &photo.camera));
    let whole = budget::for_pictures(session.device, model, size, settings.style)?.whole;
    let depths = {
        let mut painter = DepthPainter::new(session.device, model, settings, size, whole)?;
        let draw = |photo: &&Photo| Ok(painter.draw(&photo.camera)?.expected);
        photos.iter().map(draw).collect::<Result<Vec<_>, Error>>()?
    };
    let shown = DrawSource::new(session, model, whole)?;
    let mut painter = Painter::of(session.device, settings, shown.source(), size)?;
    let mut found = Vec::with_capacity(count);
    for (photo, depths) in photos.into_iter().zip(&depths) {
        session.watcher.unless_stopped()?;
        let comparison = Comparison { background: settings.background, fits_exposure };
        let (truth, weights) = (truth(photo, settings.background)?, weights(photo)?);
        let fit = CameraFit { photo, truth, weights, depths, comparison };
        found.push(fit.run(&mut |camera| Ok(painter.render(shown.source(), camera)?))?);
    }
    // Of views that differ from their photos before and after.
    let finite = found.iter().filter(|fitted| fitted.psnr.iter().all(|psnr| psnr.is_finite()));
    let finite: Vec<[f64; 2]> = finite.map(|fitted| fitted.psnr).collect();
    let mean = |k: usize| mean(&finite.iter().map(|psnr| psnr[k]).collect::<Vec<_>>()).unwrap_or(f64::INFINITY);
    let mut moved: Vec<f64> = found.iter().map(|fitted| fitted.pixels).collect();
    let pixels = median(&mut moved).unwrap_or_default();
    Ok(Some(CameraErrors { views: count, pixels, psnr: mean(0), fitted_psnr: mean(1) }))
}
