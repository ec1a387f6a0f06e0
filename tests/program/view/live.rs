//! Training that is watched: its bytes are its own, and a page can hold and end it.

use super::session::{Socket, Viewer, request};
use super::{beside, scene};
use crate::program::ended::{copy, rescale};
use crate::program::faults::harness::{content, end, program, run, undisturbed, validated};
use serde_json::Value;
use std::path::Path;
use std::time::{Duration, Instant};

/// A watched run, validated: the painter's work comes between that of the training.
fn watched(out: &Path) -> Viewer {
    let mut command = run(out, &["--view"]);
    validated(&mut command);
    Viewer::of(command)
}

/// A request from a camera of the scene that has turned by some steps.
pub fn turned(step: u32, still: bool) -> String {
    let (sin, cos) = (0.05 * f64::from(step)).sin_cos();
    let camera = format!(r#"{{"pose":{{"position":[0,-1,-6],"rotation":[{cos},0,{sin},0],"fov":0.9}}}}"#);
    request(step, &camera, &format!(r#""still":{still}"#))
}

/// Waits for news of the run that are as wanted.
fn news(socket: &mut Socket, wanted: impl Fn(&Value) -> bool) -> Value {
    let begun = Instant::now();
    loop {
        assert!(begun.elapsed() < Duration::from_secs(60), "no such news");
        match socket.frame() {
            Ok(_) => socket.send(r#"{"shown":0}"#),
            Err(text) => {
                let said: Value =
                    serde_json::from_str(&text).unwrap_or_else(|_| panic!("the run went on without us: {text}"));
                if wanted(&said) {
                    return said;
                }
            }
        }
    }
}

#[test]
fn who_watches_changes_no_byte() {
    let alone = tempfile::tempdir().unwrap();
    let viewer = watched(alone.path());
    assert_eq!(viewer.wait(), Some(0));
    assert_eq!(std::fs::read(alone.path().join("model.ply")).unwrap(), undisturbed(), "with nobody there");

    let seen_from = tempfile::tempdir().unwrap();
    let viewer = watched(seen_from.path());
    let mut socket = viewer.socket();
    socket.send(r#"{"control":{"share":0.9}}"#);
    let frames = orbited(&mut socket);
    assert_eq!(viewer.wait(), Some(0));
    let seen = frames.iter().collect::<std::collections::BTreeSet<_>>().len();
    assert!(seen > 5 && frames.is_sorted(), "pictures of {seen} iterations: {frames:?}");
    assert_eq!(
        std::fs::read(seen_from.path().join("model.ply")).unwrap(),
        undisturbed(),
        "with {} pictures",
        frames.len()
    );
    let pictures =
        |folder: &Path| content(&folder.join("renders")).into_iter().map(|(_, bytes)| bytes).collect::<Vec<_>>();
    assert_eq!(pictures(alone.path()), pictures(seen_from.path()));
}

/// The page's coordinates are those of the training: of a capture in small units, a thousand times the model's.
#[test]
fn a_page_knows_the_unit_of_a_run() {
    let folder = tempfile::tempdir().unwrap();
    let small = folder.path().join("small");
    copy(scene(), &small);
    rescale(&small.join("sparse/0"), 1e-3);
    let mut command = program();
    command.arg("run").arg(&small).arg("-o").arg(folder.path().join("out")).args(["--iterations", "3000", "--view"]);
    let description = Viewer::of(command).json("/scene.json");
    assert!((description["unit"].as_f64().unwrap() - 1e-3).abs() < 1e-9, "{}", description["unit"]);
}

/// Looks at a job from many cameras until it ends: the iterations of the pictures that came.
pub fn orbited(socket: &mut Socket) -> Vec<u32> {
    let mut iterations = Vec::new();
    for step in 0.. {
        if socket.try_send(&turned(step, step % 5 == 0)).is_err() {
            break;
        }
        match socket.frame() {
            Ok((header, _)) => {
                iterations.push(header.iteration);
                let _ = socket.try_send(r#"{"shown":0}"#);
            }
            Err(text) if text.starts_with('{') => {}
            Err(_) => break,
        }
    }
    iterations
}

/// A page that requests pictures and reads none: it is sent two, and the run takes no notice.
#[test]
fn a_page_that_stops_reading_holds_nothing_up() {
    let out = tempfile::tempdir().unwrap();
    let viewer = watched(out.path());
    let mut socket = viewer.socket();
    let begun = Instant::now();
    for step in 0..400 {
        if socket.try_send(&turned(step, false)).is_err() {
            break;
        }
    }
    assert_eq!(viewer.wait(), Some(0));
    assert!(begun.elapsed() < Duration::from_secs(120), "{:?}", begun.elapsed());
    assert_eq!(std::fs::read(out.path().join("model.ply")).unwrap(), undisturbed());
}

/// A compression of the scene's model that is trained for 200 iterations by its own pictures.
fn compression(out: &Path, more: &[&str]) -> std::process::Command {
    let mut command = program();
    command.args(["compress", &beside("model.ply"), "-o"]).arg(out);
    command.args(["--views", "10", "--size", "64x48"]).args(more);
    if !more.contains(&"--fine-tune") {
        command.args(["--fine-tune", "200"]);
    }
    command
}

#[test]
fn fine_tuning_is_watched_and_its_bytes_stay_the_same() {
    let folder = tempfile::tempdir().unwrap();
    let [alone, seen, held] = ["alone.ply", "seen.ply", "held.ply"].map(|name| folder.path().join(name));
    end(&mut compression(&alone, &[])).with(0, &[]);

    let viewer = Viewer::of(compression(&seen, &["--view"]));
    let description = viewer.json("/scene.json");
    assert_eq!((&description["live"], &description["checkpoints"]), (&Value::Bool(true), &Value::Bool(false)));
    assert!(description["start"]["position"].is_array(), "a view to begin with: {description}");
    let mut socket = viewer.socket();
    socket.send(r#"{"control":{"share":0.9}}"#);
    let iterations = orbited(&mut socket);
    assert_eq!(viewer.wait(), Some(0));
    let different = iterations.iter().collect::<std::collections::BTreeSet<_>>().len();
    assert!(different > 5 && iterations.is_sorted(), "pictures of {different} iterations: {iterations:?}");
    assert_eq!(std::fs::read(&alone).unwrap(), std::fs::read(&seen).unwrap(), "with {} pictures", iterations.len());

    // Paused it stays so, also if a page asks for a checkpoint, which it has none of; stopped, it writes nothing.
    let viewer = Viewer::of(compression(&held, &["--view"]));
    let mut socket = viewer.socket();
    socket.send(r#"{"control":"pause"}"#);
    let at = news(&mut socket, |n| n["paused"] == true)["iteration"].as_u64();
    socket.send(r#"{"control":"checkpoint"}"#);
    for _ in 0..3 {
        let now = news(&mut socket, |n| n["iteration"].is_u64());
        assert_eq!((now["iteration"].as_u64(), &now["paused"]), (at, &Value::Bool(true)));
    }
    socket.send(r#"{"control":"stop"}"#);
    assert_eq!((viewer.wait(), held.exists()), (Some(130), false));

    end(&mut compression(&held, &["--view", "--fine-tune", "0"])).with(2, &["add --fine-tune N"]);
    end(&mut compression(&held, &["--port", "8080"])).with(2, &["--view"]);
}

#[test]
fn a_page_pauses_resumes_and_stops_a_run_that_then_ends_as_ever() {
    let out = tempfile::tempdir().unwrap();
    let viewer = watched(out.path());
    let mut socket = viewer.socket();
    socket.send(r#"{"control":"pause"}"#);
    let at = news(&mut socket, |n| n["paused"] == true)["iteration"].as_u64().unwrap();
    assert!(at <= 16, "held after {at} iterations");
    // Held: pictures come as fast as they are drawn, all of the same iteration.
    for step in 0..8 {
        socket.send(&turned(step, false));
        let (header, _) = loop {
            match socket.frame() {
                Ok(frame) => break frame,
                Err(text) => assert!(text.starts_with('{'), "{text}"),
            }
        };
        socket.send(r#"{"shown":0}"#);
        assert_eq!(u64::from(header.iteration), at);
    }
    let held = out.path().join("checkpoint.safetensors");
    let before = std::fs::metadata(&held).and_then(|m| m.modified()).ok();
    socket.send(r#"{"control":"checkpoint"}"#);
    news(&mut socket, |n| n["note"].as_str().is_some_and(|note| note.starts_with("a checkpoint is written")));
    let begun = Instant::now();
    while std::fs::metadata(&held).and_then(|m| m.modified()).ok() == before {
        assert!(begun.elapsed() < Duration::from_secs(30), "no checkpoint");
        std::thread::sleep(Duration::from_millis(5));
    }
    socket.send(r#"{"control":"resume"}"#);
    news(&mut socket, |n| n["paused"] == false && n["iteration"].as_u64() > Some(at));
    socket.send(r#"{"control":"stop"}"#);
    news(&mut socket, |n| n["ended"].as_str().is_some_and(|how| how.contains("--resume")));
    assert_eq!(viewer.wait(), Some(130));
    end(&mut run(out.path(), &["--resume"])).with(0, &[]);
    assert_eq!(std::fs::read(out.path().join("model.ply")).unwrap(), undisturbed());
}
