//! Point clouds beside a capture's cameras, in files of their own.

use crate::extension::has_extension;
use std::path::{Path, PathBuf};

use super::files::inside;
use super::{point_ply, pose};
use crate::scene::{Point, Skipped};

/// Names, in lower case, of clouds that tools put beside a capture's cameras, in this order.
const NAMES: [&str; 7] =
    ["points3d.ply", "sparse_pc.ply", "point_cloud.ply", "pointcloud.ply", "points.ply", "init.ply", "input.ply"];

/// Extensions of clouds that are not read.
const UNREAD: [&str; 5] = ["las", "laz", "e57", "pcd", "xyz"];

/// The usable points of the cloud with one of the usual names, in any case, in the first of these folders that holds one. A file that
/// is not a cloud is noted and left out: nothing names it.
pub(super) fn beside(folders: &[&Path], skipped: &mut Skipped) -> Vec<Point> {
    let files = |folder: &Path| inside(folder).into_iter().filter(|path| path.is_file()).collect();
    let held: Vec<Vec<PathBuf>> = folders.iter().map(|folder| files(folder)).collect();
    let named = |files: &Vec<PathBuf>| {
        let is = |path: &&PathBuf, name: &str| path.file_name().is_some_and(|own| own.eq_ignore_ascii_case(name));
        NAMES.iter().find_map(|name| files.iter().find(|path| is(path, name))).cloned()
    };
    let Some(path) = held.iter().find_map(named) else {
        skipped.notes.extend(held.iter().find_map(|files| unread(files)));
        return Vec::new();
    };
    match point_ply::read(&path) {
        Ok(points) => {
            let points = usable(points, skipped);
            skipped.choices.push(format!("the points are those of {}", path.display()));
            points
        }
        Err(error) => {
            skipped.notes.push(format!("not read as the capture's points: {error}"));
            Vec::new()
        }
    }
}

/// A note on a cloud in a format that is not read, or under a name that says nothing.
fn unread(files: &[PathBuf]) -> Option<String> {
    if let Some(first) = files.iter().find(|path| has_extension(path, &UNREAD)) {
        return Some(format!("no points: {} is not read; convert it to PLY and name it points3D.ply", first.display()));
    }
    let ply = files.iter().find(|path| has_extension(path, &["ply"]))?;
    Some(format!("no points: if {} holds them, name it points3D.ply", ply.display()))
}

/// Leaves out and counts points that are nowhere.
pub(super) fn usable(mut points: Vec<Point>, skipped: &mut Skipped) -> Vec<Point> {
    let all = points.len();
    points.retain(|point| pose::is_place(point.position));
    skipped.bad_points += all - points.len();
    points
}
