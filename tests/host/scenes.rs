//! Scenes: formats, folders, splits, photos and errors, on small scenes written here.

mod absent;
mod clouds;
mod dialects;
mod instead;
mod leftovers;
mod lens;
mod masks;
mod panorama;
mod places;
mod shared;
mod traps;
mod units;
mod variants;
mod wide;

use std::fs;
use std::path::{Path, PathBuf};

use crate::support::files::writers::{Model, picture, row, transforms, write, written};
use glam::{DVec2, DVec3};
use qirf_vk::scene::lens::{Curve, LensModel};
use qirf_vk::scene::{AlphaRole, Error, LoadOptions, OpenOptions, Resize, Role, Scene, SceneKind, Split};
use tempfile::TempDir;

/// Intrinsics of a transforms.json whose photos are 64 x 48.
const TOP: &str = r#""fl_x": 50, "fl_y": 51, "w": 64, "h": 48"#;

/// A capture with this transforms.json and pictures of these names.
fn transformed(json: impl Into<Vec<u8>>, pictures: &[&str]) -> TempDir {
    let folder = written([("transforms.json", json.into())]);
    for name in pictures {
        picture(&folder.path().join(name), 64, 48);
    }
    folder
}

fn open(root: &Path) -> Result<Scene, Error> {
    Scene::open(root, &OpenOptions::default())
}

fn open_images(root: &Path, images: &str) -> Result<Scene, Error> {
    Scene::open(root, &OpenOptions { images: Some(PathBuf::from(images)), ..OpenOptions::default() })
}

fn message(result: Result<Scene, Error>) -> String {
    let message = result.expect_err("must be refused").to_string();
    println!("{message}");
    message
}

/// The message with which a path is refused.
fn refused(path: &Path) -> String {
    message(open(path))
}

/// Asserts that a text contains all of these.
fn says(text: &str, parts: &[&str]) {
    for part in parts {
        assert!(text.contains(part), "{text:?} lacks {part:?}");
    }
}

#[test]
fn text_and_binary_give_the_same_scene() {
    let (binary, text) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    write(&binary.path().join("sparse/0"), Model::sample().binary());
    write(&text.path().join("sparse"), Model::sample().text());
    let (binary, text) = (open(binary.path()).unwrap(), open(text.path()).unwrap());
    assert_eq!((binary.kind, text.kind), (SceneKind::ColmapBinary, SceneKind::ColmapText));
    assert_eq!(binary.points, text.points);
    assert_eq!(binary.views.len(), 10);
    for (a, b) in binary.views.iter().zip(&text.views) {
        let mut b = b.clone();
        b.image = a.image.clone();
        assert_eq!(*a, b);
    }
    let sorted = binary.views.is_sorted_by(|a, b| a.name < b.name);
    assert!(sorted && binary.views[0].name == "shelf 0/view91.jpg", "{}", binary.views[0].name);
    assert!(binary.views[0].image.ends_with("images/shelf 0/view91.jpg"));
    // Point 4 of the sample was seen by images 104, 107, 100 and 103: by name views 95, 92, 99 and 96.
    let names: Vec<&str> = binary.points[4].track.iter().map(|&v| binary.views[v as usize].name.as_str()).collect();
    assert_eq!(names, ["shelf 0/view95.jpg", "shelf 0/view99.jpg", "shelf 1/view92.jpg", "shelf 1/view96.jpg"]);
    assert_eq!(binary.points[4].colour, [4, 8, 251]);
}

#[test]
fn every_colmap_model_folder_is_found() {
    for folder in ["", "sparse", "sparse/0", "colmap/sparse/0"] {
        let scene = tempfile::tempdir().unwrap();
        write(&scene.path().join(folder), row(&["a.png"]).text());
        assert_eq!(open(scene.path()).unwrap().views.len(), 1, "{folder}");
    }
    let scene = tempfile::tempdir().unwrap();
    write(&scene.path().join("sparse/0"), row(&["a.png"]).binary());
    picture(&scene.path().join("images/a.png"), 64, 48);
    let mut given_the_model = open(&scene.path().join("sparse/0")).unwrap();
    given_the_model.require_photos().unwrap();
}

