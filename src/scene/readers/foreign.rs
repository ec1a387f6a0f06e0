//! Poses that lie beside photos in formats that are not read, or in a transforms file of another name: named, with the way to
//! a format that is read.

use std::fs;
use std::io::Read;
use std::path::Path;

use super::files::{child, inside, subfolders};
use crate::extension::has_extension;

/// How much of a file tells its format.
const BEGINNING: u64 = 4096;
/// Maximum number of subfolders that are looked into.
const SUBFOLDERS: usize = 64;

/// A format of poses that is not read.
struct Format {
    /// The names of its files in lower case; `*` stands for anything.
    names: &'static [&'static str],
    /// Text in the beginning of such a file, in lower case, where other programs use the same names; otherwise empty.
    holds: &'static str,
    /// The program that writes it.
    program: &'static str,
    /// How it becomes one that is read.
    remedy: &'static str,
}

const fn format(
    names: &'static [&'static str],
    holds: &'static str,
    program: &'static str,
    remedy: &'static str,
) -> Format {
    Format { names, holds, program, remedy }
}

const FOREIGN: [Format; 28] = [
    format(&["reconstruction.json"], "", "OpenSfM", "`opensfm export_colmap` converts it"),
    format(&["sfm_data.json", "sfm_data.bin"], "", "OpenMVG", "`openMVG_main_openMVG2Colmap` converts it"),
    format(&["meta_data.json"], "", "SDFStudio", "give its photos to `pose`, or its transforms.json"),
    format(&["poses_bounds*.npy"], "", "LLFF", "give the COLMAP model that it was made from"),
    format(&["*.out"], "# bundle file", "Bundler", "export COLMAP's format instead"),
    format(&["database.db"], "", "COLMAP, without a model", "run `colmap mapper`"),
    format(
        &["cameras.npz", "cameras_sphere.npz", "cameras_large.npz"],
        "",
        "NeuS, IDR or DTU",
        "give the COLMAP model that it was made from",
    ),
    format(&["metadata.json"], "", "Record3D", "nerfstudio's `ns-process-data record3d` converts it"),
    format(&["corrected_cameras"], "", "Polycam", "nerfstudio's `ns-process-data polycam` converts it"),
    format(&["trajectories.txt"], "# kapture", "kapture", "`kapture_export_colmap.py` converts it"),
    format(&["odometry.csv"], "timestamp", "Stray Scanner", "convert it to a transforms.json"),
    format(&["*.pose.txt"], "", "7-Scenes", "convert it to a transforms.json"),
    format(&["pose", "poses"], "", "ScanNet or NSVF", "convert it to a transforms.json"),
    format(
        &["*.sfm", "sfm.json", "*.abc", "meshroomcache"],
        "",
        "Meshroom",
        "its node ExportColmap, or `aliceVision_exportColmap`, converts it",
    ),
    format(&["*.nvm"], "nvm_v", "VisualSFM", "export COLMAP's format instead"),
    format(&["*.rcproj", "*.rsproj"], "", "RealityScan", "export the registration as COLMAP"),
    format(&["*.csv"], "#name,x,y", "RealityScan", "export the registration as COLMAP"),
    format(&["*.xmp"], "xcr:", "RealityScan", "export the registration as COLMAP"),
    format(&["*.psx"], "", "Metashape", "export cameras as COLMAP"),
    format(&["*.xml"], "<document", "Metashape", "export cameras as COLMAP"),
    format(&["*.xml"], "<blocksexchange", "ContextCapture", "export COLMAP's format instead"),
    format(&["*_calibrated_camera_parameters.txt"], "", "Pix4D", "export COLMAP's format instead"),
    format(&["*.json"], "cameraposearframe", "ARKit", "nerfstudio's `ns-process-data` converts it"),
    format(&["cameras.json"], "\"img_name\"", "a run of 3DGS", "give the capture that it was trained on"),
    format(&["groundtruth.txt"], "", "TUM RGB-D", "convert it to a transforms.json"),
    format(&["poses.txt"], "", "KITTI", "convert it to a transforms.json"),
    format(&["*.log"], "0 0 0\n", "Tanks and Temples", "give the COLMAP model that belongs to it"),
    format(
        &["transforms_val.json", "transforms_test.json"],
        "",
        "Blender, without transforms_train.json",
        "name it transforms.json",
    ),
];

