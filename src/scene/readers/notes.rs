//! Notes on what a scene's views and points do not tell together, for all formats.

use std::collections::HashSet;
use std::path::{Path, PathBuf};

use glam::{DVec2, DVec3};

use super::files::is_replaced;
use super::tree::{PhotoTree, unread};
use super::{Point, View};
use crate::sample::evenly;
use crate::scene::lens::Lens;
use crate::scene::{Error, FEWEST_POINTS, Names, Skipped, median};
use crate::wording::counted;

/// The note on photos that are left out for a fault of their camera, of which this is the first.
pub(super) fn no_lens(photos: &Names, error: &Error) -> String {
    format!("{} left out ({photos}), as a camera cannot be used: {error}", counted(photos.count, "photo"))
}

/// A note if most views see none of the points, of which some are looked at; points with tracks are seen.
pub(super) fn unseen(views: &[View], points: &[Point]) -> Option<String> {
    const LOOKED_AT: usize = 2000;
    if points.iter().any(|point| !point.track.is_empty()) || points.is_empty() {
        return None;
    }
    let some = evenly(points, LOOKED_AT);
    let blind = |view: &&View| view.face.is_none() && !some.clone().any(|point| view.camera.shows(point.position));
    let count = views.iter().filter(blind).count();
    (2 * count > views.len()).then(|| {
        format!(
            "{count} of {} see none of the points: are cameras and points in the same world, and do the poses have the axes and the \
             direction (camera to world or back) of their format?",
            counted(views.len(), "view")
        )
    })
}

/// The colour of all points, if they have one in common: it tells nothing. None for points too few to train from.
pub(super) fn plain(points: &[Point]) -> Option<[u8; 3]> {
    let first = points.first()?.colour;
    (points.len() >= FEWEST_POINTS && points.iter().all(|point| point.colour == first)).then_some(first)
}

/// The note on points that have no colour, or all the same.
pub(super) fn of_one_colour(points: usize, [red, green, blue]: [u8; 3]) -> String {
    format!(
        "{} without colours, or all of one ({red}, {green}, {blue}): training from them starts with the colours of the photos that \
         see them",
        counted(points, "point")
    )
}

/// A note on cameras far from all others: rates of training are relative to the extent of all cameras.
pub(super) fn outlying(views: &[View]) -> Option<String> {
    const FAR: f64 = 100.0;
    if views.len() < 5 {
        return None;
    }
    let centres: Vec<DVec3> = views.iter().map(|view| view.camera.centre()).collect();
    let usual =
        |of: &dyn Fn(&DVec3) -> f64| median(&mut centres.iter().map(of).collect::<Vec<_>>()).unwrap_or_default();
    let middle = DVec3::new(usual(&|c| c.x), usual(&|c| c.y), usual(&|c| c.z));
    let usual = usual(&|c| c.distance(middle));
    let mut names = Names::default();
    let far = views.iter().zip(&centres).filter(|(_, c)| usual > 0.0 && c.distance(middle) > FAR * usual);
    far.for_each(|(view, _)| names.add_photo(view));
    let views = counted(names.count, "camera");
    (names.count > 0).then(|| {
        format!("{views} more than {FAR} times as far out as half of them: leave them out, or pose again ({names})")
    })
}

/// Offset of the principal point from the middle, as a share of the side, above which it is reported: only crops have such.
const OFF_MIDDLE: f64 = 0.33;

/// A note if the principal points of most views lie far from the middle.
pub(super) fn off_middle(views: &[View]) -> Option<String> {
    let off = |lens: &Lens| {
        let size = DVec2::new(f64::from(lens.width), f64::from(lens.height));
        ((lens.principal - 0.5 * size) / size).abs().max_element() > OFF_MIDDLE
    };
    let mut names = Names::default();
    views.iter().filter(|view| off(&view.lens)).for_each(|view| names.add(&view.name));
    let photos = counted(names.count, "photo");
    (2 * names.count > views.len()).then(|| {
        format!("{photos} with a principal point far from the middle: unless they are crops, correct cx and cy, or w and h ({names})")
    })
}

/// Counts the photos in `folder` that no view has, and those that cannot be read.
pub(super) fn unposed(folder: &Path, (views, left_out): (&[View], &[PathBuf]), skipped: &mut Skipped) {
    let known: HashSet<&Path> = views.iter().map(|view| &view.image).chain(left_out).map(PathBuf::as_path).collect();
    let mut tree = PhotoTree::with_twins(folder);
    tree.unread.retain(|name| !known.contains(folder.join(name).as_path()));
    // `a.jpg` and `a.png` may stand for each other.
    let is_used = |photo: &Path| known.contains(photo) || is_replaced(photo, &known);
    for name in tree.names.iter().filter(|name| !is_used(&folder.join(name))) {
        skipped.unposed_images.add(name);
    }
    skipped.choices.extend(tree.choices());
    skipped.notes.extend(unread(&tree.unread));
}
