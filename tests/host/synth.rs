//! The synthetic scene: its bytes, its geometry, and that each effect leaves its trace.

use std::{
    collections::BTreeMap,
    fs,
    path::Path,
    sync::atomic::{AtomicU64, Ordering},
};

use glam::{DQuat, DVec2, DVec3};
use qirf_vk::synth::{self, Effect, Error, SynthOptions, SynthReport};

fn options(views: usize, effects: &[Effect]) -> SynthOptions {
    SynthOptions { views, width: 64, height: 48, points: 400, effects: effects.to_vec(), ..SynthOptions::default() }
}

fn make(options: &SynthOptions) -> (tempfile::TempDir, SynthReport) {
    let dir = tempfile::tempdir().unwrap();
    let report = synth::write(dir.path(), options, &|_| ()).unwrap();
    (dir, report)
}

/// All files below a folder with their bytes.
fn bytes(dir: &Path) -> BTreeMap<String, Vec<u8>> {
    let mut found = BTreeMap::new();
    let mut open = vec![dir.to_path_buf()];
    while let Some(folder) = open.pop() {
        for entry in fs::read_dir(folder).unwrap() {
            let path = entry.unwrap().path();
            if path.is_dir() {
                open.push(path);
            } else {
                found.insert(path.strip_prefix(dir).unwrap().display().to_string(), fs::read(&path).unwrap());
            }
        }
    }
    found
}

/// A COLMAP text model, read anew here so that a fault of the writer cannot hide in a shared reader.
struct Model {
    cameras: BTreeMap<u32, (String, DVec2, Vec<f64>)>,
    images: BTreeMap<u32, Shot>,
    points: BTreeMap<u64, Mark>,
}

struct Shot {
    rotation: DQuat,
    translation: DVec3,
    camera: u32,
    name: String,
    marks: Vec<(DVec2, u64)>,
}

struct Mark {
    place: DVec3,
    colour: [f64; 3],
    track: Vec<(u32, usize)>,
}

impl Model {
    fn read(dir: &Path) -> Self {
        let lines = |name: &str| -> Vec<String> {
            let text = fs::read_to_string(dir.join("sparse/0").join(name)).unwrap();
            text.lines().filter(|l| !l.starts_with('#')).map(str::to_owned).collect()
        };
        let numbers = |words: &[&str]| -> Vec<f64> { words.iter().map(|w| w.parse().unwrap()).collect() };
        let mut model = Self { cameras: BTreeMap::new(), images: BTreeMap::new(), points: BTreeMap::new() };
        for line in lines("cameras.txt") {
            let w: Vec<_> = line.split(' ').collect();
            let n = numbers(&w[2..]);
            model.cameras.insert(w[0].parse().unwrap(), (w[1].to_owned(), DVec2::new(n[0], n[1]), n[2..].to_vec()));
        }
        for pair in lines("images.txt").chunks(2) {
            let w: Vec<_> = pair[0].split(' ').collect();
            let n = numbers(&w[1..8]);
            let marks = numbers(&pair[1].split_whitespace().collect::<Vec<_>>());
            let shot = Shot {
                rotation: DQuat::from_xyzw(n[1], n[2], n[3], n[0]),
                translation: DVec3::new(n[4], n[5], n[6]),
                camera: w[8].parse().unwrap(),
                name: w[9].to_owned(),
                marks: marks.chunks(3).map(|m| (DVec2::new(m[0], m[1]), m[2] as u64)).collect(),
            };
            model.images.insert(w[0].parse().unwrap(), shot);
        }
        for line in lines("points3D.txt") {
            let n = numbers(&line.split(' ').collect::<Vec<_>>());
            let track = n[8..].chunks(2).map(|t| (t[0] as u32, t[1] as usize)).collect();
            let mark = Mark { place: DVec3::new(n[1], n[2], n[3]), colour: [n[4], n[5], n[6]], track };
            model.points.insert(n[0] as u64, mark);
        }
        model
    }

