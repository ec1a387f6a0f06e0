//! Each reader on small files whose values are known.

use std::path::Path;

use qirf_vk::gaussians::formats::{self, Format, Loaded};
use qirf_vk::gaussians::{Error, Gaussians};

use crate::support::files::corpus;
use crate::support::files::make::{self, Encoding};

pub fn read(bytes: &[u8], name: &str) -> Result<Loaded, Error> {
    formats::read_bytes(bytes, Path::new(name))
}

fn message(bytes: &[u8], name: &str) -> String {
    read(bytes, name).expect_err("must be refused").to_string()
}

fn near(a: f32, b: f32, tolerance: f32) -> bool {
    (a - b).abs() <= tolerance
}

#[test]
fn every_ply_encoding_gives_the_same_bits() {
    for degree in 0..=3 {
        let model = make::model(7, degree);
        for encoding in [Encoding::Little, Encoding::Big, Encoding::Ascii] {
            for double in [false, true] {
                let loaded = read(&make::ply(&model, encoding, double), "m.ply").unwrap();
                assert_eq!(loaded.gaussians, model, "degree {degree} {encoding:?}");
                assert_eq!(loaded.format, Format::Ply);
                assert!(!loaded.repairs.any());
            }
        }
    }
}

#[test]
fn no_gaussians_are_legal() {
    for encoding in [Encoding::Little, Encoding::Big, Encoding::Ascii] {
        let loaded = read(&make::ply(&Gaussians::zeroed(0, 2), encoding, false), "m.ply").unwrap();
        assert_eq!((loaded.gaussians.len(), loaded.gaussians.degree()), (0, 2));
    }
    for (version, gzip) in [(2, true), (3, false), (4, false)] {
        assert!(read(&make::spz(0, version, 1, gzip), "m.spz").unwrap().gaussians.is_empty());
    }
}

#[test]
fn a_truncated_body_says_what_is_whole_and_what_is_claimed() {
    let ply = make::ply(&make::model(7, 1), Encoding::Ascii, false);
    let lines: Vec<&[u8]> = ply.split_inclusive(|&b| b == b'\n').collect();
    // Cut off three rows of vertices and one of faces.
    let cut = lines[..lines.len() - 4].concat();
    let text = message(&cut, "m.ply");
    assert!(
        text.contains("element vertex, row 4") && text.contains("4 whole rows of the 7 that the header claims"),
        "{text}"
    );

    let mut packed = Vec::new();
    let model = make::model(10, 0);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("m.ply");
    formats::write(&path, &model, formats::RenderMode::Plain).unwrap();
    packed.extend(std::fs::read(&path).unwrap());
    packed.truncate(packed.len() - 100);
    let text = message(&packed, "m.ply");
    assert!(text.contains("element vertex, row 8") && text.contains("8 whole rows of the 10"), "{text}");

    let spz = make::spz(9, 3, 1, false);
    let text = message(&spz[..spz.len() - 9 * 9 - 4 * 9 - 1], "m.spz");
    assert!(text.contains("scales, uncompressed byte") && text.contains("8 whole rows of the 9"), "{text}");
    let text = message(&make::spz(9, 4, 1, false)[..150], "m.spz");
    assert!(text.contains("positions stream"), "{text}");
    let gz = make::spz(900, 3, 1, true);
    let text = message(&gz[..gz.len() / 2], "m.spz");
    assert!(text.contains("breaks off") && text.contains("whole rows of the 900"), "{text}");
    let text = message(&make::splat(&make::model(3, 0))[..70], "m.splat");
    assert!(text.contains("2 whole records of 32 bytes, then 6 bytes"), "{text}");
    let ksplat = make::ksplat(6, 1, 1);
    let text = message(&ksplat[..ksplat.len() - 1], "m.ksplat");
    assert!(text.contains("6 Gaussians claimed"), "{text}");
}

