//! Initial models.

use crate::support::Random;
use crate::support::files::writers::{picture, row, write};
use glam::DVec3;
use qirf_vk::scene::camera::Camera;
use qirf_vk::scene::{LoadOptions, OpenOptions, Photo, Scene};
use qirf_vk::train::Error;
use qirf_vk::train::initialise::{Seed, from_points, of_scene, random};
use std::time::Instant;

fn points(count: usize, seed: u64) -> Vec<Seed> {
    let mut r = Random(seed);
    let mut draw = |low, high| DVec3::from([0; 3].map(|_| r.within(low, high)));
    (0..count).map(|_| Seed { position: draw(-3.0, 3.0), normal: None, colour: draw(0.0, 1.0) }).collect()
}

#[test]
fn scales_are_distances_to_three_neighbours() {
    for count in [2, 3, 4, 5, 400] {
        let points = points(count, 1);
        let model = from_points(&points);
        assert_eq!((model.len(), model.degree()), (count, 0));
        for (i, p) in points.iter().enumerate() {
            let mut squares: Vec<f64> = points
                .iter()
                .enumerate()
                .filter(|(j, _)| *j != i)
                .map(|(_, q)| p.position.distance_squared(q.position))
                .collect();
            squares.sort_by(f64::total_cmp);
            squares.truncate(3);
            let right = (squares.iter().sum::<f64>() / squares.len() as f64).sqrt().ln();
            assert!(model.log_scales[i].iter().all(|s| (f64::from(*s) - right).abs() < 1e-6), "{count}: point {i}");
            assert_eq!(model.means[i], p.position.as_vec3().to_array());
            assert_eq!(model.rotations[i], [1.0, 0.0, 0.0, 0.0]);
            assert!((1.0 / (1.0 + (-model.opacity_logits[i]).exp()) - 0.1).abs() < 1e-6);
            for c in 0..3 {
                let colour = 0.28209479177387814 * f64::from(model.sh[0][3 * i + c]) + 0.5;
                assert!((colour - p.colour[c].max(1.0 / 255.0)).abs() < 1e-6);
            }
        }
    }
}

/// At 0, a Gaussian would draw nothing, and never change.
#[test]
fn black_points_draw_something() {
    let model = from_points(&[Seed { position: DVec3::ZERO, normal: None, colour: DVec3::new(0.0, 1.0, 0.5) }]);
    let drawn: Vec<f64> = model.sh[0].iter().map(|sh| 0.28209479177387814 * f64::from(*sh) + 0.5).collect();
    assert!(drawn[0] > 0.003 && (drawn[1] - 1.0).abs() < 1e-6 && (drawn[2] - 0.5).abs() < 1e-6, "{drawn:?}");
}

/// Points of one colour get those of the photos that see them, a point that none sees that of the others; points of several colours
/// keep theirs.
#[test]
fn points_without_colours_have_those_of_the_photos() {
    let names = ["a.png", "b.png", "c.png"];
    // Before the middle camera, which is at x = 1.
    let at = |k: u32| [0.75 + 0.1 * f64::from(k % 6), 0.05 + 0.3 * f64::from(k / 6), 5.0];
    let seeds = |first: [u8; 3]| {
        let mut model = row(&names);
        let places = (0..12).map(at).chain([[1.0, 0.0, -5.0]]);
        model.points = places.map(|place| (place, [7; 3], 0.5, vec![1, 2, 3])).collect();
        model.points[0].1 = first;
        let folder = tempfile::tempdir().unwrap();
        write(&folder.path().join("sparse/0"), model.text());
        for name in names {
            picture(&folder.path().join("images").join(name), 64, 48);
        }
        let mut scene = Scene::open(folder.path(), &OpenOptions::default()).unwrap();
        let photos = scene.load_photos(&LoadOptions::default(), &|_| {}).unwrap();
        (of_scene(&scene, &photos).unwrap(), scene.skipped.summary().join("; "))
    };
    let (plain, note) = seeds([7; 3]);
    assert!(note.contains("13 points without colours, or all of one (7, 7, 7): training from them starts"), "{note}");
    for (k, seed) in (0..12).zip(&plain) {
        let [x, y] = [29 + k % 6, if k < 6 { 24 } else { 27 }]; // in the middle photo, whose colours are the medians
        let shown = DVec3::from([255 * x / 64, 255 * y / 48, 90].map(|c: u32| f64::from(c) / 255.0));
        assert!((seed.colour - shown).length() < 1e-9, "{k}: {} {shown}", seed.colour);
    }
    assert!((plain[12].colour.z - 90.0 / 255.0).abs() < 1e-9 && plain[12].colour.x > 0.1, "{}", plain[12].colour);
    let (own, note) = seeds([8; 3]);
    assert!(note.is_empty() && own[1].colour == DVec3::splat(7.0 / 255.0), "{note}");
}

