//! Paths that are no capture: their contents, and the way to a capture.

use std::path::{Path, PathBuf};

use super::files::{child, inside};
use super::kinds::{self, ARCHIVES, COMPRESSED, VIDEOS};
use super::names::is_result;
use super::tree::{PhotoTree, unread};
use crate::extension::has_extension;

const UNSTITCHED: &str =
    "a 360° camera's own file: export it as an equirectangular video, and give that with --panoramas";

/// The contents of a path without photos or poses, with the remedy: of a file, its kind; of a folder, photos that are
/// not read, a video or an archive.
pub fn instead(path: &Path) -> Option<String> {
    if path.is_file() { of_file(path) } else { of_folder(path) }
}

fn of_file(path: &Path) -> Option<String> {
    // A compressed tar is an archive.
    if has_extension(path, &COMPRESSED) && !has_extension(&path.with_extension(""), &["tar"]) {
        Some("it is compressed: unpack it and give the file in it".to_owned())
    } else if has_extension(path, &ARCHIVES) {
        Some("it is an archive: unpack it and give its folder".to_owned())
    } else if has_extension(path, &kinds::UNSTITCHED) {
        Some(format!("it is {UNSTITCHED}"))
    } else if has_extension(path, &VIDEOS) {
        Some("it is a video, without poses: `run` and `pose` take it and estimate them".to_owned())
    } else if has_extension(path, &["gif"]) {
        let (path, file) = (path.display(), path.with_extension("mp4"));
        let convert = format!("convert it by `ffmpeg -i '{path}' '{}'`, and give that", file.display());
        Some(format!("it is a GIF, which is not read; if it is a video, {convert}"))
    } else {
        super::foreign::file(path)
    }
}

fn of_folder(folder: &Path) -> Option<String> {
    if is_result(folder) {
        return None;
    }
    let places = ["images", "input"].map(|name| child(folder, name));
    let places: Vec<PathBuf> = places.into_iter().chain([folder.to_owned()]).collect();
    if let Some(photos) = places.iter().find_map(|place| unread(&PhotoTree::with_twins(place).unread)) {
        return Some(format!("it holds {photos}"));
    }
    let files = inside(folder);
    let first = |known: &[&str]| files.iter().find(|path| path.is_file() && has_extension(path, known));
    let name = |path: &PathBuf| path.file_name().unwrap_or_default().to_string_lossy().into_owned();
    if let Some(video) = first(&VIDEOS) {
        return Some(format!("it holds no photos, but a video: give `run` or `pose` {}", video.display()));
    }
    if let Some(file) = first(&kinds::UNSTITCHED) {
        return Some(format!("it holds {}, {UNSTITCHED}", name(file)));
    }
    archive_in(folder).map(|archive| format!("it holds an archive: unpack {}", name(&archive)))
}

/// The first archive in a folder, which may hold photos or poses.
pub fn archive_in(folder: &Path) -> Option<PathBuf> {
    inside(folder).into_iter().find(|path| path.is_file() && has_extension(path, &ARCHIVES))
}
