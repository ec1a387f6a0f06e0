//! Writers: models read back from their files.

use std::fs;
use std::io::Cursor;
use std::path::Path;

use qirf_vk::gaussians::formats;
use qirf_vk::gaussians::{Error, Gaussians};
use qirf_vk::glam::{Mat3, Quat, Vec3};

use crate::support::files::make;

/// Asserts that `b`, read back from SPZ, equals `a` within SPZ's steps.
pub fn assert_within_spz(a: &Gaussians, b: &Gaussians, mean_step: f32) {
    assert_eq!((a.len(), a.degree()), (b.len(), b.degree()));
    let sigmoid = |x: f32| 1.0 / (1.0 + (-x).exp());
    for i in 0..a.len() {
        for axis in 0..3 {
            assert!((a.means[i][axis] - b.means[i][axis]).abs() <= mean_step * 0.51, "mean {i}");
            let scale = a.log_scales[i][axis].clamp(-10.0, 255.0 / 16.0 - 10.0);
            assert!((scale - b.log_scales[i][axis]).abs() <= 0.5 / 16.0 + 1e-5, "scale {i}");
            let (c, d) = (a.sh[0][3 * i + axis], b.sh[0][3 * i + axis]);
            let c = c.clamp(-0.5 / 0.15, 0.5 / 0.15);
            assert!((c - d).abs() <= 0.5 / 255.0 / 0.15 + 1e-5, "colour {i}");
        }
        let (p, q) = (sigmoid(a.opacity_logits[i]), sigmoid(b.opacity_logits[i]));
        assert!((p - q).abs() <= 0.5 / 255.0 + 1e-5, "opacity {i}: {p} {q}");
        // Half a step of sqrt(1/2)/511 in three components is 1.2e-3; the fourth, at least 1/2, adds up to 2.1e-3
        // across it: a chord of 2.4e-3, and a rotation turns by twice that.
        assert!(angle(a.rotations[i], b.rotations[i]) < 4.8e-3, "rotation {i}");
    }
    for l in 1..=a.degree() {
        // Half a bucket of 8 (band 1) or 16 of 256 steps over [-1, 1); the last bucket's centre, 256, is cut to 255.
        let tolerance = if l == 1 { 4.5 / 128.0 } else { 8.5 / 128.0 };
        for (x, y) in a.sh[l].iter().zip(&b.sh[l]) {
            assert!((x.clamp(-1.0, 1.0) - y).abs() <= tolerance, "band {l}: {x} {y}");
        }
    }
}

/// Angle in radians between two rotations.
pub fn angle(a: [f32; 4], b: [f32; 4]) -> f64 {
    let unit = |q: [f32; 4]| {
        let length = q.iter().map(|&c| f64::from(c).powi(2)).sum::<f64>().sqrt();
        q.map(|c| f64::from(c) / length)
    };
    let (a, b) = (unit(a), unit(b));
    let dot: f64 = a.iter().zip(b).map(|(x, y)| x * y).sum();
    // |a - +-b| = 2 sin(angle / 4), which keeps its digits near zero.
    let sign = if dot < 0.0 { -1.0 } else { 1.0 };
    let chord: f64 = a.iter().zip(b).map(|(x, y)| (x - sign * y).powi(2)).sum::<f64>().sqrt();
    4.0 * (chord / 2.0).min(1.0).asin()
}

/// Every format keeps where means count from, in itself or in the file beside it.
#[test]
fn models_of_far_worlds_keep_their_place() {
    let folder = tempfile::tempdir().unwrap();
    let origin = [500_000.0, -4_649_776.25, 312.5];
    let model = make::model(300, 1);
    let names = ["a.ply", "a.compressed.ply", "a.glb", "a.usda", "a.usdz", "a.spz", "a.sog"];
    for name in names {
        let path = folder.path().join(name);
        formats::write_at(&path, &model, formats::RenderMode::Plain, origin).unwrap();
        let bytes = fs::read(&path).unwrap();
        let (read, alone) = (formats::read(&path).unwrap(), formats::read_bytes(&bytes, &path).unwrap());
        assert_eq!(read.origin, origin, "{name}");
        assert_eq!(alone.origin == origin, !(name.ends_with("spz") || name.ends_with("sog")), "{name}");
        if formats::is_exact(&path) {
            assert_eq!(read.gaussians.means, model.means, "{name}");
        }
        formats::write(&path, &model, formats::RenderMode::Plain).unwrap();
        assert_eq!(formats::read(&path).unwrap().origin, [0.0; 3], "{name}");
    }
}

