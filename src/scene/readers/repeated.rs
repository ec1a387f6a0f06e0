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

/// Those of `twins`, views whose names have the same last part, whose file matches only that part of their name, while another
/// name claims the same file or has none.
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
