//! Errors of reading a [`Scene`](super::Scene) and its photos.

use std::path::{Path, PathBuf};

use crate::wording::counted;

/// Errors of opening a scene and of loading its photos; each message names the cause.
#[derive(Debug, thiserror::Error)]
#[expect(missing_docs, reason = "fields are parts of the message")]
#[non_exhaustive]
pub enum Error {
    /// A file or folder could not be read.
    #[error("cannot read {path}: {source}")]
    Io { path: PathBuf, source: std::io::Error },
    /// Decoded photos that do not fit the host's memory could not be put into a temporary file.
    #[error("cannot write a temporary file of decoded photos in {folder}: {source}")]
    Store { folder: PathBuf, source: std::io::Error },
    /// A record of a file violates the format.
    #[error("{path}, {record}: {what}")]
    Malformed {
        path: PathBuf,
        /// The record within the file, as a person would look for it.
        record: String,
        /// The fault and its remedy.
        what: String,
    },
    /// The folder holds photos, but no camera poses.
    #[error("{images} has {}, but {}no camera poses{beside}", counted(*photos, "photo"), owner(root, images))]
    NoPoses {
        root: PathBuf,
        images: PathBuf,
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
        root: PathBuf,
        looked_for: &'static str,
        /// The files there that may hold poses in another format, as a part of the sentence; may be empty.
        beside: String,
    },
    /// The path holds no scene, and what it holds instead has a way to one.
    #[error("{path} cannot be used: {what}")]
    Instead {
        path: PathBuf,
        /// Its contents, and the remedy.
        what: String,
    },
    /// The folder holds several scenes.
    #[error("{root} holds {} scenes: {}", .names.len(), .names.join(", "))]
    SeveralScenes { root: PathBuf, names: Vec<String> },
    /// The requested photo folder does not exist.
    #[error("no folder {asked} in {root}{}", known_folders(.known))]
    NoImageFolder {
        root: PathBuf,
        asked: PathBuf,
        /// Folders of the scene that hold photos.
        known: Vec<String>,
    },
    /// The scene has cameras, but none of their photos can be used.
    #[error("none of the {listed} photos of {root} can be used ({what})")]
    NoPhotos { root: PathBuf, listed: usize, what: String },
    /// The scene lists no camera with a usable pose.
    #[error("{path} holds no usable view ({what})")]
    NoViews { path: PathBuf, what: String },
    /// One photo or mask is in a format that is not read, or only stands for one.
    #[error("photo {path}: {what}")]
    Unread {
        path: PathBuf,
        /// The format and the remedy.
        what: String,
    },
    /// One photo or mask cannot be decoded or does not fit its camera.
    #[error("photo {path}: {what}")]
    Photo {
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

    pub(crate) fn unread(path: &Path, what: impl Into<String>) -> Self {
        Self::Unread { path: path.to_owned(), what: what.into() }
    }

    pub(crate) fn photo(path: &Path, what: impl Into<String>) -> Self {
        Self::Photo { path: path.to_owned(), what: what.into() }
    }
}

/// `SCENE has `, if photos do not lie in the scene's folder itself.
fn owner(root: &Path, images: &Path) -> String {
    if images == root { String::new() } else { format!("{} has ", root.display()) }
}

fn known_folders(known: &[String]) -> String {
    if known.is_empty() { String::new() } else { format!(" (photos lie in {})", known.join(", ")) }
}
