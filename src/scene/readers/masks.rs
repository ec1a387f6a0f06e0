//! Masks of a capture's photos, under the names and in the folders that tools give them.

use std::cell::{Cell, OnceCell, RefCell};
use std::collections::{BTreeMap, HashMap, HashSet};
use std::fs;
use std::path::{Path, PathBuf};
use std::rc::Rc;

use super::files::{appended, inside};
use super::kinds::is_photo_name;
use super::names::{MASK_WORDS, Owners, belongs_to, key, last, relative};
use super::tree::{PhotoTree, is_map_folder, is_mask_folder};
use crate::extension::folder_of;
use crate::scene::image_file::{color_type, hides_where_white};
use crate::wording::counted;
use image::ColorType;

/// The masks of a capture's photos. The folders that hold a photo are looked at from the outermost, the capture itself last: each may
/// have masks beside it or in it.
pub(super) struct Masks {
    root: PathBuf,
    images: PathBuf,
    /// Names of the photos.
    names: Vec<String>,
    /// The masks of each folder of photos seen so far.
    folders: RefCell<BTreeMap<PathBuf, FolderMasks>>,
    /// The mask folders in each folder seen so far, and their files.
    held: RefCell<Held>,
    /// Number of photos by a folder and the rest of their name below a folder in it: masks beside such folders may be any one's.
    /// Counted for the first mask that is found beside a folder.
    rests: OnceCell<HashMap<(PathBuf, String), usize>>,
    /// Photos whose mask may be another folder's.
    shared: Cell<usize>,
    found: Cell<usize>,
}

impl Masks {
    /// The masks of the photos of these names in `images`, in the capture at `root`.
    pub fn of<'a>(root: &Path, images: &Path, names: impl Iterator<Item = &'a str>) -> Self {
        let (folders, held, rests, shared, found) = Default::default();
        let (root, images, names) = (root.to_owned(), images.to_owned(), names.map(plain).collect());
        Self { root, images, names, folders, held, rests, shared, found }
    }

    /// Number of photos by a folder and the rest of their name below a folder in it.
    fn rests(&self) -> HashMap<(PathBuf, String), usize> {
        // By key: a file may have another extension than its listed name.
        let mut names: HashMap<String, String> = self.names.iter().map(|name| (key(name), name.clone())).collect();
        // Photos without a pose have masks, too. Of a capture, only its folders of photos hold such.
        let first = |name: &String| Some(name.split_once('/')?.0.to_owned());
        let folders: HashSet<String> = if self.images == self.root {
            self.names.iter().filter_map(first).collect()
        } else {
            HashSet::from([String::new()])
        };
        for folder in &folders {
            for name in PhotoTree::whole(&self.images.join(folder)).names {
                let name = plain(&format!("{folder}/{name}"));
                names.entry(key(&name)).or_insert(name);
            }
        }
        let mut rests = HashMap::new();
        for name in names.values() {
            for (folder, rest) in levels(&self.images, name) {
                if let Some(above) = folder.parent().filter(|_| folder != self.images) {
                    *rests.entry((above.to_owned(), key(rest))).or_default() += 1;
                }
            }
        }
        rests
    }

    /// The mask of the photo `name`.
    pub fn find(&self, name: &str) -> Option<PathBuf> {
        let name = plain(name);
        let mut folders = self.folders.borrow_mut();
        let mut is_shared = false;
        let mut levels = levels(&self.images, &name);
        // The capture itself holds more than photos: its pictures come last.
        levels.sort_by_key(|(folder, _)| *folder == self.root); // stable
        let found = levels.into_iter().find_map(|(folder, rest)| {
            let above = self.above(&folder);
            let masks = folders
                .entry(folder.clone())
                .or_insert_with(|| FolderMasks::of(above, &folder, &mut self.held.borrow_mut()));
            let (found, doubtful) = masks.find(rest);
            is_shared |= doubtful;
            found.filter(|mask| {
                let count = || self.rests.get_or_init(|| self.rests()).get(&(above.to_owned(), key(rest))).copied();
                let is_own = mask.starts_with(&folder) || masks.is_named() || count().unwrap_or(0) < 2;
                is_shared |= !is_own;
                is_own
            })
        });
        self.found.set(self.found.get() + usize::from(found.is_some()));
        self.shared.set(self.shared.get() + usize::from(found.is_none() && is_shared));
        found
    }

    /// The folder that may hold the masks of a folder of photos beside it; none above the capture. Photos that lie elsewhere may have
    /// theirs in the capture.
    fn above<'a>(&'a self, folder: &'a Path) -> &'a Path {
        match folder.parent() {
            Some(above) if folder != self.root && folder.starts_with(&self.root) => above,
            Some(above) if folder != self.images && folder != self.root => above,
            _ => &self.root,
        }
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
        let folders = self.folders.borrow();
        let outermost = || folders.iter().find(|(folder, _)| **folder != self.root).or(folders.iter().next());
        let other = |(_, masks): (&PathBuf, &FolderMasks)| masks.other_folder(|folder| folders.contains_key(folder));
        folders.values().find_map(FolderMasks::unmatched).or_else(|| outermost().and_then(other))
    }
}

