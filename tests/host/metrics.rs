//! The metrics against published values, and on images that are hard to measure.

use crate::support::{shared, skip};
use qirf_vk::metrics::{self, Error, Image, Kind, Lpips, Networks, Range, Scores};
use std::path::{Path, PathBuf};

/// Width, height and values in [0, 1].
fn read(path: &Path) -> (usize, usize, Vec<f32>) {
    let image = image::open(path).expect("an image").to_rgb8();
    let values = image.as_raw().iter().map(|&v| f32::from(v) / 255.0).collect();
    (image.width() as usize, image.height() as usize, values)
}

/// A smooth picture with some noise.
fn picture(width: usize, height: usize, seed: u32) -> Vec<f32> {
    let mut state = seed;
    (0..width * height * 3)
        .map(|i| {
            state = state.wrapping_mul(1664525).wrapping_add(1013904223);
            let (x, y) = ((i / 3 % width) as f32, (i / 3 / width) as f32);
            let noise = (state >> 8) as f32 / (1 << 24) as f32;
            0.4 + 0.3 * (x * 0.1 + seed as f32).sin() * (y * 0.07).cos() + 0.2 * noise
        })
        .collect()
}

/// The VGG16 weights made by tools/lpips-weights, if present.
fn found_vgg() -> Option<Lpips> {
    Networks::find(None).expect("usable weights").vgg
}

/// The same, for tests that need the weights.
fn vgg() -> Option<Lpips> {
    let vgg = found_vgg();
    if vgg.is_none() {
        skip("no VGG weights: run tools/lpips-weights, or set QIRF_LPIPS");
    }
    vgg
}

fn alex() -> Option<Lpips> {
    Some(Lpips::load(shared("lpips/lpips-alex.safetensors")?).expect("AlexNet weights"))
}

/// The two distances of the example images.
fn examples(lpips: &Lpips, folder: &Path) -> [f64; 2] {
    let (width, height, reference) = read(&folder.join("ex_ref.png"));
    let reference = Image::new(width, height, &reference).unwrap();
    ["ex_p0.png", "ex_p1.png"].map(|name| {
        let (width, height, other) = read(&folder.join(name));
        let other = Image::new(width, height, &other).unwrap();
        assert_eq!(lpips.distance(&reference, &reference, Range::Symmetric).unwrap(), 0.0);
        lpips.distance(&reference, &other, Range::Symmetric).unwrap()
    })
}

#[test]
fn networks_hit_the_published_values() {
    let Some(folder) = shared("lpips") else { return };
    let networks = [(alex(), Kind::Alex, 31, [0.721881, 0.137566]), (vgg(), Kind::Vgg, 16, [0.568613, 0.421664])];
    for (lpips, kind, least, published) in networks {
        let Some(lpips) = lpips else { continue };
        assert_eq!((lpips.kind(), lpips.least_size()), (kind, least));
        let found = examples(&lpips, &folder);
        println!("{kind:?}: {found:?}");
        for (found, wanted) in found.into_iter().zip(published) {
            assert!((found - wanted).abs() < 1e-5, "{found}, published {wanted}");
        }
    }
}

/// Files in a folder of their own.
fn file(folder: &tempfile::TempDir, name: &str, bytes: &[u8]) -> PathBuf {
    let path = folder.path().join(name);
    std::fs::write(&path, bytes).unwrap();
    path
}

#[test]
fn hard_images() {
    let networks = Networks { vgg: found_vgg(), alex: alex() };
    for (width, height) in [(1, 1), (11, 11), (11, 3), (1, 200), (15, 16), (17, 31), (31, 33)] {
        let count = width * height * 3;
        let pictures = [vec![0.0; count], vec![1.0; count], vec![f32::NAN; count], picture(width, height, 3)];
        for (i, a) in pictures.iter().enumerate() {
            // Against itself and against the picture that is not flat.
            for (j, b) in pictures.iter().enumerate().filter(|&(j, _)| j == i || j == 3) {
                let (a, b) = (Image::new(width, height, a).unwrap(), Image::new(width, height, b).unwrap());
                let scores = metrics::evaluate(&a, &b, &networks).unwrap();
                let lpips = [scores.lpips_vgg, scores.lpips_vgg_normalized, scores.lpips_alex];
                let figures = [scores.psnr, scores.ssim].into_iter().chain(lpips).flatten();
                assert!(figures.into_iter().all(f64::is_finite), "{width} x {height}, {i} {j}: {scores:?}");
                assert!((-1.0..=1.0 + 1e-12).contains(&scores.ssim.unwrap()));
                if i == j {
                    assert_eq!((scores.psnr, scores.ssim), (None, Some(1.0)));
                    assert!(lpips.into_iter().flatten().all(|v| v == 0.0));
                    assert!(scores.notes[0].contains("identical"));
                }
                let (least, small) = (width.min(height), scores.notes.iter().any(|n| n.contains("needs images")));
                assert_eq!(scores.lpips_vgg.is_some(), networks.vgg.is_some() && least >= 16);
                assert_eq!(scores.lpips_alex.is_some(), networks.alex.is_some() && least >= 31);
                assert_eq!(small, (networks.vgg.is_some() && least < 16) || (networks.alex.is_some() && least < 31));
            }
        }
    }
}

