//! `qirf-vk view MODEL|RUN|SCENE`.

use super::Global;
use super::console::Console;
use super::inspect::{is_scene, read_model, unfinished};
use super::interrupt::Watch;
use super::style;
use super::values;
use crate::effects::THUMBNAIL_WIDTH;
use crate::gaussians::Gaussians;
use crate::gaussians::outline::outline;
use crate::job::diagnostics::Diagnostics;
use crate::job::earlier::{is_run, scored_on};
use crate::job::records::ViewScores;
use crate::job::{Error, RunConfig, Selection, Session};
use crate::pipeline::compress::{CompressConfig, ViewSource};
use crate::pipeline::place::{align, doubt, shift_to};
use crate::render::Style;
use crate::sample::evenly;
use crate::scene::orbit::UP;
use crate::scene::{Resize, Scene, alpha_role};
use crate::train::initialise::{Seed, from_points};
use crate::view::subject::{Capture, Job, Model};
use crate::view::{Live, Server, ServerOptions, StaticView, Subject};
use glam::DVec3;
use std::collections::HashMap;
use std::net::{IpAddr, Ipv4Addr};
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::time::Duration;

const EXAMPLES: &str = "Examples:
  qirf-vk view flowers.ply
  qirf-vk view small.ply --against flowers.ply
  qirf-vk view trained                     # a run's folder: its model, photos and scores
  qirf-vk view capture                     # a capture's cameras and points
  qirf-vk view model.spz --scene capture
  qirf-vk view flowers.ply --diagnostics prune.safetensors   # what `compress --diagnostics` did to it

Open the printed address in a browser. To look from another machine, run the viewer with --port 8080, and there \
`ssh -L 8080:127.0.0.1:8080 SERVER`.";

/// Number of photos that tell what alpha means.
const SAMPLED: usize = 64;
/// Timeout for a request before Ctrl-C is checked.
const PATIENCE: Duration = Duration::from_millis(100);

#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub(super) struct Arguments {
    /// A model, the folder of a run, or a scene
    subject: PathBuf,
    /// Second model; a slider compares both
    #[arg(long, value_name = "MODEL")]
    against: Option<PathBuf>,
    /// Diagnostics of a prune of this model, from `compress` or `run`: the viewer shows kept Gaussians, scores, blocks and
    /// guards
    #[arg(long, value_name = "FILE")]
    diagnostics: Option<PathBuf>,
    /// Scene whose cameras and photos are shown [default: the run's]
    #[arg(long, value_name = "SCENE", help_heading = "Photos")]
    scene: Option<PathBuf>,
    /// Picture size at the photos' cameras, as largest width in pixels, or as a divisor of the photos' size [default: the run's,
    /// else 640]
    #[arg(long, value_name = "W|/K", help_heading = "Photos", value_parser = values::resolution)]
    resolution: Option<Resize>,
    /// Up axis: x, y, z, -x, -y, -z, or auto (up in the photos; without photos as in captures: -y) [default: auto]
    #[arg(long, value_name = "AXIS", value_parser = up, allow_hyphen_values = true)]
    up: Option<Up>,
    /// Colour behind the Gaussians: three numbers from 0 to 1, or black, grey, white [default: the
    /// run's, else white for photos with alpha, else black]
    #[arg(long, value_name = "R,G,B", value_parser = values::colour)]
    background: Option<[f32; 3]>,
    #[command(flatten)]
    rendering: style::Rendering,
    #[command(flatten)]
    address: Address,
}

/// Address on which a viewer listens.
#[derive(Clone, Copy, Debug, clap::Args)]
pub(super) struct Address {
    /// Port that the viewer listens on [default: any free one]
    #[arg(long, value_name = "N", default_value_t = 0, hide_default_value = true, help_heading = "Viewer")]
    port: u16,
    /// Address that the viewer listens on. At 127.0.0.1 only this machine can reach it; at any other address other machines can,
    /// too, and the connection is not encrypted
    #[arg(long, value_name = "IP", default_value_t = IpAddr::V4(Ipv4Addr::LOCALHOST), value_parser = address, help_heading = "Viewer")]
    host: IpAddr,
}