    fn project(&self, shot: &Shot, p: DVec3) -> DVec2 {
        let q = shot.rotation * p + shot.translation;
        assert!(q.z > 0.0, "an observed point lies behind its camera");
        let (model, _, k) = &self.cameras[&shot.camera];
        let u = q.truncate() / q.z;
        let r2 = u.length_squared();
        let bent = match model.as_str() {
            "PINHOLE" => u,
            "OPENCV" => {
                let radial = 1.0 + k[4] * r2 + k[5] * r2 * r2;
                DVec2::new(
                    u.x * radial + 2.0 * k[6] * u.x * u.y + k[7] * (r2 + 2.0 * u.x * u.x),
                    u.y * radial + 2.0 * k[7] * u.x * u.y + k[6] * (r2 + 2.0 * u.y * u.y),
                )
            }
            "OPENCV_FISHEYE" => {
                let theta = r2.sqrt().atan();
                let t2 = theta * theta;
                let bent = theta * (1.0 + t2 * (k[4] + t2 * (k[5] + t2 * (k[6] + t2 * k[7]))));
                u * (bent / r2.sqrt())
            }
            other => panic!("unexpected camera model {other}"),
        };
        bent * DVec2::new(k[0], k[1]) + DVec2::new(k[2], k[3])
    }

    /// Distance in focal lengths of each camera that sees a point: the size of its pixel there.
    fn footprints(&self, mark: &Mark) -> Vec<f64> {
        let size = |(image, _): &(u32, usize)| {
            let shot = &self.images[image];
            (shot.rotation * mark.place + shot.translation).length() / self.cameras[&shot.camera].2[0]
        };
        mark.track.iter().map(size).collect()
    }

    /// Median over points of the ratio of the coarsest to the finest footprint.
    fn footprint_ratio(&self) -> f64 {
        let many = self.points.values().filter(|m| m.track.len() >= 3).map(|m| {
            let mut sizes = self.footprints(m);
            sizes.sort_by(f64::total_cmp);
            sizes[sizes.len() - 1] / sizes[0]
        });
        quantile(many.collect(), 0.5)
    }

    /// Per point the root mean square over views and channels of photo less point, in 1/255.
    fn deviations(&self, dir: &Path) -> Vec<f64> {
        let open = |s: &Shot| image::open(dir.join("images").join(&s.name)).unwrap().to_rgb8();
        let photos: BTreeMap<_, _> = self.images.iter().map(|(i, s)| (*i, open(s))).collect();
        let mut all = Vec::new();
        for mark in self.points.values().filter(|m| m.track.len() >= 4) {
            let mut sum = 0.0;
            for (image, index) in &mark.track {
                let (photo, at) = (&photos[image], self.images[image].marks[*index].0 - 0.5);
                let (x, y) = (at.x.floor(), at.y.floor());
                for c in 0..3 {
                    let pixel = |dx: f64, dy: f64| f64::from(photo.get_pixel((x + dx) as u32, (y + dy) as u32)[c]);
                    let (fx, fy) = (at.x - x, at.y - y);
                    let above = pixel(0.0, 0.0) * (1.0 - fx) + pixel(1.0, 0.0) * fx;
                    let below = pixel(0.0, 1.0) * (1.0 - fx) + pixel(1.0, 1.0) * fx;
                    sum += (above * (1.0 - fy) + below * fy - mark.colour[c]).powi(2);
                }
            }
            all.push((sum / (3 * mark.track.len()) as f64).sqrt());
        }
        all
    }
}

fn quantile(mut values: Vec<f64>, q: f64) -> f64 {
    assert!(!values.is_empty(), "no values");
    values.sort_by(f64::total_cmp);
    values[((values.len() - 1) as f64 * q).round() as usize]
}

