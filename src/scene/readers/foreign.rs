//! Poses that lie beside photos in formats that are not read, or in a transforms file of another name: named, with the way to
//! a format that is read.

use std::fs;
use std::io::Read;
use std::path::Path;

use super::files::{child, inside, subfolders};
use crate::extension::has_extension;

/// How much of a file tells its format.
const BEGINNING: u64 = 4096;
/// Maximum number of files of a format's name, in one folder, that are opened: photos may each have such a file beside them.
const OPENED: usize = 16;
/// Maximum number of subfolders that are looked into.
pub(super) const SUBFOLDERS: usize = 64;

/// A format of poses that is not read: the names of its files in lower case, where `*` stands for anything; texts, with `|` between
/// them, of which one is in the beginning of such a file, or is its very first text if `^` stands before it, in lower case, where other
/// programs use the same names, otherwise empty;
/// the program that writes it; how it becomes one that is read.
struct Format(&'static [&'static str], &'static str, &'static str, &'static str);

/// The remedy where no program writes a format that is read.
const CONVERT: &str = "convert it to a transforms.json";
/// The remedy where the program writes COLMAP's format.
const COLMAP: &str = "export cameras as COLMAP";

/// The remedy for Record3D's export.
const RECORD3D: &str = "nerfstudio's `ns-process-data record3d` converts it";

/// Poses of KITTI's odometry, which lie in files of numbers in a folder of the same name, too.
const KITTI: Format = Format(&["poses.txt"], "", "KITTI", CONVERT);
/// Numbers in a line of KITTI's odometry.
const KITTI_NUMBERS: usize = 12;

