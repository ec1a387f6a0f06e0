//! Where captures lie, and what else transforms files are called and hold: each as the plain one, or an error with a way out.

use std::fs;
use std::path::Path;

use super::{TOP, open, refused, transformed};
use crate::support::files::writers::{picture, row, transforms, write};
use qirf_vk::scene::{Error, Role, Scene};

const NAMES: [&str; 2] = ["images/a.png", "images/b.png"];

fn photos(folder: &Path) {
    for name in ["a.png", "b.png"] {
        picture(&folder.join(name), 64, 48);
    }
}

/// Makes a capture in a folder.
type Make<'a> = &'a dyn Fn(&Path);

/// A capture of two photos with this transforms.json.
fn with(json: Vec<u8>) -> tempfile::TempDir {
    transformed(json, &NAMES)
}

fn text(json: &str, from: &str, to: &str) -> Vec<u8> {
    assert!(json.contains(from), "{from}");
    json.replace(from, to).into_bytes()
}

#[test]
fn transforms_of_many_hands_mean_the_same() {
    let plain = String::from_utf8(transforms(TOP, &NAMES)).unwrap();
    let expected = open(with(plain.clone().into_bytes()).path()).unwrap();
    let wide: Vec<u8> = [0xfeff].into_iter().chain(plain.encode_utf16()).flat_map(u16::to_le_bytes).collect();
    let big: Vec<u8> = [0xfeff].into_iter().chain(plain.encode_utf16()).flat_map(u16::to_be_bytes).collect();
    let flat = plain.replace("[[", "[").replace("]]", "]").replace("],[", ",");
    for (what, json) in [
        ("fx and width", text(&plain, TOP, r#""fx": 50, "fy": 51, "width": 64, "height": 48"#)),
        ("both names", text(&plain, TOP, &format!(r#"{TOP}, "fx": 50, "width": 64"#))),
        ("a model in small letters", text(&plain, TOP, &format!(r#"{TOP}, "camera_model": "opencv""#))),
        ("PERSPECTIVE", text(&plain, TOP, &format!(r#"{TOP}, "camera_model": "PERSPECTIVE""#))),
        ("UTF-16", wide),
        ("UTF-16, the other way round", big),
        ("matrices in one list", flat.into_bytes()),
        ("matrices of strings", text(&plain, "[0,1,0,0],[0,0,1,4]", r#"["0","1.0","0","0e0"],["0","0"," 1 ","4"]"#)),
        ("matrices of three rows", text(&plain, ",[0,0,0,1]", "")),
        ("a rolling shutter", text(&plain, "transform_matrix", "transform_matrix_start")),
        ("escaped names", text(&plain, "images/a", "imag%65s/%61")),
        ("NaN elsewhere", text(&plain, TOP, &format!(r#"{TOP}, "aabb": [NaN, -Infinity], "note": "NaN""#))),
    ] {
        let folder = with(json);
        let got = open(folder.path()).unwrap();
        let cameras = |scene: &Scene| scene.views.iter().map(|v| v.camera.clone()).collect::<Vec<_>>();
        assert_eq!(cameras(&got), cameras(&expected), "{what}");
        assert!(got.views.iter().all(|view| view.image.is_file()), "{what}");
    }
}

#[test]
fn frames_are_held_out_or_left_out_as_their_file_says() {
    let plain = String::from_utf8(transforms(TOP, &NAMES)).unwrap();
    let at = plain.find(",\n").unwrap();
    let two = format!("{}], \"test_frames\": [{}", &plain[..at], &plain[at + 1..]);
    let scene = open(with(two.into_bytes()).path()).unwrap();
    assert_eq!(scene.views.iter().map(|v| v.role).collect::<Vec<_>>(), [Role::Train, Role::Test]);
    assert_eq!(scene.split(8).test, [1]);

    let bad = text(&plain, r#""images/a.png","#, r#""images/a.png", "is_bad": true,"#);
    let scene = open(with(bad).path()).unwrap();
    assert_eq!(scene.views.len(), 1);
    assert!(scene.skipped.summary().join(" ").contains("1 frame that the file calls bad"), "{:?}", scene.skipped);

    // A pose with NaN is left out, the others stay.
    let scene = open(with(text(&plain, "[1,0,0,0]", "[1,0,0,NaN]")).path()).unwrap();
    assert_eq!((scene.views.len(), scene.skipped.bad_poses.count), (1, 1));
}

#[test]
fn smaller_copies_stand_for_photos_that_are_not_there() {
    let folder = tempfile::tempdir().unwrap();
    photos(&folder.path().join("images_4"));
    let top = r#""fl_x": 200, "fl_y": 204, "w": 256, "h": 192"#;
    write(folder.path(), [("transforms.json", transforms(top, &NAMES))]);
    let scene = open(folder.path()).unwrap();
    assert_eq!(scene.views[0].camera.focal.to_array(), [50.0, 51.0]);
    assert!(scene.views.iter().all(|view| view.image.is_file()));
}

#[test]
fn angles_in_degrees_and_other_files_are_named() {
    let degrees = transforms(r#""camera_angle_x": 34.2"#, &NAMES);
    assert!(refused(with(degrees).path()).contains("34.2 is not an angle of view in radians"));
    let other = with(br#"[{"cameras": {}, "shots": {}}]"#.to_vec());
    assert!(refused(other.path()).contains("has no list \"frames\""));
    let exported =
        with(br#"[{"file_path": "a.png", "transform": [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0]]}]"#.to_vec());
    assert!(refused(exported.path()).contains("`ns-export cameras` writes it"), "{}", refused(exported.path()));
    // The field is named, whether it is no number at all or one that JSON does not know.
    for (field, value) in [("k1", "\"0.1\""), ("cx", "NaN"), ("fl_x", "Infinity"), ("distortion_params[1]", "[0, {}]")]
    {
        let name = field.split('[').next().unwrap();
        let top = format!(r#"{}, "{name}": {value}"#, TOP.replacen("fl_x", "fx", 1));
        let said = refused(with(transforms(&top, &NAMES)).path());
        assert!(said.contains(&format!("{field}: invalid type")), "{said}");
    }
}

#[test]
fn a_capture_is_found_in_the_one_folder_that_holds_it() {
    let colmap = |root: &Path| write(root, row(&["a.png", "b.png"]).text());
    let capture = |root: &Path, model: &str, images: &str| {
        colmap(&root.join(model));
        photos(&root.join(images));
    };
    let layouts: [(&str, &str, Make<'_>); 8] = [
        ("unpacked", "no poses in", &|root| capture(root, "scan/sparse/0", "scan/images")),
        ("a workspace of COLMAP without the first photos", "the undistorted photos of dense/0", &|root| {
            colmap(&root.join("sparse/0"));
            capture(root, "dense/0/sparse", "dense/0/images");
            capture(root, "dense/1/sparse", "dense/1/images");
        }),
        ("the same, undistorted by hand", "the undistorted photos of dense", &|root| {
            colmap(&root.join("sparse/0"));
            capture(root, "dense/sparse", "dense/images");
        }),
        ("an undistorted workspace", "no poses in", &|root| capture(root, "dense/sparse", "dense/images")),
        ("one of several undistorted ones", "no poses in", &|root| capture(root, "dense/0/sparse", "dense/0/images")),
        ("a conversion that ended early", "", &|root| capture(root, "distorted/sparse/0", "input")),
        ("hloc", "no poses in", &|root| capture(root, "sfm", "images")),
        ("ScanNet++", "no poses in", &|root| {
            write(root, [("nerfstudio/transforms.json", transforms(TOP, &["a.png", "b.png"]))]);
            photos(&root.join("resized_images"));
        }),
    ];
    for (what, note, make) in layouts {
        let folder = tempfile::tempdir().unwrap();
        make(folder.path());
        let scene = open(folder.path()).unwrap();
        let found = scene.views.iter().filter(|view| view.image.is_file()).count();
        assert_eq!((scene.views.len(), found), (2, 2), "{what}");
        assert!(scene.skipped.summary().join("\n").contains(note), "{what}: {:?}", scene.skipped);
    }
}

#[test]
fn several_captures_are_named_and_results_are_none() {
    let folder = tempfile::tempdir().unwrap();
    let at = |name: &str| folder.path().join(name);
    for name in ["one", "two", "made"] {
        write(&at(name).join("sparse/0"), row(&["a.png", "b.png"]).text());
        photos(&at(name).join("images"));
    }
    fs::write(at("made/pose.json"), "{}").unwrap();
    assert!(refused(folder.path()).ends_with("holds 2 scenes: one, two"));
    fs::remove_dir_all(at("two")).unwrap();
    assert_eq!(open(folder.path()).unwrap().views.len(), 2);
    fs::remove_dir_all(at("one")).unwrap();
    assert!(matches!(open(folder.path()).unwrap_err(), Error::NoScene { .. }));
}

#[test]
fn a_model_that_lacks_a_file_is_named() {
    let folder = tempfile::tempdir().unwrap();
    photos(&folder.path().join("images"));
    write(&folder.path().join("sparse/0"), row(&["a.png"]).text());
    fs::remove_file(folder.path().join("sparse/0/images.txt")).unwrap();
    assert!(refused(folder.path()).contains("has cameras.bin or .txt, but no images.bin or .txt"));
}