#[test]
fn blender_axes_become_ours_and_its_split_is_kept() {
    let scene = tempfile::tempdir().unwrap();
    let top = r#""camera_angle_x": 1.0"#;
    write(
        scene.path(),
        [
            ("transforms_train.json", transforms(top, &["./train/r_0", "./train/r_1"])),
            ("transforms_test.json", transforms(top, &["./test/r_0"])),
        ],
    );
    picture(&scene.path().join("train/r_1.png"), 40, 30);
    let opened = open(scene.path()).unwrap();
    assert_eq!(opened.kind, SceneKind::Blender);
    let names: Vec<_> = opened.views.iter().map(|v| (v.name.as_str(), v.role)).collect();
    assert_eq!(names, [("test/r_0", Role::Test), ("train/r_0", Role::Train), ("train/r_1", Role::Train)]);
    assert_eq!(opened.split(8), Split { train: vec![1, 2], test: vec![0] });
    let camera = &opened.views[2].camera;
    assert_eq!((camera.width, camera.height), (40, 30));
    assert!((camera.focal - DVec2::splat(20.0 / 0.5_f64.tan())).length() < 1e-12);
    assert!((camera.centre() - DVec3::new(2.0, 0.0, 4.0)).length() < 1e-12);
    // OpenGL's camera looks along its -z with y up: a point above and ahead is at negative y and positive z.
    let seen = camera.rotation * DVec3::new(2.0, 1.0, 1.0) + camera.translation;
    assert!((seen - DVec3::new(0.0, -1.0, 3.0)).length() < 1e-12);
    assert!((opened.extent(&[1, 2]) - 1.1).abs() < 1e-12);
    assert_eq!(opened.centre(&[1, 2]), DVec3::new(1.0, 0.0, 4.0));
}

#[test]
fn nerfstudio_splits_intrinsics_and_points() {
    let top = r#""fl_x": 50, "fl_y": 51, "cx": 30, "cy": 25, "w": 64, "h": 48, "k1": 0.1, "camera_model": "OPENCV_FISHEYE",
        "train_filenames": ["images/c.png", "images/a.png"], "val_filenames": ["images/b.png"],
        "test_filenames": [], "ply_file_path": "sparse_pc.ply", "applied_transform": [[1,0,0,0],[0,1,0,0],[0,0,1,0]]"#;
    let ply = b"ply\nformat ascii 1.0\nelement vertex 2\nproperty float x\nproperty float y\nproperty float z\n\
                property uint8 red\nproperty uint8 green\nproperty uint8 blue\nend_header\n1 2 3 4 5 6\nnan 0 0 1 1 1\n";
    let names = ["images/a.png", "images/b.png", "images/c.png"];
    let scene = written([("transforms.json", transforms(top, &names)), ("sparse_pc.ply", ply.to_vec())]);
    let opened = open(scene.path()).unwrap();
    assert_eq!(opened.split(8), Split { train: vec![0, 2], test: vec![1] });
    let lens = opened.views[0].lens;
    assert_eq!((lens.model, lens.distortion.curve), (LensModel::OpenCvFisheye, Curve::Angle));
    assert_eq!(lens.focal, DVec2::new(50.0, 51.0));
    assert_eq!(opened.points.len(), 1);
    assert_eq!((opened.points[0].position, opened.points[0].colour), (DVec3::new(1.0, 2.0, 3.0), [4, 5, 6]));
    assert_eq!(opened.skipped.bad_points, 1);
}