#[test]
fn ply_round_trip_keeps_every_bit() {
    let folder = tempfile::tempdir().unwrap();
    for degree in 0..=3 {
        let mut model = make::model(5000, degree);
        model.means[1] = [-0.0, f32::MIN_POSITIVE / 4.0, f32::MAX];
        let (a, b) = (folder.path().join("a.ply"), folder.path().join("b.PLY"));
        formats::write(&a, &model, formats::RenderMode::Plain).unwrap();
        let loaded = formats::read(&a).unwrap();
        assert!(!loaded.repairs.any());
        assert_eq!(loaded.gaussians.means[1][0].to_bits(), (-0.0f32).to_bits());
        formats::write(&b, &loaded.gaussians, formats::RenderMode::Plain).unwrap();
        assert!(fs::read(&a).unwrap() == fs::read(&b).unwrap());
        assert_eq!(loaded.gaussians, model);
    }
}

/// Rows of a model, nearest first: SOG does not keep their order.
pub fn matched(a: &Gaussians, b: &Gaussians) -> Vec<(usize, usize)> {
    let distance = |i: usize, j: usize| (0..3).map(|k| (a.means[i][k] - b.means[j][k]).abs()).fold(0.0, f32::max);
    (0..a.len())
        .map(|i| (i, (0..b.len()).min_by(|j, k| distance(i, *j).total_cmp(&distance(i, *k))).unwrap()))
        .collect()
}

/// Asserts that row `i` of `a` and row `j` of `b`, of this width, differ by at most `most` in each value.
#[track_caller]
fn assert_near(a: &[f32], b: &[f32], width: usize, (i, j): (usize, usize), most: f32) {
    let (x, y) = (&a[i * width..][..width], &b[j * width..][..width]);
    assert!(x.iter().zip(y).all(|(x, y)| (x - y).abs() <= most), "{i}: {x:?} {y:?}");
}

/// The covariance of a Gaussian.
fn covariance(model: &Gaussians, i: usize) -> [f32; 9] {
    let [w, x, y, z] = model.rotations[i];
    let axes = Mat3::from_quat(Quat::from_xyzw(x, y, z, w).normalize());
    let scaled = axes * Mat3::from_diagonal(Vec3::from(model.log_scales[i].map(f32::exp)));
    (scaled * scaled.transpose()).to_cols_array()
}

/// Steps of every rung are as wide as declared; each rung takes more bytes than the previous one, and loses less.
#[test]
fn rungs_of_the_ladders_lose_less_and_less() {
    let mut model = make::model(1000, 2);
    // Neighbours are similar in scenes: SH that vary with the position.
    for l in 1..=2 {
        let width = Gaussians::band_width(l);
        for i in 0..model.len() {
            for k in 0..width {
                model.sh[l][i * width + k] = 0.2 * (model.means[i][k % 3] * (1.0 + k as f32)).sin();
            }
        }
    }
    for name in ["a.sog", "a.spz"] {
        let path = Path::new(name);
        let mut last = (0, f64::INFINITY);
        for precision in formats::ladder(path, 2).coarse() {
            let version = formats::SpzVersion::default();
            let bytes =
                formats::encode(path, &model, (formats::RenderMode::Plain, [0.0; 3]), (precision, version)).unwrap();
            let back = formats::read_bytes(&bytes, path).unwrap().gaussians;
            let error: f64 = matched(&model, &back)
                .into_iter()
                .map(|(i, j)| {
                    let band = |m: &Gaussians, i: usize| m.sh[2][i * 15..(i + 1) * 15].to_vec();
                    band(&model, i).iter().zip(band(&back, j)).map(|(a, b)| f64::from(a - b).powi(2)).sum::<f64>()
                })
                .sum();
            assert!(
                bytes.len() > last.0 && error < last.1,
                "{precision:?}: {} bytes, {error} after {last:?}",
                bytes.len()
            );
            last = (bytes.len(), error);
        }
        let ladder = formats::ladder(path, 2);
        assert_eq!(ladder.steps.last(), Some(&(ladder.rungs.len() - 1)));
    }
    assert_eq!(formats::ladder(Path::new("a.ply"), 2).rungs, [formats::Precision::Fixed]);
}

