//! Masks of a capture's photos, under the names and in the folders that tools give them.

use std::cell::{Cell, OnceCell, RefCell};
use std::collections::HashMap;
use std::fs;
use std::path::{Path, PathBuf};

use super::files::appended;
use super::kinds::is_photo_name;
use super::names::{belongs_to, key, last};
use super::tree::{PhotoTree, is_map_folder, is_mask_folder};
use crate::scene::image_file::{color_type, hides_where_white};
use crate::wording::counted;
use image::ColorType;

/// The masks that go with a photo folder.
pub(super) struct Masks {
    images: PathBuf,
    folder: Option<PathBuf>,
    index: OnceCell<Index>,
    found: Cell<usize>,
    /// The folder that holds the photos' folder, within the capture.
    beside: Option<PathBuf>,
    /// The photo that was asked for first.
    first: OnceCell<String>,
    /// Photos whose mask may be another folder's.
    shared: Cell<usize>,
}

/// Files by the keys of the photos that they may belong to.
#[derive(Default)]
struct Index {
    by_photo: HashMap<String, Vec<PathBuf>>,
    /// Number of photos by the last parts of their keys.
    photos: HashMap<String, usize>,
}

impl Masks {
    /// The masks of the photos in `images`, in the capture at `root`.
    pub fn of(root: &Path, images: &Path) -> Self {
        let beside = images.parent().filter(|_| images.starts_with(root) && images != root).map(Path::to_owned);
        let (found, shared, first) = (Cell::new(0), Cell::new(0), OnceCell::new());
        let (folder, index) = (folder(root, images), OnceCell::new());
        Self { images: images.to_owned(), folder, index, found, beside, first, shared }
    }

    /// The mask of the photo `name`: in the mask folder as name.png, name.jpg.png or the name itself, otherwise under any
    /// name there or beside the photo that says whose it is.
    pub fn find(&self, name: &str) -> Option<PathBuf> {
        self.first.get_or_init(|| name.to_owned());
        let plain = self.folder.as_ref().map(|folder| folder.join(name));
        let usual = plain.into_iter().flat_map(|p| [appended(&p, "png"), p.with_extension("png"), p]);
        let found = usual.into_iter().find(|p| p.is_file()).or_else(|| {
            let index = self.index.get_or_init(|| Index::of(self.folder.as_deref(), &self.images));
            let key = key(name);
            let of = |key: &str| index.by_photo.get(key).filter(|files| files.len() == 1).map(|files| files[0].clone());
            // A mask of the name alone is no photo's if folders have photos of that name.
            let own = index.photos.get(last(&key)).is_none_or(|photos| *photos < 2);
            let by_name = of(last(&key)).filter(|_| key != last(&key));
            self.shared.set(self.shared.get() + usize::from(by_name.is_some() && !own));
            of(&key).or(by_name.filter(|_| own))
        });
        self.found.set(self.found.get() + usize::from(found.is_some()));
        found
    }

    /// A note if there is a mask folder but none of its files belongs to a photo, or none to one photo alone.
    pub fn doubt(&self) -> Option<String> {
        if self.shared.get() > 0 {
            let photos = counted(self.shared.get(), "photo");
            return Some(format!(
                "{photos} in several folders with the same names: masks of these names are not used; put masks into folders of the \
                 photos' names"
            ));
        }
        if self.found.get() > 0 {
            return None;
        }
        let Some(folder) = &self.folder else { return self.other_folder() };
        let held = files(folder);
        let Some((first, _)) = held.first() else {
            let mut unread = fs::read_dir(folder).into_iter().flatten().flatten();
            let first = unread.next()?.file_name().to_string_lossy().into_owned();
            return Some(format!("no mask used: {} holds no pictures that are read (but {first})", folder.display()));
        };
        let number = counted(held.len(), "file");
        Some(format!("no mask used: {} holds {number} such as {first}, none with a photo's name", folder.display()))
    }

