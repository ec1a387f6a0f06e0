//! The shared scenes, if they are available.

use crate::support::shared;

use qirf_vk::scene::{AlphaRole, OpenOptions, Resize, Scene};

fn open(part: &str) -> Option<Scene> {
    Some(Scene::open(&shared(part)?, &OpenOptions::default()).unwrap())
}

#[test]
fn snowmiku() {
    let Some(mut scene) = open("scenes/snowmiku") else { return };
    scene.require_photos().unwrap();
    assert_eq!((scene.views.len(), scene.points.len()), (97, 25_784));
    assert!(scene.views.iter().all(|v| !v.undistorts() && (v.camera.width, v.camera.height) == (989, 742)));
    let split = scene.split(8);
    assert_eq!((split.train.len(), split.test.len()), (84, 13));
    // Most points lie before the cameras and within their pictures.
    let camera = &scene.views[40].camera;
    let seen = scene.points.iter().filter(|p| camera.shows(p.position)).count();
    println!("snowmiku: {seen} of 25784 points in view 40, extent {:.3}", scene.extent(&split.train));
    assert!(seen > 5_000);
}

#[test]
fn king() {
    let Some(mut scene) = open("scenes/king") else { return };
    scene.require_photos().unwrap();
    assert_eq!((scene.views.len(), scene.points.len()), (23, 1_443));
    let mut cameras: Vec<u32> = scene.views.iter().map(|v| v.camera_id).collect();
    cameras.sort_unstable();
    cameras.dedup();
    assert_eq!(cameras.len(), 23);
    assert!(scene.points.iter().all(|p| p.track.len() >= 2), "every point has its track");
    // Each point's projection into the views of its track lies within the picture: axes and order are right.
    let mut inside = (0, 0);
    for point in &scene.points {
        for &v in &point.track {
            inside.0 += usize::from(scene.views[v as usize].camera.shows(point.position));
            inside.1 += 1;
        }
    }
    println!("king: {} of {} observations inside their picture", inside.0, inside.1);
    assert_eq!(inside.0, inside.1);
}

#[test]
fn fox() {
    let Some(mut scene) = open("scenes/fox") else { return };
    assert_eq!(scene.views.len(), 67);
    scene.require_photos().unwrap();
    assert_eq!((scene.views.len(), scene.skipped.missing_images.count), (50, 17));
    let view = &scene.views[0];
    println!(
        "fox: distortion moves pixels by up to {:.2} px; ideal focal {:.1} for {:.1}, principal {:.1} for {:.1}",
        view.lens.max_displacement(),
        view.camera.focal,
        view.lens.focal,
        view.camera.principal,
        view.lens.principal
    );
    println!("{}", scene.skipped.summary().join("\n"));
    assert!(view.undistorts());
    // One of them: `shared_scenes_call_for_what_they_show` decodes more.
    let small = view.load_photo(Resize::Width(144)).unwrap();
    assert_eq!((small.camera.width, small.camera.height, small.alpha_role), (144, 256, AlphaRole::Opaque));
}

#[test]
fn chair() {
    let Some(mut scene) = open("scenes/chair") else { return };
    scene.require_photos().unwrap();
    let split = scene.split(8);
    assert_eq!((split.train.len(), split.test.len()), (100, 25));
    println!("chair: extent {:.4}", scene.extent(&split.train));
    let photo = scene.views[3].load_photo(Resize::Width(200)).unwrap();
    assert_eq!(photo.alpha_role, AlphaRole::Alpha);
    assert_eq!((photo.camera.width, photo.camera.height), (200, 200));
    assert!((scene.views[0].camera.focal.x - 1111.111).abs() < 1e-2);
}

#[test]
fn golden_scenes_open_without_photos() {
    let Some(folder) = shared("golden") else { return };
    let cases = std::fs::read_dir(folder).unwrap().flatten().filter(|e| e.path().is_dir());
    let mut opened = 0;
    for case in cases {
        let scene = Scene::open(&case.path(), &OpenOptions::default()).unwrap();
        assert!(!scene.views.is_empty() && !scene.points.is_empty());
        assert_eq!(scene.views[0].name, "view0.png");
        opened += 1;
    }
    assert!(opened >= 5);
}
