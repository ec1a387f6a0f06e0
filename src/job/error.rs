//! The errors that end a job.

use crate::qirf::study;
use crate::wording::mebibytes;
use crate::{gaussians, gpu, scene, synth, train};
use std::io;
use std::path::PathBuf;

/// Any error that ends a job: one line that names the cause. The command line adds the remedy.
#[derive(Debug, thiserror::Error)]
#[expect(missing_docs, reason = "fields are parts of the message")]
pub enum Error {
    /// A request that makes no sense, from the command line or from code.
    #[error("{0}")]
    Usage(String),
    /// A file or folder that cannot be read.
    #[error("cannot read {}: {source}", path.display())]
    Read { path: PathBuf, source: io::Error },
    /// A file or folder that cannot be written.
    #[error("cannot write {}: {source}", path.display())]
    Write { path: PathBuf, source: io::Error },
    /// Figures or options that JSON or TOML cannot represent.
    #[error("{what} cannot be written: {reason}")]
    Encode { what: &'static str, reason: String },
    /// A `config.toml` that is damaged, or has unknown or wrong fields.
    #[error("{}: {what}", path.display())]
    Config { path: PathBuf, what: String },
    /// A checkpoint from another version of the program.
    #[error("{}: this checkpoint is from another version of the program: {what}", path.display())]
    Checkpoint { path: PathBuf, what: String },
    /// Standard output is closed or full.
    #[error("cannot write to standard output: {0}")]
    Print(io::Error),
    /// The device floor.
    #[error(transparent)]
    Device(#[from] gpu::Error),
    /// A model that cannot be studied.
    #[error(transparent)]
    Study(study::Error),
    /// An error of training.
    #[error(transparent)]
    Train(train::Error),
    /// An invalid model file.
    #[error(transparent)]
    Gaussians(gaussians::Error),
    /// An edit of a model.
    #[error(transparent)]
    Edit(#[from] crate::edit::Error),
    /// An invalid scene.
    #[error(transparent)]
    Scene(scene::Error),
    /// A job that does not fit into the device's memory.
    #[error(
        "{what} would need about {} of device memory ({gaussians} Gaussians, pictures of {width} x {height}), and {device} allows {}", mebibytes(*needed), mebibytes(*there)
    )]
    Memory {
        what: &'static str,
        gaussians: usize,
        width: u32,
        height: u32,
        needed: u64,
        there: u64,
        device: String,
        /// A change that would make the job fit.
        relief: Relief,
    },
    /// A job with a buffer that is larger than the device's kernels can bind.
    #[error(
        "{what} would need {needed} bytes in one buffer ('{name}': {gaussians} Gaussians, pictures of {width} x {height}), and {device} binds at most {there}"
    )]
    Buffer {
        what: &'static str,
        name: String,
        gaussians: usize,
        width: u32,
        height: u32,
        needed: u64,
        there: u64,
        device: String,
        /// A change that would make the job fit.
        relief: Relief,
    },
    /// Threads that the system does not start.
    #[error("the system starts no more threads: {0}")]
    Threads(String),
    /// A picture that this machine's own memory cannot hold.
    #[error(
        "a picture of {width} x {height} needs about {} of this machine's memory, which has {}", mebibytes(*needed), mebibytes(*there)
    )]
    Picture { width: u32, height: u32, needed: u64, there: u64 },
    /// The synthetic scene's own errors.
    #[error(transparent)]
    Synth(#[from] synth::Error),
    /// Networks that cannot be read, or pictures that cannot be scored.
    #[error(transparent)]
    Metrics(#[from] crate::metrics::Error),
    /// The device computes wrong numbers.
    #[error("{failed} of {checks} checks failed on {device} ({driver}), in {rooms}: its results cannot be trusted")]
    SelfTest { failed: usize, checks: usize, rooms: String, device: String, driver: String },
    /// Every photo of the scene is held out.
    #[error("{}: no photo is left to train on", .0.display())]
    NothingToTrainOn(PathBuf),
    /// Masks hide all of the photos to train on.
    #[error("{}: the masks hide all of every photo to train on", .0.display())]
    AllHidden(PathBuf),
    /// No photo of the scene is held out.
    #[error("{}: no view is held out", .0.display())]
    NothingHeldOut(PathBuf),
    /// The run to resume has another configuration.
    #[error("{} holds a run with other options or photos ({})", folder.display(), changes.join("; "))]
    OtherRun {
        folder: PathBuf,
        /// The keys of its `config.toml` that differ, with both values.
        changes: Vec<String>,
    },
    /// A new run would overwrite the checkpoint of an interrupted one.
    #[error("{} belongs to an interrupted run, which this run would overwrite", .0.display())]
    Unfinished(PathBuf),
    /// A folder that holds a finished run, which a new one would replace.
    #[error("{} holds a finished run", .0.display())]
    Finished(PathBuf),
    /// Another process writes into the folder of results.
    #[error("another process is working in {}", .0.display())]
    Busy(PathBuf),
    /// A picture that would be written into a photo folder of its scene.
    #[error("{} would lie among the scene's own photos", .0.display())]
    AmongPhotos(PathBuf),
    /// No program of these is installed.
    #[error("{} not on the PATH", absent(.0))]
    NoProgram(Vec<&'static str>),
    /// A program that works for this one failed.
    #[error("{program} failed ({ended}{}{last}); its log is {}", if last.is_empty() { "" } else { ": " }, log.display())]
    Program { program: &'static str, ended: String, last: String, log: PathBuf },
    /// Too few photos could be placed.
    #[error("poses were found for {posed} of {photos} photos: too few for a scene")]
    FewPoses {
        photos: usize,
        posed: usize,
        /// True if not every pair of photos was compared.
        sequential: bool,
    },
    /// A file of a divided job that is damaged, or that is not its own.
    #[error("{}: {what}", path.display())]
    Part { path: PathBuf, what: String, task: String },
    /// A file of `--diagnostics` that is damaged, or about another model.
    #[error("{}: {what}", path.display())]
    Diagnostics { path: PathBuf, what: String },
    /// A planned job needs a photo that cannot be read any more.
    #[error("{}: photo {photo} cannot be read; it could be when the job was planned", scene.display())]
    LostPhoto { scene: PathBuf, photo: String },
    /// A planned job needs a photo that is another one now.
    #[error("{}: photo {photo}, its mask, depth map or camera has changed since the job was planned", scene.display())]
    ChangedPhoto { scene: PathBuf, photo: String },
    /// A device whose results differ in their bits from those of the device that a job was planned on.
    #[error(
        "results on this device (fingerprint {here}) are not bit-identical to those of the plan's device ({planned})"
    )]
    OtherDevice { planned: String, here: String },
    /// Neither photos nor a video.
    #[error("{} holds no photos (jpg, png, webp, tif, exr), and is not a video (mp4, mov, mkv, webm, avi)", .0.display())]
    NothingToPose(PathBuf),
    /// A folder for poses that `pose` did not write.
    #[error("{} is not an output folder of `qirf-vk pose`", .0.display())]
    NotOurs(PathBuf),
    /// The user pressed Ctrl-C.
    #[error("interrupted")]
    Interrupted,
}

/// Names of programs that are not there, as the beginning of a sentence.
fn absent(programs: &[&str]) -> String {
    match programs {
        [one] => format!("{one} is"),
        several => format!("{} are", several.join(" and ")),
    }
}

/// A change that would make a job fit the device, besides smaller photos.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Relief {
    /// No other change would make it fit.
    None,
    /// Only another device, or more of its memory: an interrupted run keeps its options.
    OtherDevice,
    /// Fewer Gaussians, or else a lower SH degree.
    Gaussians {
        /// The largest number of Gaussians that fits.
        most: usize,
        /// The highest SH degree at which the job fits with as many Gaussians as it plans, if there is one.
        degree: Option<u8>,
    },
    /// A smaller initial model.
    SmallerModel,
    /// Smaller pictures of the model itself.
    SmallerPictures,
    /// A scene divided into more blocks.
    MoreBlocks,
}

impl From<study::Error> for Error {
    fn from(error: study::Error) -> Self {
        match error {
            study::Error::Device(e) => Self::Device(e),
            other @ study::Error::Response { .. } => Self::Study(other),
        }
    }
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
}
