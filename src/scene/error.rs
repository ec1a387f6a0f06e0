//! What can go wrong between a folder of files and a [`Scene`](super::Scene).

use std::path::{Path, PathBuf};

/// Errors of opening a scene and of loading its photos; every message says what to do.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum Error {
    /// A file or folder could not be read.
    #[error("cannot read {path}: {source}; check that it exists and that you may read it")]
    Io {
        /// The file.
        path: PathBuf,
        /// The system's reason.
        source: std::io::Error,
    },
    /// A file was read, but one of its records is not what the format demands.
    #[error("{path}, {record}: {what}")]
    Malformed {
        /// The file.
        path: PathBuf,
        /// The record within it, as a person would look it up.
        record: String,
        /// What is wrong and what to do.
        what: String,
    },
    /// A camera names a model that the engine does not know.
    #[error(
        "{path}, {record}: camera model {model} is not supported; known are {}. Undistort the photos with `colmap \
         image_undistorter` and open its output, or calibrate again with --ImageReader.camera_model OPENCV",
        super::lens::LensModel::names()
    )]
    UnknownModel {
        /// The file.
        path: PathBuf,
        /// The camera's record.
        record: String,
        /// The model's name or number as found.
        model: String,
    },
    /// The folder holds photos, but nobody has found out where they were taken from.
    #[error("{}", no_poses(.root, .images, *.photos))]
    NoPoses {
        /// The folder given.
        root: PathBuf,
        /// The folder with the photos.
        images: PathBuf,
        /// How many photos it holds.
        photos: usize,
    },
    /// Nothing that looks like a scene lies there.
    #[error(
        "{root} holds no scene; looked for {looked_for}, and for photos (jpg, png, webp) in it, its images and its input \
         folder. Give the folder that holds one of them"
    )]
    NoScene {
        /// The path given.
        root: PathBuf,
        /// The places looked at.
        looked_for: &'static str,
    },
    /// The photo folder asked for does not exist.
    #[error("no folder {asked} in {root}{}; give one with --images", known_folders(.known))]
    NoImageFolder {
        /// The scene's folder.
        root: PathBuf,
        /// The folder as the user named it.
        asked: PathBuf,
        /// Folders of the scene that hold photos.
        known: Vec<String>,
    },
    /// Cameras are there, but none of their photos can be used.
    #[error("none of the {listed} photos of {root} can be used ({what}); name their folder with --images DIR")]
    NoPhotos {
        /// The scene's folder.
        root: PathBuf,
        /// How many photos the scene lists.
        listed: usize,
        /// The first photo sought, and why it was not used.
        what: String,
    },
    /// The scene lists no camera with a usable pose.
    #[error("{path} holds no usable view ({what}); reconstruct the scene again")]
    NoViews {
        /// The file with the poses.
        path: PathBuf,
        /// Why none is left.
        what: String,
    },
    /// One photo or mask cannot be decoded or does not fit its camera.
    #[error("photo {path}: {what}")]
    Photo {
        /// The file.
        path: PathBuf,
        /// What is wrong and what to do.
        what: String,
    },
}

impl Error {
    pub(crate) fn io(path: &Path, source: std::io::Error) -> Self {
        Self::Io { path: path.to_owned(), source }
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

/// A path as a shell takes it.
fn quoted(path: &Path) -> String {
    let text = path.display().to_string();
    let plain = |c: char| c.is_ascii_alphanumeric() || "/._-+,:@%=".contains(c);
    if !text.is_empty() && text.chars().all(plain) { text } else { format!("'{}'", text.replace('\'', r"'\''")) }
}

fn no_poses(root: &Path, images: &Path, photos: usize) -> String {
    let database = quoted(&root.join("database.db"));
    let sparse = quoted(&root.join("sparse"));
    let (shown, images) = (images.display(), quoted(images));
    format!(
        "{shown} holds {photos} photos, but {} says nowhere where they were taken from. COLMAP finds that out:\n  \
         colmap feature_extractor --database_path {database} --image_path {images} --ImageReader.camera_model OPENCV\n  \
         colmap exhaustive_matcher --database_path {database}\n  \
         mkdir -p {sparse}\n  \
         colmap mapper --database_path {database} --image_path {images} --output_path {sparse}\n\
         Add --ImageReader.single_camera 1 to the first where one camera at one zoom took them all. Distortion is \
         corrected here; `colmap image_undistorter` is not needed. Then open {} again.",
        root.display(),
        quoted(root),
    )
}
