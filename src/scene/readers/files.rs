//! Files of a scene: photos by folder and extension, sizes of photos, whole files.

use std::collections::{HashMap, HashSet};
use std::fs;
use std::path::{Path, PathBuf};

use super::kinds::{EXTENSIONS, is_photo_name, unread_format};
use super::names::{is_result, key, relative, tidy, unescaped};
use super::tree::photo_names;
use crate::scene::Error;
use crate::scene::image_file::{IS_LFS_POINTER, LFS_POINTER, is_unread};
use crate::scene::image_size::image_size;

/// The photo folder that the user names: within the scene, otherwise a path of its own.
pub(super) fn image_folder(root: &Path, asked: &Path) -> Result<PathBuf, Error> {
    [root.join(asked), asked.to_owned()].into_iter().find(|p| p.is_dir()).ok_or_else(|| {
        let mut known: Vec<String> = fs::read_dir(root)
            .into_iter()
            .flatten()
            .flatten()
            .filter(|e| !photo_names(&e.path()).is_empty())
            .map(|e| e.file_name().to_string_lossy().into_owned())
            .collect();
        known.sort();
        Error::NoImageFolder { root: root.to_owned(), asked: asked.to_owned(), known }
    })
}

/// A file or folder below a folder, whatever the case in which the parts of its path are written there; as named if there is none.
pub(super) fn child(folder: &Path, name: &str) -> PathBuf {
    name.split('/').fold(folder.to_owned(), |folder, part| {
        let usual = folder.join(part);
        if usual.exists() {
            return usual;
        }
        let entries = fs::read_dir(folder).into_iter().flatten().flatten();
        let same = entries.filter(|entry| entry.file_name().to_string_lossy().eq_ignore_ascii_case(part));
        same.map(|entry| entry.path()).min().unwrap_or(usual)
    })
}

/// The paths in a folder, sorted; none if there is no such folder.
pub(super) fn inside(folder: &Path) -> Vec<PathBuf> {
    let entries = fs::read_dir(folder).into_iter().flatten().flatten();
    let mut paths: Vec<PathBuf> = entries.map(|entry| entry.path()).collect();
    paths.sort();
    paths
}

/// The first candidate that exists as named, with another photo extension or with one appended; otherwise the first as
/// named. A photo in a format that is not read gives way to its copy in one that is.
pub(super) fn find_photo(candidates: &[PathBuf]) -> PathBuf {
    for candidate in candidates {
        if is_photo_name(candidate) && candidate.is_file() {
            return copy_of_unread(candidate).unwrap_or_else(|| candidate.clone());
        }
        if is_photo_name(candidate) || unread_format(candidate).is_some() {
            if let Some(found) = EXTENSIONS.iter().map(|e| candidate.with_extension(e)).find(|p| p.is_file()) {
                return found;
            }
        } else if let Some(found) = EXTENSIONS.iter().map(|e| appended(candidate, e)).find(|p| p.is_file()) {
            return found;
        }
    }
    candidates.first().cloned().unwrap_or_default()
}

/// Folders that may hold a capture: neither hidden nor results of this program.
pub(super) fn subfolders(folder: &Path) -> impl Iterator<Item = PathBuf> {
    let hidden = |path: &Path| path.file_name().is_some_and(|name| name.as_encoded_bytes().starts_with(b"."));
    inside(folder).into_iter().filter(move |path| !hidden(path) && path.is_dir() && !is_result(path))
}

/// The photo's name with each other extension of photos.
fn others(photo: &Path) -> impl Iterator<Item = PathBuf> {
    EXTENSIONS.iter().map(move |e| photo.with_extension(e)).filter(move |other| other != photo)
}

/// A copy beside a photo whose format, whatever its name says, or whose encoding is not read.
fn copy_of_unread(photo: &Path) -> Option<PathBuf> {
    if is_unread(photo) { others(photo).find(|copy| photo_size(copy).is_some()) } else { None }
}

/// True if one of these photos that are used stands for one that is not read.
pub(super) fn is_replaced(photo: &Path, used: &HashSet<&Path>) -> bool {
    others(photo).any(|copy| used.contains(copy.as_path())) && is_unread(photo)
}

/// `path.extension`, even if the path has dots already.
pub(super) fn appended(path: &Path, extension: &str) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(".");
    name.push(extension);
    PathBuf::from(name)
}

/// Folders of a capture, each read once, and only for files that are not found as listed.
#[derive(Default)]
pub(super) struct Folders {
    /// By folder: the paths in it by the keys of their names, in their order.
    read: HashMap<PathBuf, HashMap<String, Vec<PathBuf>>>,
}

impl Folders {
    /// The file that a capture names by a path, perhaps written as in a URL: as listed, else whatever the case, and without the
    /// folders of the machine that wrote it.
    pub(super) fn listed(&mut self, root: &Path, name: &str) -> PathBuf {
        let found = self.found(root, name).or_else(|| self.found(root, &unescaped(name)?));
        found.unwrap_or_else(|| root.join(tidy(name)))
    }

