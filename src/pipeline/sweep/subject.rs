//! What the light axes look at: a model, its responses, and views of it.

use super::Plan;
use super::results::Described;
use crate::error::Error;
use crate::gaussians::resident::Resident;
use crate::gaussians::{Gaussians, formats};
use crate::gpu::Device;
use crate::metrics::Networks;
use crate::pipeline::job::{Job, Stage};
use crate::pipeline::prepare::{Start, open};
use crate::pipeline::virtual_views::{self, Around};
use crate::pipeline::{Init, Output, RunConfig, Watcher, budget, pairs};
use crate::render::{Renderer, Settings, Style};
use crate::response::Responses;
use crate::scene::Photo;
use crate::scene::camera::{self, Camera};
use std::path::Path;
use std::time::Instant;

/// Views that pictures are taken from at most: enough for a mean, few enough for many rounds.
const VIEWS: usize = 6;
/// Virtual cameras that a model without photos responds to.
const AROUND: u32 = 24;

/// A model and what belongs to it.
pub struct Subject {
    /// The model.
    pub model: Gaussians,
    /// How pictures depend on its Gaussians.
    pub responses: Responses,
    /// Views, with what they should show.
    pub views: Vec<Photo>,
    /// Image formation.
    pub settings: Settings,
    /// In words.
    pub described: Described,
}

impl Subject {
    /// The views' cameras.
    pub fn cameras(&self) -> Vec<Camera> {
        self.views.iter().map(|v| v.camera.clone()).collect()
    }

    fn told(mut self, path: &Path, origin: String) -> Self {
        self.described = Described {
            path: path.display().to_string(),
            origin,
            gaussians: self.model.len(),
            degree: self.model.degree(),
            views: self.views.len(),
            size: camera::largest(self.views.iter().map(|v| &v.camera)),
        };
        self
    }
}

/// Some of many, at even steps.
fn few<T>(all: Vec<T>, count: usize) -> Vec<T> {
    let n = all.len();
    let kept: Vec<usize> = (0..count.min(n)).map(|k| k * n / count.min(n)).collect();
    all.into_iter().enumerate().filter(|(i, _)| kept.contains(i)).map(|(_, v)| v).collect()
}

/// A scene's: a model trained briefly, or the one given, with what the training photos say of it.
///
/// # Errors
/// As a run's.
pub fn of_scene(
    device: &Device,
    plan: &Plan<'_>,
    config: &RunConfig,
    model: Option<&Path>,
    watcher: &(dyn Watcher + Sync),
) -> Result<Subject, Error> {
    let begun = Instant::now();
    let output = Output::new(&plan.folder.join("light"))?;
    let config =
        RunConfig { init: model.map_or_else(|| config.init.clone(), |m| Init::Model(m.to_owned())), ..config.clone() };
    let opened = open(&config.selection())?;
    let start = Start::of(&config, &opened)?;
    let estimated = budget::for_run(device, &config, &opened, &start)?;
    let means = (plan.host_bytes, &output);
    // Scores of the light axes need no network.
    let networks = Networks::default();
    let (stage, config) = Stage::load(device, (opened, &config), means, &networks, watcher, (begun, estimated))?;
    let iterations = if model.is_some() { 0 } else { config.schedule.iterations };
    if iterations > 0 {
        watcher.note(&format!("a dense model is trained briefly, for {iterations} iterations"));
    }
    let mut job = Job::start(&stage, &config, &output, start)?;
    job.train(iterations)?;
    let (model, responses) = (job.checkpoint()?.snapshot.model, job.responses()?);
    formats::write(&output.model(), &model).map_err(Error::writing)?;
    let prepared = &stage.prepared;
    let settings = config.style().over(prepared.background);
    let subject = Subject {
        model,
        responses,
        views: few(prepared.train.clone(), VIEWS),
        settings,
        described: Described::default(),
    };
    let from = match &config.init {
        Init::Model(path) => format!("the model {}", path.display()),
        _ => format!("a dense model trained briefly, for {iterations} iterations"),
    };
    Ok(subject.told(&config.scene, format!("{from}; responses and views are of the scene's training photos")))
}

/// A model's own: virtual cameras round it, and its own pictures.
///
/// # Errors
/// Device memory; device errors; [`Error::Interrupted`].
pub fn of_model(
    device: &Device,
    path: &Path,
    model: Gaussians,
    (size, up, background): ((u32, u32), glam::DVec3, [f32; 3]),
    watcher: &dyn Watcher,
) -> Result<Subject, Error> {
    if model.is_empty() {
        return Err(Error::Usage(format!("{}: it holds no Gaussian: there is nothing to measure", path.display())));
    }
    let (cameras, settings) = Around { views: AROUND, size, up }.views(&model, (background, Style::default()));
    let resident = Resident::upload(device, &model)?;
    let pairs = pairs::few(device, model.len());
    let responses = virtual_views::responses(device, &resident, &cameras, settings, (pairs, false), |done| {
        watcher.responding(done, cameras.len());
        watcher.unless_stopped()
    })?;
    let mut renderer = Renderer::new(device, settings, model.len(), size.0, size.1)?;
    let mut views = Vec::new();
    for camera in few(cameras, VIEWS) {
        let pixels = virtual_views::photo(&renderer.render(&resident, &camera)?);
        views.push(Photo::opaque(camera, pixels));
    }
    let described = Described::default();
    let subject = Subject { model, responses, views, settings, described };
    Ok(subject
        .told(path, format!("the model itself; responses of {AROUND} virtual cameras round it to its own pictures")))
}