#[test]
fn lying_counts_are_refused_before_they_cost_memory() {
    let ply = make::ply(&make::model(2, 0), Encoding::Little, false);
    let text = String::from_utf8_lossy(&ply).replace("vertex 2\n", "vertex 18446744073709551615\n");
    assert!(read(text.as_bytes(), "m.ply").is_err());
    for (version, gzip) in [(1, true), (2, false), (3, true), (4, false)] {
        let mut spz = make::spz(3, version, 3, false);
        spz[8..12].copy_from_slice(&u32::MAX.to_le_bytes());
        if gzip {
            let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
            std::io::Write::write_all(&mut encoder, &spz).unwrap();
            spz = encoder.finish().unwrap();
        }
        assert!(message(&spz, "m.spz").contains("4294967295 Gaussians claimed"));
    }
    let mut ksplat = make::ksplat(5, 0, 0);
    ksplat[4096..4104].copy_from_slice(&[0xff; 8]);
    assert!(message(&ksplat, "m.ksplat").contains("4294967295 Gaussians claimed"));
    let mut ksplat = make::ksplat(5, 1, 0);
    ksplat[4..8].copy_from_slice(&[0xff; 4]);
    assert!(message(&ksplat, "m.ksplat").contains("sections claimed"));
}

#[test]
fn point_clouds_and_strangers_are_named() {
    let cloud = b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nproperty float y\nproperty float z\nend_header\n1 2 3\n";
    assert!(message(cloud, "c.ply").contains("no property `scale_0`"));
    assert!(message(b"hello", "c.txt").contains(".splat"));
    assert!(message(b"hello", "c.ply").contains("begins with the line `ply`"));
    for (bytes, packer) in [(&b"BZh91AY"[..], "bzip2"), (b"\xfd7zXZ\0\0", "xz"), (b"\x28\xb5\x2f\xfd\0", "zstd")] {
        let told = message(bytes, "c.ply");
        assert!(told.ends_with(&format!("it is compressed by {packer}: unpack it first")), "{told}");
    }
    assert!(message(b"", "c.splat").contains("empty"));
    assert!(formats::read(Path::new("absent.ply")).unwrap_err().to_string().starts_with("absent.ply: "));
}

#[test]
fn damaged_rows_are_counted_and_trailing_bytes_noted() {
    let mut model = make::model(6, 3);
    model.means[0][0] = f32::NAN;
    model.sh[3][2 * 21] = f32::INFINITY;
    model.rotations[3] = [0.0; 4];
    model.opacity_logits[4] = f32::NEG_INFINITY;
    model.log_scales[5][0] = f32::NEG_INFINITY;
    for encoding in [Encoding::Little, Encoding::Big, Encoding::Ascii] {
        let mut bytes = make::ply(&model, encoding, false);
        bytes.extend(b"?!");
        let loaded = read(&bytes, "m.ply").unwrap();
        let r = loaded.repairs;
        assert_eq!((r.non_finite_rows, r.zero_quaternions, r.clamped_opacities, r.floored_scales), (2, 1, 1, 1));
        assert_eq!((r.trailing_bytes, loaded.gaussians.len()), (2, 3));
        assert_eq!(loaded.gaussians.opacity_logits[1], -20.0);
        let json = serde_json::to_string(&r).unwrap();
        assert!(json.contains("\"non_finite_rows\":2"), "{json}");
    }
}