#[test]
fn transforms_find_other_photo_folders_and_masks() {
    let top = r#""fl_x": 50, "w": 64, "h": 48"#;
    let frames = transforms(top, &["images/a.png", ".\\\\images\\\\b.png"]);
    let frames = String::from_utf8(frames).unwrap().replacen("\"file", "\"mask_path\": \"own.png\", \"file", 1);
    let scene = written([("transforms.json", frames.into_bytes())]);
    picture(&scene.path().join("own.png"), 64, 48);
    picture(&scene.path().join("masks/b.png"), 64, 48);
    picture(&scene.path().join("images_2/a.png"), 32, 24);
    picture(&scene.path().join("images_2/b.png"), 32, 24);
    let mut opened = open_images(scene.path(), "images_2").unwrap();
    opened.require_photos().unwrap();
    let names: Vec<_> = opened.views.iter().map(|v| v.name.as_str()).collect();
    assert_eq!(names, ["images/a.png", "images/b.png"]);
    assert!(opened.views.iter().all(|v| v.camera.width == 32 && v.camera.focal.x == 25.0));
    let masks: Vec<_> = opened.views.iter().map(|v| v.mask.clone().unwrap()).collect();
    assert_eq!(masks, [scene.path().join("own.png"), scene.path().join("masks/b.png")]);
    let photo = opened.views[0].load_photo(Resize::Full).unwrap();
    assert_eq!((photo.alpha_role, photo.pixels.len()), (AlphaRole::Mask, 4 * 32 * 24));
    // A file in the folder that is not part of the scene is not mistaken for it.
    says(&message(open(&scene.path().join("own.png"))), &["holds no scene"]);
}

#[test]
fn every_eighth_view_is_test() {
    let names: Vec<String> = (0..17).map(|i| format!("v{i:02}.png")).collect();
    let names: Vec<&str> = names.iter().map(String::as_str).collect();
    let scene = written(row(&names).binary());
    let opened = open(scene.path()).unwrap();
    assert_eq!(opened.split(8).test, [0, 8, 16]);
    assert_eq!(opened.split(8).train.len(), 14);
    assert_eq!(opened.split(0), Split { train: (0..17).collect(), test: vec![] });
    assert_eq!(opened.extent(&opened.split(0).train), 1.1 * 8.0);
}

#[test]
fn missing_misshapen_and_damaged_photos_are_skipped_and_counted() {
    let scene = tempfile::tempdir().unwrap();
    write(&scene.path().join("sparse/0"), row(&["a.png", "b.png", "c.png", "d.jpg", "e.jpg"]).binary());
    let images = scene.path().join("images");
    picture(&images.join("b.png"), 64, 48);
    picture(&images.join("c.png"), 48, 64); // rotated
    picture(&images.join("d.jpg"), 64, 48);
    picture(&images.join("e.jpg"), 64, 48);
    let whole = fs::read(images.join("d.jpg")).unwrap();
    fs::write(images.join("d.jpg"), &whole[..whole.len() - 200]).unwrap();
    let mut opened = open(scene.path()).unwrap();
    assert_eq!(opened.views.len(), 5);
    opened.require_photos().unwrap();
    assert_eq!(opened.views.iter().map(|v| v.name.as_str()).collect::<Vec<_>>(), ["b.png", "d.jpg", "e.jpg"]);
    assert_eq!(opened.points[0].track, [0, 1, 2]);
    let photos = opened.load_photos(&LoadOptions::default(), &|_| {}).unwrap();
    assert_eq!((photos.len(), opened.views.len()), (2, 2));
    assert_eq!(opened.points[0].track, [0, 1]);
    let skipped = &opened.skipped;
    assert_eq!((skipped.missing_images.count, skipped.mismatched_images.count), (1, 1));
    assert_eq!(skipped.damaged_images.examples, ["d.jpg"]);
    says(&skipped.summary().join("\n"), &["1 photo listed but absent (a.png)", "c.png", "1 photo damaged (d.jpg)"]);
    says(
        &skipped.summary().join("\n"),
        &[
            "1 photo of another shape than the camera, 1 of these turned by 90° against its camera (c.png)",
            "c.png is 48 x 64, but its camera in ",
            " is 64 x 48: give the photos that were posed",
        ],
    );
    fs::remove_dir_all(&images).unwrap();
    let error = open(scene.path()).unwrap().require_photos().unwrap_err().to_string();
    says(&error, &["none of the 5 photos", "a.png does not exist"]);
}