#[test]
fn small_images_are_a_typed_error() {
    let Some(lpips) = alex() else { return };
    let values = picture(31, 30, 1);
    let image = Image::new(31, 30, &values).unwrap();
    let error = lpips.distance(&image, &image, Range::Unit).unwrap_err();
    assert!(matches!(error, Error::TooSmall { least: 31, width: 31, height: 30, .. }), "{error}");
}

#[test]
fn scores_as_json() {
    let values = picture(20, 20, 1);
    let image = Image::new(20, 20, &values).unwrap();
    let same = metrics::evaluate(&image, &image, &Networks::default()).unwrap();
    let json = serde_json::to_value(&same).unwrap();
    assert!(json["psnr"].is_null() && json["lpips_vgg"].is_null());
    assert_eq!(json["ssim"], 1.0);
    assert_eq!(serde_json::from_value::<Scores>(json).unwrap(), same);

    let view = |psnr, ssim, lpips_vgg| Scores { psnr, ssim, lpips_vgg, ..Default::default() };
    let mean = metrics::mean(&[view(Some(20.0), Some(0.5), Some(0.1)), view(None, Some(1.0), Some(0.3))]).unwrap();
    assert_eq!((mean.psnr, mean.ssim, mean.lpips_vgg, mean.lpips_alex), (Some(20.0), Some(0.75), Some(0.2), None));
    assert_eq!(mean.notes, ["psnr: mean of 1 of 2 views; it does not exist for the others"]);
    assert!(metrics::mean(&[]).is_none());
    // A photo that masks hide counts in no mean.
    let scores = [view(Some(20.0), Some(0.5), None), Scores::hidden(), view(None, Some(1.0), None)];
    let mean = metrics::mean(&scores).unwrap();
    assert_eq!((mean.psnr, mean.ssim), (Some(20.0), Some(0.75)));
    assert_eq!(mean.notes[0], "mean of 2 of 3 views: masks hide the others");
    assert!(metrics::mean(&scores[1..2]).is_none());
    assert!(Networks::default().note().unwrap().contains("no VGG16 weights"));
}

#[test]
fn broken_weights_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let message = |path: &Path| Networks::find(Some(path)).err().expect("an error").to_string();
    assert!(message(&folder.path().join("none")).contains("none"));
    assert!(message(folder.path()).contains("lpips-vgg.safetensors"));
    assert!(message(&file(&folder, "empty", b"")).contains("safetensors"));
    assert!(message(&file(&folder, "huge-claim", &u64::MAX.to_le_bytes())).contains("safetensors"));
    let header = |text: &str, data: usize| {
        let mut bytes = (text.len() as u64).to_le_bytes().to_vec();
        bytes.extend_from_slice(text.as_bytes());
        bytes.resize(bytes.len() + data, 0);
        bytes
    };
    let other = header(r#"{"x":{"dtype":"F32","shape":[1],"data_offsets":[0,4]}}"#, 4);
    assert!(message(&file(&folder, "other", &other)).contains("conv0.weight"));
    let count = 64 * 27 * 4;
    let first = format!(r#"{{"conv0.weight":{{"dtype":"F32","shape":[64,3,3,3],"data_offsets":[0,{count}]}}}}"#);
    assert!(message(&file(&folder, "short", &header(&first, count))).contains("conv0.bias"));

    let Some(lpips) = shared("lpips") else { return };
    let whole = std::fs::read(lpips.join("lpips-alex.safetensors")).unwrap();
    assert!(message(&file(&folder, "cut", &whole[..whole.len() - 5])).contains("safetensors"));
    let mut nan = whole.clone();
    let end = nan.len();
    nan[end - 4..].copy_from_slice(&f32::NAN.to_le_bytes());
    assert!(message(&file(&folder, "nan", &nan)).contains("lin4 holds NaN at element 255"));
    // The right file under the other network's name.
    file(&folder, "lpips-vgg.safetensors", &whole);
    assert!(message(folder.path()).contains("holds the alex network"));
    let found = Networks::find(Some(&file(&folder, "whole", &whole))).unwrap();
    assert!(found.vgg.is_none() && found.alex.is_some());
}
