//! Videos: of three frames, two are blurred.

use super::fake::Stage;
use crate::program::faults::harness::end;
use crate::support::skip;
use qirf_vk::synth::{SynthOptions, write};
use std::fs;
use std::process::Command;

/// True if a program can be started.
pub fn starts(program: &str) -> bool {
    Command::new(program).arg("-h").output().is_ok()
}

/// Frames of the video.
const FRAMES: usize = 60;

#[test]
fn the_sharp_frames_of_a_video_are_chosen() {
    if !starts("ffmpeg") {
        return skip("no ffmpeg");
    }
    let stage = Stage::new();
    let traced = stage.path("traced");
    let options = SynthOptions { views: FRAMES, width: 96, height: 72, points: 10, ..SynthOptions::default() };
    write(&traced, &options, &|_| ()).unwrap();
    let frames = stage.path("frames");
    fs::create_dir(&frames).unwrap();
    for (i, entry) in sorted(&traced.join("images")).into_iter().enumerate() {
        let sharp = image::open(entry).unwrap();
        let frame = if i % 3 == 1 { sharp } else { sharp.blur(1.2) };
        frame.save(frames.join(format!("{i:04}.png"))).unwrap();
    }
    let encoded = Command::new("ffmpeg")
        .args(["-loglevel", "error", "-nostdin", "-framerate", "10", "-i"])
        .arg(frames.join("%04d.png"))
        .args(["-c:v", "mpeg4", "-q:v", "2"])
        .arg(stage.path("a: walk.mp4"))
        .status();
    assert!(encoded.unwrap().success());

    // The script places no photo: only the choice is looked at.
    end(&mut stage.program(&["pose", "a: walk.mp4", "-o", "scene"])).with(3, &["0 of 12 photos"]);
    let chosen: Vec<usize> = sorted(&stage.path("scene/images"))
        .iter()
        .map(|path| path.file_stem().unwrap().to_str().unwrap().strip_prefix("frame_").unwrap().parse().unwrap())
        .collect();
    assert_eq!(chosen.len(), 12, "two a second: {chosen:?}");
    let sharp = chosen.iter().filter(|i| *i % 3 == 1).count();
    assert!(sharp * 100 >= 95 * chosen.len(), "{sharp} sharp frames among {chosen:?}");
    // Each is the frame that its name says.
    for (number, path) in chosen.iter().zip(sorted(&stage.path("scene/images"))) {
        let near = |i: usize| difference(&path, &frames.join(format!("{i:04}.png")));
        assert!(near(*number) < near(number - 1).min(near((number + 1) % FRAMES)), "{number}");
    }
    // An error of ffmpeg is told.
    fs::write(stage.path("broken.mp4"), [7; 999]).unwrap();
    end(&mut stage.program(&["pose", "broken.mp4", "-o", "other"])).with(3, &["ffprobe failed", "broken.mp4", "log"]);
}

fn sorted(folder: &std::path::Path) -> Vec<std::path::PathBuf> {
    let mut paths: Vec<_> = fs::read_dir(folder).unwrap().map(|e| e.unwrap().path()).collect();
    paths.sort();
    paths
}

fn difference(a: &std::path::Path, b: &std::path::Path) -> u64 {
    let [a, b] = [a, b].map(|path| image::open(path).unwrap().to_luma8().into_raw());
    a.iter().zip(&b).map(|(a, b)| u64::from(a.abs_diff(*b))).sum()
}
