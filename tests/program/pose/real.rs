//! The real COLMAP, on photos whose poses are known.

use super::fake::works;
use super::video::{MPEG4, encode, starts};
use crate::program::faults::harness::program;
use crate::support::{shared, skip};
use qirf_vk::gaussians::formats;
use qirf_vk::scene::{OpenOptions, Scene, photo_names};
use qirf_vk::synth::{SynthOptions, write};
use std::fs;
use std::path::Path;

#[test]
fn colmap_finds_the_cameras_that_are_known() {
    if !starts("colmap") {
        return skip("no colmap");
    }
    let Some(king) = shared("scenes/king") else { return };
    let folder = tempfile::tempdir().unwrap();
    let photos = folder.path().join("photos");
    fs::create_dir(&photos).unwrap();
    for name in photo_names(&king.join("images")) {
        let photo = image::open(king.join("images").join(&name)).unwrap();
        photo.resize(500, 500, image::imageops::Triangle).save(photos.join(name)).unwrap();
    }
    let mut command = program();
    command.arg("pose").arg(photos).arg("-o").arg(folder.path().join("found"));
    let (_, said) = works(command);
    assert!(said.contains("23 of 23 photos have poses"), "{said}");

    let open = |path: &Path| Scene::open(path, &OpenOptions::default()).unwrap();
    let (known, found) = (open(&king), open(&folder.path().join("found")));
    assert!(found.points.len() > 500, "{} points", found.points.len());
    // Angles between two cameras depend on neither origin nor scale nor rotation of the world.
    let turned = |scene: &Scene, i: usize| scene.views[i].camera.rotation * scene.views[0].camera.rotation.transpose();
    for i in 1..23 {
        assert_eq!(known.views[i].name, found.views[i].name);
        let between = turned(&known, i) * turned(&found, i).transpose();
        let trace = between.x_axis.x + between.y_axis.y + between.z_axis.z;
        let angle = ((trace - 1.0) / 2.0).clamp(-1.0, 1.0).acos().to_degrees();
        assert!(angle < 3.0, "view {i} is turned by {angle} degrees");
    }
}

/// A walk around a ray-traced scene, as a video and nothing else.
#[test]
fn a_video_becomes_a_model_by_one_command() {
    if !starts("ffmpeg") || !starts("colmap") {
        return skip("no ffmpeg, or no colmap");
    }
    let folder = tempfile::tempdir().unwrap();
    let [traced, video, out] = ["traced", "walk.mp4", "out"].map(|name| folder.path().join(name));
    let options = SynthOptions { views: 36, width: 480, height: 360, points: 10, ..SynthOptions::default() };
    write(&traced, &options, &|_| ()).unwrap();
    encode(&traced.join("images/view_%04d.png"), "2", &MPEG4, &video);
    let mut command = program();
    command.arg("run").arg(&video).arg("-o").arg(&out);
    command.args(["--iterations", "300", "--resolution", "120", "--grow-to", "3000"]);
    let (ended, said) = works(command);
    let note = ended.said.lines().find(|l| l.contains("photos have poses")).expect("how many photos have poses");
    println!("{note}\n{said}");
    let scene = Scene::open(&out.join("scene"), &OpenOptions::default()).unwrap();
    // COLMAP places 30 to 33 of them, from run to run.
    assert!(scene.views.len() >= 18, "{note}");
    assert!(out.join("report.html").is_file() && formats::read(&out.join("model.ply")).unwrap().gaussians.len() > 100);
    let figures: serde_json::Value = serde_json::from_slice(&fs::read(out.join("metrics.json")).unwrap()).unwrap();
    let psnr = figures["test"]["psnr"].as_f64().expect("a score of held-out frames");
    assert!(psnr > 16.0, "{psnr:.2} dB");
}
