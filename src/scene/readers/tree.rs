//! Photos of a folder whose poses are not known, without the files and folders that only look like photos.

use std::collections::{BTreeMap, BTreeSet, HashMap, HashSet};
use std::fs;
use std::path::{Path, PathBuf};

use super::files::{inside, may_be_map, photo_size, rank};
use super::kinds::{is_photo_name, spelt_usually, unread_format};
use super::names::{COPY_WORDS, Named, SEPARATORS, WORDS, belongs_to, is_scene, key, last};
use crate::extension::folder_of;
use crate::scene::Names;
use crate::scene::image_file::{holds_floats, is_grey, is_indexed};
use crate::wording::counted;

/// Names, in lower case, of folders of small copies, which cameras and servers write.
const SMALL: [&str; 6] = ["thumb", "thumbs", "thumbnail", "thumbnails", "thmbnl", "@eadir"];
/// Names, in lower case, of folders of maps that belong to photos and are no masks.
const MAPS: &str = "depth depths depth_maps depthmaps depth_images rendered_depth disparity confidence confidence_maps normals normal_maps";

/// Photos in a folder and its subfolders.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct PhotoTree {
    /// Their paths within the folder, with `/` between the parts, sorted.
    pub names: Vec<String>,
    /// Subfolders that were left out, likewise; hidden ones and masks are not told.
    pub left_out: Vec<String>,
    /// Files beside photos that are their masks, maps or small copies, or grey and named like them, likewise.
    pub aside: Vec<String>,
    /// Files that share a photo's name, in another format, likewise.
    pub twins: Vec<String>,
    /// Photos in formats that are not read, and of which there is no copy beside them that is, likewise.
    pub unread: Vec<String>,
}

impl PhotoTree {
    /// Looks into a folder. Left out are hidden files and folders, links to folders, folders of masks, maps and thumbnails,
    /// second copies of photos, and folders that hold a scene with poses or a result of this program. Empty if there is no
    /// such folder.
    pub fn of(folder: &Path) -> Self {
        let mut tree = Self::with_twins(folder);
        tree.part_maps(folder);
        tree.part_twins(folder);
        tree
    }

    /// Looks into a folder as [`Self::of`] does, and keeps photos of one name in several formats: poses tell which is meant.
    pub(super) fn with_twins(folder: &Path) -> Self {
        Self::read(folder, false)
    }

    /// Looks into a folder as [`Self::with_twins`] does, and also into its subfolders if it holds a scene with poses itself.
    pub(super) fn whole(folder: &Path) -> Self {
        Self::read(folder, true)
    }

    fn read(folder: &Path, whole: bool) -> Self {
        let mut tree = Self::default();
        let mut open = vec![(folder.to_owned(), String::new())];
        while let Some((path, prefix)) = open.pop() {
            let entries: Vec<_> = fs::read_dir(path).into_iter().flatten().flatten().collect();
            let marked = is_scene(&entries);
            if marked && !prefix.is_empty() {
                tree.left_out.push(prefix.trim_end_matches('/').to_owned());
                continue;
            }
            let (mut photos, mut unread) = (Vec::new(), Vec::new());
            for entry in entries {
                let Ok(own) = entry.file_name().into_string() else { continue };
                let name = format!("{prefix}{own}");
                if own.starts_with('.') {
                    continue;
                }
                if entry.file_type().is_ok_and(|kind| kind.is_dir()) {
                    match own.to_lowercase().as_str() {
                        lower if is_mask_folder(lower) => {}
                        lower if is_aside_folder(lower) || holds_maps(&entry.path(), lower) => tree.left_out.push(name),
                        // A scene's photos are in the folder itself; what lies deeper belongs to its results.
                        _ if marked && !whole => {}
                        _ => open.push((entry.path(), name + "/")),
                    }
                } else if is_photo_name(&entry.path()) && entry.path().is_file() {
                    photos.push(name);
                } else if unread_format(&entry.path()).is_some() {
                    unread.push(name);
                }
            }
            let read: HashSet<String> = photos.iter().map(|name| key(name)).collect();
            tree.unread.extend(unread.into_iter().filter(|name| !read.contains(&key(name))));
            tree.add(photos);
        }
        if !tree.names.iter().all(|name| is_product(name)) {
            tree.aside.extend(tree.names.extract_if(.., |name| is_product(name)));
        }
        tree.drop_copies(folder);
        tree.names.sort();
        tree.left_out.sort();
        tree.aside.sort();
        tree.unread.sort();
        tree
    }

