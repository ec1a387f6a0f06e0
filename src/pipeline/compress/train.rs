//! Training stages of a compression: responses for the prune, and fine-tuning of the kept Gaussians.

use super::config::CompressConfig;
use super::views::Views;
use crate::gaussians::Gaussians;
use crate::gpu::Device;
use crate::job::config::Pruning;
use crate::job::records::Truth;
use crate::job::{Error, Session, Stage};
use crate::pipeline::{pair_capacity, virtual_views};
use crate::render::Source;
use crate::response::Responses;
use crate::scene::camera::Camera;
use crate::train::loss::Weights;
use crate::train::schedule::{MEAN_FROM, Schedule};
use crate::train::{self, Options, Trainer};

/// Responses of the training views to each Gaussian of a model. With `of`, the views are a chunk of `of` views.
pub fn respond(
    session: &Session<'_>,
    model: Source<'_>,
    degree: usize,
    views: &Views,
    of: Option<usize>,
    config: &CompressConfig,
) -> Result<Responses, Error> {
    let Session { device, watcher, .. } = *session;
    let wanted = config.compression.selector.reads();
    if views.truth == Truth::Photos {
        let options = options(device, model.len(), degree, views, config);
        let follow = |done| -> Result<(), Error> { watcher.step(Stage::Responses, done, views.train.len()) };
        return train::responses(device, model, &views.train, &options, wanted, (follow, of));
    }
    let cameras: Vec<Camera> = views.train.iter().map(|v| v.camera.clone()).collect();
    virtual_views::responses(session, model, &cameras, of, views.settings, wanted)
}

/// Trains the kept Gaussians further.
pub fn fine_tune(
    session: &Session<'_>,
    model: &Gaussians,
    views: &Views,
    config: &CompressConfig,
) -> Result<Gaussians, Error> {
    let Session { device, watcher, .. } = *session;
    let mut trainer = trainer(device, model, views, config)?;
    while trainer.iteration() < config.fine_tune {
        let pace = trainer.iteration().saturating_add(watcher.pace());
        let progress = trainer.advance(config.fine_tune.min(pace))?;
        watcher.training(&progress, config.fine_tune);
        watcher.look(&trainer);
        watcher.unless_stopped()?;
    }
    Ok(trainer.download()?)
}

fn trainer(device: &Device, model: &Gaussians, views: &Views, config: &CompressConfig) -> Result<Trainer, Error> {
    let options = options(device, model.len(), model.degree(), views, config);
    Ok(Trainer::new(device, model, views.train.clone(), views.extent, options)?)
}

fn options(device: &Device, gaussians: usize, degree: usize, views: &Views, config: &CompressConfig) -> Options {
    let end = Schedule::default().position_rate_end;
    Options {
        // A trained model continues with the rates of the end of training: positions move as slowly, and its number is
        // fixed.
        schedule: Schedule {
            iterations: config.fine_tune,
            position_rate: end,
            position_rate_end: end,
            densify_until: 0.0,
            mean_from: MEAN_FROM,
            ..Schedule::default()
        },
        settings: views.settings,
        seed: config.seed,
        degree,
        most: gaussians,
        exposure: views.exposures.clone(),
        weights: Weights { l2: Pruning::L2 as f32, ..Weights::default() },
        pairs: pair_capacity::initial(device, gaussians),
        ..Options::default()
    }
}