#[test]
fn a_folder_of_smaller_photos_rescales_cameras() {
    let scene = tempfile::tempdir().unwrap();
    write(&scene.path().join("sparse/0"), row(&["sub/a.JPG", "b.png"]).text());
    picture(&scene.path().join("images/b.png"), 64, 48);
    picture(&scene.path().join("images_4/sub/a.png"), 16, 12); // not the listed extension
    picture(&scene.path().join("images_4/b.png"), 16, 12);
    picture(&scene.path().join("masks/b.png.png"), 64, 48);
    picture(&scene.path().join("masks_4/sub/a.png"), 16, 12);
    let mut opened = open_images(scene.path(), "images_4").unwrap();
    opened.require_photos().unwrap();
    assert_eq!(opened.views.len(), 2);
    for view in &opened.views {
        assert_eq!((view.camera.width, view.camera.height), (16, 12));
        assert_eq!((view.camera.focal, view.lens.principal), (DVec2::new(12.5, 12.75), DVec2::new(8.0, 6.0)));
    }
    assert!(opened.views[1].mask.as_ref().unwrap().ends_with("masks_4/sub/a.png"));
    assert_eq!(opened.views[0].mask, None); // masks_4 takes precedence over masks, and has no mask for it
    let full = open(scene.path()).unwrap();
    assert!(full.views[0].photo_size == Some((64, 48)));
    says(&message(open_images(scene.path(), "images_9")), &["images_9", "images, images_4, masks"]);
    let path = scene.path().join("images_4");
    assert!(open_images(scene.path(), path.to_str().unwrap()).unwrap().views[0].photo_size == Some((16, 12)));
}

#[test]
fn photos_load_at_the_size_of_their_camera() {
    let scene = tempfile::tempdir().unwrap();
    let mut model = row(&["a.png"]);
    write(&scene.path().join("sparse"), model.binary());
    picture(&scene.path().join("images/a.png"), 64, 48);
    picture(&scene.path().join("masks/a.png"), 32, 24);
    let opened = open(scene.path()).unwrap();
    let view = &opened.views[0];
    assert!(!view.undistorts());
    for resize in [Resize::Full, Resize::Width(10), Resize::Width(900), Resize::Divide(5), Resize::Divide(1000)] {
        let (photo, camera) = (view.load_photo(resize).unwrap(), view.camera_at(resize));
        assert_eq!(photo.pixels.len(), 4 * (camera.width * camera.height) as usize);
        assert_eq!((photo.camera, photo.alpha_role), (camera, AlphaRole::Mask));
    }
    assert_eq!(view.camera_at(Resize::Width(10)).height, 8); // 7.5 rounds up
    let half = view.load_photo(Resize::Divide(2)).unwrap();
    assert_eq!(half.pixels.at(33).unwrap()[0], ((255 * 2 / 64 + 255 * 3 / 64 + 1) / 2) as u8); // pixel (1, 1): columns 2 and 3

    // A distorted lens: each pixel of the undistorted ramp shows the position that it came from.
    model.cameras[0] = (1, LensModel::SimpleRadial, 64, 48, vec![50.0, 32.0, 24.0, -0.2]);
    write(&scene.path().join("sparse"), model.binary());
    let opened = open(scene.path()).unwrap();
    let view = &opened.views[0];
    assert!(view.undistorts() && view.lens.max_displacement() > 2.0);
    for (resize, tolerance) in [(Resize::Full, 3.0), (Resize::Divide(3), 3.0)] {
        let (photo, camera) = (view.load_photo(resize).unwrap(), view.camera_at(resize));
        for y in 0..camera.height {
            for x in 0..camera.width {
                let pixel = DVec2::new(f64::from(x) + 0.5, f64::from(y) + 0.5);
                let source = view.lens.project((pixel - camera.principal) / camera.focal);
                let expected = 255.0 * (source - 0.5) / DVec2::new(64.0, 48.0);
                let [red, green, ..] = photo.pixels.at((y * camera.width + x) as usize).unwrap();
                let found = DVec2::new(f64::from(red), f64::from(green));
                assert!((found - expected).abs().max_element() < tolerance, "{resize:?} {x} {y}: {found} {expected}");
            }
        }
    }
    let plain = OpenOptions { undistort: Some(false), ..OpenOptions::default() };
    let plain = &Scene::open(scene.path(), &plain).unwrap().views[0];
    assert_eq!(plain.camera.focal, DVec2::splat(50.0));
    let [plain, ideal] = [plain, view].map(|v| v.load_photo(Resize::Full).unwrap());
    assert_ne!(plain.pixels.read().unwrap(), ideal.pixels.read().unwrap());
}

