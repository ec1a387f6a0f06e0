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

/// The roles of a model's photos.
pub(super) struct Roles {
    /// By the keys of their names.
    listed: HashMap<String, Role>,
    /// The role of all others; none if they are not used.
    others: Option<Role>,
    /// Photos that are not used.
    unlisted: Names,
}

impl Roles {
    /// The roles that nerfstudio's lists give; if none names a photo, test.txt beside the model's files holds out photos, as 3DGS writes it.
    pub fn of(root: &Path, model: &Path, rows: &[ImageRow], skipped: &mut Skipped) -> Self {
        let read = |(folder, name, role): (&Path, &str, Role)| {
            let file = files::child(folder, name);
            file.is_file().then(|| (files::read_text(&file).unwrap_or_default(), file, role))
        };
        let mut lists: Vec<_> = LISTS.iter().filter_map(|(name, role)| read((root, name, *role))).collect();
        let known: HashSet<String> = rows.iter().map(|row| names::key(&row.name)).collect();
        let names_one = |text: &str| text.lines().any(|line| known.contains(&names::key(line.trim())));
        if !lists.iter().any(|(text, ..)| names_one(text)) {
            lists.extend(read((model, "test.txt", Role::Test)));
        }
        let (mut listed, mut doubtful) = (HashMap::new(), HashSet::new());
        for (text, file, role) in lists {
            let lines = text.lines().map(str::trim).filter(|line| !line.is_empty());
            let (named, unknown): (HashSet<String>, HashSet<String>) =
                lines.map(names::key).partition(|name| known.contains(name));
            let (photos, file) = (counted(named.len(), "photo"), file.display());
            skipped.notes.push(match (named.len(), role) {
                (0, Role::Train) => format!("{file} names no photo: it is ignored"),
                (0, _) => format!("{file} names no photo: nothing is held out by it"),
                (_, Role::Train) => format!("{photos} to use, as {file} says"),
                (_, Role::Validation) => format!("{photos} for validation, as {file} says"),
                _ => format!("{photos} held out, as {file} says"),
            });
            if !named.is_empty() && !unknown.is_empty() {
                let names = counted(unknown.len(), "name");
                skipped.notes.push(format!("{names} in {file} that no photo has"));
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
        let role = self.listed.get(&names::key(name)).copied().or(self.others);
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