/// A photo's name without the folders of another machine and the steps that lead nowhere.
fn plain(name: &str) -> String {
    let name = relative(name);
    name.split('/').filter(|part| !["", ".", ".."].contains(part)).collect::<Vec<_>>().join("/")
}

/// The folders that hold the photo `name` of the folder `images`, from this one on, each with the name within it.
fn levels<'a>(images: &Path, name: &'a str) -> Vec<(PathBuf, &'a str)> {
    let mut levels = vec![(images.to_owned(), name)];
    while let Some((folder, rest)) = levels.last().and_then(|(folder, rest)| {
        let (first, rest) = rest.split_once('/')?;
        Some((folder.join(first), rest))
    }) {
        levels.push((folder, rest));
    }
    levels
}

/// Mask folders, each read once.
#[derive(Default)]
struct Held {
    /// By the folder in which they lie.
    inside: HashMap<PathBuf, Rc<MaskFolders>>,
    read: HashMap<PathBuf, Rc<MaskFolder>>,
}

/// The mask folders in a folder.
struct MaskFolders {
    /// The shortest name first.
    all: Vec<PathBuf>,
    /// Mask folders named after a folder of photos, by its name in lower case.
    named: HashMap<String, Vec<PathBuf>>,
}

impl Held {
    /// The mask folders in a folder.
    fn inside(&mut self, folder: &Path) -> Rc<MaskFolders> {
        let found = self.inside.entry(folder.to_owned()).or_insert_with(|| {
            let is_mask = |path: &PathBuf| is_mask_folder(&lower(path)) && path.is_dir();
            let mut all: Vec<PathBuf> = inside(folder).into_iter().filter(is_mask).collect();
            all.sort_by_key(|path| path.as_os_str().len()); // stable
            let mut named: HashMap<String, Vec<PathBuf>> = HashMap::new();
            for path in &all {
                if let Some(images) = named_after(path) {
                    named.entry(images).or_default().push(path.clone());
                }
            }
            Rc::new(MaskFolders { all, named })
        });
        Rc::clone(found)
    }

    fn read(&mut self, folder: &Path) -> Rc<MaskFolder> {
        let read = self.read.entry(folder.to_owned()).or_insert_with(|| Rc::new(MaskFolder::of(folder)));
        Rc::clone(read)
    }

    /// The mask folder that goes with a photo folder: `images_4` has `masks_4`, else `masks` or `mask`, in `beside` or in it; upper or
    /// lower case. One that holds pictures comes before others.
    fn folder(&mut self, beside: &Path, images: &Path) -> Option<Rc<MaskFolder>> {
        let name = images.file_name().and_then(|n| n.to_str()).unwrap_or_default();
        let scaled = name.strip_prefix("images").map(|suffix| format!("masks{suffix}"));
        let usual: Vec<PathBuf> = scaled.into_iter().chain(["masks".to_owned()]).map(|m| beside.join(m)).collect();
        // Those beside come before those inside.
        let there = [self.inside(beside), self.inside(images)];
        let own = lower(images);
        let mut named: Vec<&PathBuf> = there.iter().filter_map(|there| there.named.get(&own)).flatten().collect();
        named.sort_by_key(|path| usual.iter().position(|usual| usual == *path).unwrap_or(usize::MAX)); // stable
        let usual = usual.iter().filter(|path| path.is_dir());
        let all = there.iter().flat_map(|there| &there.all);
        let mut first = None;
        for path in named.into_iter().chain(usual).chain(all) {
            let folder = self.read(path);
            if !folder.files.is_empty() {
                return Some(folder);
            }
            first.get_or_insert(folder);
        }
        first
    }
}

/// A folder of masks.
struct MaskFolder {
    path: PathBuf,
    /// Its pictures, by their paths within it.
    files: Vec<(String, PathBuf)>,
    by_photo: Owners,
}

impl MaskFolder {
    fn of(folder: &Path) -> Self {
        let (files, mut by_photo) = (files(folder), Owners::new());
        for (name, path) in &files {
            // In a folder of masks, what names no other owner is named like its photo, once or twice: x.jpg.png.
            for owner in belongs_to(name, &[MASK_WORDS]).into_iter().chain([key(name), key(&key(name))]) {
                by_photo.entry(owner).or_default().insert(path.clone());
            }
        }
        Self { path: folder.to_owned(), files, by_photo }
    }
}

/// The masks that go with one folder of photos.
struct FolderMasks {
    images: PathBuf,
    folder: Option<Rc<MaskFolder>>,
    own: OnceCell<Own>,
    /// The folder that holds the photos' folder, within the capture.
    beside: Option<PathBuf>,
    /// The photo that was asked for first.
    first: OnceCell<String>,
}

/// The contents of a folder of photos.
#[derive(Default)]
struct Own {
    /// Masks among its photos.
    by_photo: Owners,
    /// Number of photos by the last parts of their keys.
    photos: HashMap<String, usize>,
}

