//! Captures in other units of length, and far from their worlds' origins.

use super::absent::Told;
use super::dialects::{notes, open};
use crate::support::files::make;
use crate::support::files::writers::{Model, written};
use glam::DVec3;
use qirf_vk::gaussians::formats::{self, Format, RenderMode};
use qirf_vk::job::{Init, Preset, RunConfig};
use qirf_vk::pipeline::place::most_doubtful;
use qirf_vk::pipeline::start::Start;
use qirf_vk::scene::Scene;
use qirf_vk::scene::camera::Camera;

/// A capture of ten views in another unit of length and at another place.
fn moved(unit: f64, by: [f64; 3]) -> tempfile::TempDir {
    let mut model = Model::sample();
    let by = glam::DVec3::from(by);
    for image in &mut model.images {
        let [w, x, y, z] = image.1;
        let rotation = glam::DQuat::from_xyzw(x, y, z, w).normalize();
        let translation = glam::DVec3::from(image.2) * unit - rotation * by;
        image.2 = translation.to_array();
    }
    for point in &mut model.points {
        point.0 = (glam::DVec3::from(point.0) * unit + by).to_array();
    }
    written(model.text())
}

#[test]
fn the_near_plane_follows_the_unit_of_length_and_nothing_else_does() {
    let plain = open(moved(1.0, [0.0; 3]).path());
    // Scenes of usual size keep 3DGS's plane, others have one in proportion.
    assert_eq!((plain.near, open(moved(3.0, [0.0; 3]).path()).near), (0.2, 0.2));
    let shares = [1e-4, 1e-2, 0.3, 10.0, 1e4].map(|unit| f64::from(open(moved(unit, [0.0; 3]).path()).near) / unit);
    assert!(shares.iter().all(|share| (share / shares[0] - 1.0).abs() < 1e-6), "{shares:?}");
    assert!((0.05..0.2).contains(&shares[0]), "{shares:?}");
    // For training, such scenes are counted in powers of ten, and are the same numbers then.
    let mut others = [1e-4, 1e-2, 100.0].map(|unit| open(moved(unit, [0.0; 3]).path()));
    let units = others.each_mut().map(Scene::use_usual_unit);
    assert_eq!(units, [1e-4, 1e-2, 100.0]);
    for (scene, unit) in others.iter().zip(units) {
        assert_eq!(scene.unit, unit);
        for (a, b) in scene.views.iter().zip(&plain.views) {
            assert!((a.camera.centre() - b.camera.centre()).length() < 1e-12);
        }
        assert!(scene.points.iter().zip(&plain.points).all(|(a, b)| (a.position - b.position).length() < 1e-12));
    }
    let mut same = plain.clone();
    assert_eq!((same.use_usual_unit(), same.near), (1.0, plain.near));
    // It stays when views go, so that parts of a job draw alike.
    let mut few = plain.clone();
    few.retain_views(&[true, true]);
    assert_eq!(few.near, plain.near);
}

#[test]
fn far_worlds_are_read_about_an_origin_of_their_own() {
    let plain = open(moved(1.0, [0.0; 3]).path());
    assert_eq!(plain.origin, glam::DVec3::ZERO);
    for by in [[500_123.4, 4_649_776.2, 312.7], [0.0, -1e7, 0.0], [4.2e6, 1.7e5, 4.78e6]] {
        let far = open(moved(1.0, by).path());
        let left = glam::DVec3::from(by) - far.origin;
        assert!(left.length() < 10.0 && far.origin != glam::DVec3::ZERO, "{} {left}", far.origin);
        assert!(notes(&far).contains("far from its world's origin"));
        for (a, b) in far.views.iter().zip(&plain.views) {
            assert!((a.camera.centre() - b.camera.centre() - left).length() < 1e-6);
        }
        for (a, b) in far.points.iter().zip(&plain.points) {
            assert!((a.position - b.position - left).length() < 1e-6);
        }
        assert!((far.near - plain.near).abs() < 1e-6);
    }
}

#[test]
fn a_run_doubts_a_model_that_may_have_lost_its_origin() {
    let capture = moved(1.0, [5e5, 4e6, 100.0]);
    let file = capture.path().join("a.spz");
    formats::write(&file, &make::model(20, 0), RenderMode::Plain).unwrap();
    let config = RunConfig { init: Init::Model(file), ..RunConfig::of(capture.path().to_owned(), Preset::Quick) };
    let told = Told::default();
    Start::of(&config, &open(capture.path()), 64 * 48, &told).unwrap();
    let [lost, _] = told.lines();
    assert!(lost.starts_with("warning: ") && lost.contains("records no local origin"), "{lost}");
    assert_eq!(most_doubtful([Format::Ply, Format::Spz, Format::Gltf].into_iter()), Some(Format::Spz));
}

#[test]
fn a_direction_may_have_any_length() {
    let eye = DVec3::new(0.0, 0.0, -3.0);
    let at = |eye: DVec3, up: DVec3| Camera::look_at(eye, DVec3::ZERO, up, 0.7, 64, 48).rotation;
    let up = DVec3::new(1.0, 1.0, 0.0);
    for length in [1e200, 2e-162, 1e-200] {
        assert!(at(eye, up * length).abs_diff_eq(at(eye, up), 1e-12), "{length}");
        assert!(at(DVec3::X * length, DVec3::Y).abs_diff_eq(at(DVec3::X, DVec3::Y), 1e-12), "{length}");
    }
    assert!(at(eye, DVec3::ZERO).is_finite(), "another direction is taken");
}
