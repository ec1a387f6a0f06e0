//! Each detector on a scene that calls for its effect, and on scenes that do not.

use crate::support::runs::config;
use crate::support::shared;
use glam::{DVec2, DVec3};
use qirf_vk::effects::{Decision, Effect, Overrides, is_on};
use qirf_vk::job::Silent;
use qirf_vk::pipeline::effects::{add_sky, decide, examine};
use qirf_vk::pipeline::prepare::{self, Prepared};
use qirf_vk::pipeline::start::Start;
use qirf_vk::scene::{Misfit, OpenOptions, PhotoMemory, Point, Scene};
use qirf_vk::synth::{self, SynthOptions, write};
use std::path::Path;

fn decisions(path: &Path) -> Vec<Decision> {
    decisions_of(&Scene::open(path, &OpenOptions::default()).expect("a scene"))
}

fn decisions_of(scene: &Scene) -> Vec<Decision> {
    let (decisions, ..) = examine(scene).expect("photos");
    for d in &decisions {
        println!("  {:<16} {:<5} {:?} {}", d.name.name(), d.on, d.degree, d.evidence);
    }
    decisions
}

fn of_synth(views: usize, width: u32, effects: &[synth::Effect]) -> Vec<Decision> {
    let folder = tempfile::tempdir().unwrap();
    let options = SynthOptions {
        views,
        width,
        height: width * 3 / 4,
        points: 900,
        effects: effects.to_vec(),
        ..Default::default()
    };
    write(folder.path(), &options, &|_| ()).expect("a synthetic scene");
    println!("{effects:?}");
    decisions(folder.path())
}

/// Each synthetic scene calls for the effects that it was made for and, view dependence aside, for no others.
#[test]
fn synthetic_scenes_call_for_what_they_were_made_for() {
    use synth::Effect as Made;
    for (made, called) in [
        (vec![], None),
        (vec![Made::Exposure], Some(Effect::Exposure)),
        (vec![Made::Scales], Some(Effect::Antialias)),
        (vec![Made::Distortion], Some(Effect::Distortion)),
        (vec![Made::Fisheye], Some(Effect::Distortion)),
        (vec![Made::Alpha], Some(Effect::Transparency)),
        (vec![Made::Masks], Some(Effect::Masks)),
        (vec![Made::Cameras], Some(Effect::Cameras)),
        (vec![Made::Matte], None),
        (vec![Made::Glossy], None),
    ] {
        // Small pictures blur what the view changes.
        let width = if matches!(made[..], [Made::Matte | Made::Glossy]) { 96 } else { 64 };
        let found = of_synth(32, width, &made);
        assert_eq!(found.iter().map(|d| d.name).collect::<Vec<_>>(), Effect::ALL);
        for d in found.iter().filter(|d| d.name != Effect::ViewDependence) {
            // Anti-aliasing is on request only, where it would help, too.
            let is_called = d.on || d.evidence.contains("it would help");
            assert_eq!(is_called, Some(d.name) == called, "{made:?}: {} {}", d.name.name(), d.evidence);
            assert!(!d.forced);
        }
        let degree = found[0].degree;
        match made.as_slice() {
            [Made::Matte] => assert_eq!(degree, Some(1)),
            [Made::Glossy] => assert_eq!(degree, Some(3)),
            _ => {}
        }
    }
}

/// Gaussians are left out where few photos are trained on, 24 of 28, and none of them is transparent.
#[test]
fn few_photos_need_dropout() {
    for (made, on) in [(vec![], true), (vec![synth::Effect::Alpha], false)] {
        let found = of_synth(28, 64, &made);
        assert_eq!(is_on(&found, Effect::Dropout), on, "{made:?}");
    }
}