impl FolderMasks {
    /// The masks of the photos in `images`, which lies in the folder `above` or is it.
    fn of(above: &Path, images: &Path, held: &mut Held) -> Self {
        let beside = images.parent().filter(|parent| *parent == above).map(Path::to_owned);
        let (own, first) = (OnceCell::new(), OnceCell::new());
        Self { images: images.to_owned(), folder: held.folder(above, images), own, beside, first }
    }

    /// The mask of the photo `name`: in the mask folder as name.png, name.jpg.png or the name itself, otherwise under any
    /// name there or beside the photo that says whose it is. True with it if there is one that may be several photos'.
    fn find(&self, name: &str) -> (Option<PathBuf>, bool) {
        self.first.get_or_init(|| name.to_owned());
        let plain = self.folder.as_ref().map(|folder| folder.path.join(name));
        let mut usual = plain.into_iter().flat_map(|p| [appended(&p, "png"), p.with_extension("png"), p]);
        if let Some(found) = usual.find(|p| p.is_file()) {
            return (Some(found), false);
        }
        let own = self.own.get_or_init(|| Own::of(&self.images));
        let key = key(name);
        let of = |key: &str| {
            let beside = self.folder.as_ref().and_then(|folder| folder.by_photo.get(key));
            let mut found = beside.into_iter().chain(own.by_photo.get(key)).flatten();
            found.next().filter(|_| found.next().is_none()).cloned()
        };
        // A mask of the name alone is no photo's if folders have photos of that name.
        let alone = own.photos.get(last(&key)).is_none_or(|photos| *photos < 2);
        let by_name = of(last(&key)).filter(|_| key != last(&key));
        let doubtful = by_name.is_some() && !alone;
        (of(&key).or(by_name.filter(|_| alone)), doubtful)
    }

    /// True if the name of the mask folder is that of the photos' folder, so that it is no other's.
    fn is_named(&self) -> bool {
        self.folder.as_ref().is_some_and(|folder| named_after(&folder.path) == Some(lower(&self.images)))
    }

    /// A note on a mask folder none of whose files belongs to a photo.
    fn unmatched(&self) -> Option<String> {
        let MaskFolder { path, files, .. } = &**self.folder.as_ref()?;
        let Some((first, _)) = files.first() else {
            let unread = inside(path);
            let first = unread.first()?.file_name()?.to_string_lossy();
            return Some(format!("no mask used: {} holds no pictures that are read (but {first})", path.display()));
        };
        let number = counted(files.len(), "file");
        Some(format!("no mask used: {} holds {number} such as {first}, none with a photo's name", path.display()))
    }

    /// A note on a folder beside the photos' that has a grey picture of a photo's name, and holds no photos itself.
    fn other_folder(&self, holds_photos: impl Fn(&Path) -> bool) -> Option<String> {
        let photo = self.first.get()?;
        let grey = |path: PathBuf| matches!(color_type(&path), Some(ColorType::L8 | ColorType::La8));
        if grey(self.images.join(photo)) {
            return None;
        }
        let folders = inside(self.beside.as_ref()?).into_iter().filter(|folder| !is_map_folder(&lower(folder)));
        let meant = |folder: &PathBuf| {
            let same = folder.join(photo);
            grey(same.with_extension("png")) || grey(same)
        };
        let folder = folders.filter(|folder| !holds_photos(folder)).find(meant)?;
        Some(format!("no masks: if {} holds them, name it masks", folder.display()))
    }
}

impl Own {
    fn of(images: &Path) -> Self {
        let mut own = Self::default();
        for (name, path) in files(images) {
            for owner in belongs_to(&name, &[MASK_WORDS]) {
                own.by_photo.entry(owner).or_default().insert(path.clone());
            }
        }
        for name in PhotoTree::whole(images).names {
            *own.photos.entry(last(&key(&name)).to_owned()).or_default() += 1;
        }
        own
    }
}

/// The name of a folder of photos, in lower case, whose masks are in this one, if it is called L_mask, masks_L or the like.
fn named_after(masks: &Path) -> Option<String> {
    let masks = lower(masks);
    let rest = ["masks_", "mask_"].iter().find_map(|word| masks.strip_prefix(word));
    let rest = rest.or_else(|| ["_masks", "_mask"].iter().find_map(|word| masks.strip_suffix(word)))?;
    (!rest.is_empty()).then(|| rest.to_owned())
}

/// The last part of a path, in lower case.
fn lower(path: &Path) -> String {
    path.file_name().unwrap_or_default().to_string_lossy().to_lowercase()
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

/// Finds masks of photos by their names in the folder `images`: in the mask folder beside it, or within it where that is
/// the whole capture; otherwise in a folder of masks beside the photo itself or a folder that holds it. Masks that hide where they
/// are white are none.
pub fn masks_of(images: &Path) -> impl Fn(&str) -> Option<PathBuf> {
    let own = images.file_name().is_some_and(|n| n == "input" || n.to_string_lossy().starts_with("images"));
    let capture = if own { folder_of(images) } else { images };
    let names = PhotoTree::whole(images).names;
    let masks = Masks::of(capture, images, names.iter().map(String::as_str));
    move |name| masks.find(name).filter(|mask| !hides_where_white(mask))
}
