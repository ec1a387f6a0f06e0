//! `qirf-vk render MODEL`.

use super::console::Console;
use super::inspect::{open_scene, read_model};
use super::show::Show;
use super::style;
use super::values;
use super::{Global, check_no_run};
use crate::extension::has_extension;
use crate::gaussians::Gaussians;
use crate::gaussians::outline::outline;
use crate::job::output::make_place;
use crate::job::{Error, Session};
use crate::metrics::Networks;
use crate::pipeline::depth;
use crate::pipeline::evaluate::pictures::Format;
use crate::pipeline::film::film;
use crate::pipeline::panorama::{self, Panorama};
use crate::pipeline::place::{origin_of_cameras, place_read};
use crate::pipeline::prepare::refuse_photo_folders;
use crate::pipeline::render::{Orbit, RenderConfig, Shot, frames, leftovers, render, scene_shots};
use crate::scene::camera::{self, Camera};
use crate::scene::orbit::{Look, UP};
use crate::scene::{OpenOptions, Resize, Scene, near_at, walk};
use crate::wording::counted;
use clap::ArgGroup;
use glam::DVec3;
use std::path::{Path, PathBuf};

/// Frames of a path, unless told otherwise.
const FRAMES: u32 = 240;
/// Frames per second of a film, unless told otherwise.
const FPS: f64 = 30.0;

/// Extensions of films and pictures, which no folder should have.
const FILES: [&str; 11] = ["avi", "gif", "jpeg", "jpg", "m4v", "mkv", "mov", "npy", "png", "webm", "webp"];

const EXAMPLES: &str = "Examples:
  qirf-vk render flowers.ply --orbit 8 -o pictures
  qirf-vk render model.spz --orbit 36 --size 1920x1080 --up z --background white -o pictures
  qirf-vk render model.ply --scene capture --resolution /2 -o pictures
  qirf-vk render model.ply --scene capture --format npy -o arrays
  qirf-vk render model.ply --scene capture --depth -o pictures
  qirf-vk render model.ply --path capture --scene capture --frames 300 -o frames
  qirf-vk render model.ply --path orbit --frames 240 -o walk.mp4
  qirf-vk render model.ply --panorama --at 0,-1,0 --size 4096x2048 -o around.png

A path's file is {\"keys\": [{\"eye\": [x, y, z], \"target\": [x, y, z], \"up\": [x, y, z], \"fov\": degrees}, ...]}, or a camera path of nerfstudio.";