    fn found(&mut self, root: &Path, name: &str) -> Option<PathBuf> {
        let usual = root.join(tidy(name));
        if usual.is_file() {
            return Some(usual);
        }
        let relative = relative(name);
        let parts: Vec<&str> = relative.split('/').collect();
        let whole = if usual == root.join(&relative) { parts.len().min(1) } else { parts.len() };
        (0..whole).find_map(|from| self.in_any_case(root, &parts[from..]))
    }

    /// The file of a path's folder whose name differs from the path's at most in case.
    pub(super) fn same(&mut self, path: &Path) -> Option<PathBuf> {
        let found = self.of(path.parent()?).get(&key(&path.file_name()?.to_string_lossy()))?;
        found.iter().find(|path| path.is_file()).cloned()
    }

    /// The file at a path below a folder, whose parts may be written in another case.
    fn in_any_case(&mut self, folder: &Path, parts: &[&str]) -> Option<PathBuf> {
        let (first, rest) = parts.split_first()?;
        let found = self.of(folder).get(&key(first)).cloned().unwrap_or_default();
        found.into_iter().find_map(|path| {
            if rest.is_empty() { path.is_file().then_some(path) } else { self.in_any_case(&path, rest) }
        })
    }

    fn of(&mut self, folder: &Path) -> &HashMap<String, Vec<PathBuf>> {
        self.read.entry(folder.to_owned()).or_insert_with(|| {
            let mut by_key: HashMap<String, Vec<PathBuf>> = HashMap::new();
            for entry in fs::read_dir(folder).into_iter().flatten().flatten() {
                by_key.entry(key(&entry.file_name().to_string_lossy())).or_default().push(entry.path());
            }
            for paths in by_key.values_mut() {
                paths.sort();
            }
            by_key
        })
    }
}

/// Width and height of the photo at `path`, if there is one with a legible header.
///
/// Only regular files are opened: a name may point anywhere.
pub(super) fn photo_size(path: &Path) -> Option<(u32, u32)> {
    if !path.is_file() {
        return None;
    }
    let possible = |&(width, height): &(u32, u32)| (1..=1 << 30).contains(&(u64::from(width) * u64::from(height)));
    image_size(path).ok().filter(possible)
}

/// Reads a whole regular file.
pub(super) fn read(path: &Path) -> Result<Vec<u8>, Error> {
    let metadata = fs::metadata(path).map_err(|e| Error::io(path, e))?;
    if !metadata.is_file() {
        return Err(Error::io(path, std::io::Error::other("it is not a regular file")));
    }
    let bytes = fs::read(path).map_err(|e| Error::io(path, e))?;
    if bytes.starts_with(LFS_POINTER) {
        return Err(Error::malformed(path, "its beginning", IS_LFS_POINTER));
    }
    Ok(bytes)
}

/// Reads a whole text file in UTF-8, or in the UTF-16 that Windows writes, without its byte order mark.
pub fn read_text(path: &Path) -> Result<String, Error> {
    let mut bytes = read(path)?;
    let unit: Option<fn([u8; 2]) -> u16> = match bytes.get(..2) {
        Some([0xff, 0xfe]) => Some(u16::from_le_bytes),
        Some([0xfe, 0xff]) => Some(u16::from_be_bytes),
        _ => None,
    };
    if let (Some(unit), (pairs, [])) = (unit, bytes.as_chunks::<2>()) {
        let units: Vec<u16> = pairs[1..].iter().map(|pair| unit(*pair)).collect();
        if let Ok(text) = String::from_utf16(&units) {
            return Ok(text);
        }
    }
    if bytes.starts_with(b"\xef\xbb\xbf") {
        bytes.drain(..3);
    }
    if !bytes.contains(&b'\n') {
        // Lines of old Macs.
        bytes.iter_mut().filter(|byte| **byte == b'\r').for_each(|byte| *byte = b'\n');
    }
    plain_comments(&mut bytes);
    String::from_utf8(bytes).map_err(|e| {
        let at = e.utf8_error().valid_up_to();
        let line = e.as_bytes()[..at].split(|byte| *byte == b'\n').count();
        Error::malformed(
            path,
            format!("line {line} (byte {at})"),
            "is not UTF-8 text: save the file as UTF-8, or is this another format under a text file's name?",
        )
    })
}

/// Replaces by `?` what is not ASCII in comments, lines that begin with `#`, of a text that is not UTF-8.
fn plain_comments(bytes: &mut [u8]) {
    if std::str::from_utf8(bytes).is_err() {
        let comments = bytes.split_mut(|byte| *byte == b'\n').filter(|line| line.trim_ascii_start().starts_with(b"#"));
        comments.flatten().filter(|byte| !byte.is_ascii()).for_each(|byte| *byte = b'?');
    }
}
