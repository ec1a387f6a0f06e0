//! Each detector on a scene that calls for its effect, and on those that do not.

use super::common::shared;
use qirf_vk::effects::{Decision, Effect, Overrides, is_on};
use qirf_vk::pipeline::effects::of_scene;
use qirf_vk::scene::{OpenOptions, Scene};
use qirf_vk::synth::{self, SynthOptions, write};
use std::path::Path;

fn decisions(path: &Path) -> Vec<Decision> {
    let decisions = of_scene(&Scene::open(path, &OpenOptions::default()).expect("a scene"));
    for d in &decisions {
        println!("  {:<16} {:<5} {:?} {}", d.name.name(), d.on, d.degree, d.evidence);
    }
    decisions
}

fn of_synth(effects: &[synth::Effect]) -> Vec<Decision> {
    let folder = tempfile::tempdir().unwrap();
    let options =
        SynthOptions { views: 32, width: 96, height: 72, points: 900, effects: effects.to_vec(), ..Default::default() };
    write(folder.path(), &options, &|_| ()).expect("a synthetic scene");
    println!("{effects:?}");
    decisions(folder.path())
}

/// What each synthetic scene was made to call for; all else, but for view dependence, it does not.
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
        let found = of_synth(&made);
        assert_eq!(found.iter().map(|d| d.name).collect::<Vec<_>>(), Effect::ALL);
        for d in found.iter().filter(|d| d.name != Effect::ViewDependence) {
            assert_eq!(d.on, Some(d.name) == called, "{made:?}: {} {}", d.name.name(), d.evidence);
            assert!(!d.forced);
        }
        match made.as_slice() {
            [Made::Matte] => assert!(!is_on(&found, Effect::ViewDependence)),
            [Made::Glossy] => assert!(is_on(&found, Effect::ViewDependence)),
            _ => {}
        }
    }
}

#[test]
fn shared_scenes_call_for_what_they_show() {
    let Some(shared) = shared() else { return };
    for (name, distortion, transparency) in [("fox", true, false), ("chair", false, true), ("snowmiku", false, false)] {
        println!("{name}");
        let found = decisions(&shared.join("scenes").join(name));
        assert_eq!(is_on(&found, Effect::Distortion), distortion, "{name}");
        assert_eq!(is_on(&found, Effect::Transparency), transparency, "{name}");
        assert!(!is_on(&found, Effect::Masks) && !is_on(&found, Effect::DepthOrder), "{name}");
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
    let (effect, choice) = Overrides::parse("depth_order=on").unwrap();
    overrides.set(effect, choice);
    assert!(overrides.check().unwrap_err().contains("depth_order"));
}
