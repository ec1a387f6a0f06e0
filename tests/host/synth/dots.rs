//! Dots: through every lens of COLMAP, a reader's pinholes show them where they are.

use glam::{DVec2, DVec3};
use qirf_vk::scene::lens::LensModel;
use qirf_vk::scene::{LoadOptions, OpenOptions, Photo, Scene};
use qirf_vk::synth::{self, Calibration, Effect, Error, Kind, SynthOptions};

use crate::support::files::writers::parameters;

/// Largest distance in pixels between a dot and where it should be.
const BOUND: f64 = 0.1;
/// Number of views, each a picture, or six if the lens needs a cube.
const VIEWS: usize = 2;
/// Distance in pixels up to which pixels belong to a dot.
const REACH: f64 = 9.0;

fn through(model: LensModel) -> SynthOptions {
    let mut lens = Calibration { model, parameters: parameters(model) };
    let (mut width, mut height) = (640, 480);
    if model == LensModel::Equirectangular {
        (width, height, lens.parameters) = (1280, 640, vec![1280.0, 640.0]);
    }
    SynthOptions {
        kind: Kind::Dots,
        views: VIEWS,
        width,
        height,
        points: 200,
        lens: Some(lens),
        ..SynthOptions::default()
    }
}

#[test]
fn every_lens_is_undone_within_a_tenth_of_a_pixel() {
    for model in LensModel::ALL {
        let folder = tempfile::tempdir().unwrap();
        synth::write(folder.path(), &through(model), &|_| ()).unwrap();
        let mut scene = Scene::open(folder.path(), &OpenOptions::default()).unwrap();
        let photos = scene.load_photos(&LoadOptions::default(), &|_| {}).unwrap();
        let (mut inside, mut missing, mut found, mut worst) = (0, 0, 0, 0.0_f64);
        for (photo, view) in photos.iter().zip(&scene.views) {
            let size = DVec2::new(f64::from(photo.camera.width), f64::from(photo.camera.height));
            // Towards a cube's corners faces stretch dots, which moves their middles.
            let margin = if photos.len() > VIEWS { 0.1 * size.x } else { REACH + 1.0 };
            // At a panorama's poles, what is round in its rows is a thin line on the sphere.
            let polar = [".up.", ".down."].iter().any(|face| view.name.contains(face));
            let at_pole = |place: DVec2| polar && place.distance(0.5 * size) < 0.25 * size.x;
            for point in &scene.points {
                let Some(place) = pixel(photo, point.position).filter(|place| !at_pole(*place)) else { continue };
                let border = place.min(size - place).min_element();
                let dot = if border < margin { None } else { centroid(photo, place) };
                // Near the border, the photo itself may not show it.
                inside += usize::from(border > 40.0);
                missing += usize::from(border > 40.0 && dot.is_none());
                if let Some(dot) = dot {
                    found += 1;
                    worst = worst.max(dot.distance(place));
                }
            }
        }
        println!("{}: {found} dots in {} pictures, at most {worst:.3} px off", model.name(), photos.len());
        assert!(found >= 15 && 20 * missing <= inside, "{}: {found}, {missing} of {inside}", model.name());
        assert!(worst < BOUND, "{}: {worst} px", model.name());
    }
}

/// Where a pinhole shows a point in front of it.
fn pixel(photo: &Photo, point: DVec3) -> Option<DVec2> {
    let camera = &photo.camera;
    let local = camera.rotation * point + camera.translation;
    (local.z > 0.1).then(|| local.truncate() / local.z * camera.focal + camera.principal)
}

/// The middle of the light around a pixel; none if there is no dot.
fn centroid(photo: &Photo, around: DVec2) -> Option<DVec2> {
    let pixels = photo.pixels.read().unwrap();
    let (mut sum, mut light) = (DVec2::ZERO, 0.0);
    for (i, pixel) in pixels.as_chunks::<4>().0.iter().enumerate() {
        let width = photo.camera.width as usize;
        let at = DVec2::new((i % width) as f64, (i / width) as f64) + 0.5;
        if at.distance(around) < REACH {
            light += f64::from(pixel[1]);
            sum += at * f64::from(pixel[1]);
        }
    }
    (light > 100.0).then(|| sum / light)
}

#[test]
fn lenses_and_dots_exclude_what_they_cannot_have() {
    let folder = tempfile::tempdir().unwrap();
    let base = through(LensModel::Radial);
    let short = Calibration { model: LensModel::Fov, parameters: vec![300.0] };
    for (options, said) in [
        (SynthOptions { lens: Some(short), ..base.clone() }, "takes 5 parameters"),
        (SynthOptions { depth: true, ..base.clone() }, "no depth maps"),
        (SynthOptions { effects: vec![Effect::Alpha], ..base.clone() }, "has no effect"),
        (
            SynthOptions { kind: Kind::Panorama, width: 64, height: 32, ..base.clone() },
            "not apply to the kind panorama",
        ),
        (
            SynthOptions { kind: Kind::Plaza, effects: vec![Effect::Fisheye], ..base },
            "--lens does not apply to the eff",
        ),
    ] {
        let error: Error = synth::write(&folder.path().join("s"), &options, &|_| ()).unwrap_err();
        assert!(error.to_string().contains(said), "{error}");
        assert!(!folder.path().join("s").exists());
    }
}