/// An up axis; none for `auto`.
#[derive(Clone, Copy, Debug)]
struct Up(Option<DVec3>);

fn up(text: &str) -> Result<Up, String> {
    values::up(text).map(|axis| Up((text != "auto").then_some(axis)))
}

/// An IP address, or this machine's own name for itself.
fn address(text: &str) -> Result<IpAddr, String> {
    if text == "localhost" {
        return Ok(IpAddr::V4(Ipv4Addr::LOCALHOST));
    }
    text.parse().map_err(|_| "write an IP address, such as 127.0.0.1 or 0.0.0.0".to_owned())
}

impl Address {
    /// The server's options; a page may steer a run if only this machine reaches it.
    pub fn options(&self) -> ServerOptions {
        ServerOptions { host: self.host, port: self.port, control: self.host.is_loopback() }
    }

    /// Warns of an address that other machines reach.
    pub fn warn(&self, console: &Console) {
        if !self.host.is_loopback() {
            console.warn(format_args!(
                "other machines can reach {}: anyone with the printed address can see the pictures; the connection is not encrypted",
                self.host
            ));
        }
    }
}

/// Whether browsers watch a run.
#[derive(Clone, Copy, Debug, clap::Args)]
pub(super) struct Watched {
    /// Serve a viewer at the printed address; it shows the training, and can pause and stop it
    #[arg(long, help_heading = "Viewer")]
    pub view: bool,
    #[command(flatten)]
    pub address: Address,
}

impl Watched {
    /// Refuses an address that nothing listens on.
    pub fn check(&self) -> Result<(), Error> {
        let unused = !self.view && (self.address.port != 0 || self.address.host != Ipv4Addr::LOCALHOST);
        if unused { Err(Error::Usage("--port and --host need --view".into())) } else { Ok(()) }
    }

    /// Does a job, and lets browsers watch the subject if there is one.
    pub fn during<T>(
        &self,
        session: &Session<'_>,
        console: &Console,
        subject: Option<Subject>,
        job: impl FnOnce(&Session<'_>) -> Result<T, Error>,
    ) -> Result<T, Error> {
        let Some(subject) = subject else { return job(session) };
        let subject = Arc::new(subject);
        let device = session.device;
        let server = Server::start(&self.address.options(), Arc::clone(&subject), &device.info().name)?;
        self.address.warn(console);
        // Printed even with --quiet: without the address nobody can look.
        console.error(server.url());
        let live = Live::new(session.watcher, &server, device, Arc::clone(&subject));
        let done = job(&Session { watcher: &live, ..*session });
        server.requests().tell_end(&ending(&subject, done.as_ref().err()));
        done
    }
}

/// How a watched job has ended, as a sentence for its pages.
fn ending(Subject { title, job, .. }: &Subject, error: Option<&Error>) -> String {
    match (error, job) {
        (None, Job::Run) => format!("the run is finished: its model is {title}/model.ply"),
        (None, _) => format!("the compression is finished: its model is {title}"),
        (Some(Error::Interrupted), Job::Run) => "the run was stopped; `run --resume` continues it".to_owned(),
        (Some(Error::Interrupted), _) => "the compression was stopped; no model was written".to_owned(),
        (Some(error), _) => format!("qirf-vk has ended: {error}"),
    }
}

impl Arguments {
    pub fn run(&self, console: &Console, global: &Global) -> Result<(), Error> {
        let subject = Arc::new(self.subject(console)?);
        let device = global.open()?;
        let mut static_view = StaticView::new(&device, &subject)?;
        let watch = Watch::begin();
        let server = Server::start(&self.address.options(), Arc::clone(&subject), &device.info().name)?;
        self.address.warn(console);
        console.print(server.url())?;
        console.note("Ctrl-C ends the viewer");
        let requests = server.requests();
        while !watch.pressed() {
            let Some((client, request)) = requests.next_request(PATIENCE) else { continue };
            match static_view.draw(&request) {
                Ok(drawn) => requests.deliver(client, drawn.header, Arc::new(drawn.image)),
                // A request that cannot be fulfilled is the page's affair; a lost device ends the viewer.
                Err(Error::Device(e)) if !e.is_resources() => return Err(e.into()),
                Err(e) => requests.refuse(client, &request, &e),
            }
        }
        Ok(())
    }