/// Gaussians near the origin show the most, and coarse steps that suit them are too coarse for clusters far away.
#[test]
fn sog_holds_distant_clusters_at_every_precision() {
    let mean = |i: usize| [(i % 4) as f32 * 1e4 + (i % 97) as f32, (i % 89) as f32, (i % 83) as f32];
    let model = Gaussians::balls((0..1000).map(mean).collect(), 12.0_f32.ln(), 2.0, 0);
    let path = Path::new("a.sog");
    for precision in formats::ladder(path, 0).coarse() {
        let how = (precision, formats::SpzVersion::default());
        let bytes = formats::encode(path, &model, (formats::RenderMode::Plain, [0.0; 3]), how).unwrap();
        let back = formats::read_bytes(&bytes, path).unwrap().gaussians;
        let mut off: Vec<f32> = matched(&model, &back)
            .into_iter()
            .map(|(i, j)| (0..3).map(|a| (model.means[i][a] - back.means[j][a]).abs()).fold(0.0, f32::max))
            .collect();
        off.sort_by(f32::total_cmp);
        assert!(off[500] <= 12.0, "{precision:?}: {}", off[500]);
    }
}

/// The last three rungs take 8 to 23 % of the bytes of a model with SH, and pictures gain at most 2 dB.
#[test]
fn a_sog_with_sh_is_usually_a_few_rungs_below_the_finest() {
    let path = Path::new("a.sog");
    for degree in 0..=3 {
        let model = make::model(300, degree);
        let rungs = formats::ladder(path, degree).rungs;
        let spared = if degree == 0 { 0 } else { 3 };
        assert_eq!(formats::usual(path, &model), rungs[rungs.len() - 1 - spared], "degree {degree}");
    }
}

/// Each of these Gaussians shows as much as the others: no palette of fewer entries is faint, unless the SH are.
#[test]
fn a_sog_that_is_not_measured_has_the_palette_that_its_colours_need() {
    let path = Path::new("a.sog");
    let mut strong = make::model(300, 3);
    strong.log_scales.fill([-3.0; 3]);
    strong.opacity_logits.fill(1.0);
    let mut weak = strong.clone();
    weak.sh.iter_mut().skip(1).flatten().for_each(|x| *x *= 0.01);
    let finest = formats::ladder(path, 3).finest();
    assert_eq!(formats::unmeasured(path, &strong), finest);
    assert_eq!(formats::unmeasured(path, &weak), formats::usual(path, &weak));
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join(path);
    let (plain, how) = (formats::RenderMode::Plain, (finest, formats::SpzVersion::default()));
    formats::write(&file, &strong, plain).unwrap();
    assert!(fs::read(&file).unwrap() == formats::encode(path, &strong, (plain, [0.0; 3]), how).unwrap());
    let without = make::model(300, 0);
    assert_eq!(formats::unmeasured(path, &without), formats::usual(path, &without));
}

/// Random attributes are the worst case for codebooks; SH with few distinct rows, as in scenes, are reproduced well.
#[test]
fn sog_round_trip_stays_within_its_finest_steps() {
    let path = Path::new("a.sog");
    let finest = (formats::Precision::Fixed, formats::SpzVersion::Four);
    for degree in 0..=3 {
        let mut model = make::model(1000, degree);
        for l in 1..=degree {
            let width = Gaussians::band_width(l);
            for i in 0..model.len() {
                let like = i % 37 * width;
                model.sh[l].copy_within(like..like + width, i * width);
            }
        }
        let pack = || formats::encode(path, &model, (formats::RenderMode::Plain, [0.0; 3]), finest).unwrap();
        let first = pack();
        let loaded = formats::read_bytes(&first, path).unwrap();
        assert_eq!((loaded.format, loaded.repairs.any()), (formats::Format::Sog, false));
        let back = loaded.gaussians;
        assert_eq!((back.len(), back.degree()), (model.len(), degree));
        let sigmoid = |x: f32| 1.0 / (1.0 + (-x).exp());
        for (i, j) in matched(&model, &back) {
            // Half a step of 2 ln 4 / 65,535, four times as long at 3 units.
            assert_near(model.means.as_flattened(), back.means.as_flattened(), 3, (i, j), 9e-5);
            let (p, q) = (sigmoid(model.opacity_logits[i]), sigmoid(back.opacity_logits[j]));
            assert!((p - q).abs() <= 0.5 / 255.0 + 1e-5, "opacity {i}: {p} {q}");
            let (mut a, mut b) = (model.log_scales[i], back.log_scales[j]);
            a.sort_unstable_by(f32::total_cmp);
            b.sort_unstable_by(f32::total_cmp);
            // Half a step of 0.03.
            assert!((0..3).all(|k| (a[k] - b[k]).abs() < 0.0151), "scales {i}: {a:?} {b:?}");
            // Half a step of sqrt(2)/255 in each of three components and its effect on the fourth turn by 0.026 at
            // most, and the scales' 0.015 count twice. The axes may come in another order.
            let (x, y) = (covariance(&model, i), covariance(&back, j));
            let most = x.iter().fold(0.0_f32, |m, v| m.max(v.abs()));
            assert!(x.iter().zip(y).all(|(x, y)| (x - y).abs() < 0.08 * most), "shape {i}: {x:?} {y:?}");
            for l in 0..=degree {
                assert_near(&model.sh[l], &back.sh[l], Gaussians::band_width(l), (i, j), 0.01);
            }
        }
        assert!(pack() == first, "one model, one file");
    }
}

