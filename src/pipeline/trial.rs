//! Evidence on exposures and poses of a capture whose points have no tracks or errors, from a short training ahead of the run. It
//! withholds a few of the photos to train on: their scores tell whether an exposure of each photo helps, and how far their cameras have
//! to move to fit the model tells of the poses.

use super::evaluate::{Evaluator, camera_errors, mean};
use super::pair_capacity;
use super::prepare::Prepared;
use super::start::{Start, initialise};
use crate::effects::{Decision, Effect, exposure_by_trial, trial_length, untold};
use crate::gaussians::Gaussians;
use crate::gaussians::resident::Resident;
use crate::job::records::Trial;
use crate::job::{Error, RunConfig, Session};
use crate::scene::Photo;
use crate::train::growth::Growth;
use crate::train::schedule::Schedule;
use crate::train::{Exposures, Options, Trainer};

/// Number of photos that are withheld.
const WITHHELD: usize = 8;
/// Trains for a short time, if nothing else tells of poses or exposures; twice for exposures. `config` has the decisions so far.
///
/// # Errors
/// The errors of training; [`Error::Interrupted`] without a checkpoint.
pub fn trial(
    session: &Session<'_>,
    config: &RunConfig,
    prepared: &Prepared,
    start: &Start,
    decisions: &[Decision],
) -> Result<Option<Trial>, Error> {
    let [exposure, poses] = [Effect::Exposure, Effect::Poses].map(|effect| untold(decisions, effect));
    let fresh = matches!(start, Start::Points(_) | Start::Random(_));
    let Some(iterations) = trial_length(config.schedule.iterations, prepared.train.len()) else { return Ok(None) };
    if !fresh || !(exposure || poses) {
        return Ok(None);
    }
    let what = if exposure { "whether exposures differ" } else { "how well the poses fit" };
    session
        .watcher
        .note(&format!("the points do not show {what}: the run begins with a trial of {iterations} iterations"));
    let (withheld, trained) = split(&prepared.train);
    let settings = prepared.settings(config.style);
    let short = Short { session, config, prepared, first: initialise(config, prepared, start)?, iterations };
    let mut model = short.train(&trained, config.exposure)?;
    let (mut exposures, mut exposed) = (None, config.exposure);
    if exposure {
        let learnt = short.train(&trained, true)?;
        let mut evaluator = Evaluator::empty(session.device, settings)?;
        evaluator.compare_as(true);
        let mut psnr = |model: &Gaussians| -> Result<Option<f64>, Error> {
            let resident = Resident::upload(session.device, model)?;
            Ok(mean(&evaluator.psnr(&resident, withheld.iter().copied())?))
        };
        exposures = psnr(&model)?.zip(psnr(&learnt)?).map(|(without, with)| [without, with]);
        if exposures.is_some_and(|psnr| exposure_by_trial(psnr).on) {
            (model, exposed) = (learnt, true);
        }
    }
    let cameras = camera_errors(session, &model, &withheld, settings, exposed)?;
    Ok(Some(Trial { iterations, exposures, cameras }))
}

/// Short trainings that differ in one effect.
struct Short<'a> {
    session: &'a Session<'a>,
    config: &'a RunConfig,
    prepared: &'a Prepared,
    first: Gaussians,
    iterations: u32,
}

impl Short<'_> {
    /// The model of these photos, with an exposure of each or without.
    fn train(&self, photos: &[Photo], exposure: bool) -> Result<Gaussians, Error> {
        let Self { session: Session { device, watcher, .. }, config, prepared, iterations, .. } = *self;
        let growth = config.schedule.growth.map(|_| Growth::default());
        let options = Options {
            schedule: Schedule { growth, ..Schedule::of(iterations) },
            settings: prepared.settings(config.style),
            seed: config.seed,
            degree: config.sh_degree,
            most: config.max_gaussians,
            exposure: exposure.then(|| Exposures::Learnt(Vec::new())),
            pairs: pair_capacity::initial(device, self.first.len()),
            ..Options::default()
        };
        let mut trainer = Trainer::new(device, &self.first, photos.to_vec(), prepared.extent, options)?;
        while trainer.iteration() < iterations {
            let progress = trainer.advance(iterations.min(trainer.iteration().saturating_add(watcher.pace())))?;
            watcher.training(&progress, iterations);
            watcher.unless_stopped()?;
        }
        Ok(trainer.download()?)
    }
}

/// Photos withheld, evenly spread, and the others.
fn split(photos: &[Photo]) -> (Vec<&Photo>, Vec<Photo>) {
    let withheld: Vec<usize> = (0..WITHHELD).map(|k| (2 * k + 1) * photos.len() / (2 * WITHHELD)).collect();
    let others = photos.iter().enumerate().filter(|(k, _)| !withheld.contains(k)).map(|(_, photo)| photo.clone());
    (withheld.iter().map(|k| &photos[*k]).collect(), others.collect())
}
