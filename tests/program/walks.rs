//! `render --path` and `render --panorama`: frames on a path, films, pictures of all directions.

use super::cli::Sandbox;
use crate::support::skip;
use std::fs;
use std::process::{Command, Stdio};

fn frames(sandbox: &Sandbox, folder: &str) -> Vec<String> {
    let mut names: Vec<String> =
        fs::read_dir(sandbox.path(folder)).unwrap().flatten().map(|e| e.file_name().display().to_string()).collect();
    names.sort();
    names
}

#[test]
fn frames_follow_a_path() {
    let sandbox = Sandbox::new();
    let ran =
        sandbox.works(&["render", "model.ply", "--path", "orbit", "--frames", "3", "--size", "40x30", "-o", "round"]);
    assert!(ran.said.contains("3 pictures"), "{}", ran.said);
    assert_eq!(frames(&sandbox, "round"), ["frame_0000.png", "frame_0001.png", "frame_0002.png"]);
    // Fewer frames leave those of the longer path, and say so.
    fs::write(sandbox.path("round/frame_x.png"), "").unwrap();
    let ran =
        sandbox.works(&["render", "model.ply", "--path", "orbit", "--frames", "2", "--size", "40x30", "-o", "round"]);
    assert!(
        ran.said.contains("round also has 1 picture of an earlier path or orbit, from frame_0002.png"),
        "{}",
        ran.said
    );
    sandbox.works(&["render", "model.ply", "--path", "orbit", "--frames", "3", "--size", "40x30", "-o", "round"]);
    // An orbit is an orbit.
    sandbox.works(&["render", "model.ply", "--orbit", "3", "--size", "40x30", "-o", "orbit"]);
    let bytes = |name: &str| fs::read(sandbox.path(name)).unwrap();
    assert_eq!(bytes("round/frame_0001.png"), bytes("orbit/orbit_001.png"));

    let along = ["render", "model.ply", "--path", "capture", "--scene", "scene", "--frames", "4", "-o", "along"];
    sandbox.validated(&along);
    assert_eq!(frames(&sandbox, "along").len(), 4);
    // The path begins at the first camera and ends at the last.
    sandbox.works(&["render", "model.ply", "--scene", "scene", "-o", "views"]);
    assert_eq!(bytes("along/frame_0000.png"), bytes("views/b/two.png"));
    assert_eq!(bytes("along/frame_0003.png"), bytes("views/one.png"));

    let keys =
        r#"{"keys": [{"eye": [0, 0, -4], "target": [0, 0, 0]}, {"eye": [4, 0, 0], "target": [0, 0, 0], "fov": 50}]}"#;
    fs::write(sandbox.path("keys.json"), keys).unwrap();
    sandbox.works(&["render", "model.ply", "--path", "keys.json", "--frames", "2", "--size", "40x30", "-o", "keyed"]);
    assert_eq!(frames(&sandbox, "keyed").len(), 2);
    // Small models too: the near plane follows the model.
    sandbox.works(&["edit", "model.ply", "-o", "small.ply", "--scale", "0.001"]);
    fs::write(sandbox.path("near.json"), r#"{"keys": [{"eye": [0, 0, -0.004], "target": [0, 0, 0]}]}"#).unwrap();
    sandbox.works(&["render", "small.ply", "--path", "near.json", "--frames", "1", "--size", "40x30", "-o", "small"]);
    let picture = |name: &str| image::open(sandbox.path(name)).unwrap().into_rgb8();
    let pairs = picture("small/frame_0000.png").into_raw().into_iter().zip(picture("keyed/frame_0000.png").into_raw());
    assert!(pairs.into_iter().all(|(a, b)| a.abs_diff(b) <= 1));
    let posed = r#"{"camera_path": [{"camera_to_world": [1,0,0,0, 0,-1,0,0, 0,0,-1,-4, 0,0,0,1], "fov": 40}]}"#;
    fs::write(sandbox.path("posed.json"), posed).unwrap();
    sandbox.works(&["render", "model.ply", "--path", "posed.json", "--size", "40x30", "-o", "posed"]);
    // The same camera as the first key of the other file.
    assert_eq!(bytes("posed/frame_0000.png"), bytes("keyed/frame_0000.png"));
}

#[test]
fn a_panorama_shows_all_directions() {
    let sandbox = Sandbox::new();
    let around = ["render", "model.ply", "--panorama", "--at", "0,0,0", "--size", "64x32", "-o", "around.png"];
    sandbox.validated(&around);
    let picture = image::open(sandbox.path("around.png")).unwrap().into_rgb8();
    assert_eq!(picture.dimensions(), (64, 32));
    // The model's Gaussians lie in a ring round the origin, in the plane z = 0: to the left, above, to the right, below.
    let light = |x: u32, y: u32| picture.get_pixel(x, y).0.iter().map(|v| u32::from(*v)).sum::<u32>();
    assert!(light(16, 16) > 100 && light(48, 16) > 100, "{} {}", light(16, 16), light(48, 16));
    sandbox.works(&["render", "model.ply", "--panorama", "--scene", "scene", "--size", "32x16", "-o", "scene.npy"]);
    assert!(sandbox.path("scene.npy").is_file());
}

#[test]
fn walks_that_make_no_sense_are_refused() {
    let sandbox = Sandbox::new();
    fs::write(sandbox.path("bad.json"), "{}").unwrap();
    let before = sandbox.content();
    let fails = |code: i32, options: &[&str], says: &[&str]| {
        sandbox.fails(code, &[&["render", "model.ply"], options].concat(), says);
    };
    fails(2, &["--path", "capture", "-o", "o"], &["--scene"]);
    fails(2, &["--path", "orbit", "--scene", "scene", "-o", "o"], &["--path capture"]);
    fails(2, &["--path", "orbit", "--orbit", "3", "-o", "o"], &["--orbit"]);
    fails(2, &["--orbit", "3", "--scene", "scene", "-o", "o"], &["cannot be used with"]);
    fails(2, &["--scene", "scene", "--size", "9x9", "-o", "o"], &["--resolution"]);
    fails(2, &["--orbit", "3", "-o", "walk.mp4"], &["a film needs --path"]);
    fails(2, &["--path", "orbit", "--format", "npy", "-o", "walk.mp4"], &["film"]);
    fails(2, &["--path", "orbit", "--fps", "0", "-o", "walk.mp4"], &["frames per second"]);
    fails(2, &["--panorama", "-o", "around.jpg"], &["around.jpg", ".png or, without --transparent, as .npy"]);
    fails(2, &["--panorama", "--at", "1,2", "-o", "around.png"], &["x,y,z"]);
    fails(2, &["--panorama", "--size", "20000x10000", "-o", "around.png"], &["16384"]);
    fails(2, &["--frames", "3", "--orbit", "3", "-o", "o"], &["--path"]);
    // Options without effect.
    fails(2, &["--panorama", "--size", "200x200", "-o", "around.png"], &["--size", "twice as wide as high"]);
    fails(2, &["--panorama", "--format", "npy", "-o", "around.png"], &["around.png", "--format"]);
    for option in [["--fov", "60"], ["--elevation", "5"], ["--resolution", "50"], ["--images", "images"]] {
        fails(2, &[&["--panorama", "-o", "around.png"], &option[..]].concat(), &[option[0]]);
    }
    for option in [["--resolution", "50"], ["--images", "images"]] {
        fails(2, &[&["--path", "orbit", "-o", "o"], &option[..]].concat(), &["--scene"]);
    }
    fails(2, &["--path", "bad.json", "--elevation", "5", "-o", "o"], &["--elevation"]);
    for name in ["walk.webm", "walk.PNG"] {
        fails(2, &["--path", "orbit", "-o", name], &[name, ".mp4", "a folder"]);
    }
    fails(3, &["--path", "absent.json", "-o", "o"], &["absent.json"]);
    fails(3, &["--path", "bad.json", "-o", "o"], &["bad.json", "neither"]);
    assert_eq!(sandbox.content(), before, "nothing was written or changed");
}

#[test]
fn a_film_needs_ffmpeg() {
    let sandbox = Sandbox::new();
    let film = ["render", "model.ply", "--path", "orbit", "--frames", "6", "--size", "41x31", "-o", "walk.mp4"];
    let there = Command::new("ffmpeg").arg("-version").stdout(Stdio::null()).stderr(Stdio::null()).status();
    if there.is_ok_and(|status| status.success()) {
        sandbox.works(&film);
        let bytes = fs::read(sandbox.path("walk.mp4")).unwrap();
        assert_eq!(&bytes[4..8], b"ftyp");
    } else {
        let before = sandbox.content();
        sandbox.fails(2, &film, &["ffmpeg", "install"]);
        assert_eq!(sandbox.content(), before, "nothing was drawn");
        skip("no ffmpeg");
    }
}
