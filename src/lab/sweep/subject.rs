//! Subject of the light axes: a model, its responses, and views of it.

use super::records::Described;
use crate::gaussians::Gaussians;
use crate::gaussians::formats::RenderMode;
use crate::gaussians::resident::Resident;
use crate::job::{Error, Init, Output, RunConfig, Session};
use crate::metrics::Networks;
use crate::pipeline::active_run::ActiveRun;
use crate::pipeline::setup::Setup;
use crate::pipeline::virtual_views::{self, VirtualCameras, VirtualViews};
use crate::render::{Renderer, Settings, Style};
use crate::response::{Responses, Wanted};
use crate::sample::spread;
use crate::scene::Photo;
use crate::scene::camera::{self, Camera};
use std::path::Path;

/// Largest number of views that pictures are taken from: enough for a mean, few enough for many rounds.
const VIEWS: usize = 6;
/// Number of virtual cameras for the responses of a model without photos.
const AROUND: u32 = 24;

/// Input of a light axis.
pub struct Context<'a> {
    /// Device, limits and watcher.
    pub session: Session<'a>,
    /// The subject.
    pub subject: &'a Subject,
    /// True if the ground truth of its views is the subject's own pictures.
    pub own_pictures: bool,
    /// Time budget of each axis, in seconds; warm-up and three samples are always measured.
    pub seconds: f64,
}

/// A model with its responses and views.
pub struct Subject {
    /// The model.
    pub model: Gaussians,
    /// Responses of pictures to its Gaussians.
    pub responses: Responses,
    /// Views with their ground truth.
    pub views: Vec<Photo>,
    /// Settings of image formation.
    pub settings: Settings,
    /// Description for records.
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

/// The subject of a scene: a briefly trained model, or the given one, with responses from the training photos. It is
/// stored in `folder`.
pub fn of_scene(
    session: &Session<'_>,
    folder: &Path,
    config: &RunConfig,
    model: Option<&Path>,
) -> Result<Subject, Error> {
    let output = Output::new(&folder.join("light"))?;
    let init = model.map_or_else(|| config.init.clone(), |m| Init::Model(m.to_owned()));
    let config = RunConfig { init, ..config.clone() };
    // Scores of the light axes need no network.
    let session = Session { networks: &Networks::default(), ..*session };
    let (setup, start) = Setup::load(&session, &config, &output, false)?;
    let config = &setup.config;
    let iterations = if model.is_some() { 0 } else { config.schedule.iterations };
    if iterations > 0 {
        session.watcher.note(&format!("a dense model is trained briefly, for {iterations} iterations"));
    }
    let mut run = ActiveRun::start(&setup, config, &output, start)?;
    run.train(iterations)?;
    let (model, responses) = (run.checkpoint()?.snapshot.model, run.responses()?);
    let prepared = &setup.prepared;
    prepared.write(&output.model(), &model, config.style.mode())?;
    let subject = Subject {
        model,
        responses,
        views: spread(&prepared.train, VIEWS),
        settings: prepared.settings(config.style),
        described: Described::default(),
    };
    let from = match &config.init {
        Init::Model(path) => format!("the model {}", path.display()),
        _ => format!("a dense model trained briefly, for {iterations} iterations"),
    };
    Ok(subject.told(&config.scene, format!("{from}; responses and views are of the scene's training photos")))
}

/// The subject of a model, drawn in its mode: virtual cameras of this size around it, and its own pictures over a
/// background.
pub fn of_model(
    session: &Session<'_>,
    path: &Path,
    (model, mode): (Gaussians, RenderMode),
    cameras: VirtualCameras,
    background: [f32; 3],
) -> Result<Subject, Error> {
    if model.is_empty() {
        return Err(Error::Usage(format!("{}: it holds no Gaussians: there is nothing to measure", path.display())));
    }
    let size = cameras.size;
    let cameras = VirtualCameras { views: AROUND, ..cameras };
    let VirtualViews { around: cameras, settings, .. } = cameras.views(&model, background, Style::of(mode));
    let resident = Resident::upload(session.device, &model)?;
    let responses = virtual_views::responses(session, &resident, &cameras, None, settings, Wanted::CHANNELS)?;
    let mut renderer = Renderer::new(session.device, settings, model.len(), size.0, size.1)?;
    let mut views = Vec::new();
    for camera in spread(&cameras, VIEWS) {
        let pixels = virtual_views::photo(&renderer.render(&resident, &camera)?);
        views.push(Photo::opaque(camera, pixels));
    }
    let described = Described::default();
    let subject = Subject { model, responses, views, settings, described };
    Ok(subject
        .told(path, format!("drawn by {AROUND} virtual cameras around the model, compared with its own pictures")))
}
