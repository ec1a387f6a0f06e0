//! Files of a scene: photos by folder and extension, sizes of photos, whole files.

use std::collections::{HashMap, HashSet};
use std::fs;
use std::path::{Path, PathBuf};

use super::kinds::{EXTENSIONS, is_photo_name, spelt_usually, unread_format};
use super::names::{above, is_result, key, relative, tidy, unescaped};
use super::tree::PhotoTree;
use crate::extension::{extension, has_extension};
use crate::scene::Error;
use crate::scene::image_file::{IS_LFS_POINTER, LFS_POINTER, is_grey, is_indexed, is_unread};
use crate::scene::image_size::image_size;

/// Number of the first photos of a capture by which it is decided where they are, and of those of a folder by which it is decided what
/// may stand for them.
pub(super) const FIRST: usize = 100;

/// The photo folder that the user names: within the scene, otherwise a path of its own.
pub(super) fn image_folder(root: &Path, asked: &Path) -> Result<PathBuf, Error> {
    [root.join(asked), asked.to_owned()].into_iter().find(|p| p.is_dir()).ok_or_else(|| {
        let holding = inside(root).into_iter().filter(|path| !PhotoTree::with_twins(path).names.is_empty());
        let known = holding.filter_map(|path| Some(path.file_name()?.to_string_lossy().into_owned())).collect();
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
        let same = |path: &PathBuf| path.file_name().is_some_and(|name| name.eq_ignore_ascii_case(part));
        inside(&folder).into_iter().find(same).unwrap_or(usual)
    })
}

/// The paths in a folder, sorted; none if there is no such folder.
pub(super) fn inside(folder: &Path) -> Vec<PathBuf> {
    let entries = fs::read_dir(folder).into_iter().flatten().flatten();
    let mut paths: Vec<PathBuf> = entries.map(|entry| entry.path()).collect();
    paths.sort();
    paths
}

/// The first candidate that exists as named, or of which there is a likely file with another photo extension, or with one appended;
/// otherwise the first as named. A photo in a format that is not read gives way to its copy in one that is. `known`: see [`likeliest`].
pub(super) fn find_photo(candidates: &[PathBuf], known: Option<&str>) -> PathBuf {
    for candidate in candidates {
        if is_photo_name(candidate) && candidate.is_file() {
            return copy_of_unread(candidate).unwrap_or_else(|| candidate.clone());
        }
        let says = names_format(candidate);
        let named = |e: &&str| if says { candidate.with_extension(e) } else { appended(candidate, e) };
        let there = EXTENSIONS.iter().map(named).filter(|path| path.is_file()).collect();
        if let Some(found) = likeliest(candidate, there, known).into_iter().next() {
            return found;
        }
    }
    candidates.first().cloned().unwrap_or_default()
}

/// True if a name has the extension of a photo, read or not.
fn names_format(photo: &Path) -> bool {
    is_photo_name(photo) || unread_format(photo).is_some()
}

/// The files that are most likely the photo, among those with its name and any extension: those with its own extension,
/// in any case, else those in its format, else by [`rank`]. A picture that may be a mask or a depth map is it if the
/// photo is listed without a format, or if no photo of its folder is there in another format than this picture's:
/// `known` is the format of the first photo that is there.
pub(super) fn likeliest(photo: &Path, files: Vec<PathBuf>, known: Option<&str>) -> Vec<PathBuf> {
    let any = !names_format(photo);
    if files.len() < 2 && (any || known.is_none()) {
        return files;
    }
    let rank = |file: &PathBuf| {
        let other = spelt_usually(file) != spelt_usually(photo);
        (other, extension(file) != extension(photo), other.then(|| self::rank(file)))
    };
    let ranked: Vec<_> = files.into_iter().map(|file| (rank(&file), file)).collect();
    let Some(least) = ranked.iter().map(|(rank, _)| *rank).min() else { return Vec::new() };
    let may_stand = |file: &Path| any || known.is_none_or(|known| known == spelt_usually(file));
    let is_likely = |file: &Path| least.2.is_none() || !may_be_map(file) || may_stand(file);
    ranked.into_iter().filter(|(rank, file)| *rank == least && is_likely(file)).map(|(_, file)| file).collect()
}

