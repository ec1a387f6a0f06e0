//! SPZ: the steps of what it stores, what it cuts off, and what it refuses.

use std::fs;
use std::path::Path;

use qirf_vk::gaussians::Error;
use qirf_vk::gaussians::formats::{self, SpzPrecision};

use super::writers::assert_within_spz;
use crate::support::files::make;

#[test]
fn spz_round_trip_stays_within_its_steps() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.spz");
    for degree in 0..=3 {
        let model = make::model(2000, degree);
        let packed = formats::spz(&model, formats::RenderMode::Plain, formats::SpzVersion::Three, &path);
        std::fs::write(&path, packed.unwrap()).unwrap();
        let three = formats::read(&path).unwrap();
        assert_eq!(&fs::read(&path).unwrap()[..2], b"\x1f\x8b");
        formats::write(&path, &model, formats::RenderMode::Plain).unwrap();
        assert_eq!(&fs::read(&path).unwrap()[..5], b"NGSP\x04");
        assert_eq!(formats::read(&path).unwrap(), three, "both versions store the same values");
        let back = three.gaussians;
        assert_within_spz(&model, &back, 2f32.powi(-12));
        // A second round trip changes nothing beyond rounding: no drift.
        formats::write(&path, &back, formats::RenderMode::Plain).unwrap();
        let again = formats::read(&path).unwrap().gaussians;
        assert_eq!((&again.means, &again.log_scales, &again.sh), (&back.means, &back.log_scales, &back.sh));
    }
}

#[test]
fn spz_fits_tiny_and_wide_models_and_refuses_what_it_would_ruin() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("a.spz");
    let scaled = |factor: f32| {
        let mut model = make::model(500, 0);
        model.means.iter_mut().flatten().for_each(|x| *x *= factor);
        model.log_scales.iter_mut().flatten().for_each(|x| *x += factor.ln());
        model
    };
    formats::write(&path, &scaled(2f32.powi(-8)), formats::RenderMode::Plain).unwrap();
    assert_within_spz(&scaled(2f32.powi(-8)), &formats::read(&path).unwrap().gaussians, 2f32.powi(-14));
    // 3 x 2^10 units need one fractional bit less than the official 12; values must not wrap.
    formats::write(&path, &scaled(1024.0), formats::RenderMode::Plain).unwrap();
    assert_within_spz(&scaled(1024.0), &formats::read(&path).unwrap().gaussians, 2f32.powi(-11));
    let before = fs::read(&path).unwrap();
    let mut flyaway = make::model(500, 0);
    flyaway.means[3][1] = 4e6;
    assert!(matches!(formats::write(&path, &flyaway, formats::RenderMode::Plain), Err(Error::Unsupported { .. })));
    flyaway.means[3][1] = 1e9;
    let text = formats::write(&path, &flyaway, formats::RenderMode::Plain).unwrap_err().to_string();
    assert!(text.contains("beyond") && text.contains("write .ply"), "{text}");
    for factor in [1e-4, 1e5] {
        let text = formats::write(&path, &scaled(factor), formats::RenderMode::Plain).unwrap_err().to_string();
        assert!(text.contains("4.5e-5 to 3.8e2 that SPZ can store"), "{text}");
    }
    assert!(fs::read(&path).unwrap() == before, "a refused write leaves the old file");
}

/// By the two larger axes; the third may be thinner than an SPZ stores it.
#[test]
fn sizes_that_spz_cuts_off_are_counted() {
    let mut model = make::model(50, 0);
    (model.log_scales[3], model.log_scales[4]) = ([-11.0; 3], [-12.0, 7.0, 0.0]);
    (model.log_scales[5], model.log_scales[6]) = ([-12.0, -9.0, -11.0], [-12.0, -9.0, -9.9]);
    for (name, outsized) in [("a.spz", 3), ("a.html", 0), ("a.sog", 0), ("a.ply", 0)] {
        assert_eq!(formats::outsized(Path::new(name), &model), outsized, "{name}");
        assert_eq!(formats::size_warning(Path::new(name), outsized).is_some(), outsized > 0, "{name}");
    }
    let how = (formats::usual(Path::new("a.spz"), &model), formats::SpzVersion::Four);
    let file = formats::encode(Path::new("a.spz"), &model, (formats::RenderMode::Plain, [0.0; 3]), how).unwrap();
    let back = formats::read_bytes(&file, Path::new("a.spz")).unwrap().gaussians;
    assert_eq!(formats::outsized(Path::new("a.spz"), &back), 0);
    let said = formats::size_warning(Path::new("a.spz"), 1).unwrap();
    assert!(
        said.starts_with("a.spz: 1 Gaussian is smaller or larger than the 4.5e-5 to 3.8e2 that SPZ stores"),
        "{said}"
    );
}

/// Fewer bits of means make a smaller SPZ, whose means are within half a step of that share of the median Gaussian's size.
#[test]
fn spz_stores_means_as_finely_as_asked() {
    let model = make::model(500, 0);
    let mut sizes: Vec<f32> = model.log_scales.iter().map(|s| s.iter().fold(f32::MIN, |a, b| a.max(*b))).collect();
    sizes.sort_by(f32::total_cmp);
    let size = sizes[sizes.len() / 2].exp();
    let name = Path::new("a.spz");
    let mut before = 0;
    for precision in formats::ladder(name, 0).rungs {
        let formats::Precision::Spz(SpzPrecision { means, .. }) = precision else { panic!("{precision:?}") };
        let place = (formats::RenderMode::Plain, [0.0; 3]);
        let file = formats::encode(name, &model, place, (precision, formats::SpzVersion::Four)).unwrap();
        assert!(file.len() >= before, "{precision:?}: {} after {before} bytes", file.len());
        before = file.len();
        let back = formats::read_bytes(&file, name).unwrap().gaussians;
        assert_within_spz(&model, &back, means.map_or(1.0 / 4096.0, |means| size * 2f32.powi(-i32::from(means))));
    }
}