/// A surface that lies in a cloud four times, each time a little aside, has Gaussians as large as those of one surface.
#[test]
fn copies_of_a_point_are_not_its_neighbours() {
    let mut r = Random(3);
    let mut clouds = [Vec::new(), Vec::new()];
    for i in 0..400 {
        let place = DVec3::new(f64::from(i % 20), f64::from(i / 20), 0.0);
        for copy in 0..4 {
            let aside = DVec3::from([0; 3].map(|_| r.within(-0.01, 0.01)));
            let seed = Seed { position: place + aside, normal: None, colour: DVec3::ZERO };
            clouds[1].push(seed);
            clouds[0].extend((copy == 0).then_some(seed));
        }
    }
    let [one, four] = clouds.map(|cloud| from_points(&cloud).log_scales);
    for (i, scales) in four.iter().enumerate() {
        assert!((scales[0] - one[i / 4][0]).abs() < 0.1, "point {i}: {scales:?} for {:?}", one[i / 4]);
    }
}

#[test]
fn points_with_normals_are_flat_along_them() {
    let balls = from_points(&points(50, 4));
    for normal in [DVec3::Z, DVec3::NEG_Z, DVec3::new(0.6, 0.0, -0.8), DVec3::NEG_Y] {
        let seeds: Vec<Seed> = points(50, 4).into_iter().map(|p| Seed { normal: Some(normal), ..p }).collect();
        let model = from_points(&seeds);
        for i in 0..model.len() {
            let ([x, y, z], [w, a, b, c]) = (model.log_scales[i], model.rotations[i]);
            assert!([x, y] == [balls.log_scales[i][0]; 2] && (z - x - 0.1_f32.ln()).abs() < 1e-5);
            let thin = glam::Quat::from_xyzw(a, b, c, w) * glam::Vec3::Z;
            assert!(thin.dot(normal.as_vec3()).abs() > 1.0 - 1e-6, "{thin} {normal}");
        }
    }
}

#[test]
fn one_point_and_none() {
    assert!(from_points(&[]).is_empty());
    let model = from_points(&points(1, 3));
    assert!(model.len() == 1 && model.log_scales[0].iter().all(|s| s.is_finite()));
}

/// The floor of 1e-7 squared units holds if points coincide, and the search time does not grow quadratically with their
/// number.
#[test]
fn coincident_points() {
    let floor = 0.5 * 1e-7_f64.ln();
    for count in [2, 4, 7, 50_000] {
        let mut all = vec![points(1, 2)[0]; count];
        all.push(Seed { position: DVec3::splat(40.0), ..all[0] });
        let began = Instant::now();
        let model = from_points(&all);
        println!("{count} coincident points: {:.2} s", began.elapsed().as_secs_f64());
        if count > 3 {
            assert!(model.log_scales[..count].as_flattened().iter().all(|s| (f64::from(*s) - floor).abs() < 1e-5));
        }
        assert!(model.log_scales.as_flattened().iter().all(|s| s.is_finite()));
        assert!(began.elapsed().as_secs_f64() < 10.0);
    }
}

/// Cameras around the origin with photos of noise; each sees most of what the others see.
fn ring(count: usize, size: [u32; 2]) -> Vec<Photo> {
    let mut r = Random(9);
    (0..count)
        .map(|i| {
            let angle = std::f64::consts::TAU * i as f64 / count as f64;
            let eye = DVec3::new(4.0 * angle.cos(), 1.0, 4.0 * angle.sin());
            let camera = Camera::look_at(eye, DVec3::new(0.0, 0.5, 0.0), DVec3::Y, 0.8, size[0], size[1]);
            let pixels: Vec<u8> = (0..size[0] * size[1] * 4).map(|_| r.within(0.0, 256.0) as u8).collect();
            Photo::opaque(camera, pixels)
        })
        .collect()
}

