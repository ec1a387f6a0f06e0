//! Videos: of three frames, two are blurred.

use super::fake::Stage;
use crate::program::faults::harness::end;
use crate::support::skip;
use qirf_vk::synth::{SynthOptions, write};
use std::fs;
use std::path::Path;
use std::process::Command;

/// True if a program can be started.
pub fn starts(program: &str) -> bool {
    Command::new(program).arg("-h").output().is_ok()
}

/// Encodes as MPEG-4.
pub const MPEG4: [&str; 4] = ["-c:v", "mpeg4", "-q:v", "2"];

/// Makes a video of numbered pictures, so many a second.
pub fn encode(pictures: &Path, rate: &str, codec: &[&str], video: &Path) {
    let mut ffmpeg = Command::new("ffmpeg");
    ffmpeg.args(["-loglevel", "error", "-nostdin", "-framerate", rate, "-i"]).arg(pictures);
    assert!(ffmpeg.args(codec).arg(video).status().unwrap().success());
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
    encode(&frames.join("%04d.png"), "10", &MPEG4, &stage.path("a: walk.mp4"));

    // The script places no photo: only the choice is looked at.
    end(&mut stage.program(&["pose", "a: walk.mp4", "-o", "scene"])).with(3, &["0 of its 20 frames", "film longer"]);
    let chosen: Vec<usize> = sorted(&stage.path("scene/images"))
        .iter()
        .map(|path| path.file_stem().unwrap().to_str().unwrap().strip_prefix("frame_").unwrap().parse().unwrap())
        .collect();
    assert_eq!(chosen.len(), 20, "a third of a short video: {chosen:?}");
    let sharp = chosen.iter().filter(|i| *i % 3 == 1).count();
    assert!(sharp * 100 >= 95 * chosen.len(), "{sharp} sharp frames among {chosen:?}");
    // Each is the frame that its name says.
    for (number, path) in chosen.iter().zip(sorted(&stage.path("scene/images"))) {
        let near = |i: usize| difference(&path, &frames.join(format!("{i:04}.png")));
        assert!(near(*number) < near(number - 1).min(near((number + 1) % FRAMES)), "{number}");
    }
}

#[test]
fn files_without_enough_pictures_are_refused_with_advice_on_videos() {
    if !starts("ffmpeg") {
        return skip("no ffmpeg");
    }
    let stage = Stage::new();
    fs::write(stage.path("broken.mp4"), [7; 999]).unwrap();
    fs::write(stage.path("empty.mp4"), "").unwrap();
    made("sine=duration=0.2", &["-c:a", "aac"], &stage.path("sound.mp4"));
    for (file, told) in [
        ("broken.mp4", "copy or export it again"),
        ("empty.mp4", "copy or export it again"),
        ("sound.mp4", "holds no video stream"),
    ] {
        let ended = end(&mut stage.program(&["pose", file, "-o", "other"])).with(3, &[file, told]);
        assert!(!ended.said.contains("resume") && !stage.path("other").exists(), "{}", ended.said);
    }
    for i in 0..3_u8 {
        image::RgbImage::from_pixel(32, 24, image::Rgb([40 * i; 3])).save(stage.path(&format!("{i}.png"))).unwrap();
    }
    encode(&stage.path("%d.png"), "10", &MPEG4, &stage.path("short.mp4"));
    let told = ["1 sharp frame out of 3", "short.mp4 cannot be used: it gives 1 sharp frame", "film longer"];
    end(&mut stage.program(&["pose", "short.mp4", "-o", "short"])).with(3, &told);
}

#[test]
fn footage_of_high_dynamic_range_is_told() {
    if !starts("ffmpeg") {
        return skip("no ffmpeg");
    }
    let stage = Stage::new();
    for i in 0..12_u8 {
        let frame = image::RgbImage::from_fn(32, 24, |x, y| image::Rgb([i, (x * 8) as u8, (y * 9) as u8]));
        frame.save(stage.path(&format!("{i:02}.png"))).unwrap();
    }
    for (transfer, told) in [("arib-std-b67", true), ("smpte2084", true), ("bt709", false)] {
        let colours = ["-color_primaries", "bt2020", "-colorspace", "bt2020nc", "-color_trc", transfer];
        encode(
            &stage.path("%02d.png"),
            "10",
            &[&["-c:v", "ffv1", "-y"], &colours[..]].concat(),
            &stage.path("walk.mkv"),
        );
        let said = end(&mut stage.program(&["pose", "walk.mkv", "-o", transfer])).said;
        assert!(said.contains("sharp frames"), "{said}");
        assert_eq!(said.contains("high dynamic range (HLG or PQ)"), told, "{transfer}: {said}");
    }
}