/// The order in which files of one name are taken for the photo: those in colour first, then by format; masks in colours lie beside JPEGs.
pub(super) fn rank(picture: &Path) -> (bool, usize) {
    let format = spelt_usually(picture);
    let order = ["jpg", "webp", "tif", "png", "exr"].iter().position(|known| *known == format);
    (may_be_map(picture) || is_grey(picture) == Some(true), order.unwrap_or(usize::MAX))
}

/// The folders of these names of which one of the first photos is found, and its format; that of photos that are there as listed counts
/// before that of others.
pub(super) fn folders_there<'a>(
    names: impl Iterator<Item = &'a str>,
    found: impl Fn(&str) -> Option<PathBuf>,
) -> HashMap<String, String> {
    let mut folders: HashMap<&str, (usize, Option<String>)> = HashMap::new();
    for name in names {
        let (left, there) = folders.entry(above(name)).or_insert((FIRST, None));
        if *left == 0 {
            continue;
        }
        let format = found(name).map(|photo| spelt_usually(&photo));
        let as_listed = format.as_ref().is_some_and(|format| *format == spelt_usually(Path::new(name)));
        *left = if as_listed { 0 } else { *left - 1 };
        if as_listed || there.is_none() {
            *there = format;
        }
    }
    folders.into_iter().filter_map(|(folder, (_, format))| Some((folder.to_owned(), format?))).collect()
}

/// Stands in place of a format: no picture may stand for the photo as a mask or a depth map.
pub(super) const STRICT: Option<&str> = Some("");

/// True for a picture in greys or of a palette in a format without loss, such as a TIFF of floats, whose header announces nothing: it may
/// be the mask or the depth map of a photo of its name.
pub(super) fn may_be_map(picture: &Path) -> bool {
    let is_tiff = has_extension(picture, &["tif", "tiff"]);
    let is_plain = || is_grey(picture).unwrap_or(is_tiff) || is_indexed(picture);
    (is_tiff || has_extension(picture, &["png"])) && is_plain()
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

/// A copy beside a photo whose format, whatever its name says, or whose encoding is not read. Of a JPEG, it is none that may be a map.
fn copy_of_unread(photo: &Path) -> Option<PathBuf> {
    let is_copy = |copy: &PathBuf| photo_size(copy).is_some() && (spelt_usually(photo) != "jpg" || !may_be_map(copy));
    if is_unread(photo) { others(photo).filter(is_copy).min_by_key(|copy| spelt_usually(copy) != "jpg") } else { None }
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
            for path in inside(folder) {
                let key = key(&path.file_name().unwrap_or_default().to_string_lossy());
                by_key.entry(key).or_default().push(path);
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
    text_of(read(path)?).map_err(|(record, what)| Error::malformed(path, record, what))
}

/// The text of a file in UTF-8, or in the UTF-16 that Windows writes, without its byte order mark. An error is the place of the fault, and
/// a sentence on it.
pub fn text_of(mut bytes: Vec<u8>) -> Result<String, (String, &'static str)> {
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
        let what = "is not UTF-8 text: save the file as UTF-8, or is this another format under a text file's name?";
        (format!("line {line} (byte {at})"), what)
    })
}

/// Replaces by `?` what is not ASCII in comments, lines that begin with `#`, of a text that is not UTF-8.
fn plain_comments(bytes: &mut [u8]) {
    if std::str::from_utf8(bytes).is_err() {
        let comments = bytes.split_mut(|byte| *byte == b'\n').filter(|line| line.trim_ascii_start().starts_with(b"#"));
        comments.flatten().filter(|byte| !byte.is_ascii()).for_each(|byte| *byte = b'?');
    }
}
