//! Levels of detail of a model, from its merges of pairs.

use super::config::CompressConfig;
use super::train;
use super::views::Views;
use crate::gaussians::Gaussians;
use crate::job::{Error, Session};
use crate::qirf::pairs::Sequence;

/// Gaussians of a level as a share of those of the finer one.
const SHARE: f64 = 1.0 / 3.0;

/// The given number of levels of a model, from the model itself; fewer if only one Gaussian is left.
pub fn levels(
    session: &Session<'_>,
    model: &Gaussians,
    config: &CompressConfig,
    count: usize,
) -> Result<Vec<Gaussians>, Error> {
    let (views, shown) = Views::load(session, model, config, 0..0)?;
    let responses = train::respond(session, shown.source(), model.degree(), &views, None, config)?;
    drop(shown);
    let target = |level: usize| (model.len() as f64 * SHARE.powi(level as i32)).round().max(1.0) as usize;
    let coarsest = target(count.saturating_sub(1));
    let sequence = Sequence::new(model, &responses.scores, (&responses.cameras, responses.dilation), coarsest);
    let mut levels = vec![model.clone()];
    while levels.len() < count && levels.last().is_some_and(|finer| finer.len() > 1) {
        session.watcher.unless_stopped()?;
        let target = target(levels.len());
        levels.push(sequence.pairs(model, &responses.scores, target).kept());
    }
    Ok(levels)
}