#[test]
fn transparency_is_noticed() {
    let scene = written(row(&["a.png"]).binary());
    let path = scene.path().join("images/a.png");
    fs::create_dir_all(path.parent().unwrap()).unwrap();
    image::RgbaImage::from_fn(64, 48, |x, _| image::Rgba([200, 10, 10, if x < 32 { 0 } else { 255 }]))
        .save(&path)
        .unwrap();
    let photo = open(scene.path()).unwrap().views[0].load_photo(Resize::Width(1)).unwrap();
    assert_eq!(photo.alpha_role, AlphaRole::Alpha);
    assert_eq!(*photo.pixels.read().unwrap(), [200, 10, 10, 128]);
}

#[test]
fn photos_without_poses_are_refused() {
    let scene = tempfile::tempdir().unwrap();
    picture(&scene.path().join("images/a.jpg"), 8, 8);
    let root = scene.path().display().to_string();
    says(&message(open(scene.path())), &[&format!("{root}/images has 1 photo, but {root} has no camera poses")]);
    let flat = tempfile::tempdir().unwrap();
    picture(&flat.path().join("a.jpg"), 8, 8);
    says(&message(open(flat.path())), &["has 1 photo, but no camera poses"]);
    let empty = tempfile::tempdir().unwrap();
    says(&message(open(empty.path())), &["sparse/0", "transforms.json", "images"]);
    says(&message(open(&empty.path().join("nowhere"))), &["nowhere", "cannot read"]);
}

/// Opens the sample scene after a change to it.
fn changed(change: impl Fn(&mut Model)) -> (Result<Scene, Error>, Result<Scene, Error>) {
    let folders = [tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap()];
    let mut model = Model::sample();
    change(&mut model);
    write(folders[0].path(), model.binary());
    write(folders[1].path(), model.text());
    (open(folders[0].path()), open(folders[1].path()))
}

#[test]
fn bad_records_are_refused_or_counted() {
    for result in [changed(|m| m.images[3].1[2] = f64::NAN), changed(|m| m.images[3].2[0] = f64::INFINITY)] {
        for scene in [result.0.unwrap(), result.1.unwrap()] {
            assert_eq!((scene.views.len(), scene.skipped.bad_poses.count), (9, 1));
            assert!(scene.skipped.track_entries > 0);
        }
    }
    let (a, b) = changed(|m| m.points[3].0[1] = f64::NAN);
    assert_eq!((a.unwrap().skipped.bad_points, b.unwrap().points.len()), (1, 39));
    let refused = [
        (changed(|m| m.images[2].3 = 999), "refers to camera 999", "image 102"),
        (changed(|m| m.images[4].4 = m.images[2].4.clone()), "listed twice", "view97.jpg"),
        (changed(|m| m.cameras[1].0 = 7), "camera 7 is listed twice", "cameras"),
        (changed(|m| m.images[1].0 = m.images[0].0), "has the id of image", "image 100"),
        (changed(|m| m.cameras.iter_mut().for_each(|c| c.2 = 0)), "image size 0 x 480", "cameras"),
        (changed(|m| m.cameras.iter_mut().for_each(|c| c.4[0] = f64::NAN)), "focal lengths NaN", "cameras"),
        (changed(|m| m.images.clear()), "no usable view", "images"),
    ];
    for ((a, b), what, place) in refused {
        says(&message(a), &[what, place]);
        says(&message(b), &[what, place]);
    }
}

