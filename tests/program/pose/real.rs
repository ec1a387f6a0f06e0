//! The real COLMAP, on photos whose poses are known.

use super::fake::works;
use super::video::starts;
use crate::program::faults::harness::program;
use crate::support::skip;
use qirf_vk::scene::{OpenOptions, Scene};
use qirf_vk::synth::{SynthOptions, write};
use std::path::Path;

#[test]
fn colmap_finds_the_cameras_that_took_a_synthetic_scene() {
    if !starts("colmap") {
        return skip("no colmap");
    }
    let folder = tempfile::tempdir().unwrap();
    let known = folder.path().join("known");
    let options = SynthOptions { views: 16, width: 320, height: 240, points: 10, ..SynthOptions::default() };
    write(&known, &options, &|_| ()).unwrap();
    let mut command = program();
    command.arg("pose").arg(known.join("images")).arg("-o").arg(folder.path().join("found"));
    let (_, said) = works(command);
    assert!(said.contains("16 of 16 photos have poses"), "{said}");

    let open = |path: &Path| Scene::open(path, &OpenOptions::default()).unwrap();
    let (known, found) = (open(&known), open(&folder.path().join("found")));
    assert!(found.points.len() > 200, "{} points", found.points.len());
    // Angles between two cameras depend on neither origin nor scale nor rotation of the world.
    let turned = |scene: &Scene, i: usize| scene.views[i].camera.rotation * scene.views[0].camera.rotation.transpose();
    for i in 1..16 {
        assert_eq!(known.views[i].name, found.views[i].name);
        let between = turned(&known, i) * turned(&found, i).transpose();
        let trace = between.x_axis.x + between.y_axis.y + between.z_axis.z;
        let angle = ((trace - 1.0) / 2.0).clamp(-1.0, 1.0).acos().to_degrees();
        assert!(angle < 1.0, "view {i} is turned by {angle} degrees");
    }
}