#[test]
fn compressed_ply_unpacks_by_its_chunks() {
    // Position (and scale): 1024/2047, 256/1023, 1/2047; rotation: greatest x, then 0x200, 0x040, 0x001.
    let word = 1024 << 21 | 256 << 11 | 1;
    let loaded = read(&make::compressed_ply(300, word, true), "m.ply").unwrap();
    assert_eq!(loaded.format, Format::CompressedPly);
    let m = loaded.gaussians;
    assert_eq!((m.len(), m.degree()), (300, 1));
    let t = [1024.0 / 2047.0, 256.0 / 1023.0, 1.0 / 2047.0f32];
    for axis in 0..3 {
        assert!(near(m.means[0][axis], t[axis], 1e-6));
        assert!(near(m.means[299][axis], 1.0 + t[axis], 1e-6), "second chunk");
        assert!(near(m.log_scales[0][axis], -8.0 + 6.0 * t[axis], 1e-5));
    }
    let component = |bits: u32| (bits as f32 / 1023.0 - 0.5) * 2f32.sqrt();
    let others = [component(word >> 20 & 1023), component(word >> 10 & 1023), component(word & 1023)];
    let q = m.rotations[0];
    let greatest = (word >> 30) as usize;
    let rest: Vec<f32> = (0..4).filter(|&i| i != greatest).map(|i| q[i]).collect();
    assert_eq!(rest, others);
    let [r, _, _, alpha] = word.to_be_bytes().map(f32::from);
    assert!(near(m.sh[0][0], (r / 255.0 - 0.5) / 0.282_094_79, 1e-6));
    assert!(near(m.opacity_logits[0], (alpha / (255.0 - alpha)).ln(), 1e-5));
    assert!(m.sh[1].iter().all(|&c| near(c, (192.5 / 256.0 - 0.5) * 8.0, 1e-6)));
    assert!(message(&make::compressed_ply(300, word, true)[..8000], "m.ply").contains("element sh"));
}

#[test]
fn halves_in_a_ply_are_exact() {
    let m = read(&make::half_ply(2), "m.ply").unwrap().gaussians;
    let value = |k: usize| 1.0 + k as f32 / 1024.0;
    assert_eq!((m.means[1], m.rotations[0][3]), ([value(14), value(15), value(16)], value(6)));
    assert_eq!((m.opacity_logits[0], m.sh[0][5]), (value(10), value(27)));
    let text = b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float16 x\nend_header\n0.1\n";
    assert!(message(text, "m.ply").contains("no property"));
}

#[test]
fn spz_versions_systems_and_halves() {
    let decoded = [2, 3, 4].map(|version| read(&make::spz(5, version, 3, false), "m.spz").unwrap());
    assert!(decoded.iter().all(|loaded| loaded.gaussians.means == decoded[0].gaussians.means));
    assert_eq!(decoded[1].gaussians.sh[0], decoded[2].gaussians.sh[0]);
    assert_eq!(read(&make::spz(5, 3, 3, true), "m.spz").unwrap(), decoded[1]);

    let mut one = make::spz(1, 1, 0, false);
    one[16..22].copy_from_slice(&[0x00, 0x3c, 0x00, 0x40, 0x00, 0xb8]);
    assert_eq!(read(&one, "m.spz").unwrap().gaussians.means, [[1.0, -2.0, 0.5]]);

    // An extension that names the coordinate system: 6 is our own and changes nothing, 12 permutes axes.
    let plain = make::spz(5, 4, 1, false);
    let with_system = |system: u32| {
        let record = [0xADBE_0003, 4, system].map(u32::to_le_bytes).concat();
        let mut bytes = [&plain[..32], &record, &plain[32..]].concat();
        bytes[14] = 2;
        bytes[16] = 44;
        read(&bytes, "m.spz")
    };
    let (turned, as_is) = (read(&plain, "m.spz").unwrap().gaussians, with_system(6).unwrap().gaussians);
    assert_eq!(with_system(4).unwrap().gaussians, turned);
    for (a, b) in turned.means.iter().zip(&as_is.means) {
        assert_eq!([a[0], -a[1], -a[2]], *b);
    }
    assert!(with_system(12).unwrap_err().to_string().contains("axes are permuted"));
}

#[test]
fn splat_agrees_within_eight_bits() {
    let model = make::model(9, 0);
    let m = read(&make::splat(&model), "m.splat").unwrap().gaussians;
    assert_eq!(m.means, model.means);
    for i in 0..9 {
        for axis in 0..3 {
            assert!(near(m.log_scales[i][axis], model.log_scales[i][axis], 1e-5));
            assert!(near(m.sh[0][3 * i + axis], model.sh[0][3 * i + axis], 0.5 / 255.0 / 0.28));
        }
        // 127 / 128 of the value and half a step.
        assert!((0..4).all(|c| near(m.rotations[i][c], model.rotations[i][c], 1.6 / 128.0)));
    }
}

