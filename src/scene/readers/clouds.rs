//! Point clouds beside a capture's cameras, in files of their own.

use std::fs;
use std::path::{Path, PathBuf};

use super::{ListedPoint, point_ply, pose};
use crate::scene::Skipped;

/// Names of clouds that tools put beside a capture's cameras, in this order.
const NAMES: [&str; 7] =
    ["points3D.ply", "points3d.ply", "sparse_pc.ply", "point_cloud.ply", "pointcloud.ply", "points.ply", "init.ply"];

/// Extensions of clouds that are not read.
const UNREAD: [&str; 5] = ["las", "laz", "e57", "pcd", "xyz"];

/// The usable points of the first cloud that is there: one of `first`, or one of the usual names in the capture at `root`.
/// A file that is not a cloud is noted and left out: nothing names it.
pub(super) fn beside(first: impl Iterator<Item = PathBuf>, root: &Path, skipped: &mut Skipped) -> Vec<ListedPoint> {
    let usual = NAMES.iter().map(|name| root.join(name));
    let Some(path) = first.chain(usual).find(|path| path.is_file()) else {
        skipped.notes.extend(unread(root));
        return Vec::new();
    };
    match point_ply::read(&path) {
        Ok(points) => {
            let points = usable(points, skipped);
            skipped.notes.push(format!("the points are those of {}", path.display()));
            points
        }
        Err(error) => {
            skipped.notes.push(format!("not read as the capture's points: {error}"));
            Vec::new()
        }
    }
}

/// A note on a cloud in a format that is not read.
fn unread(root: &Path) -> Option<String> {
    let files = fs::read_dir(root).into_iter().flatten().flatten().map(|entry| entry.path());
    let is_cloud = |path: &PathBuf| path.extension().is_some_and(|e| UNREAD.iter().any(|u| e.eq_ignore_ascii_case(u)));
    let first = files.filter(is_cloud).min()?;
    Some(format!("no points: {} is not read, convert it to PLY and name it points3D.ply", first.display()))
}

/// Leaves out and counts points that are nowhere.
pub(super) fn usable(mut points: Vec<ListedPoint>, skipped: &mut Skipped) -> Vec<ListedPoint> {
    let all = points.len();
    points.retain(|point| pose::is_place(point.position));
    skipped.bad_points += all - points.len();
    points
}
