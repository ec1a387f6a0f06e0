//! `qirf-vk pose INPUT`, and its options, which `run` shares.

use super::check_folder;
use super::console::Console;
use super::remedy::quoted;
use super::show::Show;
use super::values;
use crate::job::Error;
use crate::pose::{self, Backend, Matching, Options, Posed};
use crate::scene::{self, CameraKind, OpenOptions, Scene, instead, photo_folder};
use clap::Args;
use std::path::PathBuf;

/// Frames taken from a video, unless told otherwise.
const FRAMES: u32 = 150;

const EXAMPLES: &str = "Examples:
  qirf-vk pose photos -o scene
  qirf-vk pose walk.mp4 -o scene --frames 200
  qirf-vk pose photos -o scene --matching exhaustive

The folder then holds images/ and sparse/0, as COLMAP's scenes do, and pose/log.txt. After an interruption, the same command \
resumes where it stopped. `qirf-vk run INPUT -o DIR` does the same into DIR/scene, and trains the scene.";

#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub(super) struct Arguments {
    /// Folder of photos, also in subfolders, or a video
    input: PathBuf,
    /// Folder for the scene: new, empty, or an earlier one of this command
    #[arg(short, long, value_name = "SCENE")]
    output: PathBuf,
    #[command(flatten)]
    posing: Posing,
    /// Print the figures as JSON on standard output
    #[arg(long)]
    json: bool,
}

/// Options of estimating poses.
#[derive(Args, Clone, Debug)]
pub(super) struct Posing {
    /// Program that estimates poses
    #[arg(long, value_name = "auto|colmap|openmvg", default_value = "auto", value_parser = values::one_of::<Backend>("a program that estimates poses"), help_heading = "Poses")]
    poses: Backend,
    /// Pairs of photos that COLMAP compares
    #[arg(long, value_name = "auto|sequential|exhaustive", default_value = "auto", value_parser = values::one_of::<Matching>("a way of matching"), help_heading = "Poses")]
    matching: Matching,
    /// Largest number of frames to take from a video, at most 2 per second (short videos: 60)
    #[arg(long, value_name = "N", default_value_t = FRAMES, help_heading = "Poses", value_parser = clap::value_parser!(u32).range(3..=100_000))]
    frames: u32,
    /// The photos come from a rig: each camera has a folder, and photos taken at the same time have the same name. Needs COLMAP
    /// 3.12 or newer. A rig_config.json of COLMAP beside the photos has the same effect
    #[arg(long, help_heading = "Poses", conflicts_with = "panoramas")]
    rig: bool,
    /// The photos or frames are equirectangular panoramas (360°); they are cut into the faces of a cube
    #[arg(long, help_heading = "Poses")]
    panoramas: bool,
}

impl Posing {
    /// True if an option was given.
    pub fn asked(&self) -> bool {
        let Self { poses, matching, frames, rig, panoramas } = self;
        *poses != Backend::default() || *matching != Matching::default() || *frames != FRAMES || *rig || *panoramas
    }

    pub fn options(&self) -> Options {
        Options {
            backend: self.poses,
            matching: self.matching,
            frames: self.frames as usize,
            rig: self.rig,
            panoramas: self.panoramas,
        }
    }
}

impl Arguments {
    pub fn run(&self, console: &Console) -> Result<(), Error> {
        check_folder(&self.output)?;
        let input = self.input()?;
        if Scene::find(&self.input, &OpenOptions::default()).is_ok() {
            let shown = quoted(&self.input);
            console.note(format_args!("{shown} has poses already: `qirf-vk run {shown} -o DIR` uses them"));
        }
        let watcher = Show::new(console);
        let posed = pose::pose(&input, &self.output, &self.posing.options(), &watcher)?;
        watcher.rest();
        if self.json {
            return console.json(&posed);
        }
        warn(&posed, console);
        console.print(posed.summary())?;
        console.print(self.output.display())
    }

    /// The video, or the folder that holds the photos.
    fn input(&self) -> Result<PathBuf, Error> {
        let path = &self.input;
        std::fs::metadata(path).map_err(|source| Error::Read { path: path.clone(), source })?;
        if pose::is_video(path) {
            return Ok(path.clone());
        }
        let is_photo = path.is_file() && CameraKind::of(path).is_some();
        let photo = || is_photo.then(|| "it is one photo: give the folder of all photos".to_owned());
        photo_folder(path, None).ok_or_else(|| match instead(path).or_else(photo) {
            Some(what) => scene::Error::Instead { path: path.clone(), what }.into(),
            None => Error::NothingToPose(path.clone()),
        })
    }
}

/// Tells what makes poses doubtful.
pub(super) fn warn(posed: &Posed, console: &Console) {
    for doubt in &posed.warnings {
        console.warn(doubt);
    }
}
