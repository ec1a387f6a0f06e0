//! Files of a scene: photos and masks by folder and extension, sizes of photos, whole files.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};

use crate::scene::Error;
use crate::scene::image_size::image_size;

/// Extensions of photos, in the order in which they are tried for names without one.
const EXTENSIONS: [&str; 8] = ["png", "jpg", "jpeg", "JPG", "PNG", "JPEG", "webp", "WEBP"];

/// True if the path has a photo's extension.
pub(super) fn is_photo_name(path: &Path) -> bool {
    path.extension().is_some_and(|e| EXTENSIONS.iter().any(|known| e.eq_ignore_ascii_case(known)))
}

/// Names, in lower case, of folders of small copies, which cameras and servers write.
const SMALL: [&str; 6] = ["thumb", "thumbs", "thumbnail", "thumbnails", "thmbnl", "@eadir"];
/// Files and folders that make their folder a scene with poses, or a result.
const MARKS: [&str; 8] = [
    "sparse",
    "cameras.bin",
    "cameras.txt",
    "transforms.json",
    "transforms_train.json",
    "pose.json",
    "config.toml",
    "metrics.json",
];

/// Photos in a folder and its subfolders.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct PhotoTree {
    /// Their paths within the folder, with `/` between the parts, sorted.
    pub names: Vec<String>,
    /// Subfolders that were left out, likewise; hidden ones and masks are not told.
    pub left_out: Vec<String>,
}

impl PhotoTree {
    /// Looks into a folder. Left out are hidden files and folders, links to folders, folders of masks and thumbnails, and
    /// folders that hold a scene with poses or a result of this program. Empty if there is no such folder.
    pub fn of(folder: &Path) -> Self {
        let mut tree = Self::default();
        let mut open = vec![(folder.to_owned(), String::new())];
        while let Some((path, prefix)) = open.pop() {
            let entries: Vec<_> = fs::read_dir(path).into_iter().flatten().flatten().collect();
            let marked = entries.iter().any(|e| MARKS.iter().any(|mark| e.file_name() == *mark));
            if marked && !prefix.is_empty() {
                tree.left_out.push(prefix.trim_end_matches('/').to_owned());
                continue;
            }
            for entry in entries {
                let Ok(own) = entry.file_name().into_string() else { continue };
                let name = format!("{prefix}{own}");
                if own.starts_with('.') {
                    continue;
                }
                if entry.file_type().is_ok_and(|kind| kind.is_dir()) {
                    match own.to_lowercase() + "_" {
                        // masks, and masks_4 for images_4.
                        lower if lower.starts_with("masks_") || lower.starts_with("mask_") => {}
                        lower if SMALL.contains(&lower.trim_end_matches('_')) => tree.left_out.push(name),
                        // A scene's photos are in the folder itself; what lies deeper belongs to its results.
                        _ if marked => {}
                        _ => open.push((entry.path(), name + "/")),
                    }
                } else if is_photo_name(&entry.path()) && entry.path().is_file() {
                    tree.names.push(name);
                }
            }
        }
        tree.names.sort();
        tree.left_out.sort();
        tree
    }

    /// The folders that hold photos, by their paths within the folder (empty for itself), with their numbers of photos.
    pub fn folders(&self) -> Vec<(&str, usize)> {
        let mut folders = BTreeMap::new();
        for name in &self.names {
            *folders.entry(name.rsplit_once('/').map_or("", |(folder, _)| folder)).or_insert(0) += 1;
        }
        folders.into_iter().collect()
    }
}

/// Names of the photos in a folder and its subfolders: those of its [`PhotoTree`].
pub fn photo_names(folder: &Path) -> Vec<String> {
    PhotoTree::of(folder).names
}

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

/// The first candidate that exists as named, with another photo extension or with one appended; otherwise the first as
/// named.
pub(super) fn find_photo(candidates: &[PathBuf]) -> PathBuf {
    for candidate in candidates {
        if is_photo_name(candidate) {
            if candidate.is_file() {
                return candidate.clone();
            }
            if let Some(found) = EXTENSIONS.iter().map(|e| candidate.with_extension(e)).find(|p| p.is_file()) {
                return found;
            }
        } else if let Some(found) = EXTENSIONS.iter().map(|e| appended(candidate, e)).find(|p| p.is_file()) {
            return found;
        }
    }
    candidates.first().cloned().unwrap_or_default()
}

/// `path.extension`, even if the path has dots already.
fn appended(path: &Path, extension: &str) -> PathBuf {
    let mut name = path.as_os_str().to_owned();
    name.push(".");
    name.push(extension);
    PathBuf::from(name)
}

/// The mask folder that goes with a photo folder: `images_4` has `masks_4`, else `masks`, beside it.
pub(super) fn mask_folder(root: &Path, images: &Path) -> Option<PathBuf> {
    let beside = images.parent().filter(|_| images.starts_with(root) && images != root).unwrap_or(root);
    let name = images.file_name().and_then(|n| n.to_str()).unwrap_or_default();
    let scaled = name.strip_prefix("images").map(|suffix| format!("masks{suffix}"));
    scaled.into_iter().chain(["masks".to_owned()]).map(|m| beside.join(m)).find(|p| p.is_dir())
}

/// The mask of a photo named `name`: name.png (extension replaced), name.jpg.png (appended), or the name itself.
pub(super) fn find_mask(folder: &Path, name: &str) -> Option<PathBuf> {
    let plain = folder.join(name);
    [appended(&plain, "png"), plain.with_extension("png"), plain].into_iter().find(|p| p.is_file())
}

/// The mask of the photo `name` in the folder `images`: in the mask folder beside it, or within it where that is the
/// whole capture; otherwise in the folder `masks` beside the photo itself.
pub fn mask_of(images: &Path, name: &str) -> Option<PathBuf> {
    let own = images.file_name().is_some_and(|n| n == "input" || n.to_string_lossy().starts_with("images"));
    let capture = if own { images.parent()? } else { images };
    let of_all = mask_folder(capture, images).and_then(|masks| find_mask(&masks, name));
    of_all.or_else(|| {
        let photo = images.join(name);
        find_mask(&photo.with_file_name("masks"), photo.file_name()?.to_str()?)
    })
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
    fs::read(path).map_err(|e| Error::io(path, e))
}

/// Reads a whole text file.
pub(super) fn read_text(path: &Path) -> Result<String, Error> {
    String::from_utf8(read(path)?).map_err(|e| {
        let at = e.utf8_error().valid_up_to();
        Error::malformed(
            path,
            format!("byte {at}"),
            "is not UTF-8 text; is this another format under a text file's name?",
        )
    })
}
