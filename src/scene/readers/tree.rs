//! Photos of a folder whose poses are not known, without the files and folders that only look like photos.

use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::Path;

use super::names::{belongs_to, has_owner, is_photo_name, is_scene, is_unread_name, key, last};
use crate::scene::Names;
use crate::wording::counted;

/// Names, in lower case, of folders of small copies, which cameras and servers write.
const SMALL: [&str; 6] = ["thumb", "thumbs", "thumbnail", "thumbnails", "thmbnl", "@eadir"];
/// Names, in lower case, of folders of maps that belong to photos.
const MAPS: [&str; 11] = [
    "depth",
    "depths",
    "depth_maps",
    "depthmaps",
    "depth_images",
    "disparity",
    "confidence",
    "confidence_maps",
    "normals",
    "normal_maps",
    "segmentation",
];
/// Photos in a folder and its subfolders.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct PhotoTree {
    /// Their paths within the folder, with `/` between the parts, sorted.
    pub names: Vec<String>,
    /// Subfolders that were left out, likewise; hidden ones and masks are not told.
    pub left_out: Vec<String>,
    /// Files beside photos that are their masks, depth maps or the like, likewise.
    pub aside: Vec<String>,
    /// Photos in a format that is not read.
    pub unread: Names,
}

impl PhotoTree {
    /// Looks into a folder. Left out are hidden files and folders, links to folders, folders of masks, maps and thumbnails,
    /// second copies of photos, and folders that hold a scene with poses or a result of this program. Empty if there is no
    /// such folder.
    pub fn of(folder: &Path) -> Self {
        let mut tree = Self::default();
        let mut open = vec![(folder.to_owned(), String::new())];
        while let Some((path, prefix)) = open.pop() {
            let entries: Vec<_> = fs::read_dir(path).into_iter().flatten().flatten().collect();
            let marked = is_scene(&entries);
            if marked && !prefix.is_empty() {
                tree.left_out.push(prefix.trim_end_matches('/').to_owned());
                continue;
            }
            let mut photos = Vec::new();
            for entry in entries {
                let Ok(own) = entry.file_name().into_string() else { continue };
                let name = format!("{prefix}{own}");
                if own.starts_with('.') {
                    continue;
                }
                if entry.file_type().is_ok_and(|kind| kind.is_dir()) {
                    match own.to_lowercase().as_str() {
                        lower if is_mask_folder(lower) => {}
                        lower if SMALL.contains(&lower) || MAPS.contains(&lower) => tree.left_out.push(name),
                        // A scene's photos are in the folder itself; what lies deeper belongs to its results.
                        _ if marked => {}
                        _ => open.push((entry.path(), name + "/")),
                    }
                } else if is_photo_name(&entry.path()) && entry.path().is_file() {
                    photos.push(name);
                } else if is_unread_name(&entry.path()) {
                    tree.unread.add(&name);
                }
            }
            tree.add(photos);
        }
        tree.drop_copies();
        tree.names.sort();
        tree.left_out.sort();
        tree.aside.sort();
        tree
    }

    /// Adds the photos of one folder, and sets aside what belongs to one of them.
    fn add(&mut self, files: Vec<String>) {
        let owners: Vec<Vec<String>> = files.iter().map(|file| belongs_to(file, true)).collect();
        let own = files.iter().zip(&owners).filter(|(_, owners)| owners.is_empty());
        let photos: Vec<String> = own.map(|(file, _)| key(file)).collect();
        for (file, owners) in files.into_iter().zip(owners) {
            let to = if has_owner(&owners, &photos) { &mut self.aside } else { &mut self.names };
            to.push(file);
        }
    }

    /// Of folders with the same photos twice, keeps one: corrected_images before images, images before images_4.
    fn drop_copies(&mut self) {
        let mut held: BTreeMap<&str, BTreeSet<String>> = BTreeMap::new();
        for name in &self.names {
            let folder = name.rsplit_once('/').map_or("", |(folder, _)| folder);
            held.entry(folder).or_default().insert(key(last(name)));
        }
        let mut copies = Vec::new();
        for (folder, photos) in &held {
            let (above, own) = folder.rsplit_once('/').map_or(("", *folder), |(above, own)| (above, own));
            let beside = |name: &str| if above.is_empty() { name.to_owned() } else { format!("{above}/{name}") };
            let scaled = own.rsplit_once('_').filter(|(_, n)| n.parse::<u32>().is_ok()).map(|(whole, _)| beside(whole));
            let better = scaled.into_iter().chain([beside(&format!("corrected_{own}"))]);
            let same = |other: &String| held.get(other.as_str()).is_some_and(|others| photos.is_subset(others));
            if !own.is_empty() && better.into_iter().any(|other| same(&other)) {
                copies.push((*folder).to_owned());
            }
        }
        let is_copy = |name: &String| name.rsplit_once('/').is_some_and(|(f, _)| copies.iter().any(|copy| copy == f));
        self.names.retain(|name| !is_copy(name));
        self.left_out.extend(copies);
    }

    /// Notes on files that are not used as photos.
    pub fn notes(&self) -> Vec<String> {
        let mut aside = Names::default();
        self.aside.iter().for_each(|name| aside.add(name));
        let files = counted(aside.count, "file");
        let aside = (aside.count > 0).then(|| format!("{files} set aside as masks or maps of photos ({aside})"));
        aside.into_iter().chain(unread(&self.unread)).collect()
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

/// A note on photos in an unsupported format; none without such photos.
fn unread(names: &Names) -> Option<String> {
    let convert = "convert them, with ImageMagick by `magick mogrify -format jpg -quality 95`";
    let photos = counted(names.count, "photo");
    (names.count > 0).then(|| format!("{photos} in a format that is not read ({names}): {convert}"))
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
    MAPS.contains(&lower) && lower != "segmentation"
}

/// Names of the photos in a folder and its subfolders: those of its [`PhotoTree`].
pub fn photo_names(folder: &Path) -> Vec<String> {
    PhotoTree::of(folder).names
}
