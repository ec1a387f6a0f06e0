//! OpenMVG-rs: one program does it all.

use super::child::{self, Output};
use super::folder::Folder;
use super::{Stage, Watcher};
use crate::job::Error;

/// The program.
pub(super) const PROGRAM: &str = "openmvg-sfm";

/// Estimates poses, into the folder of models.
pub(super) fn run(folder: &Folder, watcher: &dyn Watcher) -> Result<(), Error> {
    let path = |path: std::path::PathBuf| path.display().to_string();
    // Photos without EXIF data share a camera by size, as COLMAP's do here.
    let fixed = ["--colmap", "--share-intrinsics", "--no-progress", "--output"].map(ToOwned::to_owned);
    let arguments = [&[path(folder.images())], &fixed[..], &[path(folder.models())]].concat();
    watcher.progress(Stage::Poses, 0, folder.photos().len());
    child::run((PROGRAM, &arguments), Output::Text, &folder.log(), watcher, &mut |_| ())
}
