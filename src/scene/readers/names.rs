//! Names of photos: how captures write them, how file systems do, and which files only belong to a photo.

use crate::extension::has_extension;
use crate::percent::percent_decoded;
use std::collections::{BTreeSet, HashMap, HashSet};
use std::fs;
use std::path::{Path, PathBuf};

use unicode_normalization::UnicodeNormalization;

use super::kinds::{is_photo_name, unread_format};
use super::tree::reduction;

/// Files and folders that make their folder a scene with poses.
const SCENES: [&str; 5] = ["sparse", "cameras.bin", "cameras.txt", "transforms.json", "transforms_train.json"];
/// Files that make their folder a result of this program, or a model whose parts are pictures.
const RESULTS: [&str; 4] = ["pose.json", "config.toml", "metrics.json", "means_l.webp"];

/// Words of a name, in lower case, that say that a file belongs to a photo and is none itself: a mask, a copy or labels, or, where a file
/// holds numbers without loss, a map. Beside maps, photos may be called by the last words.
pub(super) const MASK_WORDS: &str = "mask masks";
pub(super) const COPY_WORDS: &str = "masked thumb thumbnail ir seg semantic";
pub(super) const MAP_WORDS: &str = "depth depths depthmap disparity conf confidence normal normals segmentation";
const PHOTO_WORDS: &str = "color colors rgb image img";
/// The words of files that a photo's number alone may name.
pub(super) const WORDS: [&str; 2] = [MASK_WORDS, MAP_WORDS];
/// Characters between the words of a name; digits are, too.
pub(super) const SEPARATORS: [char; 4] = ['.', '_', '-', ' '];
/// Extensions of files that hold numbers without loss.
const LOSSLESS: [&str; 4] = ["png", "tif", "tiff", "exr"];

/// The path with forward slashes, without a URL's `file://` and without a leading `./`.
pub(super) fn tidy(path: &str) -> String {
    let path = path.replace('\\', "/");
    let path = path.strip_prefix("file://").unwrap_or(&path);
    path.strip_prefix("./").unwrap_or(path).to_owned()
}

/// A tidy path without the root or the drive of the machine that wrote it.
pub(super) fn relative(path: &str) -> String {
    let path = tidy(path);
    let bytes = path.as_bytes();
    let drive = bytes.len() > 1 && bytes[0].is_ascii_alphabetic() && bytes[1] == b':';
    path[if drive { 2 } else { 0 }..].trim_start_matches('/').to_owned()
}

/// The name with escapes such as %20 decoded; none if it has none.
pub(super) fn unescaped(name: &str) -> Option<String> {
    Some(percent_decoded(name)).filter(|plain| plain != name)
}

/// The last part of a path with forward slashes.
pub(super) fn last(path: &str) -> &str {
    path.rsplit('/').next().unwrap_or(path)
}

/// A path without its last part; empty if that is all.
pub(super) fn above(path: &str) -> &str {
    path.rsplit_once(['/', '\\']).map_or("", |(folder, _)| folder)
}

/// Key of the folder that a path's last part lies in; empty without one.
pub(super) fn folder_key(path: &str) -> String {
    let path = tidy(path);
    let folder = path.rsplit_once('/').map_or("", |(folder, _)| last(folder));
    let folder = key(&percent_decoded(folder));
    // Copies stand for the photos.
    if reduction(&folder) > 1 { "images".to_owned() } else { folder }
}

/// Keys of the last parts of names that photos in different folders share.
pub(super) fn twins<'a>(names: impl Iterator<Item = &'a str>) -> HashSet<String> {
    let mut whole: HashMap<String, String> = HashMap::new();
    let mut twins = HashSet::new();
    for name in names {
        let (last, own) = (key(last(name)), key(name));
        if whole.get(&last).is_some_and(|other| *other != own) {
            twins.insert(last.clone());
        }
        whole.insert(last, own);
    }
    twins
}

/// The path without a photo's extension.
fn without_extension(path: &str) -> &str {
    match path.rsplit_once('.') {
        Some((stem, _)) if is_photo_name(Path::new(path)) || unread_format(Path::new(path)).is_some() => stem,
        _ => path,
    }
}

/// The normal form of a name, by which names are compared: lower case, composed letters, forward slashes, no photo's extension.
pub(super) fn key(path: &str) -> String {
    without_extension(&tidy(path)).nfc().collect::<String>().to_lowercase()
}

/// Files by the keys of the photos that they may belong to.
pub(super) type Owners = HashMap<String, BTreeSet<PathBuf>>;

/// Words of maps before a number.
const NUMBERED: &str = "depth disparity confidence";

/// True for one of these words.
fn is_one_of(words: &str, word: &str) -> bool {
    words.split(' ').any(|known| known == word)
}