#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
#[command(group = ArgGroup::new("cameras").required(true).multiple(true).args(["scene", "orbit", "path", "panorama"]))]
pub(super) struct Arguments {
    /// Model: a .ply, .spz, .splat, .ksplat, .sog, .glb, .gltf, .usda or .usdz file, or a SOG folder
    model: PathBuf,
    /// Scene whose cameras are used: a COLMAP, Blender, instant-ngp or nerfstudio folder; its photos may be absent
    #[arg(long, value_name = "SCENE", help_heading = "Cameras")]
    scene: Option<PathBuf>,
    /// Number of cameras on a circle around the model
    #[arg(long, value_name = "N", help_heading = "Cameras", value_parser = clap::value_parser!(u32).range(1..=100_000), conflicts_with = "scene")]
    orbit: Option<u32>,
    /// Render frames along a smooth path: orbit, once around the model; capture, along the cameras of --scene in their order;
    /// or a file with cameras
    #[arg(long, value_name = "orbit|capture|FILE", help_heading = "Cameras", conflicts_with_all = ["orbit", "panorama"])]
    path: Option<PathBuf>,
    /// Frames of a path [default: 240; the file's, for a camera path of nerfstudio]
    #[arg(long, value_name = "N", help_heading = "Cameras", requires = "path", value_parser = clap::value_parser!(u32).range(1..=100_000))]
    frames: Option<u32>,
    /// Render an equirectangular panorama from the middle of the scene's cameras or of the model
    #[arg(long, help_heading = "Cameras", conflicts_with = "orbit")]
    panorama: bool,
    /// Position of the camera of a panorama
    #[arg(long, value_name = "X,Y,Z", help_heading = "Cameras", requires = "panorama", value_parser = values::point, allow_hyphen_values = true)]
    at: Option<DVec3>,
    /// Picture size as largest width in pixels, or as a divisor of the photos' size [default: the photos' size]
    #[arg(long, value_name = "W|/K", help_heading = "Cameras", value_parser = values::resolution, requires = "scene", conflicts_with_all = ["orbit", "panorama"])]
    resolution: Option<Resize>,
    /// Photo folder, such as images_4, whose photos give the size [default: the scene's own]
    #[arg(long, value_name = "DIR", help_heading = "Cameras", requires = "scene", conflicts_with = "orbit")]
    images: Option<PathBuf>,
    /// Picture size of an orbit, of a path (for --path capture use --resolution) or of a panorama, which is twice as wide as high
    /// [default: that of a camera path of nerfstudio, else 1280x720; 2048x1024 for a panorama]
    #[arg(long, value_name = "WxH", help_heading = "Cameras", value_parser = values::size)]
    size: Option<(u32, u32)>,
    /// Vertical field of view of an orbit, or of a path whose cameras have none, in degrees [default: 40]
    #[arg(long, value_name = "DEGREES", help_heading = "Cameras", value_parser = values::degrees, conflicts_with_all = ["scene", "panorama", "resolution", "images"])]
    fov: Option<f64>,
    /// Height of an orbit above the horizon, in degrees [default: 15]
    #[arg(long, value_name = "DEGREES", help_heading = "Cameras", value_parser = values::elevation, conflicts_with_all = ["scene", "panorama", "resolution", "images"], allow_negative_numbers = true)]
    elevation: Option<f64>,
    /// Up axis of an orbit or a panorama: x, y, z, -x, -y, -z, or auto (as in captures: -y) [default: auto]
    #[arg(long, value_name = "AXIS", help_heading = "Cameras", value_parser = values::up, allow_hyphen_values = true)]
    up: Option<DVec3>,
    /// Folder for the pictures, created if absent; a film.mp4 of a path, which needs ffmpeg; the .png or .npy file of a panorama
    #[arg(short, long, value_name = "DIR|FILE", help_heading = "Pictures")]
    output: PathBuf,
    /// Frames per second of a film [default: as the path's file says, or 30]
    #[arg(long, value_name = "N", value_parser = values::frame_rate, help_heading = "Pictures")]
    fps: Option<f64>,
    /// File format
    #[arg(long, default_value = "png", value_parser = values::one_of::<Format>("a picture format"), help_heading = "Pictures")]
    format: Format,
    /// Colour behind the Gaussians: three numbers from 0 to 1, or black, grey, white [default: as in the model's run, else black]
    #[arg(long, value_name = "R,G,B", value_parser = values::colour, help_heading = "Pictures")]
    background: Option<[f32; 3]>,
    /// Write PNG files with alpha, without a background
    #[arg(long, conflicts_with = "background", help_heading = "Pictures")]
    transparent: bool,
    /// Also write expected and median depths beside each picture: x.depth and x.median, each as .npy (float32, world units)
    /// and as .png (16 bits)
    #[arg(long, help_heading = "Pictures")]
    depth: bool,
    #[command(flatten)]
    rendering: style::Rendering,
}

/// The picture to draw.
enum Work {
    Shots(Vec<Shot>),
    Film(Vec<Camera>, f64),
    Panorama(Panorama),
}