#[test]
fn ksplat_levels_and_bands() {
    for level in 0..3 {
        for degree in 0..=2 {
            let m = read(&make::ksplat(6, level, degree), "m.ksplat").unwrap().gaussians;
            assert_eq!((m.len(), m.degree()), (6, degree));
            let step = 2.5 / 32767.0;
            let mean = |i: usize, axis: usize| match (level, i) {
                (0, _) => i as f32 + 0.25 * axis as f32,
                (_, 0..4) => 10.0 + (1000 * i + axis) as f32 * step,
                _ => 20.0 + (1000 * i + axis) as f32 * step,
            };
            for i in 0..6 {
                assert!((0..3).all(|axis| near(m.means[i][axis], mean(i, axis), 1e-5)), "level {level}");
                assert_eq!(m.log_scales[i], [0.5f32.ln(); 3]);
                assert_eq!(m.rotations[i], [0.5; 4]);
                assert!(near(m.opacity_logits[i], 4f32.ln(), 1e-5));
                // Stored band by band, each channel-major: red 0 1 2, green 3 4 5, ... of band 1, then band 2 from 9.
                let value = |k: usize| match level {
                    0 => k as f32,
                    1 => 1.0 + k as f32 / 1024.0,
                    _ => -2.0 + 4.0 * k as f32 / 255.0,
                };
                if degree >= 1 {
                    assert!(near(m.sh[1][9 * i + 3 * 2 + 1], value(3 + 2), 1e-6), "band 1, green, m = 1");
                }
                if degree >= 2 {
                    assert!(near(m.sh[2][15 * i + 3 * 4 + 2], value(9 + 10 + 4), 1e-6), "band 2, blue, m = 2");
                }
            }
        }
    }
}

#[test]
fn sog_versions_agree_and_so_do_folder_and_bundle() {
    let folder = tempfile::tempdir().unwrap();
    for (name, content) in make::sog_files(50, 2) {
        std::fs::write(folder.path().join(name), content).unwrap();
    }
    let in_folder = formats::read(folder.path()).unwrap();
    // With a byte order mark, and with a version written as a float.
    let meta = std::fs::read_to_string(folder.path().join("meta.json")).unwrap();
    std::fs::write(
        folder.path().join("meta.json"),
        format!("\u{feff}{}", meta.replace("\"version\":2", "\"version\":2.0")),
    )
    .unwrap();
    assert_eq!(in_folder, formats::read(&folder.path().join("meta.json")).unwrap());
    // As Windows writes text, with a version as a string and a count as a float.
    let changed = meta.replace("\"version\":2", "\"version\":\"2\"").replace("\"count\":50", "\"count\":50.0");
    assert_ne!(changed, meta);
    let wide: Vec<u8> = format!("\u{feff}{changed}").encode_utf16().flat_map(u16::to_le_bytes).collect();
    std::fs::write(folder.path().join("meta.json"), wide).unwrap();
    assert_eq!(in_folder, formats::read(folder.path()).unwrap());
    let two = read(&make::sog(50, 2), "m.sog").unwrap();
    assert_eq!(two, in_folder);
    let m = &two.gaussians;
    assert_eq!((m.len(), m.degree(), two.format), (50, 1, Format::Sog));
    let i = 9usize;
    let log = -1.0 + 2.0 * (i as f64 * 37.0 % 256.0 + 256.0 * 27.0) / 65535.0;
    assert!(near(m.means[i][0], (log.abs().exp_m1() * log.signum()) as f32, 1e-6));
    assert_eq!(m.log_scales[i], [9.0, 18.0, 27.0].map(|b| b / 128.0 - 1.0));
    assert_eq!(m.sh[0][3 * i + 2], 54.0 / 128.0 - 1.0);
    // Label 118: row 1, entry 54 of the palette; coefficient 2 is texel 192 + 54 * 3 + 2 = 356, green steps by 2.
    assert_eq!(m.sh[1][9 * i + 3 * 2 + 1], (356 * 2 % 256) as f32 / 128.0 - 1.0);
    let q = m.rotations[i];
    assert!(near(q.iter().map(|c| c * c).sum(), 1.0, 1e-6) && q[1] > 0.6, "{q:?}");

    let one = read(&make::sog(50, 1), "m.sog").unwrap().gaussians;
    assert_eq!((&one.means, &one.rotations), (&m.means, &m.rotations));
    let close = |a: &[f32], b: &[f32]| a.iter().zip(b).all(|(&a, &b)| near(a, b, 1e-5));
    assert!(close(one.log_scales.as_flattened(), m.log_scales.as_flattened()));
    assert!(close(&one.sh[0], &m.sh[0]) && close(&one.sh[1], &m.sh[1]));

    std::fs::remove_file(folder.path().join("quats.webp")).unwrap();
    assert!(formats::read(folder.path()).unwrap_err().to_string().contains("quats.webp: "));
    #[cfg(unix)]
    {
        // A link out of the folder, as in caches of downloads.
        let outside = tempfile::NamedTempFile::new().unwrap();
        let textures = make::sog_files(50, 2).into_iter().filter(|(name, _)| *name == "quats.webp");
        textures.for_each(|(_, content)| std::fs::write(outside.path(), content).unwrap());
        std::os::unix::fs::symlink(outside.path(), folder.path().join("quats.webp")).unwrap();
        assert_eq!(formats::read(folder.path()).unwrap().gaussians.len(), m.len());
    }
    std::fs::remove_file(folder.path().join("meta.json")).unwrap();
    assert!(formats::read(folder.path()).unwrap_err().to_string().contains("a folder without the meta.json"));
}