/// The gains measured on the photos equal the factors that the photos were multiplied by.
#[test]
fn gains_are_those_that_the_photos_were_made_with() {
    let folder = tempfile::tempdir().unwrap();
    let effects = vec![synth::Effect::Exposure];
    let options = SynthOptions { views: 48, width: 64, height: 48, points: 1440, effects, ..Default::default() };
    write(folder.path(), &options, &|_| ()).expect("a synthetic scene");
    let config = config(folder.path(), 60);
    let prepared = prepare::open(&config.selection()).unwrap().load(PhotoMemory::default(), &Silent).unwrap();
    let gains = decide(&prepared, &config).unwrap().0.gains.believed();
    let made: serde_json::Value =
        serde_json::from_slice(&std::fs::read(folder.path().join("synth.json")).unwrap()).unwrap();
    let of = |name: &str, c: usize| {
        let photo = made["photos"].as_array().unwrap().iter().find(|p| p["name"] == name).unwrap();
        photo["gain"][c].as_f64().unwrap().ln()
    };
    let train = prepared.scene.split(config.eval_every).train;
    let (mut apart, mut spread) = (0.0, 0.0);
    for c in 0..3 {
        let right: Vec<f64> = train.iter().map(|i| of(&prepared.scene.views[*i].name, c)).collect();
        let mean = right.iter().sum::<f64>() / right.len() as f64;
        for (right, found) in right.iter().zip(&gains) {
            apart += (right - mean - f64::from(found[c]).ln()).powi(2);
            spread += (right - mean).powi(2);
        }
    }
    let n = 3.0 * gains.len() as f64;
    let (apart, spread) = ((apart / n).sqrt(), (spread / n).sqrt());
    println!("gains spread by {spread:.4}, found to {apart:.4}");
    assert!(apart < 0.25 * spread, "{apart} {spread}");
}

/// Photos whose exposures differ much are compared by points without tracks as well; points in one spot are no start, and tell
/// nothing. Poses are corrected where they do not fit the points, unless another focal length does.
#[test]
fn captures_without_tracks_and_with_wrong_poses_tell_what_they_call_for() {
    let folder = tempfile::tempdir().unwrap();
    let options = SynthOptions { views: 24, width: 96, height: 72, points: 3000, ..Default::default() };
    write(folder.path(), &options, &|_| ()).expect("a synthetic scene");
    let config = config(folder.path(), 60);
    let opened = prepare::open_to_train(&config.selection()).unwrap();
    let mut prepared = opened.load(PhotoMemory::default(), &Silent).unwrap();
    let (told, advice) = decide(&prepared, &config).unwrap();
    assert!(advice.is_empty() && !is_on(&told.decisions, Effect::Poses), "{advice:?}");
    for (zoomed, on) in [((1.0, 2.0), true), ((1.1, 0.1), false)] {
        for view in &mut prepared.scene.views {
            view.misfit = Some(Misfit { px: 2.0, diagonal: 120.0, behind: false, reread: [f64::INFINITY; 3], zoomed });
        }
        let (told, advice) = decide(&prepared, &config).unwrap();
        assert_eq!(is_on(&told.decisions, Effect::Poses), on, "{zoomed:?}");
        assert!(advice.iter().any(|line| line.contains("disagree by 2.0 px")), "{advice:?}");
    }
    for point in &mut prepared.scene.points {
        point.track.clear();
    }
    let exposure = |prepared: &Prepared| is_on(&decide(prepared, &config).unwrap().0.decisions, Effect::Exposure);
    assert!(!exposure(&prepared));
    let gain = |k: usize| 0.45 + 0.11 * (k % 6) as f32;
    for (k, photo) in prepared.train.iter_mut().enumerate() {
        photo.pixels = photo
            .pixels
            .read()
            .unwrap()
            .iter()
            .enumerate()
            .map(|(i, byte)| if i % 4 == 3 { *byte } else { (f32::from(*byte) * gain(k)) as u8 })
            .collect();
    }
    assert!(exposure(&prepared));
    let gains = decide(&prepared, &config).unwrap().0.gains.believed();
    let apart: Vec<f32> = gains.iter().enumerate().map(|(k, found)| (found[1] / gain(k)).ln()).collect();
    let mean = apart.iter().sum::<f32>() / apart.len() as f32;
    let apart = (apart.iter().map(|a| (a - mean).powi(2)).sum::<f32>() / apart.len() as f32).sqrt();
    assert!(gains.len() == prepared.train.len() && apart < 0.12, "{apart} {gains:?}");
    for point in &mut prepared.scene.points {
        point.position = DVec3::Y * 0.1;
    }
    let note = prepared.scene.lacks_points().expect("points in one spot show nothing");
    assert!(note.contains("fall into 2 % of the middle photo: training starts from random ones"), "{note}");
    assert!(!exposure(&prepared));
}

