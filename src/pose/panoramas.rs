//! Panoramas without poses: each is cut into the faces of a cube, which are the photos of a rig of six pinholes at one place.

use crate::extension::has_extension;
use std::collections::{BTreeMap, BTreeSet};
use std::fs;
use std::path::Path;

use glam::{DQuat, DVec3};
use image::ImageFormat;
use image::codecs::jpeg::JpegEncoder;
use serde_json::json;

use super::Watcher;
use super::folder::Folder;
use super::rig::Rig;
use crate::job::Error;
use crate::scene::faces::{self, CUBE};
use crate::scene::{AlphaRole, CameraKind, LoadOptions, Photo, Scene, View, is_panorama, load_photos};

/// The face that the others are placed by.
const FRONT: &str = "front";
/// Extensions of JPEG files, whose faces are JPEG files; those of other photos are PNG files.
const JPEG: [&str; 4] = ["jpg", "jpeg", "jpe", "jfif"];
/// Largest distance of two faces of a panorama, as a share of the cameras' extent, of reliable poses.
const APART: f64 = 0.02;
/// Quality of JPEG files.
const QUALITY: u8 = 95;

/// The sizes that the photos of a folder have: width and height in pixels.
fn sizes(folder: &Folder) -> impl Iterator<Item = (u32, u32)> {
    folder.photos().iter().filter_map(|name| CameraKind::of(&folder.images().join(name))).map(|kind| kind.size)
}

/// The hint for photos that may be panoramas.
pub(super) fn hint(folder: &Folder) -> Option<&'static str> {
    let mut sizes = sizes(folder).peekable();
    let all = sizes.peek().is_some() && sizes.all(is_panorama);
    all.then_some("all photos are twice as wide as high: panoramas (360°) need --panoramas")
}

/// Puts the faces of the panoramas of these names, `front/a.jpg` and so on, in their places, masks likewise; returns the faces' names.
pub(super) fn cut(folder: &Folder, names: &[String], watcher: &dyn Watcher) -> Result<Vec<String>, Error> {
    let mut made = Vec::with_capacity(CUBE.len() * names.len());
    for name in names {
        watcher.unless_stopped()?;
        let file = folder.images().join(name);
        let mask = folder.masks().join(Path::new(name).with_extension("png"));
        let faces = View::of_panorama(&file, mask.is_file().then_some(mask.as_path()))?;
        let views: Vec<&View> = faces.iter().map(|(_, view)| view).collect();
        let photos =
            load_photos(&views, &LoadOptions { alpha: Some(false), ..LoadOptions::default() }, &|_| ())?.photos;
        for ((face, _), photo) in faces.iter().zip(photos) {
            let name = face_name(face, name);
            write(&folder.images().join(&name), &folder.masks().join(Path::new(&name).with_extension("png")), &photo?)?;
            made.push(name);
        }
        for whole in [file, mask] {
            let _ = fs::remove_file(whole);
        }
    }
    made.sort();
    Ok(made)
}

/// The name of a face of the photo `name`: `front/a.jpg` of `a.jpg`, and `front/a.exr.png` of `a.exr`.
fn face_name(face: &str, name: &str) -> String {
    let is_kept = has_extension(Path::new(name), &JPEG) || has_extension(Path::new(name), &["png"]);
    if is_kept { format!("{face}/{name}") } else { format!("{face}/{name}.png") }
}

/// Writes a face as a JPEG file if its name is that of one, else as a PNG file, and its mask if it has one.
fn write(file: &Path, mask: &Path, photo: &Photo) -> Result<(), Error> {
    let (width, height) = (photo.camera.width, photo.camera.height);
    let unwritten =
        |path: &Path, what: String| Error::Write { path: path.to_owned(), source: std::io::Error::other(what) };
    let make = |path: &Path| match path.parent() {
        Some(parent) => fs::create_dir_all(parent).map_err(|e| unwritten(path, e.to_string())),
        None => Ok(()),
    };
    let pixels = photo.pixels.read().map_err(|e| unwritten(file, e.to_string()))?;
    let rgb: Vec<u8> = pixels.chunks_exact(4).flat_map(|p| [p[0], p[1], p[2]]).collect();
    let rgb = image::RgbImage::from_raw(width, height, rgb).unwrap_or_default();
    make(file)?;
    let written = if has_extension(file, &JPEG) {
        let out = fs::File::create(file).map_err(|e| unwritten(file, e.to_string()))?;
        rgb.write_with_encoder(JpegEncoder::new_with_quality(out, QUALITY))
    } else {
        rgb.save_with_format(file, ImageFormat::Png)
    };
    written.map_err(|e| unwritten(file, e.to_string()))?;
    if photo.alpha_role == AlphaRole::Mask {
        let grey: Vec<u8> = pixels.chunks_exact(4).map(|p| p[3]).collect();
        make(mask)?;
        let grey = image::GrayImage::from_raw(width, height, grey).unwrap_or_default();
        grey.save(mask).map_err(|e| unwritten(mask, e.to_string()))?;
    }
    Ok(())
}

/// The doubt about faces of one panorama that do not share a place, and the remedy.
pub(super) fn apart(scene: &Scene) -> Option<String> {
    let mut places: BTreeMap<&str, Vec<DVec3>> = BTreeMap::new();
    for view in &scene.views {
        // The names of a panorama's faces differ in the first folder alone.
        let (_, panorama) = view.name.split_once('/')?;
        places.entry(panorama).or_default().push(view.camera.centre());
    }
    let distances =
        |faces: &Vec<DVec3>| faces.iter().flat_map(|a| faces.iter().map(move |b| a.distance(*b))).fold(0.0, f64::max);
    let all: Vec<usize> = (0..scene.views.len()).collect();
    let share = places.values().map(distances).fold(0.0, f64::max) / scene.extent(&all);
    (share > APART).then(|| {
        format!(
            "the faces of a panorama lie up to {:.0} % of the cameras' extent apart, though it was taken at one place: these poses are \
             unreliable; install COLMAP 3.12 or newer, which keeps them together, and name a new folder with -o",
            100.0 * share
        )
    })
}

/// The rig whose cameras took the faces.
pub(super) fn rig(folder: &Folder) -> Result<Rig, Error> {
    let sizes = Vec::from_iter(sizes(folder).collect::<BTreeSet<_>>());
    let &[(side, _)] = sizes.as_slice() else {
        return Err(Error::Usage(format!(
            "--panoramas: photos of {} sizes; pose those of one size at a time",
            sizes.len()
        )));
    };
    let half = 0.5 * f64::from(side);
    let lens = [half; 4];
    let camera = |(face, turn): (&str, glam::DMat3)| {
        let q = DQuat::from_mat3(&turn);
        let mut camera = json!({
            "image_prefix": format!("{face}/"), "camera_model_name": "PINHOLE", "camera_params": lens,
        });
        if face == FRONT {
            camera["ref_sensor"] = true.into();
        } else {
            camera["cam_from_rig_rotation"] = json!([q.w, q.x, q.y, q.z]);
            camera["cam_from_rig_translation"] = json!([0.0, 0.0, 0.0]);
        }
        camera
    };
    let cameras: Vec<_> = CUBE.map(|(face, axes)| (face, faces::turn(axes))).map(camera).into();
    let text = format!("{:#}\n", json!([{ "cameras": cameras }]));
    Ok(Rig { text, cameras: CUBE.map(|(face, _)| format!("{face}/")).into(), known: true, lens: Some(lens) })
}
