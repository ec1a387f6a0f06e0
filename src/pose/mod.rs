//! `qirf-vk pose`: from photos, or a video, to a scene with camera poses, by a program that estimates them.

mod child;
mod colmap;
mod folder;
mod openmvg;
mod panoramas;
mod parts;
mod path;
mod rig;
mod source;
mod video;

use crate::job::{Error, Stage, Watcher};
use crate::scene::Names;
use folder::Folder;
use serde::{Deserialize, Serialize};
use source::Source;
use std::path::{Path, PathBuf};

pub use rig::Rig;
pub use source::is_video;

/// Minimum number of photos with poses for a scene.
const FEWEST: usize = 3;
/// Smallest share of the photos that must get poses, and the share below which the user is warned.
const SHARES: (f64, f64) = (0.2, 0.8);

/// A program that estimates poses.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
#[serde(rename_all = "kebab-case")]
pub enum Backend {
    /// COLMAP if it is installed, else OpenMVG-rs
    #[default]
    Auto,
    /// COLMAP: `colmap`
    Colmap,
    /// OpenMVG-rs: `openmvg-sfm`
    Openmvg,
}

/// The pairs of photos that are compared with each other.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
#[serde(rename_all = "kebab-case")]
pub enum Matching {
    /// Sequential for videos and for 120 photos or more, else exhaustive
    #[default]
    Auto,
    /// Each photo with its neighbours by name
    Sequential,
    /// Each photo with every other one
    Exhaustive,
}

/// Options of estimating poses.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Options {
    /// The program.
    pub backend: Backend,
    /// The pairs that COLMAP compares.
    pub matching: Matching,
    /// Largest number of photos taken from a video.
    pub frames: usize,
    /// True if folders side by side hold the photos of a rig's cameras.
    pub rig: bool,
    /// True if photos or frames are panoramas of all directions.
    pub panoramas: bool,
}

/// The result.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Posed {
    /// Photos.
    pub photos: usize,
    /// Photos with poses in the scene.
    pub posed: usize,
    /// Other parts that the photos fell into, with their numbers of photos: models without a connection to the scene.
    pub others: Vec<(PathBuf, usize)>,
    /// Photos in no part.
    pub nowhere: Names,
    /// Reasons to doubt the poses.
    pub warnings: Vec<String>,
}

impl Posed {
    /// One line for the user.
    pub fn summary(&self) -> String {
        let mut line = format!("{} of {} photos have poses", self.posed, self.photos);
        for (folder, photos) in &self.others {
            let form = if *photos == 1 { "forms" } else { "form" };
            line += &format!("; {photos} {form} a separate part, not connected to the scene ({})", folder.display());
        }
        if self.nowhere.count > 0 {
            let are = if self.nowhere.count == 1 { "is" } else { "are" };
            line += &format!("; {} {are} in no part: {}", self.nowhere.count, self.nowhere);
        }
        line
    }
}

/// Estimates the poses of the photos in a folder and its subfolders, or of frames of a video, and writes the folder `scene`: photos in
/// `images`, poses in `sparse/0`. Poses of the same photos and options that are there already are not estimated again;
/// an interrupted job resumes where it stopped.
///
/// # Errors
/// [`Error::NoProgram`]; [`Error::Usage`] for subfolders or panoramas with OpenMVG-rs, or a rig that is not there;
/// [`Error::Program`] for one that fails; [`Error::FewPoses`]; [`Error::Scene`] for a video that cannot be used or gives too few
/// poses; [`Error::NotOurs`] for a folder that holds something else; [`Error::Interrupted`]; files that cannot be read or written.
pub fn pose(input: &Path, scene: &Path, options: &Options, watcher: &dyn Watcher) -> Result<Posed, Error> {
    let source = Source::of(input, options.frames);
    let rig = if options.panoramas { None } else { source.rig(options.rig)? };
    let taken = rig.as_ref().map(|rig| rig.text.clone()).or(options.panoramas.then(|| "panoramas".to_owned()));
    let mut folder = Folder::open(scene, source.key(taken)?, options)?;
    if let Some(posed) = folder.finished() {
        return Ok(posed);
    }
    let backend = options.backend.installed()?;
    if backend == Backend::Openmvg && options.panoramas {
        let what = "--panoramas: OpenMVG-rs reads one folder, and the faces of panoramas lie in six; install COLMAP, and use \
                    --poses colmap";
        return Err(Error::Usage(what.to_owned()));
    }
    if backend == Backend::Openmvg && source.is_nested() {
        return Err(Error::Usage(format!(
            "OpenMVG-rs reads one folder, and {} has photos in subfolders; use --poses colmap, or put all photos into one folder",
            input.display()
        )));
    }
    if folder.photos().is_empty() {
        source.check(backend, watcher)?;
    }
    let hint = if options.panoramas { None } else { source.hint(rig.as_ref()) };
    for line in source.told().into_iter().chain(hint) {
        watcher.note(&line);
    }
    folder.begin()?;
    if folder.photos().is_empty() {
        let mut names = source.place(&folder, watcher)?;
        if options.panoramas {
            names = panoramas::cut(&folder, &names, watcher)?;
        }
        folder.placed(names)?;
    }
    let rig = if options.panoramas && !folder.photos().is_empty() { Some(panoramas::rig(&folder)?) } else { rig };
    if let Some(line) = panoramas::hint(&folder).filter(|_| !options.panoramas) {
        watcher.note(line);
    }
    let photos = folder.photos().len();
    if photos < FEWEST {
        return Err(source.advised(Error::FewPoses { photos, posed: 0, sequential: false }));
    }
    match backend {
        Backend::Openmvg => openmvg::run(&folder, watcher)?,
        Backend::Auto | Backend::Colmap => {
            colmap::run(&mut folder, (options.matching.of(&source, photos), rig.as_ref()), watcher)?;
        }
    }
    watcher.progress(Stage::Poses, photos, photos);
    let posed = parts::choose(&folder, options.panoramas).map_err(|error| source.advised(error))?;
    folder.finish(&posed)?;
    Ok(posed)
}

impl Backend {
    /// The program to use.
    fn installed(self) -> Result<Self, Error> {
        let wanted: &[&'static str] = match self {
            Self::Auto => &[colmap::PROGRAM, openmvg::PROGRAM],
            Self::Colmap => &[colmap::PROGRAM],
            Self::Openmvg => &[openmvg::PROGRAM],
        };
        match wanted.iter().find(|program| child::on_path(program)) {
            Some(&openmvg::PROGRAM) => Ok(Self::Openmvg),
            Some(_) => Ok(Self::Colmap),
            None => Err(Error::NoProgram(wanted.to_vec())),
        }
    }
}

impl Matching {
    fn of(self, source: &Source, photos: usize) -> Self {
        match self {
            Self::Auto if photos >= 120 || matches!(source, Source::Video { .. }) => Self::Sequential,
            Self::Auto => Self::Exhaustive,
            chosen => chosen,
        }
    }
}
