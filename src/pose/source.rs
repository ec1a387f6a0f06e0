//! The photos or the video that poses are estimated for.

use super::folder::{Folder, Key};
use super::rig::{self, Rig};
use super::video;
use super::{Backend, FEWEST, Watcher};
use crate::extension::has_extension;
use crate::job::Error;
use crate::scene::{self, Names, PhotoTree, in_eight_bits, is_video_name, masks_of};
use crate::wording::counted;
use image::ImageFormat;
use std::path::{Path, PathBuf};
use std::time::UNIX_EPOCH;
use std::{fs, io};

/// True if this is a file with the name of a video.
pub fn is_video(path: &Path) -> bool {
    path.is_file() && is_video_name(path)
}

/// Photos or a video.
pub(super) enum Source {
    /// A folder, and the photos in it and in its subfolders.
    Photos { folder: PathBuf, tree: PhotoTree },
    /// A video, and the largest number of frames to take from it.
    Video { file: PathBuf, frames: usize },
}

impl Source {
    /// The photos in the folder `input`, or the video of that name.
    pub fn of(input: &Path, frames: usize) -> Self {
        if is_video(input) {
            return Self::Video { file: input.to_owned(), frames };
        }
        Self::Photos { folder: input.to_owned(), tree: PhotoTree::of(input) }
    }

    /// Refuses a video that no frames can be taken from, and, if COLMAP is used, photos that its lists cannot name.
    pub fn check(&self, backend: Backend, watcher: &dyn Watcher) -> Result<(), Error> {
        match self {
            Self::Photos { .. } if backend == Backend::Openmvg => Ok(()),
            Self::Photos { folder, tree } => match tree.names.iter().find(|name| !is_one_line(name)) {
                Some(name) => Err(misnamed(folder, name)),
                None => Ok(()),
            },
            Self::Video { file, .. } => video::check(file, watcher),
        }
    }

    /// The same error, with advice on videos where too few of a video's frames have poses.
    pub fn advised(&self, error: Error) -> Error {
        match (self, error) {
            (Self::Video { file, frames }, Error::FewPoses { photos, posed, sequential }) => {
                let what = if photos < FEWEST {
                    format!("it gives {}, and poses need {FEWEST}: film longer", counted(photos, "sharp frame"))
                } else {
                    let pairs = if sequential { "; --matching exhaustive compares more pairs" } else { "" };
                    let more = if photos >= *frames { ", or raise --frames" } else { "" };
                    format!(
                        "poses were found for {posed} of its {photos} frames, too few for a scene: film longer while you walk \
                         slowly around the scene{more}{pairs}"
                    )
                };
                scene::Error::Instead { path: file.clone(), what }.into()
            }
            (_, error) => error,
        }
    }

    /// The rigs that took the photos: those of a file beside them, or, if `asked`, folders with photos of the same names.
    pub fn rig(&self, asked: bool) -> Result<Option<Rig>, Error> {
        match self {
            Self::Photos { folder, tree } => Rig::of(folder, &tree.names, asked),
            Self::Video { file, .. } if asked => {
                Err(Error::Usage(format!("--rig: {} is one video, of one camera", file.display())))
            }
            Self::Video { .. } => Ok(None),
        }
    }

    /// The note on a rig, or the hint for photos that one may have taken.
    pub fn hint(&self, rig: Option<&Rig>) -> Option<String> {
        match (self, rig) {
            (_, Some(rig)) => Some(rig.told()),
            (Self::Photos { tree, .. }, None) => rig::hint(&tree.names),
            (Self::Video { .. }, None) => None,
        }
    }

    /// The key that identifies these photos, and what they were taken by, if it is known.
    pub fn key(&self, rig: Option<String>) -> Result<Key, Error> {
        let (files, frames): (Vec<(PathBuf, String)>, _) = match self {
            Self::Photos { folder, tree } => (tree.names.iter().map(|n| (folder.join(n), n.clone())).collect(), None),
            Self::Video { file, frames } => {
                let name = file.file_name().unwrap_or_default().to_string_lossy().into_owned();
                (vec![(file.clone(), name)], Some(*frames))
            }
        };
        let files = files.into_iter().map(|(path, name)| match stamp(&path) {
            Ok((bytes, changed)) => Ok((name, bytes, changed)),
            Err(source) => Err(Error::Read { path, source }),
        });
        Ok(Key { files: files.collect::<Result<_, _>>()?, frames, rig })
    }