#[test]
fn the_same_bytes_on_any_number_of_threads_and_others_for_another_seed() {
    let o = options(6, &[Effect::Masks, Effect::Exposure, Effect::Distortion]);
    let on = |threads: usize, o: &SynthOptions| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| bytes(make(o).0.path()))
    };
    let (one, two) = (on(1, &o), on(2, &o));
    assert_eq!(one.len(), 6 + 6 + 3 + 1);
    assert!(one == two, "two threads changed the files");
    let other = on(2, &SynthOptions { seed: 2, ..o });
    assert_ne!(one["images/view_0000.png"], other["images/view_0000.png"]);
}

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
fn colours_depend_on_the_view_as_the_effects_say() {
    let spread = |effects: &[Effect]| {
        let o = SynthOptions { width: 120, height: 90, points: 1200, ..options(12, effects) };
        let (dir, _) = make(&o);
        let d = Model::read(dir.path()).deviations(dir.path());
        println!(
            "{effects:?}: {} points, median {:.2}, 95 % {:.2}",
            d.len(),
            quantile(d.clone(), 0.5),
            quantile(d.clone(), 0.95)
        );
        (quantile(d.clone(), 0.5), quantile(d, 0.95))
    };
    let (matte, default, glossy) = (spread(&[Effect::Matte]), spread(&[]), spread(&[Effect::Glossy]));
    // What is left without gloss is the texture within a pixel.
    assert!(matte.0 < 8.0, "matte points change by {} of 255", matte.0);
    assert!(glossy.0 > 1.5 * matte.0, "glossy {} against matte {}", glossy.0, matte.0);
    assert!(default.0 > 1.15 * matte.0, "default {} against matte {}", default.0, matte.0);
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
fn alpha_cuts_out_the_objects() {
    let (dir, _) = make(&options(2, &[Effect::Alpha]));
    let photo = image::open(dir.path().join("images/view_0000.png")).unwrap();
    assert_eq!(photo.color(), image::ColorType::Rgba8);
    let alpha: Vec<_> = photo.to_rgba8().pixels().map(|p| p[3]).collect();
    let share = |test: fn(u8) -> bool| alpha.iter().filter(|a| test(**a)).count() as f64 / alpha.len() as f64;
    assert!(share(|a| a == 0) > 0.3 && share(|a| a == 255) > 0.05 && share(|a| a > 0 && a < 255) > 0.02);
    let (plain, _) = make(&options(2, &[]));
    assert_eq!(image::open(plain.path().join("images/view_0000.png")).unwrap().color(), image::ColorType::Rgb8);
}

#[test]
fn masks_hide_all_that_moves() {
    let (moving, report) = make(&options(6, &[Effect::Masks]));
    let (still, none) = make(&options(6, &[]));
    assert!(report.masked > 0.005 && report.masked < 0.3, "masked: {}", report.masked);
    assert_eq!(none.masked, 0.0);
    assert!(!still.path().join("masks").exists());
    let mut hidden = Vec::new();
    for i in 0..6 {
        let open = |dir: &Path, sub: &str| image::open(dir.join(format!("{sub}/view_{i:04}.png"))).unwrap();
        let mask = open(moving.path(), "masks").to_luma8();
        let (with, without) = (open(moving.path(), "images").to_rgb8(), open(still.path(), "images").to_rgb8());
        assert!(mask.pixels().any(|p| p[0] == 0), "nothing moves in view {i}");
        for (x, y, p) in mask.enumerate_pixels() {
            // Outside of the mask the photo is that of the scene without the moving object, to the byte.
            assert!(p[0] == 0 || with.get_pixel(x, y) == without.get_pixel(x, y), "view {i}: ({x}, {y}) is not hidden");
        }
        hidden.push(mask.into_raw());
    }
    hidden.sort();
    hidden.dedup();
    assert_eq!(hidden.len(), 6, "the object stood still");
}

#[test]
fn exposure_scales_the_photos_by_the_gains_it_names() {
    let (jittered, _) = make(&options(8, &[Effect::Exposure]));
    let (plain, _) = make(&options(8, &[]));
    let mark: serde_json::Value =
        serde_json::from_slice(&fs::read(jittered.path().join("synth.json")).unwrap()).unwrap();
    assert_eq!(mark["complete"], true);
    let mut greens = Vec::new();
    for photo in mark["photos"].as_array().unwrap() {
        let name = photo["name"].as_str().unwrap();
        let open = |dir: &Path| image::open(dir.join("images").join(name)).unwrap().to_rgb8();
        let (a, b) = (open(jittered.path()), open(plain.path()));
        for c in 0..3 {
            let gain = photo["gain"][c].as_f64().unwrap();
            for (p, q) in a.pixels().zip(b.pixels()) {
                let expected = (gain * f64::from(q[c])).min(255.0);
                assert!((f64::from(p[c]) - expected).abs() <= 1.2, "{name}: {} for {expected}", p[c]);
            }
        }
        greens.push(photo["gain"][1].as_f64().unwrap());
    }
    let (low, high) = (quantile(greens.clone(), 0.0), quantile(greens, 1.0));
    assert!(low > 0.82 && low < 0.95 && high > 1.05 && high < 1.21, "gains from {low} to {high}");
}

#[test]
fn lenses_and_cameras_are_as_asked_for() {
    let models = |effects: &[Effect]| -> Vec<(String, DVec2, Vec<f64>)> {
        let o = SynthOptions { width: 240, height: 180, points: 0, views: 1, effects: effects.to_vec(), seed: 1 };
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

#[test]
fn what_others_keep_in_a_folder_stays() {
    let dir = tempfile::tempdir().unwrap();
    fs::write(dir.path().join("thesis.tex"), "ten years").unwrap();
    let small = SynthOptions { width: 16, height: 16, ..options(3, &[]) };
    let refused = synth::write(dir.path(), &small, &|_| ());
    assert!(matches!(refused, Err(Error::Foreign(_))), "{refused:?}");
    fs::write(dir.path().join("synth.json"), r#"{"made_by": "a synthesizer", "options": {"views": 3}}"#).unwrap();
    assert!(matches!(synth::write(dir.path(), &small, &|_| ()), Err(Error::Foreign(_))));
    assert_eq!(bytes(dir.path()).len(), 2);
    let file = dir.path().join("thesis.tex");
    assert!(matches!(synth::write(&file, &small, &|_| ()), Err(Error::NotFolder(_))));

    // A synth scene is renewed; what the user added to it is left alone, even where it is named like a photo.
    let (scene, _) = make(&options(5, &[Effect::Masks]));
    for added in ["model.ply", "images/view_0099.png", "images/mine.png"] {
        fs::write(scene.path().join(added), "mine").unwrap();
    }
    synth::write(scene.path(), &small, &|_| ()).unwrap();
    let after = bytes(scene.path());
    assert_eq!(after["model.ply"], b"mine");
    assert_eq!(after["images/mine.png"], b"mine");
    assert_eq!(after["images/view_0099.png"], b"mine");
    assert!(!after.contains_key("images/view_0004.png") && !scene.path().join("masks").exists());
    assert_eq!(after.len(), 3 + 3 + 3 + 1);
}

#[test]
fn numbers_out_of_range_and_impossible_effects_are_refused_before_anything_is_written() {
    let parent = tempfile::tempdir().unwrap();
    let dir = parent.path().join("scene");
    let base = options(3, &[]);
    let bad = [
        SynthOptions { width: 15, ..base.clone() },
        SynthOptions { height: 1, ..base.clone() },
        SynthOptions { width: 8193, ..base.clone() },
        SynthOptions { views: 0, ..base.clone() },
        SynthOptions { views: 10_000, ..base.clone() },
        SynthOptions { points: usize::MAX, ..base.clone() },
        SynthOptions { effects: vec![Effect::Matte, Effect::Glossy], ..base.clone() },
        SynthOptions { effects: vec![Effect::Fisheye, Effect::Distortion], ..base },
    ];
    for o in bad {
        let error = synth::write(&dir, &o, &|_| ()).unwrap_err();
        assert!(matches!(error, Error::Range { .. } | Error::Conflict(..)), "{error}");
        assert!(!dir.exists());
    }
}

#[test]
fn the_smallest_scene_is_written_and_progress_counts_photos() {
    let last = AtomicU64::new(0);
    let dir = tempfile::tempdir().unwrap();
    let o = SynthOptions { views: 1, width: 16, height: 16, points: 50, ..SynthOptions::default() };
    let report = synth::write(&dir.path().join("a/b"), &o, &|n| {
        last.fetch_max(n, Ordering::Relaxed);
    });
    let report = report.unwrap();
    assert_eq!((report.photos, report.test_photos, report.points), (1, 1, 50));
    assert_eq!(last.into_inner(), 1);
}

#[test]
fn effects_have_names() {
    for effect in Effect::ALL {
        assert_eq!(effect.to_string().parse::<Effect>().unwrap(), effect);
        assert!(!effect.description().is_empty());
    }
    let error = "sparkle".parse::<Effect>().unwrap_err().to_string();
    assert!(error.contains("sparkle") && error.contains("fisheye"), "{error}");
}

/// `SYNTH_DIR=out SYNTH_EFFECTS=masks,alpha cargo test --release --test synth -- --ignored --nocapture`
#[test]
#[ignore = "writes a scene of the default size to look at"]
fn a_scene_to_look_at() {
    let Ok(dir) = std::env::var("SYNTH_DIR") else { return };
    let number = |name: &str, default: u64| std::env::var(name).map_or(default, |v| v.parse().unwrap());
    let mut o = SynthOptions::default();
    o.views = number("SYNTH_VIEWS", 48) as usize;
    o.width = number("SYNTH_WIDTH", 240) as u32;
    o.height = o.width * 3 / 4;
    let effects = std::env::var("SYNTH_EFFECTS").unwrap_or_default();
    o.effects = effects.split(',').filter(|e| !e.is_empty()).map(|e| e.parse().unwrap()).collect();
    let start = std::time::Instant::now();
    let report = synth::write(Path::new(&dir), &o, &|_| ()).unwrap();
    println!(
        "{report:?} in {:.1} s; footprints {:.2}",
        start.elapsed().as_secs_f64(),
        Model::read(Path::new(&dir)).footprint_ratio()
    );
}
