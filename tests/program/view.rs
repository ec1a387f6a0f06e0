//! `view`: what it serves, to whom, and what a browser makes of it.

mod live;
mod load;
mod mutations;
mod page;
mod pictures;
mod refusals;
mod session;
mod speed;

use super::compress::ball;
use super::ended::{copy, qirf, works};
use qirf_vk::gaussians::formats::{self, RenderMode};
use qirf_vk::glam::DVec3;
use qirf_vk::synth::{SynthOptions, write};
use qirf_vk::view::protocol::Figure;
use serde_json::json;
use session::{Viewer, pose, request};
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::OnceLock;
use tempfile::TempDir;

/// Five photos of 64 x 48, and a model of their points, made once.
pub fn scene() -> &'static Path {
    static MADE: OnceLock<(TempDir, PathBuf)> = OnceLock::new();
    let made = MADE.get_or_init(|| {
        let folder = tempfile::tempdir().unwrap();
        let scene = folder.path().join("scene");
        let options = SynthOptions { views: 5, width: 64, height: 48, points: 500, ..SynthOptions::default() };
        write(&scene, &options, &|_| ()).expect("a synthetic scene");
        let points = qirf_vk::scene::Scene::open(&scene, &qirf_vk::scene::OpenOptions::default()).unwrap().points;
        let seeds: Vec<_> = points.iter().map(qirf_vk::train::initialise::Seed::from).collect();
        let mut model = qirf_vk::train::initialise::from_points(&seeds);
        model.opacity_logits.fill(3.0);
        formats::write(&folder.path().join("model.ply"), &model, RenderMode::default()).unwrap();
        model.sh[0].iter_mut().for_each(|c| *c *= 0.5);
        formats::write(&folder.path().join("other.ply"), &model, RenderMode::default()).unwrap();
        (folder, scene)
    });
    &made.1
}

/// A file beside the scene.
pub fn beside(name: &str) -> String {
    scene().with_file_name(name).display().to_string()
}

/// The model in a file of this folder whose means count from the local origin (x, 0, 0).
fn counted_from(x: f64, folder: &Path) -> String {
    let path = folder.join(format!("from_{x}.ply"));
    let mut model = formats::read(Path::new(&beside("model.ply"))).unwrap().gaussians;
    model.shift(DVec3::new(-x, 0.0, 0.0));
    formats::write_at(&path, &model, RenderMode::default(), [x, 0.0, 0.0]).unwrap();
    path.display().to_string()
}

/// A viewer of the model with the scene's photos.
fn viewer(more: &[&str]) -> Viewer {
    let (model, scene) = (beside("model.ply"), scene().display().to_string());
    Viewer::start(&[&["view", &model, "--scene", &scene], more].concat())
}

/// What `render` makes of the model at the photos' cameras.
fn rendered() -> TempDir {
    let out = tempfile::tempdir().unwrap();
    works(qirf(["render", &beside("model.ply"), "--scene"]).args([scene(), "-o".as_ref(), out.path()]));
    out
}