/// A video of one of ffmpeg's own sources.
fn made(source: &str, options: &[&str], video: &Path) {
    let mut ffmpeg = Command::new("ffmpeg");
    ffmpeg.args(["-loglevel", "error", "-nostdin", "-f", "lavfi", "-i", source]).args(options);
    assert!(ffmpeg.arg(video).status().unwrap().success());
}

/// Of BT.709, with pixels that are not square, after a smaller stream, and into a folder with a percent sign.
#[test]
fn frames_have_square_pixels_and_their_own_colours() {
    if !starts("ffmpeg") {
        return skip("no ffmpeg");
    }
    let stage = Stage::new();
    let (red, shown) = ("color=red:size=64x96:rate=10:duration=1.2", "scale=out_color_matrix=bt709:out_range=tv");
    // An aspect that no camera's pixels have is a mistake.
    for (aspect, width) in [("3/2", 96), ("9/1", 64)] {
        let filter = format!("{shown},format=yuv420p,setsar={aspect}");
        let second = ["-f", "lavfi", "-i", red, "-map", "0", "-map", "1", "-filter:v:1", &filter];
        let options = [&second[..], &["-colorspace", "bt709", "-c:v", "ffv1"]].concat();
        let (video, out) = (format!("{width}.mkv"), format!("{width}% d"));
        made("color=black:size=32x24:rate=10:duration=1.2", &options, &stage.path(&video));
        end(&mut stage.program(&["pose", &video, "-o", &out])).with(3, &["0 of its 4 frames"]);
        for path in sorted(&stage.path(&out).join("images")) {
            let frame = image::open(path).unwrap().to_rgb8();
            assert_eq!(frame.dimensions(), (width, 96));
            let [red, green, blue] = frame.get_pixel(48, 48).0;
            assert!(red > 245 && green < 10 && blue < 10, "{red} {green} {blue}");
        }
    }
}

#[test]
fn videos_that_are_cut_short_or_interlaced_are_told() {
    if !starts("ffmpeg") {
        return skip("no ffmpeg");
    }
    let stage = Stage::new();
    made("testsrc=size=64x48:rate=10:duration=2", &["-c:v", "ffv1"], &stage.path("whole.mkv"));
    let film = ["-c:v", "mpeg4", "-g", "5", "-movflags", "+faststart"];
    made("testsrc=size=64x48:rate=10:duration=20", &film, &stage.path("film.mp4"));
    for (whole, half) in [("whole.mkv", "half.mkv"), ("film.mp4", "part.mp4")] {
        let whole = fs::read(stage.path(whole)).unwrap();
        fs::write(stage.path(half), &whole[..whole.len() / 2]).unwrap();
    }
    let tape = ["-vf", "interlace", "-c:v", "mpeg2video", "-flags", "+ildct+ilme"];
    made("testsrc=size=64x48:rate=20:duration=2", &tape, &stage.path("tape.mpg"));
    // Whole ones: frames at other times than the rate says, and sound that is longer.
    let vary = "testsrc=size=64x48:rate=10:duration=2,select='lt(t,0.5)+not(mod(n,5))'";
    made(vary, &["-c:v", "ffv1"], &stage.path("vary.mkv"));
    let sound = ["-f", "lavfi", "-i", "sine=duration=4", "-c:v", "ffv1", "-c:a", "aac"];
    made("testsrc=size=64x48:rate=10:duration=2", &sound, &stage.path("song.mkv"));
    let told = [" s: it may be cut short", "the video is interlaced: it is deinterlaced"];
    let whole = ["whole.mkv", "vary.mkv", "song.mkv"].map(|video| (video, None));
    for (video, wanted) in
        whole.into_iter().chain([("half.mkv", Some(0)), ("part.mp4", Some(0)), ("tape.mpg", Some(1))])
    {
        let said = end(&mut stage.program(&["pose", video, "-o", &video[..4]])).said;
        assert!(said.contains("sharp frames out of "), "{said}");
        for (n, words) in told.iter().enumerate() {
            assert_eq!(said.contains(words), wanted == Some(n), "{video}: {said}");
        }
    }
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
