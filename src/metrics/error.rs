//! Errors of measuring pictures.

use super::lpips::Kind;
use std::path::{Path, PathBuf};

/// An error of the metrics floor; each message names the cause.
#[derive(Debug, thiserror::Error)]
#[expect(missing_docs, reason = "fields are parts of the message")]
pub enum Error {
    /// An image without pixels, or whose number of values does not match its size.
    #[error(
        "an image of {width} x {height} pixels needs {width} x {height} x 3 values (at least one pixel), not {found}"
    )]
    Pixels { width: usize, height: usize, found: usize },
    /// Two images that cannot be compared.
    #[error("the images differ in size ({} x {} and {} x {} pixels)", .0.0, .0.1, .1.0, .1.1)]
    Sizes((usize, usize), (usize, usize)),
    /// An image whose deepest feature map would be empty.
    #[error("LPIPS ({kind}) needs images of at least {least} x {least} pixels, and this one has {width} x {height}")]
    TooSmall { kind: Kind, least: usize, width: usize, height: usize },
    /// A weights file that cannot be read.
    #[error("cannot read the LPIPS weights {}: {source}", path.display())]
    Read { path: PathBuf, source: std::io::Error },
    /// A file that does not hold LPIPS weights.
    #[error("{}: {what}", path.display())]
    Weights { path: PathBuf, what: String },
}

impl Error {
    pub(super) fn weights(path: &Path, what: impl Into<String>) -> Self {
        Self::Weights { path: path.to_path_buf(), what: what.into() }
    }
}
