//! Errors of models and their files.

use std::io;
use std::path::PathBuf;

/// Errors of a model or its file.
#[derive(Debug, thiserror::Error)]
#[expect(missing_docs, reason = "fields are parts of the message")]
pub enum Error {
    /// The operating system refused to read or write.
    #[error("{}: {source}", path.display())]
    Io { path: PathBuf, source: io::Error },
    /// The file's content contradicts its format.
    #[error("{}: {record}: {what}", path.display())]
    Malformed {
        path: PathBuf,
        /// The element, row, stream or field, with its byte offset if there is one.
        record: String,
        /// The fault, then the remedy.
        what: String,
    },
    /// The file or the request is legal, but this program does not support it.
    #[error("{}: {what}", path.display())]
    Unsupported {
        path: PathBuf,
        /// The unsupported feature, then the remedy.
        what: String,
    },
    /// Writing would replace the file that the model was read from.
    #[error("{}: this is the input file itself", path.display())]
    SameFile { path: PathBuf },
    /// Writing would replace a device, a pipe or a socket by a file.
    #[error("{}: this is a device, a pipe or a socket, not a file", path.display())]
    NotAFile { path: PathBuf },
    /// The arrays of a model disagree in length.
    #[error("inconsistent model: {what}")]
    Inconsistent {
        /// The array, its length, the length expected.
        what: String,
    },
}
