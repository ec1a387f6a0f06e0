//! Real files of the shared data.

use std::path::Path;
use std::time::Instant;

use qirf_vk::gaussians::Gaussians;
use qirf_vk::gaussians::formats::{self, Format, Loaded};

use crate::support::shared;

use super::writers::{angle, assert_within_spz};

fn load(path: &Path) -> Loaded {
    let start = Instant::now();
    let loaded = formats::read(path).unwrap_or_else(|error| panic!("{error}"));
    let (n, degree) = (loaded.gaussians.len(), loaded.gaussians.degree());
    println!("{}: {n}, SH {degree}, {:?}, {:?}", path.display(), start.elapsed(), loaded.repairs);
    loaded.gaussians.validate().unwrap();
    loaded
}

fn sigmoid(x: f32) -> f32 {
    1.0 / (1.0 + (-x).exp())
}

#[test]
fn every_model_loads() {
    let Some(shared) = shared("") else { return };
    let cases = [
        ("models/flowers_lod2_93k_sh2.ply", 92_802, 2, Format::Ply),
        ("models/guitar_91k_sh0.ply", 90_854, 0, Format::Ply),
        ("models/playbot_lod3_31k_sh2.ply", 31_000, 2, Format::Ply),
        ("models/playbot-sog/3_0", 31_000, 2, Format::Sog),
        ("models/biker.spz", 152_746, 0, Format::Spz),
        ("golden/needles-sh3/model.ply", 1200, 3, Format::Ply),
    ];
    for (name, n, degree, format) in cases {
        let loaded = load(&shared.join(name));
        let m = &loaded.gaussians;
        assert_eq!(
            (m.len() + loaded.repairs.non_finite_rows, m.degree(), loaded.format),
            (n, degree, format),
            "{name}"
        );
    }
}

#[test]
fn biker_holds_infinite_logits() {
    let Some(shared) = shared("") else { return };
    let loaded = load(&shared.join("models/biker.spz"));
    assert!(loaded.repairs.clamped_opacities > 0);
    assert!(loaded.gaussians.opacity_logits.iter().all(|logit| logit.abs() <= 20.0));
    assert!(loaded.repairs.to_string().contains("infinite opacity logits clamped"));
}

#[test]
fn three_splats_agree_in_three_formats() {
    let Some(shared) = shared("") else { return };
    let file = |extension: &str| {
        load(&shared.join(format!("fixtures/three-splats/test-splat.3-points-from-train.{extension}"))).gaussians
    };
    let ply = file("ply");
    assert_within_spz(&ply, &file("spz"), 2f32.powi(-12));
    let splat = file("splat");
    assert_eq!(splat.means, ply.means);
    for i in 0..3 {
        for axis in 0..3 {
            assert!((splat.log_scales[i][axis] - ply.log_scales[i][axis]).abs() < 1e-5);
            // Its writer truncates colours to 8 bits.
            assert!((splat.sh[0][3 * i + axis] - ply.sh[0][3 * i + axis]).abs() < 1.01 / 255.0 / 0.282);
        }
        assert!((sigmoid(splat.opacity_logits[i]) - sigmoid(ply.opacity_logits[i])).abs() < 1.01 / 255.0);
        // A truncated step of 1/128 in each of four components.
        assert!(angle(splat.rotations[i], ply.rotations[i]) < 2.0 * 2.0 / 128.0);
    }
}