    fn subject(&self, console: &Console) -> Result<Subject, Error> {
        let path = &self.subject;
        let run = is_run(path);
        let config = run.then(|| RunConfig::read(&path.join("config.toml"))).transpose()?;
        let scene = self.scene.clone().or(config.as_ref().map(|c| c.scene.clone()));
        let scene = scene.or_else(|| (!run && is_scene(path)).then(|| path.clone()));
        let capture = match &scene {
            // A run's capture may be elsewhere by now; its model can be seen all the same.
            Some(scene) if run && self.scene.is_none() && !scene.exists() => {
                console.warn(format_args!("{} does not exist: the run's photos are not shown", scene.display()));
                None
            }
            Some(scene) => {
                let mut capture = capture(scene, config.as_ref().map(RunConfig::selection), self.resolution, console)?;
                if run {
                    capture.psnr = psnr(path);
                }
                Some(capture)
            }
            None => None,
        };
        let style = config.as_ref().map(|c| c.style);
        let mut models = vec![if run {
            self.model(&path.join("model.ply"), (style, capture.as_ref()), console)?
        } else if is_scene(path) {
            points(capture.as_ref(), path, console)
        } else {
            self.model(path, (style, capture.as_ref()), console)?
        }];
        if let Some(file) = &self.diagnostics {
            models[0].facts = Some(Diagnostics::read(file, &models[0].gaussians)?);
        }
        if let Some(other) = &self.against {
            let mut other = self.model(other, (None, capture.as_ref()), console)?;
            // A capture has placed both.
            if capture.is_none() {
                lay_upon(&mut other, &models[0]);
            }
            models.push(other);
        }
        let given = self.background.or(config.and_then(|c| c.background)).or_else(|| scored_on(path));
        let background =
            given.unwrap_or_else(|| capture.as_ref().map_or([0.0; 3], |c| c.alpha_role.usual_background()));
        let title = name(path);
        let up = self.up.and_then(|up| up.0);
        let outline = capture.is_none().then(|| outline(&models[0].gaussians, up.unwrap_or(UP)));
        Ok(Subject { title, job: Job::Show, models, background, up, outline, capture })
    }