impl Arguments {
    pub fn run(&self, console: &Console, global: &Global) -> Result<(), Error> {
        self.check()?;
        let mut loaded = read_model(&self.model, console)?;
        if let Some(scene) = &self.scene
            && let Some(doubt) = place_read(&mut loaded, scene, self.images.as_deref())?
        {
            console.warn(format_args!("{} {doubt}", self.model.display()));
        }
        let style = self.rendering.beside(&self.model, &loaded, console).style;
        let given = self.background.or(self.transparent.then_some([0.0; 3]));
        let settings = style.over(style::background_beside(&self.model, given, console));
        let (model, origin) = (loaded.gaussians, loaded.origin);
        let mut config =
            RenderConfig { settings, format: self.format()?, transparent: self.transparent, depth: self.depth };
        let scene = self.scene.as_ref().map(|scene| self.open(scene, console)).transpose()?;
        if let Some(scene) = &scene {
            config.settings.near = scene.near;
        }
        let work = match (&scene, &self.path) {
            _ if self.panorama => Work::Panorama(self.whole((&model, origin), scene.as_ref(), &mut config)),
            (scene, Some(path)) => {
                let (cameras, fps) = self.walk(path, scene.as_ref(), (&model, origin), &mut config)?;
                if self.is_film() {
                    Work::Film(cameras, self.fps.or(fps).unwrap_or(FPS))
                } else {
                    Work::Shots(frames(cameras, &self.output, self.format))
                }
            }
            (Some(scene), None) => Work::Shots(self.scene_shots(scene)?),
            (None, None) => Work::Shots(self.orbit(self.orbit.unwrap_or(1)).shots(&model, &self.output, &mut config)),
        };
        if let (Work::Shots(shots), Some(scene)) = (&work, &scene) {
            refuse_photo_folders(scene, shots.iter().map(|shot| &shot.path))?;
        }
        if self.panorama {
            make_place(&self.output)?;
        }
        let device = global.open()?;
        let (networks, watcher) = (Networks::default(), Show::new(console));
        let session = Session { watcher: &watcher, ..Session::new(&device, &networks) };
        let (drawn, times) = match work {
            Work::Shots(shots) => {
                let times = render(&session, model, &shots, &config)?;
                // Pictures of a scene have its photos' names.
                if self.scene.is_none() || self.path.is_some() {
                    self.tell_of_leftovers(&shots, console);
                }
                (shots.len(), times)
            }
            Work::Film(cameras, fps) => (cameras.len(), film(&session, model, cameras, &config, fps, &self.output)?),
            Work::Panorama(panorama) => (6, panorama::draw(&session, &model, &panorama, &config, &self.output)?),
        };
        watcher.rest();
        if self.depth {
            let step = depth::unit(config.settings.near);
            console.note(format_args!(
                "16-bit depths count steps of {step} world units; 0 means no depth, and 65535 means {:.3} units or more",
                f64::from(u16::MAX) * step
            ));
        }
        console.note(format_args!(
            "{} in {} ({:.1} s; {:.1} ms to draw one, on {})",
            counted(if self.panorama { 1 } else { drawn }, if self.is_film() { "frame" } else { "picture" }),
            self.output.display(),
            times.total_s,
            times.draw_s / drawn.max(1) as f64 * 1e3,
            device.info().name,
        ));
        Ok(())
    }

    /// Refuses what does not go together, before any work.
    fn check(&self) -> Result<(), Error> {
        let (film, scene) = (self.is_film(), self.scene.is_some());
        let capture = self.path.as_deref() == Some(Path::new("capture"));
        let why = if self.frames.is_some() && self.path.is_none() {
            "--frames needs --path"
        } else if self.at.is_some() && !self.panorama {
            "--at needs --panorama"
        } else if self.fps.is_some() && !film {
            "--fps applies to films: name an .mp4 file with -o"
        } else if capture && !scene {
            "--path capture follows the cameras of a scene: add --scene SCENE"
        } else if scene && self.path.is_some() && !capture {
            "--scene needs --path capture, or no --path"
        } else if scene && !self.panorama && (self.size.is_some() || self.up.is_some()) {
            "--size and --up do not apply to a scene's cameras; use --resolution"
        } else if self.elevation.is_some() && self.path.as_deref().is_some_and(|path| path != "orbit") {
            "--elevation applies to orbits; the file of a path has its cameras' positions"
        } else if self.panorama && self.size.is_some_and(|(width, height)| width != 2 * height) {
            "--size: a panorama is twice as wide as high, such as 4096x2048"
        } else if self.depth && (film || self.panorama) {
            "--depth works with pictures, not with films or panoramas"
        } else if film && self.path.is_none() {
            "a film needs --path"
        } else if film && (self.format == Format::Npy || self.transparent) {
            "a film cannot be written with --transparent or --format npy"
        } else if self.panorama && self.output.is_dir() {
            "-o names the panorama's file, such as around.png"
        } else if film || self.panorama {
            return Ok(());
        } else if has_extension(&self.output, &FILES) {
            let why = "films are .mp4 files, and pictures go to a folder; name one of these";
            return Err(Error::Usage(format!("-o {}: {why}", self.output.display())));
        } else {
            check_no_run(&self.output)?;
            if !self.transparent || self.format != Format::Npy {
                return Ok(());
            }
            "--transparent applies only to PNG; npy files always contain alpha"
        };
        Err(Error::Usage(why.to_owned()))
    }