#[test]
fn minimal_formats_agree() {
    let Some(shared) = shared("") else { return };
    let file = |name: &str| load(&shared.join("fixtures/minimal-formats").join(name)).gaussians;
    let raw = file("minimal-raw.spz");
    assert_eq!(raw, file("minimal-v2.spz"));
    let (splat, ksplat) = (file("minimal.splat"), file("minimal.ksplat"));
    assert_eq!((&splat.means, &splat.log_scales), (&ksplat.means, &ksplat.log_scales));
    assert_eq!((&splat.sh, &splat.opacity_logits), (&ksplat.sh, &ksplat.opacity_logits));
    for name in ["minimal-v3.spz", "minimal-v4.spz"] {
        let spz = file(name);
        assert_eq!(spz.means, splat.means, "{name}");
        // Two files by two writers: 8 bits of opacity, 1/16 of log-scale.
        for i in 0..4 {
            assert!((sigmoid(spz.opacity_logits[i]) - sigmoid(splat.opacity_logits[i])).abs() < 1.0 / 255.0, "{name}");
            assert!((spz.log_scales[i][0] - splat.log_scales[i][0]).abs() <= 0.5 / 16.0 + 1e-5, "{name}");
        }
    }
    // The older two were stored without the turn about x that the format requires; nothing in the files indicates it.
    for (old, new) in raw.means.iter().zip(&splat.means) {
        assert_eq!([old[0], -old[1], -old[2]], *new);
    }
}

/// For each Gaussian of `b`, the one of `a` whose mean lies within `tolerance` of it (the best scale match of several).
fn partners(a: &Gaussians, b: &Gaussians, tolerance: impl Fn(f32) -> f32) -> Vec<usize> {
    let mut by_x: Vec<usize> = (0..a.len()).collect();
    by_x.sort_by(|&i, &j| a.means[i][0].total_cmp(&a.means[j][0]));
    let gap = |i: usize, j: usize| {
        (0..3).map(|axis| (a.log_scales[i][axis] - b.log_scales[j][axis]).abs()).fold(0.0, f32::max)
    };
    (0..b.len())
        .map(|j| {
            let mean = b.means[j];
            let from = by_x.partition_point(|&i| a.means[i][0] < mean[0] - tolerance(mean[0]));
            by_x[from..]
                .iter()
                .copied()
                .take_while(|&i| a.means[i][0] <= mean[0] + tolerance(mean[0]))
                .filter(|&i| (0..3).all(|axis| (a.means[i][axis] - mean[axis]).abs() <= tolerance(mean[axis])))
                .min_by(|&i, &k| gap(i, j).total_cmp(&gap(k, j)))
                .unwrap_or_else(|| panic!("no partner for {j} at {mean:?}"))
        })
        .collect()
}

#[test]
fn playbot_sog_agrees_with_its_ply() {
    let Some(shared) = shared("") else { return };
    let ply = load(&shared.join("models/playbot_lod3_31k_sh2.ply")).gaussians;
    let sog = load(&shared.join("models/playbot-sog/3_0")).gaussians;
    // 16 bits over a range of 1.43 in sign(x) ln(1 + |x|): half a step, times 1 + |x|, and rounding.
    let step = 1.43 / 65535.0;
    let partner = partners(&ply, &sog, |x| 0.51 * step * (1.0 + x.abs()));
    let mut distinct = partner.clone();
    distinct.sort_unstable();
    distinct.dedup();
    assert_eq!(distinct.len(), ply.len(), "a partner each");
    for (j, &i) in partner.iter().enumerate() {
        // Opacity: half a step of 8 bits. Rotation: half a step of sqrt(2)/255 in three components gives a chord of at
        // most 9.6e-3 (as in SPZ), twice that as an angle.
        assert!((sigmoid(ply.opacity_logits[i]) - sigmoid(sog.opacity_logits[j])).abs() <= 0.5 / 255.0);
        assert!(angle(ply.rotations[i], sog.rotations[j]) < 1.92e-2);
        // The PLY was written from codebook values: other attributes are equal up to rounding.
        for axis in 0..3 {
            assert!((ply.log_scales[i][axis] - sog.log_scales[j][axis]).abs() < 1e-5);
        }
        for l in 0..=2 {
            let row = Gaussians::band_width(l);
            let (a, b) = (&ply.sh[l][i * row..][..row], &sog.sh[l][j * row..][..row]);
            assert!(a.iter().zip(b).all(|(x, y)| (x - y).abs() < 1e-5), "SH band {l} of {i}");
        }
    }
}