/// A sky without points is found where photos show it, and has its colour; neither points before it nor a background of its colour leave
/// any.
#[test]
fn a_sky_without_points_calls_for_far_ones() {
    const BLUE: [u8; 3] = [60, 110, 200];
    let folder = tempfile::tempdir().unwrap();
    let options = SynthOptions {
        kind: synth::Kind::Panorama,
        views: 9,
        width: 128,
        height: 64,
        points: 3000,
        ..Default::default()
    };
    write(folder.path(), &options, &|_| ()).expect("a synthetic scene");
    let config = config(folder.path(), 60);
    let mut prepared = prepare::open(&config.selection()).unwrap().load(PhotoMemory::default(), &Silent).unwrap();
    let found = |prepared: &Prepared| {
        let told = decide(prepared, &config).unwrap().0;
        assert_eq!(is_on(&told.decisions, Effect::Sky), !told.sky.is_empty());
        told.sky
    };
    assert!(found(&prepared).is_empty());
    let up = prepared.scene.up();
    for photo in &mut prepared.train {
        let camera = photo.camera.clone();
        let is_sky = |pixel: usize| {
            let at = DVec2::new((pixel % camera.width as usize) as f64, (pixel / camera.width as usize) as f64) + 0.5;
            (camera.rotation.transpose() * camera.ray(at)).normalize().dot(up) > 0.2
        };
        let mut pixels = photo.pixels.read().unwrap().to_vec();
        for (_, pixel) in pixels.chunks_exact_mut(4).enumerate().filter(|(at, _)| is_sky(*at)) {
            pixel[..3].copy_from_slice(&BLUE);
        }
        photo.pixels = pixels.into();
    }
    assert!(found(&prepared).is_empty(), "the points lie before it");
    let middle = prepared.scene.centre(&prepared.scene.split(config.eval_every).train);
    prepared.scene.points.retain(|point| (point.position - middle).normalize().dot(up) < 0.15);
    let sky = found(&prepared);
    // At its edge, a direction may show something else.
    let right = |p: &&Point| p.colour == BLUE && (p.position - middle).normalize().dot(up) > 0.15;
    let right = sky.iter().filter(right).count();
    assert!(right > 100 && 10 * right >= 9 * sky.len(), "{right} of {}", sky.len());
    let mut decisions = decide(&prepared, &config).unwrap().0.decisions;
    let points = prepared.scene.points.len();
    add_sky(&mut decisions, sky.clone(), (&config, &Start::Points(points)), &mut prepared.scene);
    assert!(is_on(&decisions, Effect::Sky) && prepared.scene.points.len() == points + sky.len());
    prepared.scene.points.truncate(points);
    add_sky(&mut decisions, sky, (&config, &Start::Random(100)), &mut prepared.scene);
    assert!(!is_on(&decisions, Effect::Sky) && prepared.scene.points.len() == points);
    prepared.background = BLUE.map(|channel| f32::from(channel) / 255.0);
    assert!(found(&prepared).is_empty());
}

