//! A run that is watched: its bytes are its own, and a page can hold and end it.

use super::session::{Socket, Viewer, wish};
use crate::program::faults::harness::{content, end, run, undisturbed};
use serde_json::Value;
use std::path::Path;
use std::time::{Duration, Instant};

fn watched(out: &Path) -> Viewer {
    Viewer::of(run(out, &["--view"]))
}

/// A wish from a camera of the scene that has turned by some steps.
fn turned(step: u32, still: bool) -> String {
    let (sin, cos) = (0.05 * f64::from(step)).sin_cos();
    let camera = format!(r#"{{"pose":{{"position":[0,-1,-6],"rotation":[{cos},0,{sin},0],"fov":0.9}}}}"#);
    wish(step, &camera, &format!(r#""still":{still}"#))
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

    let orbited = tempfile::tempdir().unwrap();
    let viewer = watched(orbited.path());
    let mut socket = viewer.socket();
    socket.send(r#"{"control":{"share":0.9}}"#);
    let mut frames = Vec::new();
    for step in 0.. {
        if socket.try_send(&turned(step, step % 5 == 0)).is_err() {
            break;
        }
        match socket.frame() {
            Ok((header, _)) => {
                frames.push(header.iteration);
                let _ = socket.try_send(r#"{"shown":0}"#);
            }
            Err(text) if text.starts_with('{') => {}
            Err(_) => break,
        }
    }
    assert_eq!(viewer.wait(), Some(0));
    let seen = frames.iter().collect::<std::collections::BTreeSet<_>>().len();
    assert!(seen > 5 && frames.is_sorted(), "pictures of {seen} iterations: {frames:?}");
    assert_eq!(
        std::fs::read(orbited.path().join("model.ply")).unwrap(),
        undisturbed(),
        "with {} pictures",
        frames.len()
    );
    let pictures =
        |folder: &Path| content(&folder.join("renders")).into_iter().map(|(_, bytes)| bytes).collect::<Vec<_>>();
    assert_eq!(pictures(alone.path()), pictures(orbited.path()));
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
    let begun = Instant::now();
    while std::fs::metadata(&held).and_then(|m| m.modified()).ok() == before {
        assert!(begun.elapsed() < Duration::from_secs(30), "no checkpoint");
        std::thread::sleep(Duration::from_millis(5));
    }
    socket.send(r#"{"control":"resume"}"#);
    news(&mut socket, |n| n["paused"] == false && n["iteration"].as_u64() > Some(at));
    socket.send(r#"{"control":"stop"}"#);
    assert_eq!(viewer.wait(), Some(130));
    end(&mut run(out.path(), &["--resume"])).with(0, &[]);
    assert_eq!(std::fs::read(out.path().join("model.ply")).unwrap(), undisturbed());
}
