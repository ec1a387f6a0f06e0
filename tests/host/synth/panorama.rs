//! Panoramas of the plaza: observations by COLMAP's formula, and faces that show the points where they lie.

use super::colmap::Model;
use super::{make, options, quantile};
use qirf_vk::scene::{LoadOptions, OpenOptions, Scene};
use qirf_vk::synth::{self, Effect, Error, Kind, SynthOptions};

fn walk() -> SynthOptions {
    SynthOptions { kind: Kind::Panorama, width: 256, height: 128, points: 300, ..options(6, &[]) }
}

#[test]
fn points_lie_where_the_panoramas_and_their_faces_show_them() {
    let (dir, report) = make(&walk());
    assert!(report.points > 150, "{report:?}");
    let model = Model::read(dir.path());
    let mut behind = 0;
    for mark in model.points.values() {
        for (image, index) in &mark.track {
            let shot = &model.images[image];
            let off = (model.project(shot, mark.place) - shot.marks[*index].0).length();
            assert!(off < 2e-3, "{off} px");
            behind += usize::from((shot.rotation * mark.place + shot.translation).z < 0.0);
        }
    }
    assert!(behind > report.observations / 5, "all directions are seen: {behind} of {}", report.observations);

    let mut scene = Scene::open(dir.path(), &OpenOptions::default()).unwrap();
    assert!(scene.near < 0.1, "objects are near: {}", scene.near);
    let photos = scene.load_photos(&LoadOptions::default(), &|_| {}).unwrap();
    assert_eq!((scene.views.len(), scene.views[0].camera.width), (36, 64));
    let mut off = Vec::new();
    for point in &scene.points {
        for v in &point.track {
            let (photo, camera) = (&photos[*v as usize], &scene.views[*v as usize].camera);
            let p = camera.rotation * point.position + camera.translation;
            let at = p.truncate() / p.z * camera.focal + camera.principal;
            let colour = photo.colour(at.to_array().map(|v| (v as u32).min(63))).unwrap();
            let expected = point.colour.map(|c| f64::from(c) / 255.0);
            off.push((0..3).map(|c| (colour[c] - expected[c]).abs()).fold(0.0, f64::max));
        }
    }
    assert_eq!(off.len(), report.observations, "each is seen by one face");
    assert!(quantile(off, 0.5) < 0.1);
}

#[test]
fn panoramas_are_twice_as_wide_as_high_and_have_one_lens() {
    let dir = tempfile::tempdir().unwrap();
    let refused = |options: SynthOptions| synth::write(dir.path(), &options, &|_| ()).unwrap_err();
    assert!(matches!(refused(SynthOptions { height: 96, ..walk() }), Error::NoPanorama { width: 256, height: 96 }));
    let effects = vec![Effect::Fisheye];
    assert!(matches!(refused(SynthOptions { effects, ..walk() }), Error::NotThere { .. }));
}
