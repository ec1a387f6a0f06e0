//! `qirf-vk render`: pictures of a model, from a scene's cameras or on a circle around it.

use super::depth::{self, DepthPainter};
use super::draw_source::DrawSource;
use super::evaluate::pictures::{self, Format};
use super::prepare::refuse_photo_folders;
use crate::gaussians::Gaussians;
use crate::gaussians::outline::outline;
use crate::job::{Error, Session, Stage};
use crate::render::{Image, Painter, Settings};
use crate::scene::camera::{self, Camera};
use crate::scene::orbit::{Framing, Look};
use crate::scene::{Resize, Scene, View, near_at};
use glam::DVec3;
use std::collections::HashSet;
use std::fs;
use std::path::{Path, PathBuf};
use std::time::Instant;

/// One picture of a model, wherever the model fits.
pub fn picture(session: &Session<'_>, model: &Gaussians, settings: Settings, camera: &Camera) -> Result<Image, Error> {
    let size = [camera.width, camera.height];
    let shown = DrawSource::for_pictures(session, model, size, settings.style)?;
    Ok(Painter::of(session.device, settings, shown.source(), size)?.render(shown.source(), camera)?)
}

/// A picture to draw, and its file.
#[derive(Clone, Debug, PartialEq)]
pub struct Shot {
    /// Its camera.
    pub camera: Camera,
    /// Its file.
    pub path: PathBuf,
}

/// Settings of drawing and writing pictures.
#[derive(Clone, Copy, Debug)]
pub struct RenderConfig {
    /// Image formation.
    pub settings: Settings,
    /// File format.
    pub format: Format,
    /// True if PNG files keep alpha in place of a background.
    pub transparent: bool,
    /// True if depths are written beside the pictures.
    pub depth: bool,
}

/// Cameras on a circle around a model.
#[derive(Clone, Copy, Debug)]
pub struct Orbit {
    /// Number of cameras.
    pub count: u32,
    /// Field of view, elevation and picture size.
    pub look: Look,
    /// World direction that is up.
    pub up: DVec3,
}

impl Orbit {
    /// The pictures of a model, below `folder`. Moves the near plane of `config` closer for a small model.
    pub fn shots(&self, model: &Gaussians, folder: &Path, config: &mut RenderConfig) -> Vec<Shot> {
        let cameras = self.cameras(model, config);
        let digits = self.count.to_string().len().max(3);
        let path = |i| folder.join(format!("orbit_{i:0digits$}.{}", config.format.extension()));
        cameras.into_iter().enumerate().map(|(i, camera)| Shot { camera, path: path(i) }).collect()
    }

    /// The cameras. Moves the near plane of `config` closer for a small model.
    pub fn cameras(&self, model: &Gaussians, config: &mut RenderConfig) -> Vec<Camera> {
        let outline = outline(model, self.up);
        let Framing { height, distance } = outline.framing(&self.look);
        tracing::info!("orbit round {} + {height:.3} up, from {distance:.3} away", outline.centre);
        config.settings.near = near_at(config.settings.near, distance);
        outline.cameras(self.count, &self.look)
    }
}

/// The pictures from a scene's cameras, below `folder`, named after its photos.
///
/// # Errors
/// [`Error::Usage`] if a picture would be written among the scene's own photos.
pub fn scene_shots(scene: &Scene, resize: Resize, folder: &Path, format: Format) -> Result<Vec<Shot>, Error> {
    let names = pictures::names(scene.views.iter().map(|v| v.name.as_str()), format.extension());
    let shot = |(view, name): (&View, PathBuf)| Shot { camera: view.camera_at(resize), path: folder.join(name) };
    let shots: Vec<Shot> = scene.views.iter().zip(names).map(shot).collect();
    refuse_photo_folders(scene, shots.iter().map(|shot| &shot.path))?;
    Ok(shots)
}