    /// True if there are photos in subfolders.
    pub fn is_nested(&self) -> bool {
        matches!(self, Self::Photos { tree, .. } if tree.names.iter().any(|name| name.contains('/')))
    }

    /// The number of photos by folder, and the folders left out; none if one folder holds all.
    pub fn told(&self) -> Option<String> {
        let Self::Photos { folder, tree } = self else { return None };
        if !self.is_nested() && tree.left_out.is_empty() && tree.notes().is_empty() {
            return None;
        }
        let shown = folder.display();
        let (mut folders, mut left_out) = (Names::default(), Names::default());
        for (within, photos) in tree.folders() {
            folders.add(&format!("{} ({photos})", if within.is_empty() { "itself" } else { within }));
        }
        tree.left_out.iter().for_each(|name| left_out.add(name));
        let mut line = match folders.count {
            1 => format!("found {} photos in 1 folder of {shown}", tree.names.len()),
            n => format!("found {} photos in {n} folders of {shown}", tree.names.len()),
        };
        line += &format!(": {folders}");
        if left_out.count > 0 {
            line += &format!("; left out: {left_out}");
        }
        for note in tree.notes() {
            line += &format!("; {note}");
        }
        Some(line)
    }

    /// Puts the photos, with their masks, or the chosen frames into the scene; returns their names.
    pub fn place(&self, folder: &Folder, watcher: &dyn Watcher) -> Result<Vec<String>, Error> {
        match self {
            Self::Photos { folder: from, tree } => {
                let mask_of = masks_of(from);
                let mut names = Vec::with_capacity(tree.names.len());
                for name in &tree.names {
                    watcher.unless_stopped()?;
                    let placed = put(&from.join(name), &folder.images(), name)?;
                    if let Some(mask) = mask_of(name) {
                        link(&mask, &folder.masks().join(Path::new(&placed).with_extension("png")))?;
                    }
                    names.push(placed);
                }
                Ok(names)
            }
            Self::Video { file, frames } => video::extract(file, *frames, folder, watcher),
        }
    }
}

/// True if a list with a name in each line, of which COLMAP trims ASCII spaces, can hold this one.
fn is_one_line(name: &str) -> bool {
    name.trim_matches(|c: char| c.is_ascii_whitespace()) == name && !name.contains(|c: char| c.is_ascii_control())
}

/// The error of a photo whose name COLMAP's lists cannot hold.
fn misnamed(folder: &Path, name: &str) -> Error {
    let path = folder.join(name.escape_debug().to_string());
    let what = "has a name that begins or ends with a space, or holds a control character, which COLMAP's lists of photos cannot \
                hold: rename it";
    scene::Error::Photo { path, what: what.to_owned() }.into()
}

/// Size in bytes, and nanoseconds since 1970 of a file's last change.
fn stamp(path: &Path) -> std::io::Result<(u64, u64)> {
    let data = fs::metadata(path)?;
    let changed = data.modified()?.duration_since(UNIX_EPOCH).map_or(0, |t| t.as_nanos() as u64);
    Ok((data.len(), changed))
}

/// Puts a photo into the folder of images, in 8 bits a channel, which every program reads: `a.exr` as `a.exr.png`. Returns its
/// name there.
fn put(photo: &Path, images: &Path, name: &str) -> Result<String, Error> {
    // A damaged photo is told later, by its name.
    let Ok(Some(image)) = in_eight_bits(photo) else {
        link(photo, &images.join(name))?;
        return Ok(name.to_owned());
    };
    let name = if has_extension(Path::new(name), &["png"]) { name.to_owned() } else { format!("{name}.png") };
    let path = images.join(&name);
    let _ = fs::remove_file(&path); // perhaps a second name of the photo itself
    let made = path.parent().map_or(Ok(()), fs::create_dir_all);
    let written = made.and_then(|()| image.save_with_format(&path, ImageFormat::Png).map_err(io::Error::other));
    written.map(|()| name).map_err(|source| Error::Write { path, source })
}

/// A second name of a file, or a copy where that is not possible.
fn link(from: &Path, to: &Path) -> Result<(), Error> {
    let _ = fs::remove_file(to); // of an interrupted job
    let made = to.parent().map_or(Ok(()), fs::create_dir_all);
    let linked = made.and_then(|()| fs::hard_link(from, to).or_else(|_| fs::copy(from, to).map(|_| ())));
    linked.map_err(|source| Error::Write { path: to.to_owned(), source })
}