    /// Adds the photos of one folder, and sets aside what belongs to one of them.
    fn add(&mut self, files: Vec<String>) {
        let owners: Vec<Vec<String>> = files.iter().map(|file| belongs_to(file, &WORDS)).collect();
        let own = files.iter().zip(&owners).filter(|(_, owners)| owners.is_empty());
        let photos = Named::of(own.map(|(file, _)| key(file)).collect());
        for (file, owners) in files.into_iter().zip(owners) {
            let is_aside = photos.has_owner(&owners) || photos.has_original(&belongs_to(&file, &[COPY_WORDS]));
            let to = if is_aside { &mut self.aside } else { &mut self.names };
            to.push(file);
        }
    }

    /// Sets aside pictures that may be masks or maps, as their headers tell, and are called like a photo in colour in their folder, with one
    /// more word, whatever it is: a_alpha.png beside a.jpg. Numbers are no words.
    fn part_maps(&mut self, root: &Path) {
        let mut named: HashMap<String, Vec<PathBuf>> = HashMap::new();
        for name in &self.names {
            named.entry(key(name)).or_default().push(root.join(name));
        }
        let is_colour = |photo: &PathBuf| !may_be_map(photo) && is_grey(photo) == Some(false);
        // Of a TIFF of grey floats, `is_grey` tells no more than of a damaged one.
        let tells = |file: &Path| is_grey(file) == Some(true) || is_indexed(file) || holds_floats(file);
        let is_plain = |file: &Path| may_be_map(file) && tells(file);
        let is_map = |name: &&String| {
            let key = key(name);
            let Some((photo, word)) = key.rsplit_once(SEPARATORS) else { return false };
            let photos = named.get(photo).filter(|_| !word.is_empty() && word.chars().all(char::is_alphabetic));
            photos.is_some_and(|photos| is_plain(&root.join(name)) && photos.iter().any(is_colour))
        };
        let maps: BTreeSet<String> = self.names.iter().filter(is_map).cloned().collect();
        self.names.retain(|name| !maps.contains(name));
        self.aside.extend(maps);
        self.aside.sort();
    }

    /// Keeps one of the photos of one name and size, by [`rank`]. a.jpg.png is another of a.jpg.
    fn part_twins(&mut self, root: &Path) {
        let mut named: BTreeMap<PathBuf, Vec<String>> = BTreeMap::new();
        for name in &self.names {
            let stem = Path::new(name).with_extension("");
            let stem = if is_photo_name(&stem) { stem.with_extension("") } else { stem };
            named.entry(stem).or_default().push(name.clone());
        }
        let others = |mut same: Vec<String>| {
            same.sort_by_cached_key(|name| rank(&root.join(name))); // stable
            let of = |name: &String| (spelt_usually(Path::new(name)), photo_size(&root.join(name)));
            let (format, size) = of(&same[0]);
            same.retain(|name| {
                let (own, pixels) = of(name);
                own != format && pixels == size
            });
            same
        };
        let several = named.into_values().filter(|same| same.len() > 1);
        let twins: BTreeSet<String> = several.flat_map(others).collect();
        self.names.retain(|name| !twins.contains(name));
        self.twins = twins.into_iter().collect();
    }

