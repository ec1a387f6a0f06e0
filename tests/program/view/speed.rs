//! How fast pictures come, and what it costs a run to be watched: `make viewer-speed` prints the tables of docs/viewer.md.

use super::live::{orbited, turned};
use super::session::{Socket, Viewer, request};
use crate::support::browser::Browser;
use crate::support::shared;
use qirf_vk::synth::{SynthOptions, write};
use serde_json::json;
use std::path::Path;
use std::process::Command;
use std::time::{Duration, Instant};

/// Moves measured, after as many to warm up as a driver needs to compile.
const MOVES: u32 = 200;
/// Size of pictures.
const SIZE: &str = "[640,360]";

/// A request from a circle about the start.
fn move_to(step: u32, start: &serde_json::Value, still: bool) -> String {
    let [position, rotation] = ["position", "rotation"].map(|key| &start[key]);
    let mut eye: Vec<f64> = position.as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect();
    eye[0] += 0.002 * f64::from(step) * eye[2].abs();
    let camera =
        format!(r#"{{"pose":{{"position":{},"rotation":{rotation},"fov":{}}}}}"#, serde_json::json!(eye), start["fov"]);
    request(step, &camera, &format!(r#""still":{still}"#)).replace("[64,48]", SIZE)
}

#[test]
#[ignore = "measures: make viewer-speed"]
fn pictures_a_second() {
    println!(
        "| model | Gaussians | pictures/s | latency, median | latency, 95 % | moving | still | reduced | host memory |"
    );
    println!("|---|---:|---:|---:|---:|---:|---:|---:|---:|");
    for name in ["flowers_lod2_93k_sh2.ply", "playbot_lod3_31k_sh2.ply"] {
        let Some(model) = shared(&format!("models/{name}")) else { return };
        let viewer = Viewer::start(&["view", &model.display().to_string()]);
        let description = viewer.json("/scene.json");
        let (start, gaussians) = (&description["start"], &description["models"][0]["gaussians"]);
        let mut socket = viewer.socket();
        for step in 0..20 {
            socket.picture(&move_to(step, start, false));
        }
        // One at a time: how long a picture takes from the request to its bytes.
        let mut waits: Vec<Duration> = (0..MOVES)
            .map(|step| {
                let begun = Instant::now();
                socket.picture(&move_to(step, start, false));
                begun.elapsed()
            })
            .collect();
        waits.sort();
        // Two under way, as a page has them. A request that is not drawn yet may be replaced by the next one.
        let begun = Instant::now();
        let (mut bytes, mut reduced, mut frames, mut step) = (0, 0, 0_u32, 1);
        socket.send(&move_to(0, start, false));
        socket.send(&move_to(1, start, false));
        loop {
            let (header, picture) = socket.frame().unwrap();
            socket.send(r#"{"shown":0}"#);
            (bytes, reduced, frames) = (bytes + picture.len(), reduced + u32::from(header.reduced), frames + 1);
            if header.number == MOVES {
                break;
            }
            if step < MOVES {
                step += 1;
                socket.send(&move_to(step, start, false));
            }
        }
        let rate = f64::from(frames) / begun.elapsed().as_secs_f64();
        let still = socket.picture(&move_to(0, start, true)).1.len();
        let at = |share: f64| waits[(share * f64::from(MOVES)) as usize].as_secs_f64() * 1e3;
        println!(
            "| {name} | {gaussians} | {rate:.1} | {:.0} ms | {:.0} ms | {:.0} kB | {:.0} kB | {reduced} of {frames} | {:.0} MB |",
            at(0.5),
            at(0.95),
            bytes as f64 / f64::from(frames) / 1e3,
            still as f64 / 1e3,
            viewer.peak_memory() / 1e6
        );
    }
}

/// Turns the camera at each of the browser's own frames; the number of pictures that it showed a second.
const TURN: &str = "new Promise((done) => { \
    const begun = performance.now(); let shown = 0, last = viewer.frame; \
    const step = (now) => { \
        if (viewer.frame !== last) { last = viewer.frame; shown += 1; } \
        if (now - begun > 10000) return done(shown / (now - begun) * 1000); \
        viewer.camera.orbit(0.01, 0); \
        Object.assign(viewer, { changed: true, lastChange: now, stillAsked: false }); \
        requestAnimationFrame(step); \
    }; \
    requestAnimationFrame(step); \
})";

/// Pictures of 640 x 360 that a browser shows while it computes on the same cores.
#[test]
#[ignore = "measures: make viewer-speed"]
fn pictures_a_second_in_a_browser() {
    println!("| model | Chromium, pictures/s | size | first picture after |");
    println!("|---|---:|---|---:|");
    for name in ["flowers_lod2_93k_sh2.ply", "playbot_lod3_31k_sh2.ply"] {
        let Some(model) = shared(&format!("models/{name}")) else { return };
        let viewer = Viewer::start(&["view", &model.display().to_string()]);
        // From the printed address: Chromium starts meanwhile, too.
        let begun = Instant::now();
        let Some(mut page) = Browser::open(&viewer.url) else { return };
        page.until("viewer.frame");
        let first = begun.elapsed().as_secs_f64();
        let screen = json!({ "width": 640, "height": 360, "deviceScaleFactor": 1, "mobile": false });
        page.call("Emulation.setDeviceMetricsOverride", &screen);
        page.key("h");
        page.until("viewer.frame?.size.join() === '640,360'");
        page.value(TURN);
        let rate = page.value(TURN).as_f64().unwrap();
        let size = page.value("viewer.frame.size.join(' x ')");
        println!("| {name} | {rate:.1} | {} | {first:.1} s |", size.as_str().unwrap());
    }
}

/// Seconds that the programs which this one waited for computed, on any core.
fn computed() -> f64 {
    let stat = std::fs::read_to_string("/proc/self/stat").unwrap_or_default();
    let numbers = stat.rsplit_once(')').map_or("", |(_, rest)| rest).split_whitespace();
    numbers.skip(13).take(2).filter_map(|n| n.parse::<f64>().ok()).sum::<f64>() / 100.0
}

/// A page that does not move: it asks for a picture whenever the model has changed.
fn watch(socket: &mut Socket) {
    let mut waits = false;
    loop {
        match socket.frame() {
            Ok(_) if socket.try_send(r#"{"shown":0}"#).is_ok() => waits = false,
            Err(text) if text.starts_with('{') => {
                if !waits && socket.try_send(&turned(1, true)).is_err() {
                    return;
                }
                waits = true;
            }
            _ => return,
        }
    }
}

/// A run that nobody can watch, that nobody watches, and that a page watches in three ways, in turns.
#[test]
#[ignore = "measures: make viewer-speed"]
fn cost_of_being_watched() {
    type Page = fn(&mut Socket);
    let orbit: Page = |socket| drop(orbited(socket));
    let deaf: Page = |socket| {
        let _ = (0..400).all(|step| socket.try_send(&turned(step, false)).is_ok());
    };
    let arms: [(&str, bool, Option<Page>); 5] = [
        ("without --view", false, None),
        ("nobody there", true, None),
        ("a page that rests", true, Some(watch)),
        ("a page that orbits", true, Some(orbit)),
        ("a page that stops reading", true, Some(deaf)),
    ];
    let folder = tempfile::tempdir().unwrap();
    let scene = folder.path().join("scene");
    write(&scene, &SynthOptions { views: 24, width: 160, height: 120, ..SynthOptions::default() }, &|_| ()).unwrap();
    let rounds: Vec<Vec<[f64; 2]>> = (0..ROUNDS)
        .map(|_| arms.iter().map(|(_, view, page)| run(&scene, &folder.path().join("out"), *view, *page)).collect())
        .collect();
    println!("| run | processor time | change | time | change |");
    println!("|---|---:|---:|---:|---:|");
    // Other work of the machine only adds to a time: the least one is the steadiest.
    let least = |arm: usize, what: usize| rounds.iter().map(|round| round[arm][what]).fold(f64::INFINITY, f64::min);
    for (arm, (name, ..)) in arms.iter().enumerate() {
        let [cpu, time] = [0, 1].map(|what| (least(arm, what), 100.0 * (least(arm, what) / least(0, what) - 1.0)));
        println!("| {name} | {:.2} s | {:+.1} % | {:.2} s | {:+.1} % |", cpu.0, cpu.1, time.0, time.1);
    }
}

/// Turns of [`cost_of_being_watched`].
const ROUNDS: usize = 5;

/// Seconds computed, and seconds, of a run that a page may watch.
fn run(scene: &Path, out: &Path, view: bool, page: Option<fn(&mut Socket)>) -> [f64; 2] {
    let _ = std::fs::remove_dir_all(out);
    let program = std::env::var_os("QIRF_PROGRAM").unwrap_or_else(|| env!("CARGO_BIN_EXE_qirf-vk").into());
    let mut command = Command::new(program);
    command.env("QIRF_VALIDATION", "0").arg("run").arg(scene).arg("-o").arg(out).args(["--iterations", "300"]);
    let (before, begun) = (computed(), Instant::now());
    if view {
        command.arg("--view");
        let viewer = Viewer::of(command);
        let mut socket = page.map(|_| viewer.socket());
        if let (Some(page), Some(socket)) = (page, &mut socket) {
            page(socket);
        }
        assert_eq!(viewer.wait(), Some(0));
    } else {
        assert!(command.output().unwrap().status.success());
    }
    [computed() - before, begun.elapsed().as_secs_f64()]
}
