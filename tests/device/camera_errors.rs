//! Held-out cameras fitted to a model's own pictures: moved ones are found again, right ones stay.

use crate::support::synthetic::small_camera;
use crate::support::{Random, device, finish};
use glam::DVec3;
use qirf_vk::gaussians::Gaussians;
use qirf_vk::job::Session;
use qirf_vk::job::records::CameraErrors;
use qirf_vk::metrics::Networks;
use qirf_vk::pipeline::evaluate::camera_errors;
use qirf_vk::render::{Painter, Settings, Source};
use qirf_vk::scene::Photo;
use qirf_vk::scene::camera::Camera;

/// A cloud of small Gaussians of many colours.
fn cloud() -> Gaussians {
    let mut random = Random(3);
    let means = (0..1500).map(|_| [2.0, 1.5, 0.5].map(|half| random.within(-half, half) as f32));
    let mut model = Gaussians::balls(means.collect(), -3.0, 2.0, 0);
    model.sh[0].fill_with(|| random.within(-1.5, 1.5) as f32);
    model
}

/// Errors where the photo is the picture by the true camera, darkened to this share, and is given with another camera.
fn errors(motion: [DVec3; 2], light: f32) -> (CameraErrors, f64) {
    let device = device();
    let (networks, settings) = (Networks::default(), Settings::default());
    let session = Session::new(&device, &networks);
    let given = small_camera(120, 90);
    let model = cloud();
    let taken = given.moved(motion[0], motion[1]);
    let image = Painter::new(&device, settings, model.len(), [120, 90]).unwrap();
    let image = { image }.render(Source::Host(&model), &taken).unwrap();
    let byte = |v: f32| (v.clamp(0.0, 1.0) * light * 255.0).round() as u8;
    let pixels: Vec<u8> = image.pixels.iter().flat_map(|p| [byte(p[0]), byte(p[1]), byte(p[2]), 255]).collect();
    let photo = Photo::opaque(given.clone(), pixels);
    let found = camera_errors(&session, &model, &[&photo], settings, light < 1.0).unwrap().unwrap();
    // How far the motion moves the picture of the scene's middle, four units away.
    let seen = |camera: &Camera| {
        let p = camera.rotation * DVec3::new(0.1, 0.2, 0.0) + camera.translation;
        p.truncate() / p.z * camera.focal
    };
    finish(&device);
    (found, seen(&given).distance(seen(&taken)))
}

#[test]
fn moved_cameras_are_found_again() {
    for light in [1.0, 0.7] {
        let (found, moved) = errors([DVec3::new(0.012, -0.01, 0.004), DVec3::new(0.02, 0.01, -0.02)], light);
        assert!((1.0..3.0).contains(&moved), "{moved}");
        assert!((0.5 * moved..1.5 * moved).contains(&found.pixels), "{found:?}, {moved}");
        assert!(found.fitted_psnr > 42.0 && found.psnr < found.fitted_psnr - 8.0, "{found:?}");
        assert!(found.note(None, false).is_some_and(|note| note.contains("poses=on")));
    }
}

#[test]
fn right_cameras_stay() {
    for light in [1.0, 0.7] {
        let (found, _) = errors([DVec3::ZERO; 2], light);
        assert!(found.pixels < 0.05 && found.psnr > 42.0 && found.fitted_psnr >= found.psnr - 0.5, "{found:?}");
        assert_eq!(found.note(None, false), None);
    }
}