    /// A note on a folder beside the photos' that has a grey picture of a photo's name.
    fn other_folder(&self) -> Option<String> {
        let photo = self.first.get()?;
        let grey = |path: PathBuf| matches!(color_type(&path), Some(ColorType::L8 | ColorType::La8));
        if grey(self.images.join(photo)) {
            return None;
        }
        let folders = fs::read_dir(self.beside.as_ref()?).into_iter().flatten().flatten();
        let lower = |entry: &fs::DirEntry| entry.file_name().to_string_lossy().to_lowercase();
        let folders = folders.filter(|entry| !is_map_folder(&lower(entry))).map(|entry| entry.path());
        let meant = |folder: &PathBuf| {
            let same = folder.join(photo);
            grey(same.with_extension("png")) || grey(same)
        };
        let folder = folders.filter(|folder| *folder != self.images).filter(meant).min()?;
        Some(format!("no masks: if {} holds them, name it masks", folder.display()))
    }
}

impl Index {
    fn of(masks: Option<&Path>, images: &Path) -> Self {
        let mut index = Self::default();
        if let Some(folder) = masks {
            for (name, path) in files(folder) {
                let mut owners = belongs_to(&name, false);
                // In a folder of masks, what names no other owner is named like its photo, once or twice: x.jpg.png.
                owners.push(key(&name));
                owners.push(key(&key(&name)));
                index.add(owners, &path);
            }
        }
        for (name, path) in files(images) {
            index.add(belongs_to(&name, false), &path);
        }
        for name in PhotoTree::whole(images).names {
            *index.photos.entry(last(&key(&name)).to_owned()).or_default() += 1;
        }
        index
    }

    fn add(&mut self, mut owners: Vec<String>, path: &Path) {
        owners.sort();
        owners.dedup();
        for owner in owners {
            self.by_photo.entry(owner).or_default().push(path.to_owned());
        }
    }
}

/// The photos below a folder, by their paths within it.
fn files(folder: &Path) -> Vec<(String, PathBuf)> {
    let (mut found, mut open) = (Vec::new(), vec![(folder.to_owned(), String::new())]);
    while let Some((path, prefix)) = open.pop() {
        for entry in fs::read_dir(path).into_iter().flatten().flatten() {
            let name = format!("{prefix}{}", entry.file_name().to_string_lossy());
            if entry.file_type().is_ok_and(|kind| kind.is_dir()) {
                open.push((entry.path(), name + "/"));
            } else if is_photo_name(&entry.path()) {
                found.push((name, entry.path()));
            }
        }
    }
    found.sort();
    found
}

/// The mask folder that goes with a photo folder: `images_4` has `masks_4`, else `masks` or `mask`, beside it or in it; upper or
/// lower case.
fn folder(root: &Path, images: &Path) -> Option<PathBuf> {
    let beside = images.parent().filter(|_| images.starts_with(root) && images != root).unwrap_or(root);
    let name = images.file_name().and_then(|n| n.to_str()).unwrap_or_default();
    let scaled = name.strip_prefix("images").map(|suffix| format!("masks{suffix}"));
    let usual = scaled.into_iter().chain(["masks".to_owned()]).map(|m| beside.join(m)).find(|p| p.is_dir());
    usual.or_else(|| {
        let mut others: Vec<PathBuf> = [beside, images]
            .into_iter()
            .filter_map(|place| fs::read_dir(place).ok())
            .flatten()
            .flatten()
            .filter(|e| is_mask_folder(&e.file_name().to_string_lossy().to_lowercase()) && e.path().is_dir())
            .map(|e| e.path())
            .collect();
        others.sort_by_key(|path| (path.as_os_str().len(), path.clone()));
        others.into_iter().next()
    })
}

/// Finds masks of photos by their names in the folder `images`: in the mask folder beside it, or within it where that is
/// the whole capture; otherwise in the folder of masks beside the photo itself. Masks that hide where they are white are none.
pub fn masks_of(images: &Path) -> impl Fn(&str) -> Option<PathBuf> {
    let images = images.to_owned();
    let own = images.file_name().is_some_and(|n| n == "input" || n.to_string_lossy().starts_with("images"));
    let capture = images.parent().filter(|_| own).unwrap_or(&images);
    let all = Masks::of(capture, &images);
    let beside = RefCell::new(HashMap::new());
    move |name| {
        all.find(name)
            .or_else(|| {
                let photo = images.join(name);
                let folder = photo.parent()?.to_owned();
                let mut beside = beside.borrow_mut();
                let masks = beside.entry(folder).or_insert_with_key(|folder| Masks::of(folder, folder));
                masks.find(photo.file_name()?.to_str()?)
            })
            .filter(|mask| !hides_where_white(mask))
    }
}
