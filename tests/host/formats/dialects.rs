//! Models as other tools write them.

use std::io::Write;
use std::path::Path;

use qirf_vk::gaussians::Gaussians;
use qirf_vk::gaussians::formats::{self, Format};

use crate::support::files::make;

/// Type, name, and value by row of a property.
type Property = (&'static str, &'static str, fn(u32) -> f64);

/// A text PLY of three rows with these properties after the position; each value is given as a function of the row.
fn ply(properties: &[Property]) -> Vec<u8> {
    let usual: [Property; 3] =
        [("double", "x", |i| 500_000.0 + f64::from(i)), ("float", "y", f64::from), ("float", "z", |_| 2.0)];
    let all: Vec<_> = usual.iter().chain(properties).collect();
    let header: Vec<String> = all.iter().map(|(kind, name, _)| format!("property {kind} {name}")).collect();
    let header = header.join("\n") + "\n";
    let row = |i: u32| all.iter().map(move |(.., value)| format!("{:?}", value(i)).trim_end_matches(".0").to_owned());
    let rows: String = (0..3).map(|i| row(i).collect::<Vec<_>>().join(" ") + "\n").collect();
    format!("ply\nformat ascii 1.0\nelement vertex 3\n{header}end_header\n{rows}").into_bytes()
}

const DC: [Property; 3] = [("float", "f_dc_0", |_| 0.25), ("float", "f_dc_1", |_| 0.25), ("float", "f_dc_2", |_| 0.25)];
const REST: [Property; 7] = [
    ("float", "opacity", |_| 0.5),
    ("float", "scale_0", |_| -2.0),
    ("float", "scale_1", |_| -3.0),
    ("float", "rot_0", |_| 1.0),
    ("float", "rot_1", |_| 0.0),
    ("float", "rot_2", |_| 0.0),
    ("float", "rot_3", |_| 0.0),
];
const THIRD: Property = ("float", "scale_2", |_| -4.0);

fn read(bytes: &[u8]) -> formats::Loaded {
    formats::read_bytes(bytes, Path::new("model.ply")).unwrap()
}

#[test]
fn colours_may_stand_in_red_green_and_blue() {
    let base: [Property; 3] =
        [("uchar", "red", |i| f64::from(100 * i)), ("uchar", "green", |_| 255.0), ("uchar", "blue", |_| -0.0)];
    let whole = read(&ply(&[&base[..], &REST, &[THIRD]].concat()));
    let floats: [Property; 3] =
        [("float", "red", |i| f64::from(100 * i) / 255.0), ("float", "green", |_| 1.0), ("float", "blue", |_| 0.0)];
    let shares = read(&ply(&[&floats[..], &REST, &[THIRD]].concat()));
    let bytes: [Property; 3] =
        [("double", "red", |i| f64::from(100 * i)), ("float", "green", |_| 255.0), ("float", "blue", |_| 0.0)];
    let counted = read(&ply(&[&bytes[..], &REST, &[THIRD]].concat()));
    let called = |names: [&'static str; 3]| {
        let renamed: Vec<Property> =
            base.iter().zip(names).map(|((kind, _, value), name)| (*kind, name, *value)).collect();
        read(&ply(&[&renamed[..], &REST, &[THIRD]].concat())).gaussians
    };
    let [short, diffuse] = [["r", "g", "b"], ["diffuse_red", "diffuse_green", "diffuse_blue"]].map(called);
    for model in [whole.gaussians, shares.gaussians, counted.gaussians, short, diffuse] {
        for (i, row) in model.sh[0].chunks(3).enumerate() {
            let wanted = [100.0 * i as f64, 255.0, 0.0].map(|c| (c / 255.0 - 0.5) / 0.282_094_79);
            assert!(row.iter().zip(wanted).all(|(a, b)| (f64::from(*a) - b).abs() < 1e-5), "{row:?} {wanted:?}");
        }
    }
    // f_dc takes precedence if both exist.
    assert_eq!(read(&ply(&[&base[..], &DC, &REST, &[THIRD]].concat())).gaussians.sh[0], [0.25; 9]);
    // A point cloud is not a model.
    let cloud = formats::read_bytes(&ply(&base), Path::new("cloud.ply")).unwrap_err().to_string();
    assert!(cloud.contains("point cloud"), "{cloud}");
}

