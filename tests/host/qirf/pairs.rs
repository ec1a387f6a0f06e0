//! Merging by pairs: counts, order, moments, and hard cases.

use qirf_vk::gaussians::Gaussians;
use qirf_vk::qirf::pairs::{PairCounts, Pairs, merge};
use qirf_vk::response::Score;
use qirf_vk::scene::camera::Camera;

const DILATION: f32 = 0.3;

fn cameras() -> Vec<Camera> {
    let eye = |x: f64, z: f64| {
        Camera::look_at(glam::DVec3::new(x, 0.0, z), glam::DVec3::ZERO, glam::DVec3::NEG_Y, 0.8, 100, 100)
    };
    vec![eye(0.0, 4.0), eye(4.0, 0.0), eye(-4.0, 0.5)]
}

/// A sheet of side x side discs in two colours.
fn sheet(side: usize) -> Gaussians {
    let mut model = Gaussians::zeroed(side * side, 1);
    for i in 0..side * side {
        let (x, y) = ((i % side) as f32, (i / side) as f32);
        model.means[i] = [0.05 * x, 0.05 * y, 0.001 * ((7 * i) % 5) as f32];
        model.log_scales[i] = [0.04_f32.ln(), 0.04_f32.ln(), 0.002_f32.ln()];
        model.rotations[i] = [1.0, 0.0, 0.0, 0.0];
        model.opacity_logits[i] = 1.0;
        model.sh[0][3 * i] = if x < 0.5 * side as f32 { 1.0 } else { -1.0 };
        model.sh[1][9 * i + 4] = 0.1 * x;
    }
    model
}

/// Equal scores for all.
fn even(model: &Gaussians) -> Vec<Score> {
    let score = Score { contribution: 20.0, squares: 6.0, hits: 60.0, behind: [10.0; 3], ..Score::default() };
    vec![score; model.len()]
}

fn kept(pairs: &Pairs) -> Vec<usize> {
    (0..pairs.keep.len()).filter(|i| pairs.keep[*i]).collect()
}

#[test]
fn as_many_as_wanted_are_kept_and_every_time_the_same() {
    let model = sheet(20);
    for target in [1, 2, 40, 112, 399, 400, 1000] {
        let pairs = merge(&model, &even(&model), &cameras(), DILATION, target);
        assert_eq!(kept(&pairs).len(), target.min(400), "{target}");
        let PairCounts { clusters, merged, dropped } = pairs.counts;
        assert_eq!((merged, dropped), (400 - target.min(400), 0), "{target}");
        assert!(clusters <= target && (clusters > 0) == (target < 400));
        assert!(pairs == merge(&model, &even(&model), &cameras(), DILATION, target));
        let few = pairs.model.select(&kept(&pairs));
        few.validate().unwrap();
        assert_eq!(few.undrawable(), 0);
    }
}

#[test]
fn neighbours_of_one_colour_merge() {
    let model = sheet(20);
    let pairs = merge(&model, &even(&model), &cameras(), DILATION, 100);
    for i in kept(&pairs) {
        let red = pairs.model.sh[0][3 * i];
        assert!((red.abs() - 1.0).abs() < 1e-6, "{i}: {red}, of two colours");
        let [a, b, c] = pairs.model.log_scales[i].map(f32::exp);
        assert!(a.min(b).min(c) < 0.01, "{i}: clusters stay flat");
    }
}

/// A cluster of two has their mean, covariance and colours, weighted by their contributions to the pictures.
#[test]
fn moments_are_those_of_both() {
    let mut model = sheet(2).select(&[0, 1]);
    model.rotations[1] = [0.8, 0.0, 0.0, 0.6];
    let mut scores = even(&model);
    scores[1] = Score { contribution: 60.0, squares: 18.0, ..scores[1] };
    let pairs = merge(&model, &scores, &cameras(), DILATION, 1);
    assert_eq!(kept(&pairs), [1], "in the place of the more visible one");
    assert_eq!(pairs.counts, PairCounts { clusters: 1, merged: 1, dropped: 0 });
    let close = |a: f32, b: f32| assert!((a - b).abs() < 1e-6, "{a}, not {b}");
    let mean = |v: [f32; 2]| 0.25 * v[0] + 0.75 * v[1];
    for k in 0..3 {
        close(pairs.model.means[1][k], mean([model.means[0][k], model.means[1][k]]));
        close(pairs.model.sh[0][3 + k], mean([model.sh[0][k], model.sh[0][3 + k]]));
    }
    close(pairs.model.sh[1][9 + 4], mean([model.sh[1][4], model.sh[1][9 + 4]]));
    // Discs in nearly one plane, 0.05 apart along x.
    let mut axes = pairs.model.log_scales[1].map(f32::exp);
    axes.sort_by(f32::total_cmp);
    let along = (0.04_f32.powi(2) + 0.25 * 0.75 * 0.05_f32.powi(2)).sqrt();
    assert!((axes[1] - 0.04).abs() < 1e-5 && (axes[2] - along).abs() < 1e-5, "{axes:?}");
}

#[test]
fn what_no_picture_shows_goes_first() {
    let model = sheet(10);
    let mut scores = even(&model);
    (0..100).step_by(2).for_each(|i| scores[i] = Score::default());
    let pairs = merge(&model, &scores, &cameras(), DILATION, 50);
    assert!(kept(&pairs).iter().all(|i| i % 2 == 1));
    assert_eq!(pairs.counts, PairCounts { clusters: 0, merged: 0, dropped: 50 });
    assert!(pairs.model == model, "the others are as they were");
    let more = merge(&model, &scores, &cameras(), DILATION, 60);
    assert_eq!((kept(&more).len(), more.counts.dropped), (60, 40));
    let none = merge(&model, &vec![Score::default(); 100], &cameras(), DILATION, 7);
    assert_eq!(kept(&none), [0, 1, 2, 3, 4, 5, 6]);
}

/// Coincident and distant Gaussians, damaged rows and measurements, no cameras, and an empty model.
#[test]
fn hard_cases() {
    let mut model = sheet(12);
    for i in 0..40 {
        model.means[i] = model.means[0];
    }
    model.means[50] = [1e6, -1e6, 1e6];
    model.means[51][0] = f32::NAN;
    model.rotations[52] = [0.0; 4];
    model.log_scales[53] = [-60.0; 3];
    model.log_scales[54] = [20.0, -20.0, 3.0];
    model.opacity_logits[55] = f32::INFINITY;
    model.opacity_logits[56] = f32::NEG_INFINITY;
    let mut scores = even(&model);
    scores[60].contribution = f32::NAN;
    scores[61].squares = f32::INFINITY;
    scores[62].behind = [f32::NAN; 3];
    scores[63] = Score { contribution: f32::MIN_POSITIVE, squares: f32::MIN_POSITIVE, ..Score::default() };
    scores[64] = Score { contribution: 1e30, squares: 1e30, ..Score::default() };
    for cameras in [cameras(), Vec::new()] {
        for target in [1, 30, 100, 140] {
            let pairs = merge(&model, &scores, &cameras, DILATION, target);
            assert_eq!(kept(&pairs).len(), target);
            let changed: Vec<usize> =
                kept(&pairs).into_iter().filter(|i| pairs.model.means[*i] != model.means[*i]).collect();
            pairs.model.select(&changed).validate().unwrap();
        }
    }
    let empty = merge(&Gaussians::zeroed(0, 1), &[], &[], DILATION, 3);
    assert!(empty.keep.is_empty());
}