/// Cameras in a row, all with the same direction: their axes never meet.
fn photos_in_a_row(count: usize) -> Vec<Photo> {
    let mut views = ring(count, [40, 30]);
    for (i, view) in views.iter_mut().enumerate() {
        let eye = DVec3::new(0.3 * i as f64, 0.0, 0.0);
        view.camera = Camera::look_at(eye, eye + DVec3::Z, DVec3::NEG_Y, 0.8, 40, 30);
    }
    views
}

/// Cameras near one place, looking outward: their axes meet behind them.
fn outward(count: usize) -> Vec<Photo> {
    let mut views = ring(count, [40, 30]);
    for (i, view) in views.iter_mut().enumerate() {
        let angle = 0.1 * i as f64;
        let way = DVec3::new(angle.cos(), 0.0, angle.sin());
        view.camera = Camera::look_at(0.1 * way, way, DVec3::Y, 0.8, 40, 30);
    }
    views
}

#[test]
fn random_points_lie_where_cameras_look() {
    let scenes = [
        ("ring", ring(12, [40, 30])),
        ("row", photos_in_a_row(6)),
        ("outward", outward(8)),
        ("two", ring(24, [40, 30])[..2].to_vec()),
        ("one", ring(1, [40, 30])),
    ];
    for (name, views) in scenes {
        let seeds = random(&views, 2000, false, 3).unwrap();
        assert_eq!(seeds.len(), 2000, "{name}");
        for seed in &seeds {
            assert!(seed.position.is_finite());
            assert!(seed.colour.min_element() >= 0.0 && seed.colour.max_element() <= 1.0);
            let seen = views.iter().filter(|v| v.camera.shows(seed.position)).count();
            assert!(seen >= views.len().min(3), "{name}: {:?} is seen by {seen}", seed.position);
        }
        assert_ne!(seeds, random(&views, 2000, false, 4).unwrap(), "{name}: another seed");
        assert!(random(&views, 0, false, 1).unwrap().is_empty() && random(&views, 1, false, 1).unwrap().len() == 1);
    }
    assert!(matches!(random(&[], 100, false, 1), Err(Error::NoViews)));
}

/// A scene in small units: much of the space in view lies before the near planes, and gets no point.
#[test]
fn random_points_keep_off_the_lenses() {
    for scale in [0.005, 0.05, 0.1, 0.3] {
        let mut views = ring(12, [40, 30]);
        for view in &mut views {
            view.camera.translation *= scale;
        }
        let seeds = random(&views, 2000, false, 3).unwrap();
        assert_eq!(seeds.len(), 2000, "{scale}");
        for seed in &seeds {
            let stored = seed.position.as_vec3().as_dvec3();
            let seen = views.iter().map(|view| &view.camera).filter(|camera| camera.shows(stored));
            let near = seen.map(|camera| camera.depth(stored)).fold(f64::MAX, f64::min);
            assert!(near >= f64::from(0.2_f32), "{scale}: {near} before a camera");
        }
    }
}

/// If cameras leave no place for a point, the search soon ends with an error that says so.
#[test]
fn cameras_that_see_nothing_in_common() {
    let mut apart = ring(6, [40, 30]);
    for (i, view) in apart.iter_mut().enumerate() {
        let eye = DVec3::new(1e4 * i as f64, 0.0, 0.0);
        view.camera = Camera::look_at(eye, eye + DVec3::Z, DVec3::NEG_Y, 0.1, 40, 30);
    }
    // A ring far from the cube that Blender scenes lie in.
    let mut elsewhere = ring(12, [40, 30]);
    for view in &mut elsewhere {
        view.camera.translation -= view.camera.rotation * DVec3::splat(50.0);
    }
    for (name, views, blender) in [("apart", apart, false), ("elsewhere", elsewhere, true)] {
        let began = Instant::now();
        let error = random(&views, 3000, blender, 3).unwrap_err();
        let said = error.to_string();
        println!("{name}: {said} ({:.1} s)", began.elapsed().as_secs_f64());
        assert!(matches!(error, Error::Points { asked: 3000, found: 0..3000, .. }));
        assert!(said.contains("3000 random points"), "{said}");
    }
}

#[test]
fn blender_scenes_stay_in_their_cube() {
    let seeds = random(&ring(12, [40, 30]), 2000, true, 3).unwrap();
    assert_eq!(seeds.len(), 2000); // rays that miss the cube are redrawn
    assert!(seeds.iter().all(|s| s.position.abs().max_element() <= 1.3));
}