#[test]
fn flat_models_get_a_thin_axis_and_say_so() {
    let flat = read(&ply(&[&DC[..], &REST].concat()));
    assert!(flat.gaussians.log_scales.iter().all(|s| s[..2] == [-2.0, -3.0] && (s[2] - 1e-6_f32.ln()).abs() < 1e-5));
    assert!(flat.doubt.unwrap().contains("2DGS"));
    assert_eq!(read(&ply(&[&DC[..], &REST, &[THIRD]].concat())).doubt, None);
}

#[test]
fn opacities_in_whole_numbers_are_doubted() {
    let byte: Property = ("uchar", "opacity", |_| 128.0);
    let loaded = read(&ply(&[&DC[..], &[byte], &REST[1..], &[THIRD]].concat()));
    assert_eq!(loaded.gaussians.opacity_logits, [128.0; 3]);
    assert!(loaded.doubt.unwrap().contains("whole numbers, which are taken as logits"));
}

/// Mip-Splatting smooths by a filter of its own size: variances add up, and opacity falls by the roots of their ratios.
#[test]
fn filters_of_mip_splatting_are_taken_in() {
    let filter: Property = ("float", "filter_3D", |i| f64::from(i) * 0.1);
    let loaded = read(&ply(&[&DC[..], &REST, &[THIRD, filter]].concat()));
    assert!(loaded.mode.antialiased() && loaded.doubt.unwrap().contains("Mip-Splatting"));
    for i in 0..3 {
        let variances = [-2.0_f64, -3.0, -4.0].map(|s| ((2.0 * s).exp(), (2.0 * s).exp() + (0.1 * i as f64).powi(2)));
        let share: f64 = variances.iter().map(|(before, after)| (before / after).sqrt()).product();
        let opacity = share / (1.0 + (-0.5_f64).exp());
        let logit = f64::from(loaded.gaussians.opacity_logits[i]);
        assert!((logit - (opacity / (1.0 - opacity)).ln()).abs() < 1e-5, "{i}: {logit}");
        let scales = loaded.gaussians.log_scales[i].map(f64::from);
        assert!(scales.iter().zip(variances).all(|(s, (_, after))| (s - 0.5 * after.ln()).abs() < 1e-6), "{scales:?}");
    }
}

#[test]
fn gzip_is_unpacked_whatever_it_holds() {
    let plain = ply(&[&DC[..], &REST, &[THIRD]].concat());
    let zip = |bytes: &[u8]| {
        let mut out = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::default());
        out.write_all(bytes).unwrap();
        out.finish().unwrap()
    };
    let packed = zip(&plain);
    for name in ["model.ply.gz", "model.gz", "model.ply"] {
        let read = formats::read_bytes(&packed, Path::new(name)).unwrap();
        assert_eq!((read.format, read.gaussians.len()), (Format::Ply, 3));
    }
    for (bytes, what) in [(zip(&packed), "gzip twice"), (packed[..packed.len() / 2].to_vec(), "gzip")] {
        let error = formats::read_bytes(&bytes, Path::new("model.ply.gz")).unwrap_err().to_string();
        assert!(error.contains(what), "{error}");
    }
    // Files of several members, as `cat` makes them, and faults within, by the file's own name.
    let halves = |bytes: &[u8]| {
        let (first, last) = bytes.split_at(bytes.len() / 2);
        [zip(first), zip(last), vec![0; 5]].concat()
    };
    let spz = make::spz(9, 3, 1, false);
    for (bytes, name, count) in [(halves(&plain), "model.ply", 3), (halves(&spz), "model.spz", 9)] {
        assert_eq!(formats::read_bytes(&bytes, Path::new(name)).unwrap().gaussians.len(), count, "{name}");
    }
    for name in ["model.ply.gz", "model.ply"] {
        let fault = formats::read_bytes(&zip(&plain[..plain.len() - 9]), Path::new(name)).unwrap_err().to_string();
        assert!(fault.starts_with(&format!("{name}: ")), "{fault}");
    }
}