/// The keys of photos that a file may belong to, if one of these lists of words says so: as its mask, its small copy, its depth map or
/// the like; none if its name does not say that it does.
pub(super) fn belongs_to(path: &str, words: &[&str]) -> Vec<String> {
    let lossless = has_extension(Path::new(path), &LOSSLESS);
    let key = key(path);
    let (folder, stem) = key.rsplit_once('/').map_or(("", key.as_str()), |(f, s)| (f, s));
    let within = |name: &str| if folder.is_empty() { name.to_owned() } else { format!("{folder}/{name}") };
    let is_word = |w: &str| words.iter().any(|list| is_one_of(list, w) && (lossless || *list != MAP_WORDS));
    let mut at = 0;
    for word in stem.split(|c: char| SEPARATORS.contains(&c) || c.is_ascii_digit()) {
        // normal1.png is a photo as front1.png is; depth1.png is not.
        let numbered = stem[at + word.len()..].starts_with(|c: char| c.is_ascii_digit());
        let counts = !numbered || [NUMBERED, COPY_WORDS].iter().any(|list| is_one_of(list, word));
        if counts && is_word(word) && word.len() < stem.len() {
            let before = stem[..at].trim_end_matches(SEPARATORS);
            let after = stem[at + word.len()..].trim_start_matches(SEPARATORS);
            let mut owners = Vec::new();
            let whole = format!("{}{after}", &stem[..at]);
            for owner in [before, after, if before.is_empty() || after.is_empty() { "" } else { whole.as_str() }] {
                if !owner.is_empty() {
                    owners.push(within(without_extension(owner)));
                }
            }
            return owners;
        }
        at += word.len() + 1;
    }
    Vec::new()
}

/// The digits at the end of a key.
pub(super) fn number(key: &str) -> &str {
    &key[key.trim_end_matches(|c: char| c.is_ascii_digit()).len()..]
}

/// The photos of one folder, by what names their files.
pub(super) struct Named {
    keys: HashSet<String>,
    /// Digits at the ends of their keys.
    numbers: HashSet<String>,
}

impl Named {
    /// The photos with these keys.
    pub fn of(mut keys: HashSet<String>) -> Self {
        let plain = |key: &String| {
            let (plain, word) = key.rsplit_once(SEPARATORS)?;
            is_one_of(PHOTO_WORDS, word).then(|| plain.to_owned())
        };
        let plain: Vec<String> = keys.iter().filter_map(plain).collect();
        keys.extend(plain);
        let numbers = keys.iter().map(|key| number(key).to_owned()).filter(|number| !number.is_empty()).collect();
        Self { keys, numbers }
    }

    /// True if one of them is the owner of a file: by its whole name, perhaps with one more word (x_hair_mask), or by the same
    /// number at its end (frame_00001 and depth_00001).
    pub fn has_owner(&self, owners: &[String]) -> bool {
        let is_one = |name: &str| self.keys.contains(name) || self.numbers.contains(last(name));
        let shorter = |owner: &str| {
            owner.rsplit_once(SEPARATORS).is_some_and(|(shorter, word)| !word.contains('/') && is_one(shorter))
        };
        owners.iter().any(|owner| is_one(owner) || shorter(owner))
    }

    /// True if one of them is the owner of a file by its whole name: a photo may be called masked_1 beside bare_1.
    pub fn has_original(&self, owners: &[String]) -> bool {
        owners.iter().any(|owner| self.keys.contains(owner))
    }
}

/// True if these files and folders make their folder a scene with poses, or a result.
pub(super) fn is_scene(entries: &[fs::DirEntry]) -> bool {
    entries.iter().any(|e| SCENES.iter().chain(&RESULTS).any(|mark| e.file_name() == *mark))
}

/// True if a folder is a result of this program.
pub(super) fn is_result(folder: &Path) -> bool {
    RESULTS.iter().any(|mark| folder.join(mark).is_file())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_other_systems_become_relative() {
        for (written, meant) in [
            (r"D:\scans\a b\x.png", "scans/a b/x.png"),
            ("/home/me/x.png", "home/me/x.png"),
            ("file:///home/me/x.png", "home/me/x.png"),
            (r"\\server\share\x.png", "server/share/x.png"),
            (r".\images\x.png", "images/x.png"),
            ("a:b.png", "b.png"),
            ("cam 0/x.png", "cam 0/x.png"),
        ] {
            assert_eq!(relative(written), meant);
        }
        assert_eq!(key("Caf\u{e9}.PNG"), key("cafe\u{301}.jpg"));
    }

    #[test]
    fn masks_and_maps_name_their_photos() {
        let owners = |name: &str| belongs_to(name, &WORDS);
        assert_eq!(owners("a/x.PNG.mask.png"), ["a/x".to_owned()]);
        assert!(owners("x_mask.jpg").contains(&"x".to_owned()));
        assert!(owners("mask_x.png").contains(&"x".to_owned()));
        assert!(owners("r_0_depth_0001.png").contains(&"r_0".to_owned()));
        let photos = Named::of(["frame_00012".to_owned(), "x".to_owned()].into());
        for file in ["depth_00012.png", "depth00012.png", "x_depth.png", "x_hair_mask.png"] {
            assert!(photos.has_owner(&owners(file)), "{file}");
        }
        for (file, is_copy) in [("x_thumb.jpg", true), ("x.ir.png", true), ("masked_00012.jpg", false)] {
            assert_eq!(photos.has_original(&belongs_to(file, &[COPY_WORDS])), is_copy, "{file}");
        }
        assert!(!photos.has_owner(&owners("depth_00013.png")) && !photos.has_owner(&owners("x00012_depth.png")));
        assert!(!Named::of(["01".to_owned()].into()).has_owner(&owners("01_left/x_mask.png")));
        for photo in ["depth_1.jpg", "mask.png", "unmasked_x.png", "alpha_01.jpg"] {
            assert!(owners(photo).is_empty(), "{photo}");
        }
    }
}