impl Format {
    /// True for the path of such a file or folder.
    fn is_of(&self, path: &Path) -> bool {
        let name = path.file_name().unwrap_or_default().to_string_lossy().to_lowercase();
        let matches = |known: &&str| match known.split_once('*') {
            Some((start, end)) => {
                name.len() >= start.len() + end.len() && name.starts_with(start) && name.ends_with(end)
            }
            None => name == **known,
        };
        self.names.iter().any(matches) && (self.holds.is_empty() || beginning(path).contains(self.holds))
    }

    fn told(&self, what: &str) -> String {
        format!("{what}perhaps of {}, is not read: {}", self.program, self.remedy)
    }
}

/// The beginning of a file as text in lower case.
fn beginning(path: &Path) -> String {
    let mut bytes = Vec::new();
    if path.is_file() {
        // An unreadable file tells nothing.
        let _ = fs::File::open(path).and_then(|file| file.take(BEGINNING).read_to_end(&mut bytes));
    }
    String::from_utf8_lossy(&bytes).replace("\r\n", "\n").to_lowercase()
}

/// A clause on the format of a file, if it is one that is not read.
pub(super) fn file(path: &Path) -> Option<String> {
    let format = FOREIGN.iter().find(|format| format.is_of(path))?;
    // A transforms file may have any name.
    let named = path.file_name().is_some_and(|name| name.to_string_lossy().to_lowercase().starts_with("transforms"));
    let begins = beginning(path);
    let is_transforms = named || ["\"transform_matrix\"", "\"fl_x\""].iter().any(|field| begins.contains(field));
    (!is_transforms).then(|| format.told("this file, "))
}

/// A clause on the files in a folder, beside its photos or in a subfolder, that may hold poses and are not read; empty if there are
/// none.
pub(super) fn poses(folder: &Path) -> String {
    let images = child(folder, "images");
    let told = transforms(folder).or_else(|| [folder, &images].into_iter().find_map(|place| in_folder(folder, place)));
    told.or_else(|| half_a_model(folder)).or_else(|| in_subfolders(folder)).unwrap_or_default()
}

/// A transforms file whose name is not looked for, as far as its beginning tells.
fn transforms(folder: &Path) -> Option<String> {
    // Blender's have a line of their own: each holds a part of the photos.
    let blender = ["transforms_val.json", "transforms_test.json"];
    let other = |path: &std::path::PathBuf| {
        let name = path.file_name().unwrap_or_default().to_string_lossy().to_lowercase();
        has_extension(path, &["json"]) && !blender.contains(&name.as_str())
    };
    let mut files = inside(folder).into_iter().filter(other);
    let file = files.find(|path| {
        let begins = beginning(path);
        ["\"frames\"", "\"transform_matrix\""].iter().all(|field| begins.contains(field))
    })?;
    let name = file.file_name().unwrap_or_default().display();
    Some(format!("; {name} may hold some: give {} to use them", file.display()))
}

fn in_folder(root: &Path, folder: &Path) -> Option<String> {
    let paths = inside(folder);
    FOREIGN.iter().find_map(|format| {
        let path = paths.iter().find(|path| format.is_of(path))?;
        let name = path.strip_prefix(root).unwrap_or(path).display();
        Some(format.told(&format!("; {name}, ")))
    })
}

fn in_subfolders(folder: &Path) -> Option<String> {
    subfolders(folder).take(SUBFOLDERS).find_map(|path| in_folder(folder, &path))
}

/// A COLMAP model that lacks a file.
fn half_a_model(folder: &Path) -> Option<String> {
    let places = ["sparse/0", "sparse", "colmap/sparse/0", ""];
    places.iter().find_map(|place| {
        let has = |name: &str| ["bin", "txt"].iter().any(|e| folder.join(place).join(name).with_extension(e).is_file());
        let (there, lacks) = match (has("cameras"), has("images")) {
            (true, false) => ("cameras", "images"),
            (false, true) => ("images", "cameras"),
            _ => return None,
        };
        Some(format!("; {} has {there}.bin or .txt, but no {lacks}.bin or .txt", folder.join(place).display()))
    })
}