    fn model(
        &self,
        path: &Path,
        (run, capture): (Option<Style>, Option<&Capture>),
        console: &Console,
    ) -> Result<Model, Error> {
        let mut loaded = read_model(path, console)?;
        if let Some(doubt) = capture.and_then(|c| doubt(&loaded, &c.scene)) {
            console.warn(format_args!("{} {doubt}", path.display()));
        }
        let shift = capture.map_or(DVec3::ZERO, |c| shift_to(&loaded.gaussians, loaded.origin, &c.scene));
        loaded.gaussians.shift(shift);
        let style = self.rendering.style(path, &loaded, run, console);
        let (gaussians, origin) = (loaded.gaussians, loaded.origin);
        Ok(Model { name: name(path), gaussians, origin, shift, style, facts: None })
    }
}

/// Lets a model lie where another one of its world lies, as `eval --against` does.
fn lay_upon(model: &mut Model, other: &Model) {
    model.shift = align(&mut model.gaussians, [model.origin, other.origin], &other.gaussians);
}

/// PSNR of a run's held-out views by name, from its metrics.json; empty where there is none. The folder is only read: the run
/// may still be writing.
fn psnr(run: &Path) -> HashMap<String, f64> {
    let read = || -> Option<Vec<ViewScores>> {
        let document: serde_json::Value =
            serde_json::from_slice(&std::fs::read(run.join("metrics.json")).ok()?).ok()?;
        serde_json::from_value(document["views"].clone()).ok()
    };
    let views = read().unwrap_or_default().into_iter();
    views.filter_map(|v| Some((v.name, v.scores.psnr?))).collect()
}

/// The last part of a path.
fn name(path: &Path) -> String {
    path.file_name().map_or_else(|| path.display().to_string(), |n| n.to_string_lossy().into_owned())
}

/// A run that is to be watched: its capture, and no model yet.
pub(super) fn of_run(config: &RunConfig, output: &Path, console: &Console) -> Result<Subject, Error> {
    let mut capture = capture(&config.scene, Some(config.selection()), None, console)?;
    capture.scene.use_usual_unit(); // as the run does
    let background = config.background.unwrap_or_else(|| capture.alpha_role.usual_background());
    let (title, models) = (name(output), Vec::new());
    Ok(Subject { title, job: Job::Run, models, background, up: None, outline: None, capture: Some(capture) })
}

/// A compression whose fine-tuning is to be watched: what judges the model, and where that lies.
pub(super) fn of_compression(
    config: &CompressConfig,
    model: &Gaussians,
    output: &Path,
    console: &Console,
) -> Result<Subject, Error> {
    let (background, outline, capture) = match &config.views {
        ViewSource::Photos(selection) => {
            let capture = capture(&selection.scene, Some(selection.clone()), None, console)?;
            (selection.background.unwrap_or_else(|| capture.alpha_role.usual_background()), None, Some(capture))
        }
        ViewSource::OwnPictures { cameras, background } => (*background, Some(outline(model, cameras.up)), None),
    };
    let (title, models) = (name(output), Vec::new());
    Ok(Subject { title, job: Job::Compression, models, background, up: None, outline, capture })
}

/// A capture at the working size of the selection that it was trained with, or 640 pixels wide.
fn capture(
    path: &Path,
    trained: Option<Selection>,
    resolution: Option<Resize>,
    console: &Console,
) -> Result<Capture, Error> {
    let run = trained.is_some();
    let selection = trained.unwrap_or_else(|| Selection::of(path.to_owned()));
    let mut scene = Scene::open(path, &selection.open_options()).map_err(|e| unfinished(path, e.into()))?;
    // As a run does before it holds photos out; a capture without any photo still has its cameras.
    if scene.has_photos() {
        scene.require_photos()?;
    }
    for line in scene.skipped.summary() {
        console.warn(format_args!("{}: {line}", path.display()));
    }
    let own = if run { selection.resize().map_err(Error::Usage)? } else { Resize::Width(640) };
    let resize = resolution.unwrap_or(own);
    let split = scene.split(selection.eval_every);
    // Evenly spread: thousands of photos would take longer to decode than to show.
    let views: Vec<_> = evenly(&scene.views, SAMPLED).collect();
    let small = selection.load_options(Resize::Width(THUMBNAIL_WIDTH));
    let alpha_role = alpha_role(&views, &small)?;
    Ok(Capture { scene, resize, split, alpha_role, psnr: HashMap::new() })
}

/// A capture's points as a model, for captures without one; an empty model if it has no points.
fn points(capture: Option<&Capture>, path: &Path, console: &Console) -> Model {
    let seeds: Vec<Seed> = capture.map_or_else(Vec::new, |c| c.scene.points.iter().map(Seed::from).collect());
    if seeds.is_empty() {
        console.warn(format_args!(
            "{} has no points: only its cameras and photos are shown; train it with `qirf-vk run`, or name its model",
            path.display()
        ));
    }
    let mut gaussians = from_points(&seeds);
    // Visible dots in place of the faint blobs that training starts from.
    gaussians.opacity_logits.fill(4.0);
    gaussians.log_scales.iter_mut().flatten().for_each(|s| *s -= 1.5);
    let origin = capture.map_or([0.0; 3], |c| c.scene.origin.to_array());
    Model { name: "points".into(), gaussians, origin, shift: DVec3::ZERO, style: Style::default(), facts: None }
}