#[test]
fn unknown_models_and_truncation_name_file_and_record() {
    let scene = tempfile::tempdir().unwrap();
    let [cameras, images, points] = row(&["a.png"]).binary();
    let with_model = |number: u8| {
        let mut bytes = cameras.1.clone();
        bytes[12] = number;
        write(scene.path(), [("cameras.bin", bytes), images.clone(), points.clone()]);
        message(open(scene.path()))
    };
    says(&with_model(99), &["cameras.bin", "camera 1 of 1", "number 99", "EQUIRECTANGULAR"]);
    for (name, bytes) in row(&["a.png"]).binary() {
        write(scene.path(), row(&["a.png"]).binary());
        fs::write(scene.path().join(name), &bytes[..bytes.len() - 3]).unwrap();
        says(&message(open(scene.path())), &[name, "cut short"]);
        let mut claims = bytes.clone();
        claims[..8].copy_from_slice(&u64::MAX.to_le_bytes());
        fs::write(scene.path().join(name), claims).unwrap();
        says(&message(open(scene.path())), &[name, "claims 18446744073709551615 entries"]);
        fs::write(scene.path().join(name), [bytes, vec![0; 5]].concat()).unwrap();
        says(&message(open(scene.path())), &[name, "5 bytes follow"]);
    }
    let mut files = row(&["a.png"]).text();
    files[0].1 = b"# one\n1 FISHY 64 48 50\n".to_vec();
    let text = written(files);
    says(&message(open(text.path())), &["cameras.txt", "line 2", "FISHY", "SIMPLE_PINHOLE"]);
    let mut files = row(&["a.png", "b.png"]).text();
    files[1].1 = b"1 1 0 0 0 0 0 0 1 a.png\n2 1 0 0 0 1 0 0 1 b.png\n".to_vec(); // no lines of 2D points
    write(text.path(), files);
    says(&message(open(text.path())), &["images.txt", "line 2", "two lines"]);
}

#[test]
fn transforms_faults_name_the_frame() {
    let scene = tempfile::tempdir().unwrap();
    let attempt = |json: &str| {
        write(scene.path(), [("transforms.json", json.as_bytes().to_vec())]);
        open(scene.path())
    };
    let pose = "[[1,0,0,0],[0,1,0,0],[0,0,1,0],[0,0,0,1]]";
    let frame = |extra: &str| format!(r#"{{"file_path": "a.png", "transform_matrix": {pose}{extra}}}"#);
    let size = r#""fl_x": 50, "w": 64, "h": 48"#;
    says(&message(attempt("{\n\"frames\": [NAN]}")), &["line 2", "not JSON"]);
    says(&message(attempt("{}")), &["frames"]);
    says(&message(attempt(&format!("{{{size}, \"frames\": [{{\"file_path\": 3}}]}}"))), &["frame 1"]);
    says(&message(attempt(&format!("{{\"fl_x\": 50, \"frames\": [{}]}}", frame("")))), &["frame 1", "neither w nor h"]);
    says(&message(attempt(&format!("{{\"w\": 6, \"h\": 4, \"frames\": [{}]}}", frame("")))), &["fl_x"]);
    let fishy = frame(r#", "camera_model": "FISHY""#);
    says(&message(attempt(&format!("{{{size}, \"frames\": [{fishy}]}}"))), &["frame 1", "FISHY"]);
    let mirrored = frame("").replace("[[1,", "[[-1,");
    let text = message(attempt(&format!("{{{size}, \"frames\": [{mirrored}]}}")));
    says(&text, &["no usable view", "1 view without a usable pose (a.png)"]);
    let twice = attempt(&format!("{{{size}, \"frames\": [{}, {}]}}", frame(""), frame(""))).unwrap();
    assert_eq!((twice.views.len(), twice.skipped.repeated_views.count), (1, 1));
    let cameras = [frame(""), frame(r#", "fl_x": 60"#).replace("a.png", "b.png")].join(",");
    let two = attempt(&format!("{{{size}, \"frames\": [{cameras}]}}")).unwrap();
    assert_eq!((two.views[0].camera_id, two.views[1].camera_id), (0, 1));
    assert_eq!(two.views[1].camera.focal, DVec2::splat(60.0));
}