/// The pictures of cameras on a path, below `folder`, numbered from 0.
pub fn frames(cameras: Vec<Camera>, folder: &Path, format: Format) -> Vec<Shot> {
    let digits = frame_digits(cameras.len());
    let path = |i| folder.join(format!("frame_{i:0digits$}.{}", format.extension()));
    cameras.into_iter().enumerate().map(|(i, camera)| Shot { camera, path: path(i) }).collect()
}

/// The names of pictures in `folder` that are numbered like these and are not among them, sorted.
pub fn leftovers(folder: &Path, shots: &[Shot]) -> Vec<String> {
    let written: HashSet<&str> = shots.iter().filter_map(|shot| shot.path.file_name()?.to_str()).collect();
    let form = |name: &str| {
        let (stem, extension) = name.rsplit_once('.')?;
        let (kind, number) = stem.rsplit_once('_')?;
        let counts = !number.is_empty() && number.bytes().all(|b| b.is_ascii_digit());
        counts.then(|| (kind.to_owned(), extension.to_owned()))
    };
    let forms: HashSet<_> = written.iter().filter_map(|name| form(name)).collect();
    let there = fs::read_dir(folder).into_iter().flatten().flatten();
    let names = there.filter_map(|entry| entry.file_name().into_string().ok());
    let mut left: Vec<String> = names
        .filter(|name| !written.contains(name.as_str()) && form(name).is_some_and(|f| forms.contains(&f)))
        .collect();
    left.sort();
    left
}

/// Seconds of rendering.
#[derive(Clone, Copy, Debug)]
pub struct RenderTimes {
    /// Drawing and writing all pictures.
    pub total_s: f64,
    /// Drawing alone.
    pub draw_s: f64,
}

/// Draws pictures of a model and writes them.
///
/// # Errors
/// Device memory; device errors; a full disk; [`Error::Interrupted`], which leaves only whole pictures.
pub fn render(
    session: &Session<'_>,
    mut model: Gaussians,
    shots: &[Shot],
    config: &RenderConfig,
) -> Result<RenderTimes, Error> {
    if config.format == Format::Png {
        // Skips bands that change no colour by a step of eight bits; `.npy` pictures are drawn from the full model.
        model.sh.truncate(model.degree_in_effect() + 1);
    }
    let size = camera::largest(shots.iter().map(|s| &s.camera));
    let shown = DrawSource::for_pictures(session, &model, size, config.settings.style)?;
    let mut painter = Painter::of(session.device, config.settings, shown.source(), size)?;
    let begun = Instant::now();
    let (mut draw_s, mut empty) = (0.0, 0_usize);
    for (done, shot) in shots.iter().enumerate() {
        session.watcher.step(Stage::Rendering, done, shots.len())?;
        let started = Instant::now();
        let image = painter.render(shown.source(), &shot.camera)?;
        draw_s += started.elapsed().as_secs_f64();
        empty += usize::from(image.pixels.iter().all(|p| p[3] <= 0.0));
        pictures::write(&shot.path, &image, config.format, config.transparent)?;
    }
    session.watcher.progress(Stage::Rendering, shots.len(), shots.len());
    let whole = shown.is_whole();
    drop((painter, shown));
    if config.depth {
        let mut painter = DepthPainter::new(session.device, &model, config.settings, size, whole)?;
        for shot in shots {
            session.watcher.unless_stopped()?;
            painter.draw(&shot.camera)?.write(&shot.path, depth::unit(config.settings.near))?;
        }
    }
    if empty > 0 {
        let all = shots.len();
        let note = format!("{empty} of {all} pictures show nothing: does the model lie where the cameras look?");
        session.watcher.note(&note);
    }
    Ok(RenderTimes { total_s: begun.elapsed().as_secs_f64(), draw_s })
}

/// Digits of the numbers of so many frames.
pub(super) fn frame_digits(frames: usize) -> usize {
    frames.to_string().len().max(4)
}
