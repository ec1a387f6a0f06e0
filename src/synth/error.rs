//! Errors of making a synthetic scene.

use std::path::{Path, PathBuf};

use super::{Effect, Kind};

/// The reason why no synthetic scene was written.
#[derive(Debug, thiserror::Error)]
#[expect(missing_docs, reason = "fields are parts of the message")]
pub enum Error {
    /// Two effects that exclude each other were requested.
    #[error("effects \"{0}\" and \"{1}\" exclude each other")]
    Conflict(Effect, Effect),
    /// An effect that scenes of this kind do not have.
    #[error("a scene of kind {kind} has no effect \"{effect}\"")]
    NotThere { effect: Effect, kind: Kind },
    /// A lens that is not known, or whose parameters no camera has.
    #[error("lens: {0}")]
    Lens(String),
    /// An option beside which there can be no lens.
    #[error("--lens does not apply to {0}")]
    Lenses(String),
    /// Depth maps of a scene of dots.
    #[error("a scene of kind dots has no surfaces, and no depth maps")]
    NoDepth,
    /// A panorama of another shape.
    #[error("a panorama is twice as wide as high, as 512x256 is, not {width}x{height}")]
    NoPanorama { width: u32, height: u32 },
    /// A number in the options lies outside its range.
    #[error("{what} is {value}: it must lie in {low}..={high}")]
    Range {
        /// The option, in words.
        what: &'static str,
        value: u64,
        low: u64,
        high: u64,
    },
    /// The folder holds files that no earlier run wrote.
    #[error("{} is not empty and not a synth scene (it has no synth.json by qirf-vk): nothing was written", .0.display())]
    Foreign(PathBuf),
    /// The path exists but is not a folder.
    #[error("{} is a file", .0.display())]
    NotFolder(PathBuf),
    /// A file or folder could not be read, written or removed.
    #[error("cannot read or write {}: {source}", path.display())]
    Io { path: PathBuf, source: std::io::Error },
    /// A picture could not be encoded or written.
    #[error("cannot write {}: {source}", path.display())]
    Picture { path: PathBuf, source: image::ImageError },
}

impl Error {
    /// Names the file or folder in an error of the system.
    pub(super) fn io(path: &Path) -> impl FnOnce(std::io::Error) -> Self {
        let path = path.to_path_buf();
        move |source| Self::Io { path, source }
    }
}
