//! An error inside a reader, before the file's name is known to it.

use std::io;
use std::path::{Path, PathBuf};

use super::Error;
use crate::ply;

/// [`Error`] without the path, which only the caller knows.
#[derive(Debug)]
pub(super) enum Fault {
    Malformed {
        record: String,
        what: String,
    },
    Unsupported(String),
    /// A file beside the one named (a texture of a SOG folder) could not be read.
    Io {
        path: PathBuf,
        source: io::Error,
    },
}

impl Fault {
    /// Names the file.
    pub(super) fn at(self, path: &Path) -> Error {
        match self {
            Self::Malformed { record, what } => Error::Malformed { path: path.to_owned(), record, what },
            Self::Unsupported(what) => Error::Unsupported { path: path.to_owned(), what },
            Self::Io { path, source } => Error::Io { path, source },
        }
    }
}

impl From<ply::Fault> for Fault {
    fn from(ply::Fault { record, what }: ply::Fault) -> Self {
        Self::Malformed { record, what }
    }
}

/// A contradiction in `record`; `what` states the fault, then the remedy.
pub(super) fn malformed(record: impl Into<String>, what: impl Into<String>) -> Fault {
    Fault::Malformed { record: record.into(), what: what.into() }
}
