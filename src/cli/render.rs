//! `qirf-vk render MODEL`.

use super::Global;
use super::console::Console;
use super::inspect::read_model;
use super::show::Show;
use super::style;
use super::values::{self, Up};
use crate::metrics::Networks;
use crate::pipeline::Error;
use crate::pipeline::Session;
use crate::pipeline::evaluate::pictures::Format;
use crate::pipeline::render::{Orbit, RenderConfig, Shot, render, scene_shots};
use crate::scene::orbit::Look;
use crate::scene::{OpenOptions, Resize, Scene};
use crate::wording::counted;
use clap::ArgGroup;
use std::path::{Path, PathBuf};

const EXAMPLES: &str = "Examples:
  qirf-vk render flowers.ply --orbit 8 -o pictures
  qirf-vk render model.spz --orbit 36 --size 1920x1080 --up z --background white -o pictures
  qirf-vk render model.ply --scene capture --resolution /2 -o pictures
  qirf-vk render model.ply --scene capture --format npy -o arrays";

/// Render pictures of a model, from a scene's cameras or on a circle around it.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
#[command(group = ArgGroup::new("cameras").required(true).args(["scene", "orbit"]))]
pub(super) struct Arguments {
    /// Model: a .ply, .spz, .splat, .ksplat, .sog, .glb, .gltf, .usda or .usdz file, or a SOG folder
    model: PathBuf,
    /// Scene whose cameras are used: a COLMAP, Blender, instant-ngp or nerfstudio folder; its photos may be absent
    #[arg(long, value_name = "SCENE", help_heading = "Cameras")]
    scene: Option<PathBuf>,
    /// Number of cameras on a circle around the model
    #[arg(long, value_name = "N", help_heading = "Cameras", value_parser = clap::value_parser!(u32).range(1..=100_000))]
    orbit: Option<u32>,
    /// Picture size as largest width in pixels, or as a divisor of the photos' size [default: the photos' size]
    #[arg(long, value_name = "W|/K", help_heading = "Cameras", value_parser = values::resolution, conflicts_with = "orbit")]
    resolution: Option<Resize>,
    /// Photo folder, such as images_4, whose photos give the size [default: the scene's own]
    #[arg(long, value_name = "DIR", help_heading = "Cameras", conflicts_with = "orbit")]
    images: Option<PathBuf>,
    /// Picture size of an orbit [default: 1280x720]
    #[arg(long, value_name = "WxH", help_heading = "Cameras", value_parser = values::size, conflicts_with = "scene")]
    size: Option<(u32, u32)>,
    /// Vertical field of view of an orbit, in degrees [default: 40]
    #[arg(long, value_name = "DEGREES", help_heading = "Cameras", value_parser = values::degrees, conflicts_with = "scene")]
    fov: Option<f64>,
    /// Height of an orbit above the horizon, in degrees [default: 15]
    #[arg(long, value_name = "DEGREES", help_heading = "Cameras", value_parser = values::elevation, conflicts_with = "scene", allow_negative_numbers = true)]
    elevation: Option<f64>,
    /// World axis that is up in an orbit: x, y, z, -x, -y, -z, or auto (as in captures: -y) [default: auto]
    #[arg(long, value_name = "AXIS", help_heading = "Cameras", value_parser = values::up, conflicts_with = "scene", allow_hyphen_values = true)]
    up: Option<Up>,
    /// Folder for the pictures; created if absent
    #[arg(short, long, value_name = "DIR", help_heading = "Pictures")]
    output: PathBuf,
    /// File format
    #[arg(long, default_value = "png", value_parser = values::one_of::<Format>("a picture format"), help_heading = "Pictures")]
    format: Format,
    /// Colour behind the Gaussians: three numbers from 0 to 1, or black, grey, white
    #[arg(long, value_name = "R,G,B", default_value = "black", value_parser = values::colour, help_heading = "Pictures")]
    background: [f32; 3],
    /// Write PNG files with alpha, without a background
    #[arg(long, conflicts_with = "background", help_heading = "Pictures")]
    transparent: bool,
    #[command(flatten)]
    rendering: style::Rendering,
}

impl Arguments {
    pub fn run(&self, console: &Console, global: &Global) -> Result<(), Error> {
        if self.output.exists() && !self.output.is_dir() {
            return Err(Error::Usage(format!("-o {} is a file; name a folder", self.output.display())));
        }
        if self.transparent && self.format == Format::Npy {
            return Err(Error::Usage("--transparent is for PNG; npy files always hold alpha".into()));
        }
        let loaded = read_model(&self.model, console)?;
        let settings = self.rendering.style(&self.model, &loaded, None, console).over(self.background);
        let model = loaded.gaussians;
        let mut config = RenderConfig { settings, format: self.format, transparent: self.transparent };
        let shots = match &self.scene {
            Some(scene) => self.scene_shots(scene, console)?,
            None => self.orbit().shots(&model, &self.output, &mut config),
        };
        let device = global.open()?;
        let (networks, watcher) = (Networks::default(), Show::new(console));
        let session = Session { watcher: &watcher, ..Session::new(&device, &networks) };
        let times = render(&session, model, &shots, &config)?;
        console.note(format_args!(
            "{} in {} ({:.1} s; {:.1} ms to draw one, on {})",
            counted(shots.len(), "picture"),
            self.output.display(),
            times.total_s,
            times.draw_s / shots.len().max(1) as f64 * 1e3,
            device.info().name,
        ));
        Ok(())
    }

    fn orbit(&self) -> Orbit {
        let default = Look::default();
        let look = Look {
            fov: self.fov.map_or(default.fov, f64::to_radians),
            elevation: self.elevation.map_or(default.elevation, f64::to_radians),
            size: self.size.unwrap_or(default.size),
        };
        Orbit { count: self.orbit.unwrap_or(1), look, up: self.up.unwrap_or(Up::Auto).direction() }
    }

    fn scene_shots(&self, path: &Path, console: &Console) -> Result<Vec<Shot>, Error> {
        let scene = Scene::open(path, &OpenOptions { images: self.images.clone(), undistort: None })?;
        for line in scene.skipped.summary() {
            console.warn(format_args!("{}: {line}", path.display()));
        }
        scene_shots(&scene, self.resolution.unwrap_or(Resize::Full), &self.output, self.format)
    }
}
