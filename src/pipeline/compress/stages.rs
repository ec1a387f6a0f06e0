//! The stages of a compression as separate functions, for divided jobs: the results equal those of [`super::compress_to`], bit for
//! bit.

use super::config::{CompressConfig, ViewSource};
use super::scoring::Scoring;
use super::train;
use super::views::Views;
use crate::gaussians::Gaussians;
use crate::job::records::{CompressProtocol, Truth, ViewStages};
use crate::job::{Error, Session};
use crate::pipeline::prune::{self, PrunePlan, PruneRequest};
use crate::pipeline::virtual_views::ALL;
use crate::response::{CHUNK, Responses};
use crate::scene::AlphaRole;
use crate::train::{Exposures, exposure};
use std::ops::Range;

/// No view held out.
const NONE: Range<usize> = 0..0;

/// The views of a compression.
pub struct Census {
    /// Number of chunks of views with responses.
    pub chunks: usize,
    /// Views held out.
    pub test_views: usize,
    /// Names of the training photos and of the held-out photos; empty for the model's own pictures.
    pub photos: [Vec<String>; 2],
    /// Background of the pictures.
    pub background: [f32; 3],
    /// Meaning of the photos' fourth byte.
    pub alpha_role: AlphaRole,
    /// Conditions of the measurement.
    pub protocol: CompressProtocol,
}

/// Counts the views.
pub fn census(session: &Session<'_>, model: &Gaussians, config: &CompressConfig) -> Result<Census, Error> {
    // Pictures need not be drawn to be counted.
    let (held_out, drawn) = match &config.views {
        ViewSource::Photos(_) => (ALL, None),
        ViewSource::OwnPictures { cameras, .. } => (NONE, Some(cameras.held_out())),
    };
    let (views, _) = Views::load(session, model, config, held_out)?;
    let test_views = drawn.unwrap_or(views.test.len());
    let protocol = CompressProtocol { test_views, ..views.protocol(config) };
    let chunks = views.train.len().div_ceil(CHUNK);
    let alpha_role = AlphaRole::of(views.train.iter().chain(views.test.iter().map(|(_, photo)| photo)));
    let photos = [views.names, views.test.into_iter().map(|(name, _)| name).collect()];
    Ok(Census { chunks, test_views, photos, background: views.settings.background, alpha_role, protocol })
}

/// The responses of one chunk of views. If `photos` are named, only those of the chunk are decoded; they may have known
/// exposures.
pub fn evidence(
    session: &Session<'_>,
    model: &Gaussians,
    config: &CompressConfig,
    chunk: usize,
    photos: &[String],
    exposures: Option<Exposures>,
) -> Result<Responses, Error> {
    let of_chunk = |n: usize, each: usize| (each * CHUNK * chunk).min(n)..(each * CHUNK * (chunk + 1)).min(n);
    let (views, shown, all) = match &config.views {
        ViewSource::Photos(selection) => {
            let names = &photos[of_chunk(photos.len(), 1)];
            let (mut views, shown) = Views::named(session, model, selection, names, config)?;
            if exposures.is_none() {
                views.fit_gains(session, shown.source(), config)?;
            }
            (views, shown, photos.len())
        }
        ViewSource::OwnPictures { .. } => {
            let (views, shown) = Views::load(session, model, config, NONE)?;
            let all = views.train.len();
            (Views { train: views.train[of_chunk(all, 1)].to_vec(), ..views }, shown, all)
        }
    };
    let exposures = exposures.map(|known| match known {
        Exposures::Known(maps) => Exposures::Known(maps[of_chunk(maps.len(), exposure::SIZE)].to_vec()),
        learnt @ Exposures::Learnt(_) => learnt,
    });
    let views = Views { exposures: exposures.or(views.exposures), ..views };
    train::respond(session, shown.source(), model.degree(), &views, Some(all), config)
}

/// Selects the Gaussians by the responses of all chunks in their order. Photos are named, but not decoded.
pub fn choose(
    session: &Session<'_>,
    model: &Gaussians,
    config: &CompressConfig,
    photos: &[String],
    chunks: impl Iterator<Item = Result<Responses, Error>>,
) -> Result<PrunePlan, Error> {
    let (cameras, settings, shown) = Views::cameras(session, model, config, photos)?;
    let responses = Responses::sum(model.len(), config.compression.selector.reads(), chunks)?;
    let responses = Responses { cameras, dilation: settings.dilation, ..responses };
    let request = PruneRequest { compression: &config.compression, keep: config.compression.keep, seed: config.seed };
    prune::plan(session.device, shown.source(), model, &responses, &request)
}

/// The scores of a compressed model in the held-out views with these indices. Held-out photos are named, and only these are
/// decoded.
pub fn score(
    session: &Session<'_>,
    model: &Gaussians,
    compressed: &Gaussians,
    config: &CompressConfig,
    held_out: Range<usize>,
    photos: &[String],
) -> Result<Vec<ViewStages>, Error> {
    let (views, shown) = match &config.views {
        ViewSource::Photos(selection) => {
            let (views, shown) = Views::named(session, model, selection, &photos[held_out], config)?;
            let test = views.names.iter().cloned().zip(views.train.iter().cloned()).collect();
            (Views { test, ..views }, shown)
        }
        ViewSource::OwnPictures { .. } => Views::load(session, model, config, held_out)?,
    };
    let mut scoring = Scoring::new(session, &views, config);
    let before = if views.truth == Truth::Photos { scoring.scores(shown.source())? } else { Vec::new() };
    drop(shown);
    let after = scoring.scores_of(compressed)?;
    Ok(views.stages([before, after, Vec::new(), Vec::new()]))
}
