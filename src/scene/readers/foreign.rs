//! Poses that lie beside photos in formats that are not read: named, with the way to a format that is.

use std::fs;
use std::path::Path;

/// How a file's name ends, in lower case, the program that writes it, and how that program exports COLMAP's format.
const FOREIGN: [(&str, &str, &str); 16] = [
    ("reconstruction.json", "OpenSfM", "`opensfm export_colmap` converts it"),
    ("sfm_data.json", "OpenMVG", "`openMVG_main_openMVG2Colmap` converts it"),
    ("meta_data.json", "SDFStudio", "give its photos to `pose`, or its transforms.json"),
    ("poses_bounds.npy", "LLFF", "give the COLMAP model that it was made from"),
    ("bundle.out", "Bundler", "export COLMAP's format instead"),
    ("database.db", "COLMAP, without a model", "run `colmap mapper`"),
    ("cameras_sphere.npz", "NeuS or IDR", "give the COLMAP model that it was made from"),
    ("metadata.json", "Record3D", "nerfstudio's `ns-process-data record3d` converts it"),
    ("pose", "ScanNet or NSVF", "convert it to a transforms.json"),
    (".sfm", "Meshroom", "its node ExportColmap, or `aliceVision_exportColmap`, converts it"),
    (".abc", "Meshroom", "its node ExportColmap, or `aliceVision_exportColmap`, converts it"),
    (".nvm", "VisualSFM", "export COLMAP's format instead"),
    (".rcproj", "RealityScan", "export the registration as COLMAP"),
    (".psx", "Metashape", "export cameras as COLMAP"),
    (".xml", "Metashape", "export cameras as COLMAP"),
    (".csv", "RealityScan", "export the registration as COLMAP"),
];

/// A sentence on the files in a folder that may hold poses and are not read; empty if there are none.
pub(super) fn poses(folder: &Path) -> String {
    let mut names: Vec<String> =
        fs::read_dir(folder).into_iter().flatten().flatten().filter_map(|e| e.file_name().into_string().ok()).collect();
    names.sort();
    let told = names.iter().find_map(|name| {
        let lower = name.to_lowercase();
        let (_, program, remedy) = FOREIGN.iter().find(|(end, ..)| lower.ends_with(end))?;
        Some(format!("; {name}, perhaps of {program}, is not read: {remedy}"))
    });
    told.or_else(|| half_a_model(folder)).unwrap_or_default()
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