const FOREIGN: &[Format] = &[
    Format(&["reconstruction.json"], "", "OpenSfM", "`opensfm export_colmap` converts it"),
    Format(&["sfm_data.json", "sfm_data.bin"], "", "OpenMVG", "`openMVG_main_openMVG2Colmap` converts it"),
    Format(&["meta_data.json"], "", "SDFStudio", "give its photos to `pose`, or its transforms.json"),
    Format(&["poses_bounds*.npy"], "", "LLFF", "give the COLMAP model that it was made from"),
    Format(&["*.out"], "# bundle file", "Bundler", CONVERT),
    Format(&["database.db"], "", "COLMAP, without a model", "run `colmap mapper`"),
    Format(&["cameras.npz", "cameras_sphere.npz", "cameras_large.npz"], "", "NeuS, IDR or DTU", CONVERT),
    Format(&["metadata.json"], "\"appearance_id\"", "Nerfies", CONVERT),
    Format(&["metadata.json"], "\"cam_transform_mat\"", "NeRFactor", CONVERT),
    Format(&["metadata"], "{", "Record3D", RECORD3D),
    Format(
        &["metadata.json"],
        "\"initpose\"|\"poses\"|\"fps\"|\"perframeintrinsiccoeffs\"|\"frametimestamps\"",
        "Record3D",
        RECORD3D,
    ),
    Format(&["corrected_cameras"], "", "Polycam", "nerfstudio's `ns-process-data polycam` converts it"),
    Format(&["*.json"], "\"t_00\"", "Polycam", "nerfstudio's `ns-process-data polycam` converts it"),
    Format(&["shots.geojson"], "", "OpenDroneMap", "nerfstudio's `ns-process-data odm` converts it"),
    Format(&["closed_loop_trajectory.csv"], "", "Project Aria", "nerfstudio's `ns-process-data aria` converts it"),
    Format(&["trajectories.txt"], "# kapture", "kapture", "`kapture_export_colmap.py` converts it"),
    Format(&["odometry.csv"], "timestamp", "Stray Scanner", CONVERT),
    Format(&["*.pose.txt"], "", "7-Scenes", CONVERT),
    Format(&["pose", "poses"], "", "ScanNet or NSVF", CONVERT),
    Format(
        &["*.sfm", "sfm.json", "sfmdata.json", "*.abc", "meshroomcache"],
        "",
        "Meshroom",
        "its node ExportColmap, or `aliceVision_exportColmap`, converts it",
    ),
    Format(&["*.nvm"], "nvm_v", "VisualSFM", CONVERT),
    Format(&["*.rcproj", "*.rsproj"], "", "RealityScan", "export the registration as COLMAP"),
    Format(&["*.csv"], "#name", "RealityScan", "export the registration as COLMAP"),
    Format(&["*.xmp"], "xcr:", "RealityScan", "export the registration as COLMAP"),
    Format(&["*.psx"], "", "Metashape", COLMAP),
    Format(&["*.xml"], "<document", "Metashape", COLMAP),
    Format(&["*.txt"], "# photoid,", "Metashape", COLMAP),
    Format(&["*.xml"], "<blocksexchange", "ContextCapture", CONVERT),
    Format(&["*_calibrated_camera_parameters.txt", "*.opf"], "", "Pix4D", CONVERT),
    Format(&["*.json"], "cameraposearframe", "ARKit", CONVERT),
    Format(&["*.json"], "\"pixel_aspect_ratio\"", "Nerfies", CONVERT),
    Format(&["cameras.json"], "\"img_name\"", "a run of 3DGS", "give the capture that it was trained on"),
    Format(&["*.txt", "*.csv"], "# coordinatesystem", "Metashape", COLMAP),
    Format(&["groundtruth.txt", "*.tum"], "", "TUM RGB-D", CONVERT),
    KITTI,
    Format(&["oxts"], "", "KITTI's raw data", CONVERT),
    Format(&["cam0_to_world.txt"], "", "KITTI-360", CONVERT),
    Format(&["state_groundtruth_estimate0"], "", "EuRoC", CONVERT),
    Format(&["ego_pose.json"], "", "nuScenes", CONVERT),
    Format(&["ego_pose"], "", "Waymo", CONVERT),
    Format(&["frame_annotations.jgz"], "", "CO3D", CONVERT),
    Format(
        &["depth_masks"],
        "",
        "CO3D",
        "convert the poses in frame_annotations.jgz, one folder up, to a transforms.json",
    ),
    Format(&["camera_keyframe_positions.hdf5"], "", "Hypersim", CONVERT),
    Format(&["*.sens"], "", "ScanNet", "unpack it by ScanNet's SensReader, and convert its poses to a transforms.json"),
    Format(&["*.zep"], "", "3DF Zephyr", "export its cameras, and convert them to a transforms.json"),
    Format(&["pos_001.txt"], "", "DTU", CONVERT),
    Format(&["*.mvs"], "", "OpenMVS", "give the COLMAP model that it was made from"),
    Format(&["pose_intrinsic_imu.json"], "", "ScanNet++'s iPhone data", CONVERT),
    Format(&["traj.txt", "traj_w_c.txt"], "", "Replica", CONVERT),
    Format(&["predictions.npz", "poses.npy"], "", "VGGT or a similar network", CONVERT),
    Format(&["cameras.bin.gz", "images.bin.gz"], "", "COLMAP, compressed", "unpack its files by `gunzip *.gz`"),
    Format(&["*.pincam"], "", "ARKitScenes", CONVERT),
    Format(&["*_cam.txt"], "extrinsic", "MVSNet", CONVERT),
    Format(&["coordinates.pt"], "", "Mega-NeRF", CONVERT),
    Format(&["*.log"], "0 0 0\n", "Tanks and Temples", "give the COLMAP model that belongs to it"),
    Format(&["*.log"], "0\t0\t1\n", "Open3D", CONVERT),
    Format(
        &["transforms_val.json", "transforms_test.json"],
        "",
        "Blender, without transforms_train.json",
        "name it transforms.json",
    ),
    Format(&["*.txt"], "^https://www.youtube.com/watch", "RealEstate10K", CONVERT),
];

impl Format {
    /// True for the name of such a file or folder.
    fn names(&self, path: &Path) -> bool {
        let Self(names, ..) = *self;
        let name = path.file_name().unwrap_or_default().to_string_lossy().to_lowercase();
        let matches = |known: &&str| match known.split_once('*') {
            Some((start, end)) => {
                name.len() >= start.len() + end.len() && name.starts_with(start) && name.ends_with(end)
            }
            None => name == **known,
        };
        names.iter().any(matches)
    }

