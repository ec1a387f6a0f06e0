//! Depth maps of photos, in a folder of their own.

use crate::extension::{extension, has_extension};
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};

use super::files::{Folders, appended, inside};
use super::names::{MAP_WORDS, Named, Owners, belongs_to, key, last, number};
use crate::scene::View;
use crate::wording::counted;

/// Extensions of depth maps; `render --depth` writes the first. COLMAP writes the last two: depths on which photos agree come before those
/// of each photo alone.
const EXTENSIONS: [&str; 9] =
    ["depth.npy", "npy", "depth.png", "png", "exr", "tif", "tiff", "geometric.bin", "photometric.bin"];

/// The depth maps in a folder.
pub(super) struct DepthMaps {
    folder: PathBuf,
    folders: Folders,
    /// The files in it that say whose they are, by the keys of the photos that may be meant, or by their numbers.
    owned: Owners,
    /// All its files.
    files: Vec<PathBuf>,
}

impl DepthMaps {
    pub fn of(folder: &Path) -> Self {
        let files: Vec<PathBuf> = inside(folder).into_iter().filter(|path| path.is_file()).collect();
        let mut owned = Owners::new();
        for path in files.iter().filter(|path| has_extension(path, &EXTENSIONS)) {
            for owner in belongs_to(&as_png(path), &[MAP_WORDS]) {
                owned.entry(owner).or_default().insert(path.clone());
            }
        }
        Self { folder: folder.to_owned(), folders: Folders::default(), owned, files }
    }

    /// The map of a photo: with its name, or that of its file alone, and an extension of depth maps in place of its own or
    /// after it, in any case; otherwise the only one that names it, as a_depth.npy and depth_0001.npy do.
    pub fn find(&mut self, name: &str) -> Option<PathBuf> {
        let bases = [name, last(name)].map(|name| self.folder.join(name));
        let candidates = bases.iter().flat_map(|base| {
            EXTENSIONS.iter().flat_map(move |extension| [base.with_extension(extension), appended(base, extension)])
        });
        let candidates: Vec<PathBuf> = candidates.chain(bases.iter().cloned()).collect();
        let named = candidates.iter().find(|path| path.is_file()).cloned();
        named.or_else(|| candidates.iter().find_map(|path| self.folders.same(path))).or_else(|| {
            let photo = key(last(name));
            let names = [photo.as_str(), number(&photo)].into_iter().filter(|name| !name.is_empty());
            let owned: BTreeSet<&PathBuf> = names.filter_map(|name| self.owned.get(name)).flatten().collect();
            owned.first().filter(|_| owned.len() == 1).map(|path| (*path).clone())
        })
    }

    /// The only subfolder of a folder without files.
    pub fn only_folder(&self) -> Option<PathBuf> {
        let mut folders = inside(&self.folder).into_iter().filter(|path| path.is_dir());
        let first = folders.next()?;
        (self.files.is_empty() && folders.next().is_none()).then_some(first)
    }

    /// A note on a folder none of whose files is the map of one of these views' photos.
    pub fn doubt(&self, views: &[View]) -> String {
        let photos = Named::of(views.iter().map(|view| key(last(&view.name))).collect());
        let named = |path: &Path| {
            let name = as_png(path);
            photos.has_owner(&[key(&name)]) || photos.has_owner(&belongs_to(&name, &[MAP_WORDS]))
        };
        let unread = |path: &PathBuf| Some((path.clone(), unread_depth_map(path).filter(|_| named(path))?));
        let (folder, number) = (self.folder.display(), counted(self.files.len(), "file"));
        let name = |path: &Path| path.file_name().unwrap_or_default().to_string_lossy().into_owned();
        let told = match (self.files.first(), self.files.iter().find_map(unread)) {
            (_, Some((path, what))) => format!("{number}, and {} {what}", name(&path)),
            (Some(first), None) => format!("{number} such as {}, none a depth map with a photo's name", name(first)),
            (None, None) => "no files".to_owned(),
        };
        format!("no depth map used: {folder} holds {told}")
    }
}

/// The name of a file as that of a PNG: depth maps are files of numbers without loss, as PNG is.
fn as_png(path: &Path) -> String {
    path.with_extension("png").file_name().unwrap_or_default().to_string_lossy().into_owned()
}

/// The fault of a depth map whose extension is that of no format that is read, as a predicate, and the remedy.
pub fn unread_depth_map(map: &Path) -> Option<String> {
    let extension = extension(map);
    let what = if extension.is_empty() { "of an unknown format".to_owned() } else { format!(".{extension}") };
    let name = map.file_name().unwrap_or_default().to_string_lossy().to_ascii_lowercase();
    let is_read =
        EXTENSIONS.iter().any(|extension| name.strip_suffix(extension).is_some_and(|stem| stem.ends_with('.')));
    (!is_read).then(|| format!("is {what}, which is not read: save as .npy"))
}
