//! Errors of reading a [`Scene`](super::Scene) and its photos.

use std::path::{Path, PathBuf};

/// Errors of opening a scene and of loading its photos; each message names the cause.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A file or folder could not be read.
    #[error("cannot read {path}: {source}")]
    Io {
        /// The file.
        path: PathBuf,
        /// The system's reason.
        source: std::io::Error,
    },
    /// Decoded photos that do not fit the host's memory could not be put into a temporary file.
    #[error("cannot write a temporary file of decoded photos in {folder}: {source}")]
    Store {
        /// The file's folder.
        folder: PathBuf,
        /// The system's reason.
        source: std::io::Error,
    },
    /// A record of a file violates the format.
    #[error("{path}, {record}: {what}")]
    Malformed {
        /// The file.
        path: PathBuf,
        /// The record within the file, as a person would look for it.
        record: String,
        /// The fault and its remedy.
        what: String,
    },
    /// A camera has a model that the engine does not know.
    #[error("{path}, {record}: camera model {model} is not supported; known are {}", super::lens::LensModel::names())]
    UnknownModel {
        /// The file.
        path: PathBuf,
        /// The camera's record.
        record: String,
        /// The model's name or number as found.
        model: String,
    },
    /// The folder holds photos, but no camera poses.
    #[error("{images} has {photos} photos, but {root} has no camera poses{beside}")]
    NoPoses {
        /// The folder given.
        root: PathBuf,
        /// The folder with the photos.
        images: PathBuf,
        /// Number of photos in that folder.
        photos: usize,
        /// The files there that may hold poses in another format, as a part of the sentence; may be empty.
        beside: String,
    },
    /// The path holds no scene.
    #[error(
        "{root} holds no scene; looked for {looked_for}, and for photos (jpg, png, webp, tif, exr) in it, its images and its input \
         folder, and in their subfolders{beside}"
    )]
    NoScene {
        /// The path given.
        root: PathBuf,
        /// The places searched.
        looked_for: &'static str,
        /// The files there that may hold poses in another format, as a part of the sentence; may be empty.
        beside: String,
    },
    /// The folder holds several scenes.
    #[error("{root} holds {} scenes: {}", .names.len(), .names.join(", "))]
    SeveralScenes {
        /// The folder given.
        root: PathBuf,
        /// Their folders in it.
        names: Vec<String>,
    },
    /// The requested photo folder does not exist.
    #[error("no folder {asked} in {root}{}", known_folders(.known))]
    NoImageFolder {
        /// The scene's folder.
        root: PathBuf,
        /// The folder as the user named it.
        asked: PathBuf,
        /// Folders of the scene that hold photos.
        known: Vec<String>,
    },
    /// The scene has cameras, but none of their photos can be used.
    #[error("none of the {listed} photos of {root} can be used ({what})")]
    NoPhotos {
        /// The scene's folder.
        root: PathBuf,
        /// Number of photos that the scene lists.
        listed: usize,
        /// The reason why the first photo was not used.
        what: String,
    },
    /// The scene lists no camera with a usable pose.
    #[error("{path} holds no usable view ({what})")]
    NoViews {
        /// The file with the poses.
        path: PathBuf,
        /// The reason why no view is left.
        what: String,
    },
    /// One photo or mask cannot be decoded or does not fit its camera.
    #[error("photo {path}: {what}")]
    Photo {
        /// The file.
        path: PathBuf,
        /// The fault and its remedy.
        what: String,
    },
}

impl Error {
    pub(crate) fn io(path: &Path, source: std::io::Error) -> Self {
        Self::Io { path: path.to_owned(), source }
    }

    pub(crate) fn store(folder: &Path, source: std::io::Error) -> Self {
        Self::Store { folder: folder.to_owned(), source }
    }

    pub(crate) fn malformed(path: &Path, record: impl Into<String>, what: impl Into<String>) -> Self {
        Self::Malformed { path: path.to_owned(), record: record.into(), what: what.into() }
    }

    pub(crate) fn photo(path: &Path, what: impl Into<String>) -> Self {
        Self::Photo { path: path.to_owned(), what: what.into() }
    }
}

fn known_folders(known: &[String]) -> String {
    if known.is_empty() { String::new() } else { format!(" (photos lie in {})", known.join(", ")) }
}