/// Steps within chunks of 256 neighbours: a chunk of random ones spans 1.5 units and all scales.
#[test]
fn compressed_ply_round_trip_stays_within_its_steps() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.compressed.ply");
    for degree in 0..=3 {
        let mut model = make::model(1000, degree);
        model.sh.iter_mut().skip(1).flatten().enumerate().for_each(|(i, c)| *c *= (i % 5) as f32);
        formats::write(&path, &model, formats::RenderMode::AntiAliased).unwrap();
        let loaded = formats::read(&path).unwrap();
        assert_eq!((loaded.format, loaded.mode), (formats::Format::CompressedPly, formats::RenderMode::AntiAliased));
        let back = loaded.gaussians;
        assert_eq!((back.len(), back.degree()), (1000, degree));
        let sigmoid = |x: f32| 1.0 / (1.0 + (-x).exp());
        for (i, j) in matched(&model, &back) {
            assert_near(model.means.as_flattened(), back.means.as_flattened(), 3, (i, j), 6.0 / 2046.0);
            let [scales, scales_back] = [&model, &back].map(|m| m.log_scales.as_flattened());
            assert_near(scales, scales_back, 3, (i, j), 0.51 * 4.0 / 1023.0);
            assert_near(&model.sh[0], &back.sh[0], 3, (i, j), 0.51 * 1.8 / 255.0);
            assert!((sigmoid(model.opacity_logits[i]) - sigmoid(back.opacity_logits[j])).abs() <= 0.5 / 255.0 + 1e-5);
            // Half a step of sqrt(2)/1023 in three components, their effect on the fourth, and twice that as an angle.
            assert!(angle(model.rotations[i], back.rotations[j]) < 0.0066, "rotation {i}");
            for l in 1..=degree {
                assert_near(&model.sh[l], &back.sh[l], Gaussians::band_width(l), (i, j), 4.01 / 256.0);
            }
        }
        // Repacked chunk by chunk, it gives the same words.
        let first = fs::read(&path).unwrap();
        formats::write(&path, &model, formats::RenderMode::AntiAliased).unwrap();
        assert!(fs::read(&path).unwrap() == first);
    }
}

/// Also where one Gaussian's long numbers, 256 times in each codebook, are most of the text.
#[test]
fn sog_deflates_its_text_alone() {
    let mut long = make::model(1, 1);
    long.sh.iter_mut().flatten().for_each(|x| *x = 1.234_567_9e17);
    let (path, place) = (Path::new("a.sog"), (formats::RenderMode::Plain, [0.0; 3]));
    let how = (formats::Precision::Fixed, formats::SpzVersion::Four);
    for model in [make::model(1, 1), long] {
        let file = formats::encode(path, &model, place, how).unwrap();
        let mut archive = zip::ZipArchive::new(Cursor::new(&file[..])).unwrap();
        for k in 0..archive.len() {
            let entry = archive.by_index(k).unwrap();
            let is_text = entry.name().unwrap() == "meta.json";
            assert_eq!(entry.compression() == zip::CompressionMethod::Deflated, is_text);
            assert!(!is_text || 3 * entry.compressed_size() < 2 * entry.size(), "{} bytes", entry.compressed_size());
        }
        assert_eq!(formats::read_bytes(&file, path).unwrap().gaussians.len(), 1);
    }
}

