//! The real COLMAP, on photos whose poses are known.

use super::fake::works;
use super::video::starts;
use crate::program::faults::harness::program;
use crate::support::{shared, skip};
use qirf_vk::scene::{OpenOptions, Scene, photo_names};
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
