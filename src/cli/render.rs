//! `qirf-vk render MODEL`.

use super::Global;
use super::console::Console;
use super::inspect::read_model;
use super::interrupt::Watch;
use super::style;
use super::values::{self, Up};
use crate::error::Error;
use crate::gaussians::formats::Loaded;
use crate::gaussians::outline::outline;
use crate::gaussians::resident::Resident;
use crate::pipeline::evaluate::pictures::{self, Format};
use crate::render::{Renderer, Settings};
use crate::scene::camera::Camera;
use crate::scene::orbit::Look;
use crate::scene::{OpenOptions, Resize, Scene};
use clap::ArgGroup;
use std::collections::HashSet;
use std::path::{Path, PathBuf};
use std::time::Instant;

const EXAMPLES: &str = "Examples:
  qirf-vk render flowers.ply --orbit 8 -o pictures
  qirf-vk render model.spz --orbit 36 --size 1920x1080 --up z --background white -o pictures
  qirf-vk render model.ply --scene capture --resolution /2 -o pictures
  qirf-vk render model.ply --scene capture --format npy -o arrays";

/// Render a model's pictures: from a scene's cameras, or on a circle round it.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
#[command(group = ArgGroup::new("cameras").required(true).args(["scene", "orbit"]))]
pub(super) struct Arguments {
    /// Model: a .ply, .spz, .splat, .ksplat or .sog file, or a SOG folder
    model: PathBuf,
    /// Cameras of this scene (COLMAP, Blender, instant-ngp, nerfstudio); its photos need not be there
    #[arg(long, value_name = "SCENE", help_heading = "Cameras")]
    scene: Option<PathBuf>,
    /// This many cameras on a circle round the model
    #[arg(long, value_name = "N", help_heading = "Cameras", value_parser = clap::value_parser!(u32).range(1..=100_000))]
    orbit: Option<u32>,
    /// Picture size as width, or as a divisor of the photos' size
    #[arg(long, value_name = "W|/K", help_heading = "Cameras", value_parser = values::resolution, conflicts_with = "orbit")]
    resolution: Option<Resize>,
    /// Photo folder, whose pictures give the size (such as images_4)
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
    /// World axis that is up in an orbit: x, y, z, -x, -y, -z, or auto: -y, as captures have it [default: auto]
    #[arg(long, value_name = "AXIS", help_heading = "Cameras", value_parser = values::up, conflicts_with = "scene", allow_hyphen_values = true)]
    up: Option<Up>,
    /// Folder for the pictures; made where it is absent
    #[arg(short, long, value_name = "DIR", help_heading = "Pictures")]
    output: PathBuf,
    /// File format
    #[arg(long, default_value = "png", help_heading = "Pictures")]
    format: Format,
    /// Colour behind the Gaussians: three numbers from 0 to 1, or black, grey, white
    #[arg(long, value_name = "R,G,B", default_value = "black", value_parser = values::colour, help_heading = "Pictures")]
    background: [f32; 3],
    /// Keep alpha in the PNG instead of a background
    #[arg(long, conflicts_with = "background", help_heading = "Pictures")]
    transparent: bool,
    #[command(flatten)]
    rendering: style::Rendering,
}

/// What to draw, and where to.
struct Shot {
    camera: Camera,
    path: PathBuf,
}

