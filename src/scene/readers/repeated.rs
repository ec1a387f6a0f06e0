//! Views that a capture lists twice, and files that several views claim.

use std::collections::{HashMap, HashSet};
use std::path::Path;

use super::names;
use crate::scene::view::{Role, View};
use crate::scene::{Error, Skipped};
use crate::wording::counted;

/// Drops views listed twice with the same fields; refuses a name with two poses or cameras, as either may be wrong.
/// Views listed for training and for test have no role.
pub(super) fn drop_repeated(
    views: Vec<(u32, View)>,
    source: &Path,
    skipped: &mut Skipped,
) -> Result<Vec<(u32, View)>, Error> {
    let mut kept: Vec<(u32, View)> = Vec::with_capacity(views.len());
    let mut split_copies = 0_usize;
    for (id, view) in views {
        match kept.last_mut() {
            Some((_, last)) if last.name == view.name => {
                if last.camera != view.camera || last.lens != view.lens {
                    return Err(Error::malformed(
                        source,
                        format!("image {:?}", view.name),
                        "is listed twice, with different poses or cameras; remove the wrong entry",
                    ));
                }
                if last.role == view.role {
                    skipped.repeated_views.add(&view.name);
                } else if last.role != Role::Unsaid {
                    split_copies += 1;
                    last.role = Role::Unsaid;
                }
            }
            _ => kept.push((id, view)),
        }
    }
    skipped.notes.extend((split_copies > 0).then(|| no_split(split_copies)));
    Ok(kept)
}

/// The note on views that are held out and trained on.
pub(super) fn no_split(count: usize) -> String {
    format!("{} listed for training and for test, which is no split", counted(count, "view"))
}

/// If two views claim one file, the view with exactly that name keeps it, otherwise the first. If only the last parts of their names
/// match the file's, neither gets it.
pub(super) fn unshare(root: &Path, views: &mut [View]) {
    let mut twins: HashMap<String, Vec<usize>> = HashMap::new();
    for (i, view) in views.iter().enumerate().filter(|(_, view)| view.name.contains('/')) {
        twins.entry(names::key(names::last(&view.name))).or_default().push(i);
    }
    let named = |view: &View| names::folder_key(&view.name);
    let doubtful = |i: &usize, twins: &[usize]| {
        let view = &views[*i];
        let other = |twin: &View| named(twin) != named(view) && (twin.image == view.image || !twin.image.is_file());
        names::folder_key(&view.image.to_string_lossy()) != named(view) && twins.iter().any(|j| other(&views[*j]))
    };
    let all = twins.values().filter(|twins| twins.len() > 1);
    let doubtful: Vec<usize> =
        all.flat_map(|twins| twins.iter().copied().filter(|i| doubtful(i, twins)).collect::<Vec<_>>()).collect();
    for i in doubtful {
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