/// Files of a bundle, by name.
type Files = Vec<(&'static str, Vec<u8>)>;

#[test]
fn hostile_bundles_are_refused() {
    let refused = |what: &str, change: &dyn Fn(&mut Files)| {
        let mut files = make::sog_files(50, 2);
        change(&mut files);
        let said = read(&make::bundle(&files), "m.sog").unwrap_err().to_string();
        assert!(said.contains(what), "{what}: {said}");
    };
    let text = |from: &str, to: &str| {
        let meta = String::from_utf8(make::sog_files(50, 2)[0].1.clone()).unwrap();
        let changed = meta.replace(from, to);
        assert_ne!(changed, meta, "{from}");
        changed.into_bytes()
    };
    // 64 MB of zeros are 64 kB in the archive.
    for k in [0, 1, 7] {
        refused("grows beyond", &|files| files[k].1 = vec![0; 64 << 20]);
    }
    refused("claimed, more than", &|files| files[0].1 = text("\"count\":50", "\"count\":1000000000"));
    refused("claimed, more than", &|files| files[0].1 = text("\"count\":50", "\"count\":18446744073709551615"));
    refused("1e+300 Gaussians claimed", &|files| files[0].1 = text("\"count\":50", "\"count\":1e300"));
    refused("is a number of Gaussians", &|files| files[0].1 = text("\"count\":50", "\"count\":49.5"));
    refused("SOG version two;", &|files| files[0].1 = text("\"version\":2", "\"version\":\"two\""));
    refused("texels for 65 Gaussians", &|files| files[0].1 = text("\"count\":50", "\"count\":65"));
    for path in ["../quats.webp", "/quats.webp", "a/../../quats.webp", ".."] {
        refused("leaves the folder", &|files| files[0].1 = text("\"quats.webp\"", &format!("\"{path}\"")));
    }
    refused("no meta.json", &|files| files.truncate(0));
}

#[test]
fn truncation_at_any_byte_is_refused_or_salvaged_but_never_panics() {
    for corpus::Input { file: name, bytes, .. } in corpus::models() {
        assert!(read(&bytes, &name).is_ok(), "{name}: {:?}", read(&bytes, &name));
        for end in 0..bytes.len() {
            if let Ok(loaded) = read(&bytes[..end], &name) {
                // Only a file without its own count, or one that lacks an unneeded last line of text, may still be
                // read.
                loaded.gaussians.validate().unwrap();
                let needless = matches!(&*name, "ascii.ply" | "a.usda") && end + 5 >= bytes.len();
                assert!(name == "a.splat" || needless, "{name} cut at {end}");
            }
        }
    }
}
