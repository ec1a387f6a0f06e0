//! Content of the photos.

use super::colmap::Model;
use super::{make, options, quantile};
use qirf_vk::synth::{Effect, SynthOptions};
use std::fs;
use std::path::Path;

#[test]
fn colours_depend_on_the_view_as_the_effects_say() {
    let spread = |effects: &[Effect]| {
        let o = SynthOptions { width: 80, height: 60, points: 1200, ..options(12, effects) };
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
    // The remaining difference without gloss is the texture within a pixel.
    assert!(matte.0 < 8.0, "matte points change by {} of 255", matte.0);
    assert!(glossy.0 > 1.5 * matte.0, "glossy {} against matte {}", glossy.0, matte.0);
    assert!(default.0 > 1.15 * matte.0, "default {} against matte {}", default.0, matte.0);
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
            // Outside the mask the photo is that of the scene without the moving object, to the byte.
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