#[test]
fn a_still_picture_is_the_file_that_render_writes() {
    let out = rendered();
    let viewer = viewer(&[]);
    let description = viewer.json("/scene.json");
    let cameras = description["cameras"].as_array().unwrap();
    assert_eq!((cameras.len(), description["models"][0]["name"].as_str()), (5, Some("model.ply")));
    let mut socket = viewer.socket();
    for (n, camera) in cameras.iter().enumerate() {
        let (header, bytes) = socket.picture(&request(n as u32, &format!(r#"{{"photo":{n}}}"#), r#""still":true"#));
        let file = out.path().join(camera["name"].as_str().unwrap()).with_extension("png");
        assert_eq!(bytes, fs::read(file).unwrap(), "photo {n}");
        assert_eq!((header.number, header.size, header.reduced), (n as u32, [64, 48], false));
    }
}

#[test]
fn every_kind_of_picture_is_drawn() {
    let other = beside("other.ply");
    let viewer = viewer(&["--against", &other]);
    let mut socket = viewer.socket();
    let mut seen = Vec::new();
    for (n, kind) in ["colour", "depth", "alpha", "blocks", "error", "count"].into_iter().enumerate() {
        let still = format!(r#""picture":"{kind}","still":true"#);
        let (header, bytes) = socket.picture(&request(n as u32, r#"{"photo":1}"#, &still));
        let picture = image::load_from_memory(&bytes).unwrap().into_rgb8();
        assert_eq!(matches!(header.figure, Figure::Psnr(_)), kind == "error");
        assert_eq!(matches!(header.figure, Figure::Blended(_)), kind == "count");
        assert!(picture.pixels().any(|p| p != picture.get_pixel(0, 0)), "{kind} is one colour");
        assert!(!seen.contains(&bytes), "{kind} looks like another");
        seen.push(bytes);
        // Moving colours are a JPEG of nearly the same; false colours stay lossless.
        let (_, moving) = socket.picture(&request(100 + n as u32, r#"{"photo":1}"#, &format!(r#""picture":"{kind}""#)));
        assert_eq!(moving[..2] == [0xff, 0xd8], kind == "colour");
        let moving = image::load_from_memory(&moving).unwrap().into_rgb8();
        let apart: f64 = picture.iter().zip(moving.iter()).map(|(a, b)| f64::from(a.abs_diff(*b))).sum();
        assert!(apart / (picture.len() as f64) < if kind == "colour" { 12.0 } else { 1e-9 }, "{kind}: {apart}");
    }
    // From elsewhere, an error picture compares the two models; from the second model's side it is the same.
    let of = |model: u32| pose(&format!(r#""picture":"error","still":true,"model":{model}"#), model + 7);
    let [first, second] = [0, 1].map(|m| socket.picture(&of(m)));
    assert_eq!(first.1, second.1);
    assert!(matches!(first.0.figure, Figure::Psnr(db) if db > 0.0), "{:?}", first.0.figure);
}

#[test]
fn models_with_local_origins_lie_in_one_world() {
    let folder = tempfile::tempdir().unwrap();
    let [first, second] = [2.0, 12.0].map(|x| counted_from(x, folder.path()));
    let viewer = Viewer::start(&["view", &first, "--against", &second]);
    let description = viewer.json("/scene.json");
    let shifts = [0_usize, 1].map(|m| description["models"][m]["shift"].clone());
    assert_eq!(shifts, [json!([0.0, 0.0, 0.0]), json!([10.0, 0.0, 0.0])]);
    let (header, _) = viewer.socket().picture(&pose(r#""picture":"error","still":true"#, 1));
    assert!(matches!(header.figure, Figure::Psnr(db) if db > 50.0), "{:?}", header.figure);
    let viewer = Viewer::start(&["view", &second, "--scene", &scene().display().to_string()]);
    let description = viewer.json("/scene.json");
    assert_eq!((&description["models"][0]["shift"], &description["unit"]), (&json!([12.0, 0.0, 0.0]), &json!(1.0)));
}

/// The first view is its photo's, also where the principal point lies beside the picture's middle.
#[test]
fn the_first_view_is_that_of_its_photo() {
    let folder = tempfile::tempdir().unwrap();
    copy(scene(), folder.path());
    fs::write(folder.path().join("sparse/0/cameras.txt"), "1 PINHOLE 64 48 60 60 39 17\n").unwrap();
    let viewer = Viewer::start(&["view", &beside("model.ply"), "--scene", &folder.path().display().to_string()]);
    let description = viewer.json("/scene.json");
    let first = description["cameras"].as_array().unwrap().iter().position(|c| c["held_out"] == true).unwrap();
    let mut socket = viewer.socket();
    let [free, photo] = [json!({ "pose": description["start"] }), json!({ "photo": first })].map(|camera| {
        let (_, bytes) = socket.picture(&request(1, &camera.to_string(), r#""still":true"#));
        image::load_from_memory(&bytes).unwrap().into_rgb8()
    });
    let most = free.iter().zip(photo.iter()).map(|(a, b)| a.abs_diff(*b)).max();
    assert!(most.is_some_and(|most| most <= 2), "{most:?}");
}

#[test]
fn an_up_axis_is_the_users_or_that_of_the_photos() {
    let up = |more: &[&str]| viewer(more).json("/scene.json")["up"].clone();
    assert_eq!(up(&["--up", "z"]), json!([0.0, 0.0, 1.0]));
    assert_eq!(up(&["--up", "auto"]), up(&[]));
}

#[test]
fn the_newest_wish_wins_and_two_frames_are_in_flight_at_most() {
    let viewer = viewer(&[]);
    let mut socket = viewer.socket();
    socket.send(&pose("", 0));
    let first = socket.frame().unwrap();
    for number in 1..500 {
        socket.send(&pose("", number));
    }
    // Nothing is acknowledged: a second frame comes, and no third.
    let frames = [first, socket.frame().unwrap()];
    assert!(frames[0].0.number == 0 && frames[1].0.number > 0);
    assert!(socket.frame_within(std::time::Duration::from_millis(400)).is_none());
    socket.send(r#"{"shown":0}"#);
    let last = match frames[1].0.number {
        499 => frames[1].0.number,
        _ => socket.frame().unwrap().0.number,
    };
    assert_eq!(last, 499, "the last request is fulfilled");
}

#[test]
fn a_capture_alone_shows_its_points_and_a_run_its_scores() {
    let viewer = Viewer::start(&["view", &scene().display().to_string()]);
    let description = viewer.json("/scene.json");
    assert_eq!(description["models"][0]["name"], "points");
    assert!(description["models"][0]["gaussians"].as_u64().unwrap() > 100);
    let photo = viewer.get("/photo/2");
    assert_eq!((photo.0, image::load_from_memory(&photo.1).unwrap().width()), (200, 64));
    drop(viewer);

    let out = tempfile::tempdir().unwrap();
    let mut run = qirf(["run".as_ref(), scene(), "-o".as_ref(), out.path()]);
    works(run.args(["--iterations", "20", "--grow-to", "500"]));
    let viewer = Viewer::start(&["view", &out.path().display().to_string()]);
    let description = viewer.json("/scene.json");
    let cameras = description["cameras"].as_array().unwrap();
    let scored: Vec<_> = cameras.iter().filter(|c| c["psnr"].is_number()).collect();
    assert_eq!((cameras.len(), scored.len(), scored[0]["held_out"].as_bool()), (5, 1, Some(true)));
}

#[test]
fn a_capture_without_points_shows_its_cameras() {
    let folder = tempfile::tempdir().unwrap();
    copy(scene(), folder.path());
    fs::write(folder.path().join("sparse/0/points3D.txt"), "").unwrap();
    let viewer = Viewer::start(&["view", &folder.path().display().to_string()]);
    let description = viewer.json("/scene.json");
    let cameras = description["cameras"].as_array().unwrap().len();
    assert_eq!((&description["models"][0]["gaussians"], cameras), (&json!(0), 5));
    viewer.socket().picture(&pose("", 1));
}

#[test]
fn levels_of_detail_are_a_model_and_no_scene() {
    let folder = tempfile::tempdir().unwrap();
    let meta = folder.path().join("lod-meta.json");
    formats::write_levels(&meta, &[ball()], (RenderMode::Plain, [0.0; 3])).unwrap();
    for place in [folder.path(), &meta] {
        let description = Viewer::start(&["view", &place.display().to_string()]).json("/scene.json");
        assert_eq!(description["models"][0]["gaussians"], ball().len());
    }
}

#[test]
fn ctrl_c_tells_the_page_and_ends_well() {
    let viewer = viewer(&[]);
    let mut socket = viewer.socket();
    socket.picture(&pose("", 1));
    let ended = viewer.interrupt();
    assert_eq!(ended, Some(0));
    assert_eq!(socket.goodbye(), "qirf-vk has ended");
}
