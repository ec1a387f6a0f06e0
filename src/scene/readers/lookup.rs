//! Photos found by names that differ from theirs.

use std::cell::OnceCell;
use std::collections::HashMap;
use std::path::{Path, PathBuf};

use super::files::likeliest;
use super::names::{key, last, relative, tidy, unescaped};
use super::tree::PhotoTree;

/// All photos below a folder, without what only looks like them ([`PhotoTree`]), found by names that differ from theirs in case, in the composition of letters, in
/// extensions, or in the folders of the machine that wrote them.
#[derive(Default)]
pub(super) struct Lookup {
    folder: PathBuf,
    files: OnceCell<Files>,
}

#[derive(Default)]
struct Files {
    /// True if all photos lie in the folder itself.
    flat: bool,
    /// True if some photos lie in images.
    some_of_images: bool,
    /// Paths within the folder, by key.
    whole: HashMap<String, Vec<String>>,
    /// The same, by the key's last part: those in images, or, if it holds none, those in any folder unless photos lie here directly.
    /// Elsewhere, a picture with a photo's name comes from another program.
    last: HashMap<String, Vec<String>>,
}

impl Lookup {
    /// Reads the folder when it is first needed.
    pub fn of(folder: &Path) -> Self {
        Self { folder: folder.to_owned(), files: OnceCell::new() }
    }

    /// The folder.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// The path within the folder of the only photo that can be meant by `name`, which may be written as in a URL. `known`: see
    /// [`likeliest`].
    pub fn find(&self, name: &str, known: Option<&str>) -> Option<String> {
        self.found(name, known).or_else(|| self.found(&unescaped(name)?, known))
    }

    fn found(&self, name: &str, known: Option<&str>) -> Option<String> {
        let files = self.files.get_or_init(|| Files::of(&self.folder));
        let foreign = name.starts_with(['/', '\\']) || tidy(name).starts_with("../") || relative(name) != tidy(name);
        let key = key(&relative(name));
        let mut rest = key.as_str();
        loop {
            // Beside images, a picture of a photo's name is none.
            let is_stray = rest != key && !rest.contains('/') && files.some_of_images;
            if let Some(found) = files.whole.get(rest).filter(|_| !is_stray) {
                return self.one(found, name, known);
            }
            // Folders of another machine say nothing; those within a capture tell photos of several cameras apart.
            match rest.split_once('/') {
                Some((_, inner)) if foreign || files.flat => rest = inner,
                Some(("images", inner)) if !files.some_of_images => rest = inner,
                None if rest == key || is_stray => {
                    return files.last.get(rest).and_then(|found| self.one(found, name, known));
                }
                _ => return None,
            }
        }
    }

    /// The only one of these files that is likely to be the photo `name`.
    fn one(&self, found: &[String], name: &str, known: Option<&str>) -> Option<String> {
        let files = found.iter().map(|file| self.folder.join(file)).collect();
        let likely = likeliest(Path::new(name), files, known);
        let [only] = likely.as_slice() else { return None };
        found.iter().find(|file| self.folder.join(file) == *only).cloned()
    }
}

impl Files {
    fn of(folder: &Path) -> Self {
        let mut files = Self { flat: true, ..Self::default() };
        let names = PhotoTree::whole(folder).names;
        let is_deep = names.iter().all(|name| name.contains('/'));
        let of_images = |name: &String| name.to_ascii_lowercase().starts_with("images/");
        files.some_of_images = names.iter().any(of_images);
        for name in names {
            let key = key(&name);
            files.flat &= !name.contains('/');
            if of_images(&name) || (is_deep && !files.some_of_images) {
                files.last.entry(last(&key).to_owned()).or_default().push(name.clone());
            }
            files.whole.entry(key).or_default().push(name);
        }
        files
    }
}