    /// True for a file that begins as those of this format do.
    fn begins(&self, path: &Path) -> bool {
        let Self(_, holds, ..) = *self;
        if holds.is_empty() {
            return true;
        }
        let begins = beginning(path);
        holds.split('|').any(|text| match text.strip_prefix('^') {
            Some(first) => begins.starts_with(first),
            None => begins.contains(text),
        })
    }

    fn told(&self, what: &str) -> String {
        let Self(.., program, remedy) = self;
        format!("{what}perhaps from {program}, is not read: {remedy}")
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
    let format = FOREIGN.iter().find(|format| format.names(path) && format.begins(path))?;
    // A transforms file may have any name.
    let named = path.file_name().is_some_and(|name| name.to_string_lossy().to_lowercase().starts_with("transforms"));
    let begins = beginning(path);
    let is_transforms = named || ["\"transform_matrix\"", "\"fl_x\""].iter().any(|field| begins.contains(field));
    (!is_transforms).then(|| format.told("this file, "))
}

/// A clause on the files in a folder, beside its photos or up to two subfolders deep, that may hold poses and are not read; empty if
/// there are none.
pub(super) fn poses(folder: &Path) -> String {
    let images = child(folder, "images");
    let places = [folder, &images];
    let told = transforms(folder).or_else(|| places.into_iter().find_map(|place| in_folder(folder, place)));
    let told = told.or_else(|| half_a_model(folder)).or_else(|| in_subfolders(folder, in_folder));
    let told = told.or_else(|| places.into_iter().find_map(|place| table_in(folder, place)));
    told.or_else(|| in_subfolders(folder, table_in)).unwrap_or_default()
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
    let kitti = paths.iter().find(|path| is_kitti(path)).map(|path| (path, &KITTI));
    let found = kitti.or_else(|| {
        FOREIGN.iter().find_map(|format| {
            let path = paths.iter().filter(|path| format.names(path)).take(OPENED).find(|path| format.begins(path))?;
            Some((path, format))
        })
    });
    found.map(|(path, format)| format.told(&format!("; {}, ", within(root, path))))
}

/// The path of a file below a folder.
fn within(root: &Path, path: &Path) -> String {
    path.strip_prefix(root).unwrap_or(path).display().to_string()
}

/// A clause on a table in a folder whose columns are quaternions.
fn table_in(root: &Path, folder: &Path) -> Option<String> {
    let paths = inside(folder);
    let path = ["csv", "txt", "json"].into_iter().find_map(|extension| {
        let mut tables = paths.iter().filter(|path| has_extension(path, &[extension])).take(OPENED);
        tables.find(|path| has_quaternions(path))
    })?;
    Some(format!("; {} may hold poses of a format that is not read: {CONVERT}", within(root, path)))
}

/// True for a file whose beginning names the parts of quaternions, and that is no part of a COLMAP model.
fn has_quaternions(path: &Path) -> bool {
    let begins = beginning(path);
    let words: Vec<&str> = begins.split(|c: char| !c.is_alphanumeric() && c != '_').collect();
    let are_named =
        (words.contains(&"qw") && words.contains(&"qx")) || words.iter().any(|word| word.ends_with("ori_w"));
    let of_colmap = ["images", "frames", "rigs"];
    are_named && path.file_stem().is_none_or(|name| !of_colmap.iter().any(|own| name.eq_ignore_ascii_case(own)))
}

/// True for a folder of poses whose first file has KITTI's lines of twelve numbers.
fn is_kitti(folder: &Path) -> bool {
    let is_named = folder.file_name().is_some_and(|name| name.eq_ignore_ascii_case("poses"));
    let first = || inside(folder).into_iter().find(|path| has_extension(path, &["txt"]));
    is_named
        && first().is_some_and(|file| {
            let begins = beginning(&file);
            let line = begins.lines().next().unwrap_or_default();
            line.split_whitespace().filter(|word| word.parse::<f64>().is_ok()).count() == KITTI_NUMBERS
        })
}

fn in_subfolders(folder: &Path, told: fn(&Path, &Path) -> Option<String>) -> Option<String> {
    let deeper = subfolders(folder).flat_map(|path| subfolders(&path).collect::<Vec<_>>());
    subfolders(folder).chain(deeper).take(SUBFOLDERS).find_map(|path| told(folder, &path))
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
