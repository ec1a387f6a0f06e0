//! Errors of training.

use crate::gpu;
use crate::wording::counted;
use std::io;

/// An error of the training floor.
#[derive(Debug, thiserror::Error)]
#[expect(missing_docs, reason = "fields are parts of the message")]
pub enum Error {
    /// The device floor.
    #[error(transparent)]
    Device(#[from] gpu::Error),
    /// No photos to train on.
    #[error("there is no photo to train on")]
    NoViews,
    /// A failure of the file that holds the photos beyond the host's share of memory.
    #[error("the temporary file of decoded photos failed: {0}")]
    Photos(#[from] io::Error),
    /// A checkpoint of a run on other photos.
    #[error("the checkpoint holds {what} of {stored} photos, the scene has {photos} to train on")]
    OtherPhotos {
        /// Data of each photo: `exposures` or `camera corrections`.
        what: &'static str,
        stored: usize,
        photos: usize,
    },
    /// A checkpoint whose arrays do not match the method's.
    #[error("the checkpoint's arrays are not those of the method {method}")]
    Method { method: &'static str },
    /// The cameras leave no place for random points.
    #[error(
        "only {found} of {asked} random points found a place in {tries} tries that {} can see from {near:.1} or further",
        counted(*cameras, "camera")
    )]
    Points {
        found: usize,
        asked: usize,
        tries: u64,
        /// The near plane in world units.
        near: f64,
        cameras: usize,
    },
}

/// Results of this floor.
pub type Result<T, E = Error> = std::result::Result<T, E>;