/// Nothing shows how far away things are: points lie as far away as in a scene of usual size.
#[test]
fn cameras_at_one_place_have_points_at_usual_distances() {
    let one = ring(1, [40, 30]);
    assert!(random(&one, 500, true, 3).unwrap().iter().all(|s| s.position.abs().max_element() <= 1.3));
    let mut turned = ring(5, [40, 30]);
    for (i, view) in turned.iter_mut().enumerate() {
        let (sin, cos) = (0.4 * i as f64).sin_cos();
        view.camera = Camera::look_at(DVec3::ZERO, DVec3::new(cos, 0.0, sin), DVec3::Y, 0.8, 40, 30);
    }
    for views in [one, turned] {
        let seeds = random(&views, 500, false, 3).unwrap();
        let view = |s: &Seed| views.iter().find(|v| v.camera.shows(s.position)).unwrap();
        let mut depths: Vec<f64> = seeds.iter().map(|s| view(s).camera.depth(s.position)).collect();
        depths.sort_by(f64::total_cmp);
        assert!(depths[0] > 1.0 && (2.0..20.0).contains(&depths[250]), "{depths:?}");
    }
}

/// The faces of a panorama see nothing in common: two panoramas are two witnesses, not twelve.
#[test]
fn two_panoramas_have_points() {
    let mut views = ring(12, [40, 40]);
    for (i, view) in views.iter_mut().enumerate() {
        let eye = DVec3::new((i / 6) as f64, 0.0, 0.0);
        let way = [DVec3::X, DVec3::Z, DVec3::Y][i % 3] * if i % 6 < 3 { 1.0 } else { -1.0 };
        let up = if i % 3 == 2 { DVec3::X } else { DVec3::Y };
        view.camera = Camera::look_at(eye, eye + way, up, std::f64::consts::FRAC_PI_2, 40, 40);
    }
    let seeds = random(&views, 500, false, 3).unwrap();
    assert!(seeds.iter().all(|s| views.iter().filter(|v| v.camera.shows(s.position)).count() >= 2));
}

#[test]
fn random_points_do_not_depend_on_threads() {
    let views = ring(12, [40, 30]);
    let with = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| (random(&views, 1000, false, 3).unwrap(), from_points(&points(1000, 4))))
    };
    let one = with(1);
    assert_eq!(one, with(4));
}

/// Points are placed at depths at which the photos agree: a wall whose colours are known.
#[test]
fn depths_on_which_the_photos_agree_are_preferred() {
    let mut views = ring(10, [64, 48]);
    let colour = |p: DVec3| {
        let cell = (p.x * 2.5).floor() as i64 * 7 + (p.y * 2.5).floor() as i64 * 13;
        [cell * 53, cell * 97, cell * 31].map(|v| v.rem_euclid(256) as u8)
    };
    for (i, view) in views.iter_mut().enumerate() {
        let eye = DVec3::new(0.5 * i as f64 - 2.5, 0.3 * (i % 3) as f64, -4.0);
        view.camera = Camera::look_at(eye, DVec3::ZERO, DVec3::NEG_Y, 0.8, 64, 48);
        let camera = &view.camera;
        let mut pixels = Vec::new();
        for n in 0..64 * 48 {
            let at = glam::DVec2::new(f64::from(n % 64) + 0.5, f64::from(n / 64) + 0.5);
            let ray = camera.rotation.transpose() * ((at - camera.principal) / camera.focal).extend(1.0);
            let centre = camera.centre();
            let [r, g, b] = colour(centre - ray * (centre.z / ray.z)); // the wall z = 0
            pixels.extend([r, g, b, 255]);
        }
        view.pixels = pixels.into();
    }
    let seeds = random(&views, 3000, false, 1).unwrap();
    let near = seeds.iter().filter(|s| s.position.z.abs() < 0.8).count() as f64 / seeds.len() as f64;
    // Log-uniform depths alone would put ln(4.8 / 3.2) / ln(15) = 15 % of them there.
    println!("{} points, {:.0} % near the wall", seeds.len(), 100.0 * near);
    assert!(near > 0.4, "{near}");
}

/// Readers refuse such points; one that came through would be a single Gaussian that density control removes.
#[test]
fn points_that_are_not_finite() {
    for bad in [f64::NAN, f64::INFINITY, 1e300] {
        let mut all = points(50, 3);
        all[7].position.y = bad;
        let model = from_points(&all);
        assert_eq!(model.len(), 50);
        let finite = |i: usize| model.log_scales[i].iter().all(|s| s.is_finite());
        assert!((0..50).filter(|i| *i != 7).all(finite), "{bad}");
    }
}