/// By Gaussians; values that were cut off when they were stored are not cut off again.
#[test]
fn spherical_harmonics_that_a_format_cuts_off_are_counted() {
    let mut model = make::model(50, 2);
    (model.sh[1][9 * 3], model.sh[2][15 * 3 + 1], model.sh[2][15 * 7]) = (-1.5, 4.5, 2.0);
    // In band 0, SPZ rounds 3.34 by less than half a step.
    (model.sh[0][3 * 9], model.sh[0][3 * 11 + 2]) = (-3.4, 3.34);
    for (name, clipped) in
        [("a.spz", 3), ("a.html", 3), ("a.compressed.ply", 1), ("a.ply", 0), ("a.sog", 0), ("a.glb", 0), ("a.obj", 0)]
    {
        let path = Path::new(name);
        assert_eq!(formats::clipped(path, &model), clipped, "{name}");
        assert_eq!(formats::clip_warning(path, clipped).is_some(), clipped > 0, "{name}");
        let how = (formats::usual(path, &model), formats::SpzVersion::Four);
        if let Ok(file) = formats::encode(path, &model, (formats::RenderMode::Plain, [0.0; 3]), how) {
            let back = formats::read_bytes(&file, path).unwrap().gaussians;
            assert_eq!(formats::clipped(path, &back), 0, "{name}");
        }
    }
    let said = formats::clip_warning(Path::new("a.compressed.ply"), 1).unwrap();
    assert!(said.starts_with("a.compressed.ply: 1 Gaussian has "), "{said}");
    assert!(said.contains("beyond the +-4 that compressed PLY stores; its colours are cut off"), "{said}");
    let said = formats::clip_warning(Path::new("a.spz"), 2).unwrap();
    assert!(said.contains("beyond the +-1 that SPZ stores (+-3.3 in band 0); their colours are cut off"), "{said}");
}

#[test]
fn sog_refuses_what_it_would_ruin() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.sog");
    let mut model = make::model(500, 0);
    model.log_scales.iter_mut().flatten().for_each(|x| *x -= 12.0);
    let text = formats::write(&path, &model, formats::RenderMode::Plain).unwrap_err().to_string();
    assert!(text.contains("16 bits") && text.contains("write .ply") && !path.exists(), "{text}");
}

#[test]
fn odd_values_are_written_without_panic() {
    let folder = tempfile::tempdir().unwrap();
    let mut model = make::model(8, 3);
    model.rotations[0] = [0.0; 4];
    model.rotations[1] = [1e20, -1e20, 1e-20, 0.0];
    model.rotations[2] = [f32::NAN; 4];
    model.opacity_logits[3] = f32::INFINITY;
    model.log_scales[4] = [f32::NEG_INFINITY, f32::INFINITY, f32::NAN];
    model.sh[2][7] = f32::NAN;
    model.sh[1][3] = 1e30;
    for name in ["a.ply", "a.compressed.ply", "a.spz", "a.sog", "a.glb", "a.usda", "a.usdz"] {
        formats::write(&folder.path().join(name), &model, formats::RenderMode::Plain).unwrap();
    }
    for empty in [Gaussians::default(), Gaussians::zeroed(0, 3)] {
        for name in ["e.ply", "e.compressed.ply", "e.spz", "e.sog", "e.glb", "e.usda", "e.usdz"] {
            formats::write(&folder.path().join(name), &empty, formats::RenderMode::Plain).unwrap();
            assert!(formats::read(&folder.path().join(name)).unwrap().gaussians.is_empty());
        }
    }
}

#[test]
fn bad_requests_are_refused_and_write_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let model = make::model(3, 1);
    let path = folder.path().join("a.obj");
    assert!(matches!(formats::write(&path, &model, formats::RenderMode::Plain), Err(Error::Unsupported { .. })));
    let mut torn = model.clone();
    torn.sh[1].pop();
    assert!(matches!(
        formats::write(&folder.path().join("a.ply"), &torn, formats::RenderMode::Plain),
        Err(Error::Inconsistent { .. })
    ));
    let nowhere = folder.path().join("absent").join("a.ply");
    assert!(matches!(formats::write(&nowhere, &model, formats::RenderMode::Plain), Err(Error::Io { .. })));
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0);
}
