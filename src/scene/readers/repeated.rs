//! Views that a capture lists twice, and files that several views claim.

use glam::{DMat3, DVec3};
use std::collections::{HashMap, HashSet};
use std::path::{Path, PathBuf};

use super::names;
use crate::scene::camera::Camera;
use crate::scene::view::{Role, View};
use crate::scene::{Error, Skipped};
use crate::wording::counted;

/// Rounding of a pose that is written in two files, of entries of rotations and of translations; far translations are rounded to
/// a millionth.
const ROUNDED: f64 = 1e-4;

/// True if two views have one lens, and one pose except for rounding.
fn agree(a: &View, b: &View) -> bool {
    let turned = (a.camera.rotation - b.camera.rotation).to_cols_array();
    let moved = a.camera.translation.distance(b.camera.translation);
    let exact = |view: &View| Camera { rotation: DMat3::IDENTITY, translation: DVec3::ZERO, ..view.camera.clone() };
    exact(a) == exact(b)
        && a.lens == b.lens
        && turned.iter().all(|entry| entry.abs() <= ROUNDED)
        && moved <= ROUNDED.max(1e-6 * a.camera.translation.length())
}

/// Drops views listed twice with the same fields, under one name or for one file; refuses a name with two poses or cameras, as
/// either may be wrong. Views listed for training and for test have no role; those for validation and for test are for test.
pub(super) fn drop_repeated(
    views: Vec<(u32, View)>,
    source: &Path,
    skipped: &mut Skipped,
) -> Result<Vec<(u32, View)>, Error> {
    let mut kept: Vec<(u32, View)> = Vec::with_capacity(views.len());
    let mut split_copies = 0_usize;
    let mut of_file: HashMap<PathBuf, usize> = HashMap::new();
    for (id, view) in views {
        let same_name = kept.len().checked_sub(1).filter(|last| kept[*last].1.name == view.name);
        let same_file = of_file.get(&view.image).copied().filter(|i| agree(&kept[*i].1, &view));
        let Some(i) = same_name.or(same_file) else {
            of_file.entry(view.image.clone()).or_insert(kept.len());
            kept.push((id, view));
            continue;
        };
        let known = &mut kept[i].1;
        if !agree(known, &view) {
            return Err(Error::malformed(
                source,
                format!("image {:?}", view.name),
                "is listed twice, with different poses or cameras; remove the wrong entry",
            ));
        }
        let is_held_out = |role: Role| matches!(role, Role::Validation | Role::Test);
        if known.role == view.role {
            skipped.repeated_views.add(&view.name);
        } else if is_held_out(known.role) && is_held_out(view.role) {
            known.role = Role::Test;
        } else if known.role != Role::Unsaid {
            split_copies += 1;
            known.role = Role::Unsaid;
        }
    }
    skipped.notes.extend((split_copies > 0).then(|| no_split(split_copies)));
    Ok(kept)
}

/// The note on views that are held out and trained on.
pub(super) fn no_split(count: usize) -> String {
    format!("{} listed for both training and test: both roles are ignored", counted(count, "view"))
}

/// If two views claim one file, the view with exactly that name keeps it, otherwise the first. If only the last parts of their names
/// match the file's, neither gets it.
pub(super) fn unshare(root: &Path, views: &mut [View]) {
    let mut twins: HashMap<String, Vec<usize>> = HashMap::new();
    for (i, view) in views.iter().enumerate().filter(|(_, view)| view.name.contains('/')) {
        twins.entry(names::key(names::last(&view.name))).or_default().push(i);
    }
    let all = twins.values().filter(|twins| twins.len() > 1);
    for i in all.flat_map(|twins| doubtful(views, twins)).collect::<Vec<_>>() {
        let view = &mut views[i];
        view.image = view.image.with_file_name(&view.name); // which is not there
    }
    let named = |view: &View| names::last(&view.name) == view.image.file_name().unwrap_or_default();
    let mut order: Vec<&mut View> = views.iter_mut().collect();
    order.sort_by_key(|view| !named(view)); // stable
    let mut taken = HashSet::new();
    for view in order {
        if !taken.insert(view.image.clone()) {
            let own = view.image.with_file_name(names::last(&view.name));
            view.image = if own.is_file() { root.join(&view.name) } else { own };
        }
    }
}

/// The views among `twins`, whose names have the same last part, whose file matches only that part of their name, while
/// another name claims the same file or has none.
fn doubtful(views: &[View], twins: &[usize]) -> Vec<usize> {
    let named: Vec<String> = twins.iter().map(|i| names::folder_key(&views[*i].name)).collect();
    let mut claims: HashMap<&Path, HashSet<&str>> = HashMap::new();
    let mut absent = HashSet::new();
    for (i, name) in twins.iter().zip(&named) {
        let image = views[*i].image.as_path();
        claims.entry(image).or_default().insert(name);
        if !image.is_file() {
            absent.insert(name.as_str());
        }
    }
    let others = |of: &HashSet<&str>, own: &str| of.len() > usize::from(of.contains(own));
    let is_doubtful = |(i, own): &(usize, &String)| {
        let image = &views[*i].image;
        names::folder_key(&image.to_string_lossy()) != **own
            && (others(&absent, own) || others(&claims[image.as_path()], own))
    };
    twins.iter().copied().zip(&named).filter(is_doubtful).map(|(i, _)| i).collect()
}
