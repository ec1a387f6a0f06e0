//! Each detector on a scene that calls for its effect, and on scenes that do not.

use crate::support::runs::config;
use crate::support::shared;
use qirf_vk::effects::{Decision, Effect, Overrides, is_on};
use qirf_vk::job::Silent;
use qirf_vk::pipeline::effects::{decide, examine};
use qirf_vk::pipeline::prepare;
use qirf_vk::scene::{OpenOptions, PhotoMemory, Scene};
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
    let (_, gains) = decide(&prepared, &config).unwrap();
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
