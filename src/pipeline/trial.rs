//! Evidence on the poses of a capture whose points have no errors, from a short training ahead of the run: it withholds a few of the
//! photos to train on, and tells how far their cameras have to move to fit its model.

use super::effects::untold;
use super::evaluate::camera_errors;
use super::pair_capacity;
use super::prepare::Prepared;
use super::start::{Start, initialise};
use crate::effects::{Decision, Effect};
use crate::job::config::RunConfig;
use crate::job::records::Trial;
use crate::job::{Error, Session};
use crate::scene::Photo;
use crate::train::growth::Growth;
use crate::train::schedule::Schedule;
use crate::train::{Options, Trainer};

/// Number of photos that are withheld.
const WITHHELD: usize = 8;
/// Smallest number of photos to train on: of fewer, the others show too little of what a withheld one shows.
const FEWEST_PHOTOS: usize = 32;
/// Iterations on each photo, and least number of all.
const LOOKS: usize = 6;
const LEAST: u32 = 500;
/// Largest share of the run's iterations. Runs that are too short for [`LEAST`] have no trial.
const SHARE: u32 = 10;

/// Length of the trial of a run of this many iterations and photos; none if it has no trial.
pub fn length(iterations: u32, photos: usize) -> Option<u32> {
    let wanted = ((LOOKS * photos) as u32).max(LEAST).min(iterations / SHARE);
    (photos >= FEWEST_PHOTOS && wanted >= LEAST).then_some(wanted)
}

/// Trains for a short time, if nothing else tells about the poses. `config` has the decisions so far.
///
/// # Errors
/// As of training; [`Error::Interrupted`] without a checkpoint.
pub fn trial(
    session: &Session<'_>,
    config: &RunConfig,
    (prepared, start): (&Prepared, &Start),
    decisions: &[Decision],
) -> Result<Option<Trial>, Error> {
    let fresh = matches!(start, Start::Points(_) | Start::Random(_));
    let Some(iterations) = length(config.schedule.iterations, prepared.train.len()) else { return Ok(None) };
    if !fresh || !untold(decisions, Effect::Poses) {
        return Ok(None);
    }
    let Session { device, watcher, .. } = *session;
    watcher.note(&format!("no point tells how well the poses fit: a trial of {iterations} iterations comes first"));
    let (withheld, trained) = split(&prepared.train);
    let settings = prepared.settings(config.style);
    let model = {
        let first = initialise(config, prepared, start)?;
        let options = Options {
            schedule: Schedule {
                growth: config.schedule.growth.map(|_| Growth::default()),
                ..Schedule::of(iterations)
            },
            settings,
            seed: config.seed,
            degree: config.sh_degree,
            most: config.max_gaussians,
            pairs: pair_capacity::initial(device, first.len()),
            ..Options::default()
        };
        let mut trainer = Trainer::new(device, &first, trained, prepared.extent, options)?;
        while trainer.iteration() < iterations {
            let progress = trainer.advance(iterations.min(trainer.iteration().saturating_add(watcher.pace())))?;
            watcher.training(&progress, iterations);
            watcher.unless_stopped()?;
        }
        trainer.download()?
    };
    let cameras = camera_errors(session, &model, &withheld, (settings, config.exposure))?;
    Ok(Some(Trial { iterations, cameras }))
}

/// Photos withheld, evenly spread, and the others.
fn split(photos: &[Photo]) -> (Vec<&Photo>, Vec<Photo>) {
    let withheld: Vec<usize> = (0..WITHHELD).map(|k| (2 * k + 1) * photos.len() / (2 * WITHHELD)).collect();
    let others = photos.iter().enumerate().filter(|(k, _)| !withheld.contains(k)).map(|(_, photo)| photo.clone());
    (withheld.iter().map(|k| &photos[*k]).collect(), others.collect())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_trial_takes_a_tenth_of_a_run_at_most() {
        assert_eq!(length(30_000, 84), Some(504));
        assert_eq!((length(7_000, 300), length(30_000, 300)), (Some(700), Some(1800)));
        assert_eq!((length(5_000, 40), length(4_999, 40), length(30_000, 31)), (Some(500), None, None));
    }
}
