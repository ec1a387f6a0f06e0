//! The photos or the video that poses are estimated for.

use super::Watcher;
use super::folder::{Folder, Key};
use super::video;
use crate::error::Error;
use crate::scene::{mask_of, photo_names};
use std::fs;
use std::path::{Path, PathBuf};
use std::time::UNIX_EPOCH;

/// Extensions of videos.
const VIDEOS: [&str; 10] = ["mp4", "mov", "m4v", "mkv", "webm", "avi", "mpg", "mpeg", "mts", "3gp"];

/// True if this is a file with the name of a video.
pub fn is_video(path: &Path) -> bool {
    let video = |e: &std::ffi::OsStr| VIDEOS.iter().any(|known| e.eq_ignore_ascii_case(known));
    path.is_file() && path.extension().is_some_and(video)
}

/// Photos or a video.
pub(super) enum Source {
    /// A folder, and the names of its photos.
    Photos { folder: PathBuf, names: Vec<String> },
    /// A video, and the largest number of frames to take from it.
    Video { file: PathBuf, frames: usize },
}

impl Source {
    /// The photos in the folder `input`, or the video of that name.
    pub fn of(input: &Path, frames: usize) -> Self {
        if is_video(input) {
            return Self::Video { file: input.to_owned(), frames };
        }
        Self::Photos { folder: input.to_owned(), names: photo_names(input) }
    }

    /// What tells these photos from others.
    ///
    /// # Errors
    /// A file that cannot be read.
    pub fn key(&self) -> Result<Key, Error> {
        let (paths, frames): (Vec<PathBuf>, _) = match self {
            Self::Photos { folder, names } => (names.iter().map(|n| folder.join(n)).collect(), None),
            Self::Video { file, frames } => (vec![file.clone()], Some(*frames)),
        };
        let files = paths.iter().map(|path| stamp(path).map_err(|source| Error::Read { path: path.clone(), source }));
        Ok(Key { files: files.collect::<Result<_, _>>()?, frames })
    }

    /// Puts the photos, with their masks, or the chosen frames into the scene; returns their names.
    pub fn place(&self, folder: &Folder, watcher: &dyn Watcher) -> Result<Vec<String>, Error> {
        match self {
            Self::Photos { folder: from, names } => {
                for name in names {
                    watcher.unless_stopped()?;
                    link(&from.join(name), &folder.images().join(name))?;
                    if let Some(mask) = mask_of(from, name) {
                        link(&mask, &folder.masks().join(Path::new(name).with_extension("png")))?;
                    }
                }
                Ok(names.clone())
            }
            Self::Video { file, frames } => video::extract(file, *frames, folder, watcher),
        }
    }
}

/// Name, size in bytes, and nanoseconds since 1970 of a file's last change.
fn stamp(path: &Path) -> std::io::Result<(String, u64, u64)> {
    let data = fs::metadata(path)?;
    let changed = data.modified()?.duration_since(UNIX_EPOCH).map_or(0, |t| t.as_nanos() as u64);
    let name = path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    Ok((name, data.len(), changed))
}

/// A second name of a file, or a copy where that is not possible.
fn link(from: &Path, to: &Path) -> Result<(), Error> {
    let _ = fs::remove_file(to); // of an interrupted job
    let made = to.parent().map_or(Ok(()), fs::create_dir_all);
    let linked = made.and_then(|()| fs::hard_link(from, to).or_else(|_| fs::copy(from, to).map(|_| ())));
    linked.map_err(|source| Error::Write { path: to.to_owned(), source })
}