    /// Keeps one of the folders with the same photos: corrected_images before images, images before images_2, that
    /// before images_4. Folders with other names ending in _2, and 2x beside 1x, hold copies if these are half as large: there are
    /// cameras of such names.
    fn drop_copies(&mut self, root: &Path) {
        let mut held: BTreeMap<&str, BTreeSet<String>> = BTreeMap::new();
        for name in &self.names {
            let folder = name.rsplit_once('/').map_or("", |(folder, _)| folder);
            held.entry(folder).or_default().insert(key(last(name)));
        }
        let mut copies = Vec::new();
        for (folder, photos) in &held {
            let (above, own) = folder.rsplit_once('/').map_or(("", *folder), |(above, own)| (above, own));
            let beside = |name: &str| if above.is_empty() { name.to_owned() } else { format!("{above}/{name}") };
            let scaled = own.rsplit_once('_').and_then(|(whole, n)| Some((beside(whole), n.parse::<u32>().ok()?)));
            let same = |other: &String| held.get(other.as_str()).is_some_and(|others| photos.is_subset(others));
            let is_smaller = |(whole, factor): &(String, u32)| {
                own.starts_with("images_") || (same(whole) && self.is_reduced(root, (folder, whole), *factor))
            };
            let times = own.strip_suffix('x').and_then(|n| n.parse::<u32>().ok()).filter(|n| n.is_power_of_two());
            let times = times.map_or(0, u32::ilog2);
            let fewer = (0..times).map(|power| (beside(&format!("{}x", 1 << power)), 1_u32 << (times - power)));
            let scaled = scaled.into_iter().chain(fewer).filter(is_smaller).map(|(whole, _)| whole);
            let larger = (1..reduction(own).ilog2()).map(|power| beside(&format!("images_{}", 1 << power)));
            let corrected = (own == "images").then(|| beside("corrected_images"));
            let mut better = scaled.chain(larger).chain(corrected);
            if !own.is_empty() && better.any(|other| same(&other)) {
                copies.push((*folder).to_owned());
            }
        }
        let is_copy = |name: &String| name.rsplit_once('/').is_some_and(|(f, _)| copies.iter().any(|copy| copy == f));
        self.names.retain(|name| !is_copy(name));
        self.left_out.extend(copies);
    }

    /// True if the first photo of a folder is this many times smaller than that of the same name in another, up to rounding.
    fn is_reduced(&self, root: &Path, (folder, whole): (&str, &str), factor: u32) -> bool {
        let within =
            |name: &String, folder: &str| name.strip_prefix(folder).and_then(|rest| rest.strip_prefix('/')).map(key);
        let Some((name, photo)) = self.names.iter().find_map(|name| Some((name, within(name, folder)?))) else {
            return false;
        };
        let other = self.names.iter().find(|other| within(other, whole).as_ref() == Some(&photo));
        let size = |name: &String| photo_size(&root.join(name));
        let sizes = size(name).zip(other.and_then(size));
        sizes.is_some_and(|((w, h), (wide, high))| {
            [(w, wide), (h, high)].into_iter().all(|(s, l)| (s.saturating_mul(factor)).abs_diff(l) <= factor)
        }) && factor > 1
    }

    /// Notes on files that are not used as photos.
    pub fn notes(&self) -> Vec<String> {
        self.choices().into_iter().chain(unread(&self.unread)).collect()
    }

