//! The strip of land: its cameras look down from a grid, and those at one end see nothing of the other.

use super::colmap::{Model, Shot};
use super::{make, options};
use glam::DVec3;
use qirf_vk::synth::{self, Effect, Error, Kind, SynthOptions};
use std::fs;

pub fn strip(views: usize) -> SynthOptions {
    SynthOptions { kind: Kind::Terrain, points: 900, ..options(views, &[]) }
}

fn centre(shot: &Shot) -> DVec3 {
    -(shot.rotation.inverse() * shot.translation)
}

/// Greatest distance of two cameras.
fn length(model: &Model) -> f64 {
    let all: Vec<DVec3> = model.images.values().map(centre).collect();
    all.iter().flat_map(|a| all.iter().map(|b| a.distance(*b))).fold(0.0, f64::max)
}

#[test]
fn the_drone_looks_down_from_a_grid_and_a_little_ahead() {
    let (dir, report) = make(&strip(36));
    let model = Model::read(dir.path());
    assert!(report.points > 600 && model.images.len() == 36, "{report:?}");
    for shot in model.images.values() {
        // The files' world has y pointing down: the ground is y = 0, and heights are negative.
        let (eye, gaze) = (centre(shot), shot.rotation.inverse() * DVec3::Z);
        assert!((-3.5..-2.9).contains(&eye.y), "{}: {eye}", shot.name);
        assert!((0.9..0.99).contains(&gaze.y), "{}: {gaze}", shot.name);
    }
    // Three lines, flown to and fro: neighbours in a line are near, and every line is as long as the others.
    let at: Vec<DVec3> = model.images.values().map(centre).collect();
    for line in at.chunks(12) {
        assert!(line.windows(2).all(|pair| (0.5..1.0).contains(&pair[0].distance(pair[1]))));
        assert!((line[0].x - line[11].x).abs() > 7.5);
    }
    assert!(at[11].distance(at[12]) < 2.2 && at[23].distance(at[24]) < 2.2, "it turns at the ends");
    let points: Vec<f64> = model.points.values().map(|mark| -mark.place.y).collect();
    assert!(points.iter().all(|height| (-1e-3..1.2).contains(height)), "points lie on the land");
    assert!(points.iter().filter(|height| **height > 0.1).count() > 60, "and on what stands on it");
}

#[test]
fn a_strip_grows_with_its_photos_and_its_ends_share_nothing() {
    let small = |views| SynthOptions { width: 32, height: 24, points: 300, ..strip(views) };
    let [short, long] = [18, 54].map(|views| Model::read(make(&small(views)).0.path()));
    assert!(length(&long) > 2.5 * length(&short), "{} {}", length(&long), length(&short));
    for mark in long.points.values() {
        let seen: Vec<f64> = mark.track.iter().map(|(image, _)| centre(&long.images[image]).x).collect();
        let reach = seen.iter().copied().fold(f64::MIN, f64::max) - seen.iter().copied().fold(f64::MAX, f64::min);
        assert!(mark.track.len() >= 2 && reach < 0.4 * length(&long), "one point over {reach}");
    }
}

#[test]
fn a_strip_says_what_it_is() {
    let told = |options: &SynthOptions| fs::read_to_string(make(options).0.path().join("synth.json")).unwrap();
    assert!(told(&strip(2)).contains("\"kind\": \"terrain\""));
    assert!(!told(&options(2, &[])).contains("kind"), "the plaza's file is as it was");
}

#[test]
fn effects_of_the_plaza_are_refused() {
    let dir = tempfile::tempdir().unwrap();
    for effect in Effect::ALL {
        let asked = SynthOptions { effects: vec![effect], width: 16, height: 16, points: 0, ..strip(2) };
        let refused = synth::write(dir.path(), &asked, &|_| ());
        let plaza = [Effect::Masks, Effect::Scales, Effect::Alpha, Effect::Fisheye].contains(&effect);
        assert_eq!(matches!(refused, Err(Error::NotThere { .. })), plaza, "{effect}: {refused:?}");
    }
}
