//! How fast pictures come: `make viewer-speed` prints the table of docs/viewer.md.

use super::session::{Viewer, wish};
use crate::support::shared;
use std::time::{Duration, Instant};

/// Moves measured, after as many to warm up as a driver needs to compile.
const MOVES: u32 = 200;
/// Size of pictures.
const SIZE: &str = "[640,360]";

/// A wish from a circle about the start.
fn move_to(step: u32, start: &serde_json::Value, still: bool) -> String {
    let [position, rotation] = ["position", "rotation"].map(|key| &start[key]);
    let mut eye: Vec<f64> = position.as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect();
    eye[0] += 0.002 * f64::from(step) * eye[2].abs();
    let camera =
        format!(r#"{{"pose":{{"position":{},"rotation":{rotation},"fov":{}}}}}"#, serde_json::json!(eye), start["fov"]);
    wish(step, &camera, &format!(r#""still":{still}"#)).replace("[64,48]", SIZE)
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
        // One at a time: how long a picture takes from the wish to its bytes.
        let mut waits: Vec<Duration> = (0..MOVES)
            .map(|step| {
                let begun = Instant::now();
                socket.picture(&move_to(step, start, false));
                begun.elapsed()
            })
            .collect();
        waits.sort();
        // Two under way, as a page has them. A wish that is not drawn yet may be replaced by the next one.
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
