//! Panoramas: each is cut into the six faces of a cube, which belong together.

use std::f64::consts::{PI, TAU};
use std::path::Path;

use glam::{DMat3, DQuat, DVec2, DVec3};
use qirf_vk::scene::lens::LensModel;
use qirf_vk::scene::{AlphaRole, LoadOptions, OpenOptions, Photo, Resize, Scene, Split, load_photos};

use super::open;
use crate::support::files::writers::{Model, write};

const FACES: [&str; 6] = ["back", "down", "front", "left", "right", "up"];

/// A colour for each direction of the world.
pub(super) fn colour(direction: DVec3) -> [f64; 3] {
    direction.normalize().to_array().map(|v| 127.5 + 100.0 * v)
}

/// A capture of panoramas of a world at infinity, by COLMAP's formula.
fn capture(root: &Path, names: &[&str], [width, height]: [u32; 2]) -> Vec<DMat3> {
    let turn = |i: usize| DQuat::from_euler(glam::EulerRot::YXZ, 0.7 * i as f64, 0.2, -0.1);
    let mut model = Model { cameras: Vec::new(), images: Vec::new(), points: Vec::new() };
    let size = [width, height].map(f64::from);
    model.cameras.push((1, LensModel::Equirectangular, width.into(), height.into(), size.to_vec()));
    for (i, name) in names.iter().enumerate() {
        let q = turn(i);
        let at = q * -DVec3::new(i as f64, 0.0, 0.5);
        model.images.push((i as u32 + 1, [q.w, q.x, q.y, q.z], at.to_array(), 1, (*name).to_owned(), 0));
        let picture = image::RgbImage::from_fn(width, height, |x, y| {
            let theta = TAU * ((f64::from(x) + 0.5) / size[0] - 0.5);
            let phi = PI * (0.5 - (f64::from(y) + 0.5) / size[1]);
            let ray = DVec3::new(phi.cos() * theta.sin(), -phi.sin(), phi.cos() * theta.cos());
            image::Rgb(colour(q.inverse() * ray).map(|v| v.round() as u8))
        });
        let path = root.join("images").join(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        picture.save(path).unwrap();
    }
    let of_all = |place: [f64; 3]| (place, [9, 9, 9], 0.5, (1..=names.len() as u32).collect());
    model.points = vec![of_all([0.0, 0.0, 40.0]), of_all([0.3, 30.0, 0.2]), of_all([-50.0, 3.0, 1.0])];
    write(&root.join("sparse/0"), model.binary());
    (0..names.len()).map(|i| DMat3::from_quat(turn(i))).collect()
}

/// The world's direction at a pixel's middle.
pub(super) fn direction(photo: &Photo, n: usize) -> DVec3 {
    let camera = &photo.camera;
    let (x, y) = (n as u32 % camera.width, n as u32 / camera.width);
    let ray = (DVec2::new(f64::from(x), f64::from(y)) + 0.5 - camera.principal) / camera.focal;
    camera.rotation.transpose() * ray.extend(1.0)
}

fn load(scene: &mut Scene, resize: Resize) -> Vec<Photo> {
    scene.load_photos(&LoadOptions { resize, ..LoadOptions::default() }, &|_| {}).unwrap()
}

#[test]
fn faces_show_what_the_panorama_shows() {
    let folder = tempfile::tempdir().unwrap();
    capture(folder.path(), &["walk/a.png", "walk/b.png"], [256, 128]);
    let mut scene = open(folder.path()).unwrap();
    let names: Vec<&str> = scene.views.iter().map(|view| view.name.as_str()).collect();
    let expected: Vec<String> =
        ["a", "b"].iter().flat_map(|photo| FACES.map(|face| format!("walk/{photo}.{face}.png"))).collect();
    assert_eq!(names, expected);
    for resize in [Resize::Full, Resize::Width(20)] {
        let photos = load(&mut scene, resize);
        assert_eq!(photos.len(), 12);
        let mut solid = 0.0;
        for (photo, view) in photos.iter().zip(&scene.views) {
            let first = scene.views[if view.photo_name() == "walk/a.png" { 0 } else { 6 }].camera.centre();
            assert!(photo.camera.centre().distance(first) < 1e-12, "all faces lie at one place");
            let pixels = photo.pixels.read().unwrap();
            for (n, pixel) in pixels.as_chunks::<4>().0.iter().enumerate() {
                let d = direction(photo, n);
                let off = colour(d).iter().zip(pixel).map(|(a, b)| (a - f64::from(*b)).abs()).fold(0.0, f64::max);
                assert!(off < 1.6, "{} pixel {n}: {pixel:?} is not {:?}", view.name, colour(d));
                // The share of all directions that the pixel has.
                let ray = photo.camera.rotation * d;
                solid += (ray.z / ray.length()).powi(3) / photo.camera.focal.element_product();
            }
        }
        assert!((solid / (4.0 * PI) - 2.0).abs() < 0.01, "two panoramas are two spheres: {}", solid / (4.0 * PI));
    }
}

#[test]
fn points_are_seen_by_the_faces_that_show_them() {
    let folder = tempfile::tempdir().unwrap();
    capture(folder.path(), &["a.png", "b.png", "c.png"], [64, 32]);
    let scene = open(folder.path()).unwrap();
    assert_eq!((scene.points.len(), scene.skipped.track_entries), (3, 0));
    for point in &scene.points {
        assert_eq!(point.track.len(), 3, "one face of each: {:?}", point.track);
        for view in point.track.iter().map(|v| &scene.views[*v as usize]) {
            let p = view.camera.rotation * point.position + view.camera.translation;
            assert!(p.z > 0.0 && p.truncate().abs().max_element() <= p.z, "{}: {p}", view.name);
        }
    }
}

#[test]
fn views_of_a_panorama_are_held_out_together() {
    let folder = tempfile::tempdir().unwrap();
    capture(folder.path(), &["a.png", "b.png", "c.png", "d.png"], [16, 8]);
    let mut scene = open(folder.path()).unwrap();
    let all = |photos: [usize; 2]| photos.iter().flat_map(|p| 6 * p..6 * p + 6).collect::<Vec<_>>();
    assert_eq!(scene.split(2), Split { train: all([1, 3]), test: all([0, 2]) });
    assert!(scene.split(0).test.is_empty());
    // An absent panorama is one photo, not six.
    std::fs::remove_file(folder.path().join("images/b.png")).unwrap();
    std::fs::write(folder.path().join("images/c.png"), b"no photo").unwrap();
    scene = open(folder.path()).unwrap();
    scene.require_photos().unwrap();
    assert_eq!((scene.skipped.missing_images.count, scene.views.len()), (1, 18));
    load(&mut scene, Resize::Full);
    assert_eq!((scene.skipped.damaged_images.count, scene.views.len()), (1, 12));
    assert_eq!(scene.skipped.damaged_images.examples, ["c.png"]);
    assert_eq!(scene.split(8).test, [0, 1, 2, 3, 4, 5]);
    scene.retain_views(&[true; 6]);
    assert_eq!(scene.split(8).train.len(), 6, "a single panorama is trained on");
}

#[test]
fn the_pole_is_masked() {
    let folder = tempfile::tempdir().unwrap();
    let turns = capture(folder.path(), &["a.png", "b.png"], [128, 64]);
    let options = OpenOptions { pole_mask: 50.0, ..OpenOptions::default() };
    let mut scene = Scene::open(folder.path(), &options).unwrap();
    assert!(scene.has_masks());
    let photos = load(&mut scene, Resize::Full);
    let mut hidden = 0;
    for (at, photo) in photos.iter().enumerate() {
        assert_eq!(photo.alpha_role, AlphaRole::Mask);
        for (n, pixel) in photo.pixels.read().unwrap().as_chunks::<4>().0.iter().enumerate() {
            let down = (turns[at / 6] * direction(photo, n)).angle_between(DVec3::Y).to_degrees();
            assert_eq!(pixel[3] == 0, down < 50.0, "{} pixel {n}, {down} degrees", scene.views[at].name);
            hidden += u32::from(pixel[3] == 0);
        }
    }
    assert!(hidden > 1000);
    // A mask of the panorama, which hides what is above 45 degrees, counts as well.
    let half = image::GrayImage::from_fn(128, 64, |_, y| image::Luma([if y < 16 { 0 } else { 255 }]));
    std::fs::create_dir_all(folder.path().join("masks")).unwrap();
    half.save(folder.path().join("masks/a.png")).unwrap();
    let mut scene = Scene::open(folder.path(), &options).unwrap();
    for (at, photo) in load(&mut scene, Resize::Full).iter().enumerate().take(6) {
        for (n, pixel) in photo.pixels.read().unwrap().as_chunks::<4>().0.iter().enumerate() {
            let down = (turns[0] * direction(photo, n)).angle_between(DVec3::Y).to_degrees();
            // At the mask's edge, pixels are mixed.
            if (down - 135.0).abs() > 4.0 {
                assert_eq!(pixel[3] == 0, !(50.0..135.0).contains(&down), "face {at} pixel {n}, {down} degrees");
            }
        }
    }
}

/// Alpha of a panorama hides what the stitcher did not have, beside the pole.
#[test]
fn alpha_leaves_the_pole_masked() {
    let folder = tempfile::tempdir().unwrap();
    let turns = capture(folder.path(), &["a.png"], [128, 64]);
    let file = folder.path().join("images/a.png");
    let mut picture = image::open(&file).unwrap().into_rgba8();
    picture.enumerate_pixels_mut().filter(|(_, y, _)| *y < 16).for_each(|(.., pixel)| pixel[3] = 0);
    picture.save(&file).unwrap();
    // A mask that cannot be used takes nothing from that of the faces.
    crate::support::files::writers::picture(&folder.path().join("masks/a.png"), 30, 30);
    let mut scene = Scene::open(folder.path(), &OpenOptions { pole_mask: 50.0, ..OpenOptions::default() }).unwrap();
    let photos = scene.load_photos(&LoadOptions::default(), &|_| {}).unwrap();
    let notes = scene.skipped.summary().join("; ");
    assert!(notes.contains("are transparent: masked in faces") && !notes.contains("are not used"), "{notes}");
    for (photo, view) in photos.iter().zip(&scene.views) {
        assert_eq!(photo.alpha_role, AlphaRole::Mask);
        for (n, pixel) in photo.pixels.read().unwrap().as_chunks::<4>().0.iter().enumerate() {
            let d = direction(photo, n);
            let down = (turns[0] * d).angle_between(DVec3::Y).to_degrees();
            // At 135 degrees, pixels are mixed.
            if (down - 135.0).abs() > 4.0 {
                let shown = (50.0..135.0).contains(&down);
                assert_eq!(pixel[3], if shown { 255 } else { 0 }, "{} pixel {n}, {down} degrees", view.name);
            }
        }
    }
    // Photos that are transparent throughout are taken as opaque.
    let mut nothing = picture.clone();
    nothing.pixels_mut().for_each(|pixel| pixel[3] = 0);
    nothing.save(&file).unwrap();
    let up = scene.views.iter().find(|view| view.name == "a.up.png").unwrap();
    let shown = up.load_photo(Resize::Full).unwrap().pixels.read().unwrap().to_vec();
    assert!(shown.iter().skip(3).step_by(4).all(|counts| *counts == 255));
    picture.save(&file).unwrap();
    // A task that sees one face has the same pixels.
    let whole = photos[0].pixels.read().unwrap().to_vec();
    let alone = LoadOptions { alpha: Some(false), ..LoadOptions::default() };
    let alone = load_photos(&[&scene.views[0]], &alone, &|_| ()).unwrap().photos.remove(0).unwrap();
    assert_eq!(alone.pixels.read().unwrap().to_vec(), whole);
}

#[test]
fn nerfstudio_panoramas_need_no_focal_length() {
    let folder = tempfile::tempdir().unwrap();
    crate::support::files::writers::picture(&folder.path().join("images/p.png"), 64, 32);
    let frame = r#"{"file_path": "images/p.png", "transform_matrix": [[1,0,0,0],[0,1,0,0],[0,0,1,2],[0,0,0,1]]}"#;
    for more in ["", r#""w": 64, "h": 32, "fl_x": 32.0, "fl_y": 32.0, "#] {
        let json = format!(r#"{{{more}"camera_model": "EQUIRECTANGULAR", "frames": [{frame}]}}"#);
        write(folder.path(), [("transforms.json", json.into_bytes())]);
        let mut scene = open(folder.path()).unwrap();
        let photos = load(&mut scene, Resize::Full);
        assert_eq!(photos.len(), 6);
        // OpenGL's camera looks along -z: that is where the middle of the panorama lies.
        let front = scene.views.iter().position(|view| view.name == "images/p.front.png").unwrap();
        assert!((scene.views[front].camera.rotation.row(2) - DVec3::NEG_Z).length() < 1e-12);
        let middle = photos[front].pixels.at(8 * 16 + 8).unwrap();
        assert!(middle[0].abs_diff(128) < 6 && middle[1].abs_diff(128) < 10, "{middle:?}");
    }
}

#[test]
fn panoramas_without_their_poles_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    capture(folder.path(), &["a.png", "b.png"], [64, 22]);
    let error = Scene::open(folder.path(), &OpenOptions::default()).unwrap_err().to_string();
    assert!(error.contains("a panorama is twice as wide as high") && error.contains("-extent 64x32"), "{error}");
}
