//! The stages of a compression one by one, for jobs that are divided: the same results as [`super::compress`], bit for bit.

use super::at_least_one;
use super::config::{CompressConfig, ViewSource};
use super::scoring::Scoring;
use super::train;
use super::views::Views;
use crate::error::Error;
use crate::gaussians::Gaussians;
use crate::pipeline::prune::{self, PrunePlan, PruneRequest};
use crate::pipeline::records::{CompressProtocol, Truth, ViewStages};
use crate::pipeline::session::Session;
use crate::pipeline::virtual_views::ALL;
use crate::response::{CHUNK, Responses};
use crate::train::Exposures;
use std::ops::Range;

/// No view held out.
const NONE: Range<usize> = 0..0;

/// The views of a compression.
pub struct Census {
    /// Chunks of views that responses are taken from.
    pub chunks: usize,
    /// Views held out.
    pub test_views: usize,
    /// Conditions of the measurement.
    pub protocol: CompressProtocol,
}

/// Counts the views.
///
/// # Errors
/// Those of reading a scene; a model or views that do not fit the device.
pub fn census(session: &Session<'_>, model: &Gaussians, config: &CompressConfig) -> Result<Census, Error> {
    let (views, test_views) = match &config.views {
        ViewSource::Photos(_) => {
            let (views, _) = Views::load(session, model, config, ALL)?;
            let photos = views.test.len();
            (views, photos)
        }
        // Pictures need not be drawn to be counted.
        ViewSource::OwnPictures { cameras, .. } => (Views::load(session, model, config, NONE)?.0, cameras.held_out()),
    };
    let protocol = CompressProtocol { test_views, ..views.protocol(config) };
    Ok(Census { chunks: views.train.len().div_ceil(CHUNK), test_views, protocol })
}

/// The responses of one chunk of views, whose photos may have known exposures.
///
/// # Errors
/// As of a compression.
pub fn evidence(
    session: &Session<'_>,
    model: &Gaussians,
    config: &CompressConfig,
    (chunk, exposures): (usize, Option<Exposures>),
) -> Result<Responses, Error> {
    let (views, shown) = Views::load(session, model, config, NONE)?;
    let views = Views { exposures, ..views };
    train::respond(session, shown.source(), model.degree(), (&views, Some(chunk)), config)
}

/// The choice of Gaussians, by the responses of all chunks in their order.
///
/// # Errors
/// As of a compression; those of the chunks.
pub fn choose(
    session: &Session<'_>,
    model: &Gaussians,
    config: &CompressConfig,
    chunks: impl Iterator<Item = Result<Responses, Error>>,
) -> Result<PrunePlan, Error> {
    let (views, shown) = Views::load(session, model, config, NONE)?;
    let responses = Responses::sum(model.len(), config.compression.selector.reads(), chunks)?;
    let responses = Responses {
        cameras: views.train.iter().map(|view| view.camera.clone()).collect(),
        dilation: views.settings.dilation,
        ..responses
    };
    let keep = at_least_one(config.compression.keep, model.len());
    let request = PruneRequest { compression: &config.compression, keep, seed: config.seed };
    prune::plan(session.device, shown.source(), model, &responses, &request)
}

/// The scores of a compressed model in the views held out with these numbers.
///
/// # Errors
/// As of a compression.
pub fn score(
    session: &Session<'_>,
    model: &Gaussians,
    compressed: &Gaussians,
    config: &CompressConfig,
    held_out: Range<usize>,
) -> Result<Vec<ViewStages>, Error> {
    let (views, shown) = Views::load(session, model, config, held_out)?;
    let mut scoring = Scoring::new(session, &views, config);
    let before = if views.truth == Truth::Photos { scoring.scores(shown.source())? } else { Vec::new() };
    drop(shown);
    let after = scoring.scores_of(compressed)?;
    Ok(views.stages([before, after, Vec::new()]))
}