#[test]
fn a_byte_order_mark_is_no_part_of_a_text() {
    let folder = tempfile::tempdir().unwrap();
    let plain = Gaussians::balls(vec![[1.0, 2.0, 3.0]], -2.0, 1.0, 0);
    for name in ["model.ply", "model.usda"] {
        let path = folder.path().join(name);
        formats::write(&path, &plain, formats::RenderMode::default()).unwrap();
        let bytes = std::fs::read(&path).unwrap();
        let marked = [b"\xef\xbb\xbf".as_slice(), &bytes].concat();
        let of = |bytes: &[u8]| formats::read_bytes(bytes, Path::new(name)).unwrap().gaussians;
        assert_eq!(of(&marked), of(&bytes), "{name}");
    }
    // A million of them are no text, and end no program.
    let marks = [0xef, 0xbb, 0xbf].repeat(1_000_000);
    assert!(formats::read_bytes(&marks, Path::new("model.ply")).is_err());
    // Three bytes of a coordinate are none.
    assert!(formats::read_bytes(&[0xef, 0xbb, 0xbf, 0x40], Path::new("model.splat")).is_err());
    let splat = [[0xef, 0xbb, 0xbf, 0x40].as_slice(), &[0; 8], &[0, 0, 0, 0x3f].repeat(3), &[255; 8]].concat();
    assert_eq!(formats::read_bytes(&splat, Path::new("model.splat")).unwrap().gaussians.len(), 1);
}

/// Doubles far from the origin keep their differences, and the place that the means then count from is written and read.
#[test]
fn far_doubles_keep_their_differences() {
    let all = [&DC[..], &REST, &[THIRD]].concat();
    let plain = ply(&all);
    let far: String = String::from_utf8(plain.clone())
        .unwrap()
        .replace("float y", "double y")
        .replace("float z", "double z")
        .lines()
        .map(|line| match line.split_once(' ') {
            Some((x, rest)) if x.parse::<f64>().is_ok() => format!("{x}.25 46497{rest}\n"),
            _ => format!("{line}\n"),
        })
        .collect();
    let read_far = read(far.as_bytes());
    assert_ne!(read_far.origin, [0.0; 3]);
    for (i, mean) in read_far.gaussians.means.iter().enumerate() {
        let world = [0, 1].map(|axis| f64::from(mean[axis]) + read_far.origin[axis]);
        let wanted = [500_000.25 + i as f64, 464_970.0 + i as f64];
        assert!(world.iter().zip(wanted).all(|(a, b)| (a - b).abs() < 1e-6), "{world:?} {wanted:?}");
    }
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("local.ply");
    formats::write_at(&path, &read_far.gaussians, read_far.mode, read_far.origin).unwrap();
    let again = formats::read(&path).unwrap();
    assert_eq!((again.origin, again.gaussians), (read_far.origin, read_far.gaussians));
    let beside = std::fs::read_to_string(folder.path().join("georeference.json")).unwrap();
    assert!(beside.contains("\"origin\""), "{beside}");
    // One axis in doubles is enough.
    let mixed = read(&plain);
    let x = f64::from(mixed.gaussians.means[2][0]) + mixed.origin[0];
    assert!(mixed.origin[0] != 0.0 && (x - 500_002.0).abs() < 1e-6, "{:?}", mixed.origin);
    // Floats, and doubles near the origin of the world, count from there.
    let near = String::from_utf8(plain).unwrap().replace("\n50000", "\n");
    assert_eq!(read(near.as_bytes()).origin, [0.0; 3]);
}