    /// Notes on files that are taken for something else than photos, or for copies of photos.
    pub fn choices(&self) -> Vec<String> {
        let told = |names: &[String], what: &str| {
            let mut some = Names::default();
            for name in names {
                some.add(name);
            }
            (some.count > 0).then(|| format!("{} {what} ({some})", counted(some.count, "file")))
        };
        let what = "set aside as masks, maps, small copies of photos, or grey or palette pictures named like a photo in colour";
        let aside = told(&self.aside, what);
        let twins = told(&self.twins, "not used, because photos in another format have their names");
        aside.into_iter().chain(twins).collect()
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

/// A note on photos in formats that are not read; none without such photos.
pub(super) fn unread(names: &[String]) -> Option<String> {
    let formats: BTreeSet<String> = names.iter().filter_map(|name| unread_format(Path::new(name))).collect();
    let formats: Vec<String> = formats.into_iter().collect();
    let is_not = if formats.len() == 1 { "is not read" } else { "are not read" };
    let (photos, formats) = (counted(names.len(), "photo"), formats.join(" and "));
    let mut some = Names::default();
    for name in names {
        some.add(name);
    }
    names.first().map(|name| {
        format!("{photos} in {formats}, which {is_not} ({some}): convert them, {}", conversion(Path::new(name)))
    })
}

/// The command that converts all photos with the extension of this one.
fn conversion(photo: &Path) -> String {
    let every = photo.extension().map_or_else(|| "*".into(), |e| format!("*.{}", e.display()));
    format!("with ImageMagick: `magick mogrify -format jpg -quality 95 {every}`")
}

/// A clause on the file beside an absent photo that is the same photo in a format that is not read.
pub(in crate::scene) fn only_unread(photo: &Path) -> Option<String> {
    let mut same = inside(folder_of(photo)).into_iter().filter(|path| path.file_stem() == photo.file_stem());
    let (path, format) = same.find_map(|path| unread_format(&path).map(|format| (path, format)))?;
    let name = path.file_name()?.display();
    Some(format!("only {name} is there, in {format}, which is not read: convert it, {}", conversion(&path)))
}

/// The factor by which photos in a folder of this name are smaller: 4 for images_4; 1 for others.
pub(super) fn reduction(folder: &str) -> u32 {
    let number = folder.strip_prefix("images_").and_then(|n| n.parse::<u32>().ok());
    number.filter(|n| n.is_power_of_two()).unwrap_or(1)
}

/// True for the name of a file that an app of scans writes beside its photos: a small copy, or a texture.
fn is_product(name: &str) -> bool {
    let key = key(last(name));
    key.starts_with("thumb_") || key == "thumbnail" || key == "textured_output"
}

/// True for the name, in lower case, of a folder of maps or of small copies.
fn is_aside_folder(lower: &str) -> bool {
    SMALL.contains(&lower) || lower == "segmentation" || is_map_folder(lower)
}

/// The subfolders of a capture in which its photos may lie; folders of smaller copies last, the largest copies first.
pub(super) fn photo_folders(capture: &Path) -> Vec<PathBuf> {
    let entries = fs::read_dir(capture).into_iter().flatten().flatten();
    // Pictures of a model that this program trained, in the capture's own folder.
    let of_a_run = capture.join("config.toml").is_file() || capture.join("metrics.json").is_file();
    let mut folders: Vec<(u32, PathBuf)> = entries
        .filter_map(|entry| {
            let (path, lower) = (entry.path(), entry.file_name().to_string_lossy().to_lowercase());
            let left_out = lower.starts_with('.')
                || is_mask_folder(&lower)
                || is_aside_folder(&lower)
                || holds_maps(&path, &lower)
                || (of_a_run && lower == "renders");
            let inner: Vec<_> = fs::read_dir(&path).ok()?.flatten().collect();
            (!left_out && !is_scene(&inner)).then(|| (reduction(&lower), path))
        })
        .collect();
    folders.sort();
    folders.into_iter().map(|(_, folder)| folder).collect()
}

/// True for the name, in lower case, of a folder of masks: masks, mask, masks_4 for images_4, images_masks.
pub(super) fn is_mask_folder(lower: &str) -> bool {
    "mask masks".split(' ').any(|word| {
        let rest = |end: bool| if end { lower.strip_suffix(word) } else { lower.strip_prefix(word) };
        lower == word || rest(false).is_some_and(|r| r.starts_with('_')) || rest(true).is_some_and(|r| r.ends_with('_'))
    })
}

/// True for the name, in lower case, of a folder of maps that are no masks.
pub(super) fn is_map_folder(lower: &str) -> bool {
    MAPS.split(' ').any(|map| map == lower)
}

/// True for a folder one word of whose name, in lower case, is that of maps, and whose first picture may be one.
fn holds_maps(folder: &Path, lower: &str) -> bool {
    let first = || inside(folder).into_iter().find(|path| is_photo_name(path));
    let mut words = lower.split(|c: char| SEPARATORS.contains(&c) || c.is_ascii_digit());
    words.any(is_map_folder) && first().is_some_and(|picture| may_be_map(&picture))
}

/// Names of the photos in a folder and its subfolders: those of its [`PhotoTree`].
pub fn photo_names(folder: &Path) -> Vec<String> {
    PhotoTree::of(folder).names
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pictures_of_a_model_are_no_photos() {
        let capture = tempfile::tempdir().unwrap();
        fs::create_dir(capture.path().join("renders")).unwrap();
        assert_eq!(photo_folders(capture.path()), [capture.path().join("renders")]);
        fs::write(capture.path().join("config.toml"), "").unwrap();
        assert!(photo_folders(capture.path()).is_empty());
    }
}
