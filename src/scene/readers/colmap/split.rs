//! The roles of a model's photos, which COLMAP does not know: lists in files beside it tell them.

use std::collections::{HashMap, HashSet};
use std::path::Path;

use super::ImageRow;
use crate::scene::readers::{files, names, repeated};
use crate::scene::view::Role;
use crate::scene::{Names, Skipped};
use crate::wording::counted;

/// nerfstudio's lists in the capture's folder, with the roles that they give; of two lists, the later one counts.
const LISTS: [(&str, Role); 4] = [
    ("val_list.txt", Role::Validation),
    ("validation_list.txt", Role::Validation),
    ("test_list.txt", Role::Test),
    ("train_list.txt", Role::Train),
];

/// A note on ScanNet++'s lists, which are not read, in the folder of a capture or the one above; none beside lists that are.
pub(super) fn unread(root: &Path) -> Option<String> {
    let mut lists = root.ancestors().take(2).map(|folder| folder.join("train_test_lists.json"));
    let list = lists.find(|list| list.is_file())?;
    let (list, folder) = (list.display(), root.display());
    let none = LISTS.iter().all(|(name, _)| !files::child(root, name).is_file());
    none.then(|| format!("{list} is not read: write its names to train_list.txt and test_list.txt in {folder}"))
}

/// A model's photos, by what lists call them.
struct Known<'a> {
    /// By their names in COLMAP, with forward slashes.
    exact: HashMap<String, &'a str>,
    /// By the keys of their names; none for a key that photos share.
    keys: HashMap<String, Option<&'a str>>,
}

impl<'a> Known<'a> {
    fn of(rows: &'a [ImageRow]) -> Self {
        let (mut exact, mut keys) = (HashMap::new(), HashMap::new());
        for name in rows.iter().map(|row| row.name.as_str()) {
            exact.insert(names::tidy(name), name);
            let only = keys.entry(names::key(name)).or_insert(Some(name));
            *only = only.filter(|other| *other == name);
        }
        Self { exact, keys }
    }

    /// The photo that a list names: by its exact name, else without extension and case, if no other photo is called so.
    fn find(&self, listed: &str) -> Option<&'a str> {
        let exact = self.exact.get(&names::tidy(listed)).copied();
        exact.or_else(|| self.keys.get(&names::key(listed)).copied().flatten())
    }

    /// True if several photos have this name without extension and case.
    fn share(&self, listed: &str) -> bool {
        self.keys.get(&names::key(listed)).is_some_and(Option::is_none)
    }
}

/// The roles of a model's photos.
pub(super) struct Roles {
    /// By their names in COLMAP.
    listed: HashMap<String, Role>,
    /// The role of all others; none if they are not used.
    others: Option<Role>,
    /// Photos that are not used.
    unlisted: Names,
}

impl Roles {
    /// The roles that nerfstudio's lists give; if none names a photo, test.txt beside the model's files, as 3DGS writes it, or else in the
    /// capture's folder, unless that one names all photos, holds out photos.
    pub fn of(root: &Path, model: &Path, rows: &[ImageRow], skipped: &mut Skipped) -> Self {
        let read = |(folder, name, role): (&Path, &str, Role)| {
            let file = files::child(folder, name);
            file.is_file().then(|| (files::read_text(&file).unwrap_or_default(), file, role))
        };
        let mut lists: Vec<_> = LISTS.iter().filter_map(|(name, role)| read((root, name, *role))).collect();
        let known = Known::of(rows);
        let names_one = |text: &str| text.lines().any(|line| known.find(line.trim()).is_some());
        if !lists.iter().any(|(text, ..)| names_one(text)) {
            let of_root = || {
                let list = read((root, "test.txt", Role::Test))?;
                let named: HashSet<&str> = list.0.lines().filter_map(|line| known.find(line.trim())).collect();
                let names_all = rows.iter().all(|row| named.contains(row.name.as_str()));
                let what = "names all photos, and would leave none to train on: it is ignored";
                skipped.notes.extend(names_all.then(|| format!("{} {what}", list.1.display())));
                (!names_all).then_some(list)
            };
            lists.extend(read((model, "test.txt", Role::Test)).or_else(of_root));
        }
        let (mut listed, mut doubtful) = (HashMap::new(), HashSet::new());
        for (text, file, role) in lists {
            let (mut named, mut shared, mut unknown) = (HashSet::new(), HashSet::new(), HashSet::new());
            for line in text.lines().map(str::trim).filter(|line| !line.is_empty()) {
                match known.find(line) {
                    Some(name) => named.insert(name.to_owned()),
                    None if known.share(line) => shared.insert(line),
                    None => unknown.insert(line),
                };
            }
            let (photos, file) = (counted(named.len(), "photo"), file.display());
            let one = if shared.is_empty() { "" } else { "single " };
            let list = if named.is_empty() { &mut skipped.notes } else { &mut skipped.choices };
            list.push(match (named.len(), role) {
                (0, Role::Train) => format!("{file} names no {one}photo: it is ignored"),
                (0, _) => format!("{file} names no {one}photo: nothing is held out by it"),
                (_, Role::Train) => format!("{photos} to use, as {file} says"),
                (_, Role::Validation) => format!("{photos} for validation, as {file} says"),
                _ => format!("{photos} held out, as {file} says"),
            });
            if named.len() + shared.len() > 0 && !unknown.is_empty() {
                let names = counted(unknown.len(), "name");
                skipped.notes.push(format!("{names} in {file} that no photo has"));
            }
            if !shared.is_empty() {
                let names = counted(shared.len(), "name");
                let what = "that several photos share without extension and case, not used: write a photo's whole name";
                skipped.notes.push(format!("{names} in {file} {what}"));
            }
            for name in named {
                let before = listed.insert(name.clone(), role);
                if role == Role::Train && before.is_some_and(|other| other != role) {
                    doubtful.insert(name);
                }
            }
        }
        let has = |wanted: fn(&Role) -> bool| listed.values().any(wanted);
        let others = match (has(|role| *role == Role::Train), has(|role| *role != Role::Train)) {
            // As in nerfstudio.
            (true, _) => None,
            (false, true) => Some(Role::Train),
            (false, false) => Some(Role::Unsaid),
        };
        if !doubtful.is_empty() {
            skipped.notes.push(repeated::no_split(doubtful.len()));
            listed.extend(doubtful.into_iter().map(|name| (name, Role::Unsaid)));
        }
        Self { listed, others, unlisted: Names::default() }
    }

    /// The role of a photo; none, and the photo is counted, if it is not used.
    pub fn find(&mut self, name: &str) -> Option<Role> {
        let role = self.listed.get(name).copied().or(self.others);
        if role.is_none() {
            self.unlisted.add(name);
        }
        role
    }

    /// A note on the photos that are not used.
    pub fn note(&self) -> Option<String> {
        let Names { count, .. } = self.unlisted;
        let photos = counted(count, "photo");
        let what = "in neither train_list.txt nor the lists beside it, not used";
        (count > 0).then(|| format!("{photos} {what} ({})", self.unlisted))
    }
}