    /// True if all pictures make one file.
    pub(super) fn is_one_file(&self) -> bool {
        self.panorama || self.is_film()
    }

    fn is_film(&self) -> bool {
        !self.panorama && has_extension(&self.output, &["mp4"])
    }

    /// Says which pictures of an earlier, longer path or orbit are still in the folder.
    fn tell_of_leftovers(&self, shots: &[Shot], console: &Console) {
        let left = leftovers(&self.output, shots);
        if let Some(first) = left.first() {
            console.note(format_args!(
                "{} also has {} of an earlier path or orbit, from {first} on; remove them before you make a film of the folder",
                self.output.display(),
                counted(left.len(), "picture")
            ));
        }
    }

    /// The format of pictures; a panorama's file may name it.
    fn format(&self) -> Result<Format, Error> {
        if !self.panorama {
            return Ok(self.format);
        }
        match self.output.extension().and_then(|e| e.to_str()) {
            Some("png") if self.format == Format::Png => Ok(Format::Png),
            Some("npy") if !self.transparent => Ok(Format::Npy),
            _ => Err(Error::Usage(format!(
                "-o {}: a panorama is written as .png or, without --transparent, as .npy, as --format says",
                self.output.display()
            ))),
        }
    }

    fn orbit(&self, count: u32) -> Orbit {
        let default = Look::default();
        let look = Look {
            fov: self.fov.map_or(default.fov, f64::to_radians),
            elevation: self.elevation.map_or(default.elevation, f64::to_radians),
            size: self.size.unwrap_or(default.size),
        };
        Orbit { count, look, up: self.up.unwrap_or(UP) }
    }

    /// The cameras of a path, and the frames per second that its file names.
    fn walk(
        &self,
        path: &Path,
        scene: Option<&Scene>,
        (model, origin): (&Gaussians, [f64; 3]),
        config: &mut RenderConfig,
    ) -> Result<(Vec<Camera>, Option<f64>), Error> {
        let count = self.frames.unwrap_or(FRAMES);
        let orbit = self.orbit(count);
        if path == Path::new("orbit") {
            return Ok((orbit.cameras(model, config), None));
        }
        if let Some(scene) = scene {
            let resize = self.resolution.unwrap_or(Resize::Full);
            let keys: Vec<Camera> = scene.views.iter().map(|view| view.camera_at(resize)).collect();
            return Ok((walk::walk(&keys, count), None));
        }
        let Orbit { look, up, .. } = orbit;
        let frame = walk::Frame { size: look.size, asked: self.size.is_some(), fov: look.fov, up };
        let walk::PathFile { cameras: mut keys, every, fps } = walk::read(path, &frame)?;
        if !model.is_empty() {
            config.settings.near = near_at(config.settings.near, outline(model, up).framing(&look).distance);
        }
        let from = origin_of_cameras(camera::mean_centre(keys.iter()), origin);
        for key in &mut keys {
            *key = key.relative_to(from);
        }
        Ok(if every && self.frames.is_none() { (keys, fps) } else { (walk::walk(&keys, count), None) })
    }

    /// A panorama, whose near plane suits a small model.
    fn whole(
        &self,
        (model, origin): (&Gaussians, [f64; 3]),
        scene: Option<&Scene>,
        config: &mut RenderConfig,
    ) -> Panorama {
        let up = self.up.unwrap_or(UP);
        let all = scene.map(|scene| camera::mean_centre(scene.views.iter().map(|view| &view.camera)));
        let outline = outline(model, up);
        let reach = outline.rings.iter().map(|(_, radius)| *radius).fold(0.0, f64::max);
        if reach > 0.0 {
            config.settings.near = near_at(config.settings.near, reach);
        }
        let at = self.at.map(|at| at - origin_of_cameras(at, origin));
        let eye = at.or(all).unwrap_or(outline.centre);
        Panorama { eye, up, width: self.size.map_or(2048, |size| size.0) }
    }

    fn open(&self, path: &Path, console: &Console) -> Result<Scene, Error> {
        open_scene(path, &OpenOptions { images: self.images.clone(), ..OpenOptions::default() }, console)
    }

    fn scene_shots(&self, scene: &Scene) -> Result<Vec<Shot>, Error> {
        scene_shots(scene, self.resolution.unwrap_or(Resize::Full), &self.output, self.format)
    }
}