impl Arguments {
    pub fn run(&self, console: &Console, global: &Global) -> Result<(), Error> {
        if self.output.exists() && !self.output.is_dir() {
            return Err(Error::Usage(format!("-o {} is a file; name a folder", self.output.display())));
        }
        if self.transparent && self.format == Format::Npy {
            return Err(Error::Usage("--transparent is for PNG; npy files always hold alpha".into()));
        }
        let mut loaded = read_model(&self.model, console)?;
        let mut settings = self.rendering.style().over(self.background);
        let shots = match &self.scene {
            Some(scene) => self.scene_shots(scene, console)?,
            None => self.orbit_shots(&loaded, &mut settings),
        };
        let device = global.open()?;
        let watch = Watch::begin();
        let largest = |side: fn(&Camera) -> u32| shots.iter().map(|s| side(&s.camera)).max().unwrap_or(1);
        let (width, height) = (largest(|c| c.width), largest(|c| c.height));
        if self.format == Format::Png {
            // Bands that turn no colour by a step of eight bits are no work; arrays are drawn as the file has it.
            let degree = loaded.gaussians.degree_in_effect();
            loaded.gaussians.sh.truncate(degree + 1);
        }
        let resident = Resident::upload(&device, &loaded.gaussians)?;
        let mut renderer = Renderer::new(&device, settings, loaded.gaussians.len(), width, height)?;
        let begun = Instant::now();
        let mut drawing = 0.0;
        let bar = console.bar(shots.len() as u64, "rendering");
        for shot in &shots {
            watch.check()?;
            let started = Instant::now();
            let image = renderer.render(&resident, &shot.camera)?;
            drawing += started.elapsed().as_secs_f64();
            pictures::write(&shot.path, &image, self.format, self.transparent)?;
            bar.inc(1);
        }
        bar.finish_and_clear();
        console.note(format_args!(
            "{} pictures in {} ({:.1} s; {:.1} ms to draw one, on {})",
            shots.len(),
            self.output.display(),
            begun.elapsed().as_secs_f64(),
            drawing / shots.len().max(1) as f64 * 1e3,
            device.info().name,
        ));
        Ok(())
    }

    fn orbit_shots(&self, loaded: &Loaded, settings: &mut Settings) -> Vec<Shot> {
        let look = Look {
            fov: self.fov.unwrap_or(40.0).to_radians(),
            elevation: self.elevation.unwrap_or(15.0).to_radians(),
            size: self.size.unwrap_or((1280, 720)),
        };
        let up = self.up.unwrap_or(Up::Auto).direction();
        let outline = outline(&loaded.gaussians, up);
        let (height, distance) = outline.framing(&look);
        tracing::info!("orbit round {} + {height:.3} up, from {distance:.3} away", outline.centre);
        // A model in small units must not fall before the near plane.
        settings.near = settings.near.min((0.02 * distance) as f32);
        let count = self.orbit.unwrap_or(1);
        let digits = count.to_string().len().max(3);
        let path = |i| self.output.join(format!("orbit_{i:0digits$}.{}", self.format.extension()));
        let cameras = outline.cameras(count, &look);
        cameras.into_iter().enumerate().map(|(i, camera)| Shot { camera, path: path(i) }).collect()
    }

    fn scene_shots(&self, path: &Path, console: &Console) -> Result<Vec<Shot>, Error> {
        let scene = Scene::open(path, &OpenOptions { images: self.images.clone(), undistort: None })?;
        for line in scene.skipped.summary() {
            console.warn(format_args!("{}: {line}", path.display()));
        }
        let names = pictures::names(scene.views.iter().map(|v| v.name.as_str()), self.format.extension());
        let shots: Vec<Shot> = scene
            .views
            .iter()
            .zip(names)
            .map(|(view, name)| Shot {
                camera: view.camera_at(self.resolution.unwrap_or(Resize::Full)),
                path: self.output.join(name),
            })
            .collect();
        refuse_photo_folders(&scene, &shots)?;
        Ok(shots)
    }
}

/// Refuses to put pictures where the scene's photos or masks lie.
fn refuse_photo_folders(scene: &Scene, shots: &[Shot]) -> Result<(), Error> {
    let folder = |p: &Path| p.parent().and_then(|p| std::fs::canonicalize(p).ok());
    let files = scene.views.iter().flat_map(|v| [Some(v.image.as_path()), v.mask.as_deref()]).flatten();
    let photos: HashSet<PathBuf> = files.filter_map(folder).collect();
    match shots.iter().find(|s| folder(&s.path).is_some_and(|f| photos.contains(&f))) {
        Some(shot) => Err(Error::Usage(format!(
            "{} would lie among the scene's own photos; name another folder with -o",
            shot.path.display()
        ))),
        None => Ok(()),
    }
}