#[test]
fn shared_scenes_call_for_what_they_show() {
    const MOST: usize = 32;
    let Some(scenes) = shared("scenes") else { return };
    for (name, distortion, transparency) in
        [("fox", true, false), ("chair", false, true), ("snowmiku", false, false), ("king", false, false)]
    {
        println!("{name}");
        let mut scene = Scene::open(&scenes.join(name), &OpenOptions::default()).unwrap();
        scene.require_photos().unwrap();
        let train = scene.split(8).train;
        if train.len() > MOST {
            let keep: Vec<bool> = (0..scene.views.len()).map(|view| train[..MOST].contains(&view)).collect();
            scene.retain_views(&keep);
        }
        let found = decisions_of(&scene);
        assert_eq!(is_on(&found, Effect::Distortion), distortion, "{name}");
        assert_eq!(is_on(&found, Effect::Transparency), transparency, "{name}");
        // King's light changes with the view, which is not an exposure; the other detectors need points, which it
        // lacks.
        for off in [Effect::Masks, Effect::DepthOrder, Effect::Exposure] {
            assert!(!is_on(&found, off), "{name}");
        }
        assert_eq!(is_on(&found, Effect::Cameras), name == "king");
        // King has 20 photos to train on, the others keep 28: every eighth is held out again.
        assert_eq!(is_on(&found, Effect::Dropout), name == "king", "{name}");
    }
}

#[test]
fn overrides_are_read_or_refused() {
    let (effect, choice) = Overrides::parse("exposure=on").unwrap();
    let mut overrides = Overrides::default();
    assert!(overrides.is_empty() && overrides.forced(effect).is_none());
    overrides.set(effect, choice);
    assert_eq!(overrides.forced(Effect::Exposure), Some(true));
    let text = toml::to_string(&overrides).unwrap();
    assert_eq!(text.trim(), "exposure = \"on\"");
    assert_eq!(toml::from_str::<Overrides>(&text).unwrap(), overrides);
    overrides.set(effect, qirf_vk::effects::Choice::Auto);
    assert!(overrides.is_empty());
    for bad in ["", "exposure", "exposure=", "exposure=maybe", "sharpness=on", "=on"] {
        assert!(Overrides::parse(bad).is_err(), "{bad}");
    }
    let (effect, choice) = Overrides::parse("cameras=on").unwrap();
    overrides.set(effect, choice);
    assert!(overrides.check().unwrap_err().contains("cameras"));
}

/// Headers are reported beside the measurement, and decide nothing.
#[test]
fn exif_exposures_are_told() {
    use exif::{Field, In, Rational, Tag, Value, experimental::Writer};
    use image::ImageEncoder;
    let folder = tempfile::tempdir().unwrap();
    let options = SynthOptions { views: 9, width: 48, height: 36, points: 300, ..Default::default() };
    write(folder.path(), &options, &|_| ()).expect("a synthetic scene");
    let field = |tag, value| Field { tag, ifd_num: In::PRIMARY, value };
    let rational = |num, denom| Value::Rational(vec![Rational { num, denom }]);
    let photos = std::fs::read_dir(folder.path().join("images")).unwrap();
    let mut photos: Vec<_> = photos.map(|f| f.unwrap().path()).collect();
    photos.sort();
    for (i, photo) in photos.into_iter().enumerate() {
        // 1/100 s to 1/1600 s: four stops. One header lacks the aperture.
        let time = field(Tag::ExposureTime, rational(1, 100 << (i % 5)));
        let (aperture, iso) =
            (field(Tag::FNumber, rational(28, 10)), field(Tag::PhotographicSensitivity, Value::Short(vec![200])));
        let mut writer = Writer::new();
        writer.push_field(&time);
        writer.push_field(&iso);
        if i != 1 {
            writer.push_field(&aperture);
        }
        let mut header = std::io::Cursor::new(Vec::new());
        writer.write(&mut header, false).unwrap();
        let picture = image::open(&photo).unwrap().to_rgb8();
        let mut encoder = image::codecs::png::PngEncoder::new(std::fs::File::create(&photo).unwrap());
        encoder.set_exif_metadata(header.into_inner()).unwrap();
        let (width, height) = picture.dimensions();
        encoder.write_image(&picture, width, height, image::ExtendedColorType::Rgb8).unwrap();
    }
    let found = decisions(folder.path());
    let exposure = found.iter().find(|d| d.name == Effect::Exposure).unwrap();
    // The first and the last are held out.
    assert!(exposure.evidence.ends_with("; EXIF of 6 photos: exposures span 4.0 stops"), "{}", exposure.evidence);
    assert!(!exposure.on);
}
