//! The exit code of each error: the table of docs/tour.md.

use crate::job::Error;
use crate::{edit, gaussians, gpu, scene, synth, train};
use std::io;

/// Kinds of failure, with their exit codes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Exit {
    /// A request that cannot be met as it was made.
    Usage = 2,
    /// A file or folder that cannot be read, or whose contents are wrong.
    BadInput = 3,
    /// A device that is missing, unsuitable or lost, or that computes wrong numbers.
    Device = 4,
    /// Memory or disk space that ran out; output that cannot be written.
    Resources = 5,
    /// Ctrl-C.
    Interrupted = 130,
}

impl Exit {
    /// The kind of failure that an error is.
    #[allow(clippy::match_same_arms)] // one line a kind of cause
    pub fn of(error: &Error) -> Self {
        match error {
            Error::Usage(_) | Error::NothingHeldOut(_) | Error::NothingToTrainOn(_) => Self::Usage,
            Error::OtherRun { .. }
            | Error::Unfinished(_)
            | Error::Finished(_)
            | Error::Busy(_)
            | Error::AmongPhotos(_) => Self::Usage,
            Error::NoProgram(_) | Error::NotOurs(_) | Error::Encode { .. } => Self::Usage,
            Error::Read { source, .. } if source.kind() == io::ErrorKind::OutOfMemory => Self::Resources,
            Error::Read { .. } | Error::Checkpoint { .. } | Error::Part { .. } => Self::BadInput,
            Error::LostPhoto { .. } | Error::ChangedPhoto { .. } | Error::AllHidden(_) => Self::BadInput,
            Error::Program { .. } | Error::FewPoses { .. } | Error::NothingToPose(_) => Self::BadInput,
            Error::Config { .. } | Error::Metrics(_) | Error::Diagnostics { .. } | Error::Study(_) => Self::BadInput,
            Error::Memory { .. } | Error::Buffer { .. } | Error::Picture { .. } => Self::Resources,
            Error::Write { .. } | Error::Print(_) | Error::Threads(_) => Self::Resources,
            Error::SelfTest { .. } | Error::OtherDevice { .. } => Self::Device,
            Error::Interrupted => Self::Interrupted,
            Error::Device(e) => Self::of_device(e),
            Error::Train(train::Error::NoViews) => Self::Usage,
            Error::Train(train::Error::Photos(_)) => Self::Resources,
            Error::Train(_) => Self::BadInput,
            Error::Gaussians(gaussians::Error::SameFile { .. } | gaussians::Error::NotAFile { .. }) => Self::Usage,
            Error::Gaussians(_) => Self::BadInput,
            Error::Edit(edit::Error::Modes(..)) => Self::BadInput,
            Error::Edit(_) => Self::Usage,
            Error::Scene(scene::Error::NoImageFolder { .. }) => Self::Usage,
            Error::Scene(_) => Self::BadInput,
            Error::Synth(synth::Error::Io { .. } | synth::Error::Picture { .. }) => Self::Resources,
            Error::Synth(_) => Self::Usage,
        }
    }

    fn of_device(error: &gpu::Error) -> Self {
        match error {
            e if e.is_resources() => Self::Resources,
            gpu::Error::Variable { .. } | gpu::Error::Address(_) | gpu::Error::Tuning(_) => Self::Usage,
            _ => Self::Device,
        }
    }

    /// The process's exit code.
    pub fn code(self) -> u8 {
        self as u8
    }
}
