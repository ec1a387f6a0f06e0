//! The real COLMAP, on photos whose poses are known.

use super::fake::works;
use super::video::{MPEG4, encode, starts};
use crate::program::faults::harness::program;
use crate::support::{shared, skip};
use qirf_vk::gaussians::formats;
use qirf_vk::scene::camera::Camera;
use qirf_vk::scene::{OpenOptions, Scene, photo_names};
use std::fs;
use std::path::Path;

/// Photos of the first test, a part of the walk round the subject: matching takes a time for each pair.
const PHOTOS: usize = 14;

#[test]
fn colmap_finds_the_cameras_that_are_known() {
    if !starts("colmap") {
        return skip("no colmap");
    }
    let Some(king) = shared("scenes/king") else { return };
    let folder = tempfile::tempdir().unwrap();
    let photos = folder.path().join("photos");
    fs::create_dir(&photos).unwrap();
    let mut chosen = photo_names(&king.join("images"));
    chosen.truncate(PHOTOS);
    for name in &chosen {
        let photo = image::open(king.join("images").join(name)).unwrap();
        photo.resize(500, 500, image::imageops::Triangle).save(photos.join(name)).unwrap();
    }
    let mut command = program();
    command.arg("pose").arg(photos).arg("-o").arg(folder.path().join("found"));
    let (_, said) = works(command);
    assert!(said.contains(&format!("{PHOTOS} of {PHOTOS} photos have poses")), "{said}");

    let (mut known, found) = (open(&king), open(&folder.path().join("found")));
    known.views.retain(|view| chosen.contains(&view.name));
    assert!(found.points.len() > 500, "{} points", found.points.len());
    let names = |scene: &Scene| scene.views.iter().map(|view| view.name.clone()).collect::<Vec<_>>();
    assert_eq!(names(&known), names(&found));
    are_turned_alike(3.0, known.views.iter().zip(&found.views).map(|(known, found)| (&known.camera, &found.camera)));
}

fn open(path: &Path) -> Scene {
    Scene::open(path, &OpenOptions::default()).unwrap()
}

/// Asserts that the cameras, each as known and as found, are turned against the first of them alike, up to `most` degrees: this
/// depends on neither origin nor scale nor rotation of the world.
#[track_caller]
fn are_turned_alike<'a>(most: f64, cameras: impl Iterator<Item = (&'a Camera, &'a Camera)>) {
    let cameras: Vec<_> = cameras.map(|(known, found)| (known.rotation, found.rotation)).collect();
    let (first_known, first_found) = cameras[0];
    for (i, (known, found)) in cameras.into_iter().enumerate() {
        let between = known * first_known.transpose() * (found * first_found.transpose()).transpose();
        let trace = between.x_axis.x + between.y_axis.y + between.z_axis.z;
        let angle = ((trace - 1.0) / 2.0).clamp(-1.0, 1.0).acos().to_degrees();
        assert!(angle < most, "view {i} is turned by {angle} degrees");
    }
}

/// The photos of a walk, as a video and nothing else.
#[test]
fn a_video_becomes_a_model_by_one_command() {
    if !starts("ffmpeg") || !starts("colmap") {
        return skip("no ffmpeg, or no colmap");
    }
    let Some(walk) = shared("scenes/snowmiku") else { return };
    let folder = tempfile::tempdir().unwrap();
    let [frames, video, out] = ["frames", "walk.mp4", "out"].map(|name| folder.path().join(name));
    fs::create_dir(&frames).unwrap();
    let known = open(&walk);
    for (i, view) in known.views.iter().take(12).enumerate() {
        let frame = image::open(&view.image).unwrap().resize_exact(480, 360, image::imageops::Triangle);
        frame.save(frames.join(format!("{i:04}.png"))).unwrap();
    }
    encode(&frames.join("%04d.png"), "2", &MPEG4, &video);
    let mut command = program();
    command.arg("run").arg(&video).arg("-o").arg(&out);
    command.args(["--iterations", "200", "--resolution", "120", "--grow-to", "3000"]);
    let (ended, said) = works(command);
    let note = ended.said.lines().find(|l| l.contains("photos have poses")).expect("how many photos have poses");
    println!("{note}\n{said}");
    let found = open(&out.join("scene"));
    assert!(found.views.len() >= 9, "{note}");
    // If one frame were taken for the next, its camera would be off by 20 degrees.
    let frame = |name: &str| -> usize { name[6..12].parse().expect("frame_, the frame's number, and .jpg") };
    are_turned_alike(6.0, found.views.iter().map(|view| (&known.views[frame(&view.name)].camera, &view.camera)));
    assert!(out.join("report.html").is_file() && formats::read(&out.join("model.ply")).unwrap().gaussians.len() > 100);
    let figures: serde_json::Value = serde_json::from_slice(&fs::read(out.join("metrics.json")).unwrap()).unwrap();
    let psnr = figures["test"]["psnr"].as_f64().expect("a score of held-out frames");
    assert!(psnr > 20.0, "{psnr:.2} dB");
}
