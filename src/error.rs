//! Errors that end the program early, and their exit codes.

use crate::wording::mebibytes;
use crate::{gaussians, gpu, scene, synth, train};
use std::io;
use std::path::PathBuf;

/// Any error that ends a job: one line that names the cause. The command line adds the remedy.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// A request that makes no sense, from the command line or from code: exit code 2.
    #[error("{0}")]
    Usage(String),
    /// A file or folder that cannot be read: exit code 3.
    #[error("cannot read {}: {source}", path.display())]
    Read {
        /// The file or folder.
        path: PathBuf,
        /// The system's reason.
        source: io::Error,
    },
    /// A file or folder that cannot be written: exit code 5.
    #[error("cannot write {}: {source}", path.display())]
    Write {
        /// The file or folder.
        path: PathBuf,
        /// The system's reason.
        source: io::Error,
    },
    /// Figures or options that JSON or TOML cannot represent: exit code 5.
    #[error("{what} cannot be written: {reason}")]
    Encode {
        /// The file or document.
        what: &'static str,
        /// The encoder's reason.
        reason: String,
    },
    /// A checkpoint of another version of the program: exit code 3.
    #[error("{}: this checkpoint is of another version of the program: {what}", path.display())]
    Checkpoint {
        /// The file.
        path: PathBuf,
        /// The note that is missing, unknown or unreadable.
        what: String,
    },
    /// Standard output is closed or full: exit code 5.
    #[error("cannot write to standard output: {0}")]
    Print(io::Error),
    /// The device floor: exit code 4, or 5 where memory ran out.
    #[error(transparent)]
    Device(#[from] gpu::Error),
    /// Training: 2 without photos, 3 for poses that leave no room for random points, 5 for the photos' temporary file.
    #[error(transparent)]
    Train(train::Error),
    /// An invalid model file: exit code 3.
    #[error(transparent)]
    Gaussians(gaussians::Error),
    /// An invalid scene: exit code 3.
    #[error(transparent)]
    Scene(scene::Error),
    /// A job that does not fit into the device's memory: exit code 5.
    #[error(
        "{what} would need about {} of device memory ({gaussians} Gaussians, pictures of {width} x {height}), and {device} allows {}", mebibytes(*needed), mebibytes(*there)
    )]
    Memory {
        /// The job.
        what: &'static str,
        /// Gaussians expected.
        gaussians: usize,
        /// Widest picture in pixels.
        width: u32,
        /// Highest picture in pixels.
        height: u32,
        /// Bytes needed.
        needed: u64,
        /// Bytes allowed.
        there: u64,
        /// The device's name.
        device: String,
        /// A change that would make the job fit.
        relief: Relief,
    },
    /// A picture that this machine's own memory cannot hold: exit code 5.
    #[error(
        "a picture of {width} x {height} needs about {} of this machine's memory, which has {}", mebibytes(*needed), mebibytes(*there)
    )]
    Picture {
        /// Pixels per row.
        width: u32,
        /// Rows.
        height: u32,
        /// Bytes needed.
        needed: u64,
        /// Bytes of memory.
        there: u64,
    },
    /// The synthetic scene's own errors: 2 for options or an unsuitable folder, 5 for writing.
    #[error(transparent)]
    Synth(#[from] synth::Error),
    /// Networks that cannot be read, or pictures that cannot be scored: exit code 3.
    #[error(transparent)]
    Metrics(#[from] crate::metrics::Error),
    /// The device computes wrong numbers: exit code 4.
    #[error("{failed} of {checks} checks failed on {device} ({driver}), in {rooms}: its results are not to be trusted")]
    SelfTest {
        /// Checks that failed.
        failed: usize,
        /// Checks made.
        checks: usize,
        /// The parts of the engine whose checks failed.
        rooms: String,
        /// The device's name.
        device: String,
        /// Its driver.
        driver: String,
    },
    /// Every photo of the scene is held out: exit code 2.
    #[error("{}: no photo is left to train on", .0.display())]
    NothingToTrainOn(PathBuf),
    /// No photo of the scene is held out: exit code 2.
    #[error("{}: no view is held out", .0.display())]
    NothingHeldOut(PathBuf),
    /// The run to resume has another configuration: exit code 2.
    #[error("{} holds a run with other options ({})", folder.display(), changes.join("; "))]
    OtherRun {
        /// The run's folder.
        folder: PathBuf,
        /// The keys of its `config.toml` that differ, with both values.
        changes: Vec<String>,
    },
    /// A new run would overwrite the checkpoint of an interrupted one: exit code 2.
    #[error("{} is of an interrupted run, which this one would overwrite", .0.display())]
    Unfinished(PathBuf),
    /// A picture that would be written among a scene's own photos: exit code 2.
    #[error("{} would lie among the scene's own photos", .0.display())]
    AmongPhotos(PathBuf),
    /// None of these programs is installed: exit code 2.
    #[error("{} not on the PATH", absent(.0))]
    NoProgram(Vec<&'static str>),
    /// A program that works for this one failed: exit code 3.
    #[error("{program} failed ({ended}{}{last}); its log is {}", if last.is_empty() { "" } else { ": " }, log.display())]
    Program {
        /// The program.
        program: &'static str,
        /// How it ended.
        ended: String,
        /// The last line that it wrote.
        last: String,
        /// The file with all its lines.
        log: PathBuf,
    },
    /// Too few photos could be placed: exit code 3.
    #[error("poses were found for {posed} of {photos} photos: too few for a scene")]
    FewPoses {
        /// Photos.
        photos: usize,
        /// Photos with poses.
        posed: usize,
    },
    /// A file of a divided job that is damaged, or that is not its own: exit code 3.
    #[error("{}: {what}", path.display())]
    Part {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        what: String,
        /// The task that writes it.
        task: String,
    },
    /// A file of `--diagnostics` that is damaged, or about another model: exit code 3.
    #[error("{}: {what}", path.display())]
    Diagnostics {
        /// The file.
        path: PathBuf,
        /// What is wrong with it.
        what: String,
    },
    /// A planned job needs a photo that cannot be read any more: exit code 3.
    #[error("{}: photo {photo} cannot be read; it could be when the job was planned", scene.display())]
    LostPhoto {
        /// The scene.
        scene: PathBuf,
        /// The photo's name.
        photo: String,
    },
    /// A device that computes other bits than the one that a job was planned on: exit code 4.
    #[error("this device computes other bits ({here}) than the one that the job was planned on ({planned})")]
    OtherDevice {
        /// Fingerprint of the plan's device.
        planned: String,
        /// Fingerprint of this one.
        here: String,
    },
    /// Neither photos nor a video: exit code 3.
    #[error("{} holds no photos (jpg, png, webp), and is no video (mp4, mov, mkv, webm, avi)", .0.display())]
    NothingToPose(PathBuf),
    /// A folder for poses that holds something else: exit code 2.
    #[error("{} holds something else than poses that this program estimated", .0.display())]
    NotOurs(PathBuf),
    /// The user pressed Ctrl-C: exit code 130.
    #[error("interrupted; what was finished is kept")]
    Interrupted,
}

/// Names of programs that are not there, as the beginning of a sentence.
fn absent(programs: &[&str]) -> String {
    match programs {
        [one] => format!("{one} is"),
        several => format!("{} are", several.join(" and ")),
    }
}

/// A change that would make a job fit into the device's memory, besides smaller photos.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Relief {
    /// Nothing else.
    None,
    /// At most this many Gaussians.
    Gaussians(usize),
    /// A smaller initial model.
    SmallerModel,
    /// Smaller pictures of the model itself.
    SmallerPictures,
    /// A scene divided into more blocks.
    MoreBlocks,
}

impl From<train::Error> for Error {
    fn from(error: train::Error) -> Self {
        match error {
            train::Error::Device(e) => Self::Device(e),
            other => Self::Train(other),
        }
    }
}

impl From<gaussians::Error> for Error {
    fn from(error: gaussians::Error) -> Self {
        match error {
            gaussians::Error::Io { path, source } => Self::Read { path, source },
            other => Self::Gaussians(other),
        }
    }
}

impl From<scene::Error> for Error {
    fn from(error: scene::Error) -> Self {
        match error {
            scene::Error::Io { path, source } => Self::Read { path, source },
            scene::Error::Store { folder, source } => Self::Write { path: folder, source },
            other => Self::Scene(other),
        }
    }
}

impl Error {
    /// An error of the JSON or TOML encoder.
    pub(crate) fn encoding(what: &'static str, reason: impl std::fmt::Display) -> Self {
        Self::Encode { what, reason: reason.to_string() }
    }

    /// The same error, marked as one of writing a model instead of reading it.
    #[must_use]
    pub fn writing(error: gaussians::Error) -> Self {
        match error {
            gaussians::Error::Io { path, source } => Self::Write { path, source },
            gaussians::Error::Unsupported { .. } => Self::Usage(error.to_string()),
            other => other.into(),
        }
    }

    /// The exit code: 2 usage, 3 bad input, 4 device, 5 resources, 130 interrupted.
    #[allow(clippy::match_same_arms)] // one line a kind of cause
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::Device(e) if e.is_resources() => 5,
            Self::Device(gpu::Error::Variable { .. } | gpu::Error::Address(_)) => 2,
            Self::Read { source, .. } if source.kind() == io::ErrorKind::OutOfMemory => 5,
            Self::Memory { .. } | Self::Picture { .. } | Self::Write { .. } | Self::Encode { .. } | Self::Print(_) => 5,
            Self::Synth(synth::Error::Io { .. } | synth::Error::Picture { .. }) => 5,
            Self::Train(train::Error::Photos(_)) => 5,
            Self::NoProgram(_) | Self::NotOurs(_) => 2,
            Self::Program { .. } | Self::FewPoses { .. } | Self::NothingToPose(_) => 3,
            Self::Usage(_) | Self::NothingHeldOut(_) | Self::OtherRun { .. } | Self::Unfinished(_) | Self::Synth(_) => {
                2
            }
            Self::AmongPhotos(_) | Self::NothingToTrainOn(_) | Self::Train(train::Error::NoViews) => 2,
            Self::Gaussians(gaussians::Error::SameFile { .. }) | Self::Scene(scene::Error::NoImageFolder { .. }) => 2,
            Self::Train(_) => 3,
            Self::Read { .. } | Self::Checkpoint { .. } | Self::Part { .. } | Self::LostPhoto { .. } => 3,
            Self::Diagnostics { .. } => 3,
            Self::Gaussians(_) | Self::Scene(_) | Self::Metrics(_) => 3,
            Self::Device(gpu::Error::Tuning(_)) => 2,
            Self::Device(_) | Self::SelfTest { .. } | Self::OtherDevice { .. } => 4,
            Self::Interrupted => 130,
        }
    }
}
