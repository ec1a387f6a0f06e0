//! Cameras, lenses and points.

use super::colmap::Model;
use super::{make, options};
use glam::DVec2;
use qirf_vk::synth::{Effect, SynthOptions};

#[test]
fn observed_points_land_where_images_txt_says() {
    for effects in [&[][..], &[Effect::Distortion], &[Effect::Fisheye], &[Effect::Cameras, Effect::Masks]] {
        let (dir, report) = make(&options(9, effects));
        let model = Model::read(dir.path());
        assert_eq!(model.images.len(), 9);
        assert_eq!(model.points.len(), report.points);
        assert!(report.points > 300, "{effects:?}: only {} points", report.points);
        let mut seen = 0;
        for (id, mark) in &model.points {
            assert!(mark.track.len() >= 2);
            for (image, index) in &mark.track {
                let shot = &model.images[image];
                let (pixel, back) = shot.marks[*index];
                assert_eq!(back, *id, "the track and the photo's list disagree");
                let off = (model.project(shot, mark.place) - pixel).length();
                assert!(off < 0.01, "{effects:?}: point {id} is {off} px off in {}", shot.name);
                seen += 1;
            }
        }
        assert_eq!(seen, report.observations);
        assert_eq!(seen, model.images.values().map(|s| s.marks.len()).sum::<usize>());
    }
}

#[test]
fn footprints_differ_only_where_near_and_far_cameras_were_asked_for() {
    let ratio = |effects: &[Effect]| {
        let (dir, _) = make(&options(24, effects));
        Model::read(dir.path()).footprint_ratio()
    };
    let (plain, scales) = (ratio(&[]), ratio(&[Effect::Scales]));
    println!("median ratio of footprints: {plain:.2} and with scales {scales:.2}");
    assert!(plain < 1.5, "default footprints differ by {plain}");
    assert!(scales > 3.0, "footprints of near and far cameras differ by {scales}");
}

#[test]
fn lenses_and_cameras_are_as_asked_for() {
    let models = |effects: &[Effect]| -> Vec<(String, DVec2, Vec<f64>)> {
        let o = SynthOptions {
            width: 240,
            height: 180,
            points: 0,
            views: 1,
            effects: effects.to_vec(),
            seed: 1,
            ..SynthOptions::default()
        };
        Model::read(make(&o).0.path()).cameras.into_values().collect()
    };
    assert_eq!(models(&[])[0].0, "PINHOLE");
    assert_eq!(models(&[Effect::Fisheye])[0].0, "OPENCV_FISHEYE");
    let (name, size, k) = models(&[Effect::Distortion]).remove(0);
    assert_eq!(name, "OPENCV");
    let r2 = (size / 2.0 / k[0]).length_squared();
    let moved = k[0] * r2.sqrt() * (k[4] * r2 + k[5] * r2 * r2).abs();
    assert!(moved > 3.0, "corners move by {moved} px");

    let (dir, _) = make(&options(9, &[Effect::Cameras]));
    let model = Model::read(dir.path());
    assert_eq!(model.cameras.len(), 3);
    let mut used = [0; 3];
    for shot in model.images.values() {
        let (_, size, _) = &model.cameras[&shot.camera];
        let photo = image::open(dir.path().join("images").join(&shot.name)).unwrap();
        assert_eq!((f64::from(photo.width()), f64::from(photo.height())), (size.x, size.y));
        used[shot.camera as usize - 1] += 1;
    }
    assert_eq!(used, [3, 3, 3]);
}
