//! Training stages of a compression: responses for the prune, and fine-tuning of the kept Gaussians.

use super::config::CompressConfig;
use super::views::Views;
use crate::error::Error;
use crate::gaussians::Gaussians;
use crate::gaussians::resident::Resident;
use crate::gpu::Device;
use crate::pipeline::config::Pruning;
use crate::pipeline::pairs;
use crate::pipeline::records::Truth;
use crate::pipeline::session::Session;
use crate::pipeline::virtual_views;
use crate::response::Responses;
use crate::scene::camera::Camera;
use crate::train::loss::Weights;
use crate::train::schedule::Schedule;
use crate::train::{Options, Trainer};

/// Responses of the training views to each Gaussian; also returns the model on the device, given as `resident`.
pub fn respond(
    session: &Session<'_>,
    model: &Gaussians,
    resident: Resident,
    views: &Views,
    config: &CompressConfig,
) -> Result<(Responses, Resident), Error> {
    let Session { device, watcher, .. } = *session;
    let wanted = config.compression.selector.reads();
    if views.truth == Truth::Photos {
        // A trainer has its own copy of the model: two copies would be too much.
        drop(resident);
        let mut trainer = trainer(device, model, views, config)?;
        let responses = trainer.responses_with(wanted, |done| -> Result<(), Error> {
            watcher.responding(done, views.train.len());
            watcher.unless_stopped()
        })?;
        return Ok((responses, trainer.into_model()));
    }
    let cameras: Vec<Camera> = views.train.iter().map(|v| v.camera.clone()).collect();
    let responses = virtual_views::responses(session, &resident, &cameras, views.settings, wanted)?;
    Ok((responses, resident))
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
        let progress = trainer.advance(config.fine_tune)?;
        watcher.training(&progress, config.fine_tune);
        watcher.unless_stopped()?;
    }
    Ok(trainer.download()?)
}

fn trainer(device: &Device, model: &Gaussians, views: &Views, config: &CompressConfig) -> Result<Trainer, Error> {
    let end = Schedule::default().position_rate_end;
    let options = Options {
        // A trained model continues with the rates of the end of training: positions move as slowly, and its number is
        // fixed.
        schedule: Schedule {
            iterations: config.fine_tune,
            position_rate: end,
            position_rate_end: end,
            densify_until: 0.0,
            ..Schedule::default()
        },
        settings: views.settings,
        seed: config.seed,
        degree: model.degree(),
        most: model.len(),
        exposure: None,
        weights: Weights { l2: Pruning::L2 as f32, ..Weights::default() },
        averaged: 0..0,
        pairs: pairs::few(device, model.len()),
    };
    Ok(Trainer::new(device, model, views.train.clone(), views.extent, options)?)
}
