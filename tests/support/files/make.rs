//! Small files of every format, built byte by byte from their descriptions and not by the code under test.

use std::io::{Cursor, Write};

use qirf_vk::gaussians::Gaussians;

/// Encoding of a PLY body.
#[derive(Clone, Copy, Debug)]
pub enum Encoding {
    Ascii,
    Little,
    Big,
}

/// `n` Gaussians of degree `degree` with plain, varied, finite values.
pub fn model(n: usize, degree: usize) -> Gaussians {
    let mut state = 12345u64;
    let mut next = move || {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        (state >> 40) as f32 / (1u64 << 24) as f32 * 2.0 - 1.0
    };
    let mut model = Gaussians::zeroed(n, degree);
    model.means.iter_mut().flatten().for_each(|x| *x = 3.0 * next());
    model.log_scales.iter_mut().flatten().for_each(|x| *x = -3.0 + 2.0 * next());
    model.rotations.iter_mut().flatten().for_each(|x| *x = next());
    model.opacity_logits.iter_mut().for_each(|x| *x = 4.0 * next());
    model.sh.iter_mut().flatten().for_each(|x| *x = 0.9 * next());
    model
}

/// Coefficient `k` of bands 1 and up, for one colour.
pub fn rest(model: &Gaussians, i: usize, channel: usize, k: usize) -> f32 {
    let l = (k + 1).isqrt();
    model.sh[l][i * Gaussians::band_width(l) + 3 * (k - (l * l - 1)) + channel]
}

/// Number of coefficients of bands 1 and up.
pub fn rest_count(model: &Gaussians) -> usize {
    (model.degree() + 1).pow(2) - 1
}

/// One named value per column of the standard layout, rotations first: readers must accept any order.
fn columns(model: &Gaussians, i: usize) -> Vec<(String, f32)> {
    let mut row: Vec<(String, f32)> = Vec::new();
    let mut push = |name: &str, values: &[f32]| {
        row.extend(values.iter().enumerate().map(|(axis, &value)| (format!("{name}{axis}"), value)));
    };
    push("rot_", &model.rotations[i]);
    push("f_dc_", &model.sh[0][3 * i..3 * i + 3]);
    let k = rest_count(model);
    let flat: Vec<f32> = (0..3 * k).map(|j| rest(model, i, j / k, j % k)).collect();
    push("f_rest_", &flat);
    push("scale_", &model.log_scales[i]);
    row.push(("opacity".into(), model.opacity_logits[i]));
    row.extend(["x", "y", "z"].into_iter().zip(model.means[i]).map(|(name, value)| (name.to_owned(), value)));
    row
}

/// A PLY with extra properties (a list among them) and extra elements on both sides; `double` widens the means.
pub fn ply(model: &Gaussians, encoding: Encoding, double: bool) -> Vec<u8> {
    let name = match encoding {
        Encoding::Ascii => "ascii",
        Encoding::Little => "binary_little_endian",
        Encoding::Big => "binary_big_endian",
    };
    let mut out = format!(
        "ply\r\nformat {name} 1.0\ncomment made by a test\nelement camera 2\nproperty float fx\nproperty list uchar int \
         views\nelement vertex {}\nproperty uchar label\nproperty list ushort float near\n",
        model.len()
    )
    .into_bytes();
    let sample = if model.is_empty() { columns(&self::model(1, model.degree()), 0) } else { columns(model, 0) };
    let is_mean = |name: &str| name.len() == 1;
    for (name, _) in &sample {
        let kind = if double && is_mean(name) { "double" } else { "float" };
        out.extend(format!("property {kind} {name}\n").bytes());
    }
    out.extend(b"element face 1\nproperty list uchar int vertex_indices\nend_header\n");

    let mut body = Body { out, encoding };
    for camera in 0..2 {
        body.float(0.5);
        body.integer(2, 1);
        body.integer(camera, 4);
        body.integer(7, 4);
        body.end_row();
    }
    for i in 0..model.len() {
        body.integer(i as u32 % 200, 1);
        body.integer(i as u32 % 3, 2);
        (0..i % 3).for_each(|_| body.float(1.5));
        for (name, value) in columns(model, i) {
            if double && is_mean(&name) { body.double(value.into()) } else { body.float(value) }
        }
        body.end_row();
    }
    body.integer(1, 1);
    body.integer(0, 4);
    body.end_row();
    body.out
}

struct Body {
    out: Vec<u8>,
    encoding: Encoding,
}

impl Body {
    fn push(&mut self, mut little: Vec<u8>, text: &str) {
        match self.encoding {
            Encoding::Ascii => self.out.extend(format!("{text} ").bytes()),
            Encoding::Little => self.out.append(&mut little),
            Encoding::Big => self.out.extend(little.into_iter().rev()),
        }
    }

    fn float(&mut self, value: f32) {
        self.push(value.to_le_bytes().into(), &value.to_string());
    }

    fn double(&mut self, value: f64) {
        self.push(value.to_le_bytes().into(), &value.to_string());
    }

    fn integer(&mut self, value: u32, width: usize) {
        self.push(value.to_le_bytes()[..width].into(), &value.to_string());
    }

    fn end_row(&mut self) {
        if matches!(self.encoding, Encoding::Ascii) {
            self.out.push(b'\n');
        }
    }
}

/// A compressed PLY of `n` Gaussians in the middle of their ranges: every packed word is `word`, every SH byte 192.
pub fn compressed_ply(n: usize, word: u32, with_sh: bool) -> Vec<u8> {
    let chunks = n.div_ceil(256);
    let mut out = format!("ply\nformat binary_little_endian 1.0\nelement chunk {chunks}\n").into_bytes();
    for name in ["x", "y", "z", "scale_x", "scale_y", "scale_z", "r", "g", "b"] {
        out.extend(format!("property float min_{name}\nproperty float max_{name}\n").bytes());
    }
    out.extend(format!("element vertex {n}\n").bytes());
    for name in ["position", "rotation", "scale", "color"] {
        out.extend(format!("property uint packed_{name}\n").bytes());
    }
    if with_sh {
        out.extend(format!("element sh {n}\n").bytes());
        (0..9).for_each(|i| out.extend(format!("property uchar f_rest_{i}\n").bytes()));
    }
    out.extend(b"end_header\n");
    for chunk in 0..chunks {
        for (low, high) in [(chunk as f32, chunk as f32 + 1.0), (-8.0, -2.0), (0.0, 1.0)] {
            (0..3).for_each(|_| out.extend([low, high].iter().flat_map(|x| x.to_le_bytes())));
        }
    }
    (0..4 * n).for_each(|_| out.extend(word.to_le_bytes()));
    if with_sh {
        out.resize(out.len() + 9 * n, 192);
    }
    out
}

/// A PLY of `n` Gaussians of degree 0 in halves.
pub fn half_ply(n: usize) -> Vec<u8> {
    let names = [
        "x", "y", "z", "rot_0", "rot_1", "rot_2", "rot_3", "scale_0", "scale_1", "scale_2", "opacity", "f_dc_0",
        "f_dc_1", "f_dc_2",
    ];
    let mut out = format!("ply\nformat binary_little_endian 1.0\nelement vertex {n}\n").into_bytes();
    for name in names {
        out.extend(format!("property half {name}\n").bytes());
    }
    out.extend(b"end_header\n");
    // 1, 1 + 1/1024, ...: exact in halves.
    (0..n * names.len()).for_each(|k| out.extend((0x3c00 + k as u16).to_le_bytes()));
    out
}

/// A USD text layer of `n` Gaussians of degree 1.
pub fn usda(n: usize) -> Vec<u8> {
    let list = |element: &dyn Fn(usize) -> String| (0..n).map(element).collect::<Vec<_>>().join(", ");
    let sh = |i: usize| (0..4).map(|k| format!("({k}, {i}, 0.5)")).collect::<Vec<_>>().join(",");
    format!(
        "#usda 1.0\n(\n    upAxis = \"Z\"\n)\ndef Xform \"a\"\n{{\n    def ParticleField3DGaussianSplat \"s\" (\n        customData = {{ \
         string SplatRenderMode = \"mip\" }}\n    )\n    {{\n        point3f[] positions = [{}]\n        quatf[] orientations = [{}]\n        \
         float3[] scales = [{}]\n        float[] opacities = [{}]\n        uniform int radiance:sphericalHarmonicsDegree = 1\n        float3[] \
         radiance:sphericalHarmonicsCoefficients = [{}]\n    }}\n}}\n",
        list(&|i| format!("({i}, 1.5, -2e1)")),
        list(&|_| "(0.5, -0.5, 0.5, 0.5)".into()),
        list(&|i| format!("(1, 0.{}, 3)", i + 1)),
        list(&|i| format!("0.{}", i + 1)),
        list(&sh),
    )
    .into_bytes()
}

/// The same layer in a package.
pub fn usdz(n: usize) -> Vec<u8> {
    let mut archive = zip::ZipWriter::new(Cursor::new(Vec::new()));
    let options = zip::write::SimpleFileOptions::default().compression_method(zip::CompressionMethod::Stored);
    archive.start_file("a.usda", options.with_alignment(64)).unwrap();
    archive.write_all(&usda(n)).unwrap();
    archive.finish().unwrap().into_inner()
}

/// The attributes of SPZ, `n` rows each of arbitrary but valid bytes.
fn spz_streams(n: usize, version: u32, degree: usize) -> [Vec<u8>; 6] {
    let widths =
        [if version == 1 { 6 } else { 9 }, 1, 3, 3, if version < 3 { 3 } else { 4 }, 3 * ((degree + 1).pow(2) - 1)];
    let mut seed = 7u8;
    widths.map(|width| {
        (0..width * n)
            .map(|_| {
                seed = seed.wrapping_mul(77).wrapping_add(31);
                // Halves of version 1 must be finite.
                if version == 1 && width == 6 { seed & 0x3f } else { seed.clamp(1, 254) }
            })
            .collect()
    })
}

/// SPZ of versions 1 to 4; `gzip` wraps versions below 4.
pub fn spz(n: usize, version: u32, degree: usize, gzip: bool) -> Vec<u8> {
    let streams = spz_streams(n, version, degree);
    let mut out = b"NGSP".to_vec();
    out.extend(version.to_le_bytes());
    out.extend((n as u32).to_le_bytes());
    out.extend([degree as u8, 12, 0, 0]);
    if version < 4 {
        out.extend(streams.concat());
        if gzip {
            let mut encoder = flate2::write::GzEncoder::new(Vec::new(), flate2::Compression::fast());
            encoder.write_all(&out).unwrap();
            out = encoder.finish().unwrap();
        }
        return out;
    }
    let streams: Vec<&Vec<u8>> = streams.iter().filter(|stream| !stream.is_empty()).collect();
    let frames: Vec<Vec<u8>> = streams.iter().map(|stream| zstd::bulk::compress(stream, 3).unwrap()).collect();
    out[15] = streams.len() as u8;
    out.extend(32u32.to_le_bytes());
    out.resize(32, 0);
    for (stream, frame) in streams.iter().zip(&frames) {
        out.extend((frame.len() as u64).to_le_bytes());
        out.extend((stream.len() as u64).to_le_bytes());
    }
    out.extend(frames.concat());
    out
}

/// A `.splat` file: opacity and colours in 8 bits, linear scales.
pub fn splat(model: &Gaussians) -> Vec<u8> {
    let mut out = Vec::new();
    for i in 0..model.len() {
        out.extend(model.means[i].iter().flat_map(|x| x.to_le_bytes()));
        out.extend(model.log_scales[i].iter().flat_map(|s| s.exp().to_le_bytes()));
        out.extend(model.sh[0][3 * i..3 * i + 3].iter().map(|c| ((c * 0.282_094_79 + 0.5) * 255.0).round() as u8));
        out.push((255.0 / (1.0 + (-model.opacity_logits[i]).exp())).round() as u8);
        out.extend(model.rotations[i].iter().map(|q| (q * 127.0 + 128.0).round() as u8));
    }
    out
}

/// A `.ksplat` file of one section: one full bucket of 4, and one partly filled with the rest (5 to 8 Gaussians in
/// all).
pub fn ksplat(n: usize, level: u16, degree: usize) -> Vec<u8> {
    assert!(n > 4 && n <= 8);
    let (mean, value, sh) = [(12, 4, 4), (6, 2, 2), (6, 2, 1)][level as usize];
    let mut out = vec![0u8; 4096 + 1024];
    let mut set = |at: usize, bytes: &[u8]| out[at..at + bytes.len()].copy_from_slice(bytes);
    set(1, &[1]);
    set(4, &1u32.to_le_bytes());
    set(16, &(n as u32).to_le_bytes());
    set(20, &level.to_le_bytes());
    set(36, &(-2f32).to_le_bytes());
    set(40, &2f32.to_le_bytes());
    let section = 4096;
    set(section, &(n as u32).to_le_bytes());
    set(section + 4, &(n as u32).to_le_bytes());
    set(section + 8, &4u32.to_le_bytes());
    set(section + 12, &2u32.to_le_bytes());
    set(section + 16, &5f32.to_le_bytes());
    set(section + 20, &12u16.to_le_bytes());
    set(section + 24, &32767u32.to_le_bytes());
    set(section + 32, &1u32.to_le_bytes());
    set(section + 36, &1u32.to_le_bytes());
    set(section + 40, &(degree as u16).to_le_bytes());
    out.extend((n as u32 - 4).to_le_bytes());
    out.extend([10f32, 10.0, 10.0, 20.0, 20.0, 20.0].iter().flat_map(|x| x.to_le_bytes()));
    for i in 0..n {
        match mean {
            12 => (0..3).for_each(|axis| out.extend((i as f32 + 0.25 * axis as f32).to_le_bytes())),
            _ => (0..3).for_each(|axis| out.extend((32767 + 1000 * i as u16 + axis).to_le_bytes())),
        }
        // The value one, as float or half, for three scales and four components.
        for _ in 0..7 {
            if value == 4 { out.extend(0.5f32.to_le_bytes()) } else { out.extend(0x3800u16.to_le_bytes()) }
        }
        out.extend([255, 128, 0, 204]);
        for k in 0..3 * ((degree + 1).pow(2) - 1) {
            match sh {
                4 => out.extend((k as f32).to_le_bytes()),
                2 => out.extend((0x3c00 + k as u16).to_le_bytes()),
                _ => out.push(k as u8),
            }
        }
    }
    out
}

fn webp(width: u32, height: u32, texel: impl Fn(usize) -> [u8; 4]) -> Vec<u8> {
    let pixels: Vec<u8> = (0..(width * height) as usize).flat_map(texel).collect();
    let mut out = Vec::new();
    let encoder = image::codecs::webp::WebPEncoder::new_lossless(&mut out);
    encoder.encode(&pixels, width, height, image::ExtendedColorType::Rgba8).unwrap();
    out
}

/// The files of a SOG model of `n` <= 64 Gaussians with SH of degree 1, version 1 or 2.
pub fn sog_files(n: usize, version: u32) -> Vec<(&'static str, Vec<u8>)> {
    let codebook: Vec<f32> = (0..256).map(|i| i as f32 / 128.0 - 1.0).collect();
    let limits = |k: usize| serde_json::json!({ "mins": vec![-1.0; k], "maxs": vec![255.0 / 128.0 - 1.0; k] });
    let mut meta = serde_json::json!({
        "means": { "mins": [-1.0, -1.0, -1.0], "maxs": [1.0, 1.0, 1.0], "files": ["means_l.webp", "means_u.webp"] },
        "scales": { "files": ["scales.webp"] },
        "quats": { "files": ["quats.webp"] },
        "sh0": { "files": ["sh0.webp"] },
        "shN": { "files": ["shN_centroids.webp", "shN_labels.webp"] },
    });
    let mut merge = |key: &str, values: serde_json::Value| {
        for (name, value) in values.as_object().unwrap() {
            meta[key][name] = value.clone();
        }
    };
    if version == 2 {
        for key in ["scales", "sh0", "shN"] {
            merge(key, serde_json::json!({ "codebook": codebook }));
        }
        merge("shN", serde_json::json!({ "count": 128, "bands": 1 }));
        meta["version"] = 2.into();
        meta["count"] = n.into();
    } else {
        merge("means", serde_json::json!({ "shape": [n, 3] }));
        merge("scales", limits(3));
        merge("sh0", limits(4));
        merge("shN", serde_json::json!({ "mins": -1.0, "maxs": 255.0 / 128.0 - 1.0 }));
    }
    let byte = |i: usize, step: usize| (i * step % 256) as u8;
    vec![
        ("meta.json", meta.to_string().into_bytes()),
        ("means_l.webp", webp(8, 8, |i| [byte(i, 37), byte(i, 11), byte(i, 5), 255])),
        ("means_u.webp", webp(8, 8, |i| [byte(i, 3), 128, byte(i, 1), 255])),
        ("quats.webp", webp(8, 8, |i| [byte(i, 2), 128, 127, 252 + (i % 4) as u8])),
        ("scales.webp", webp(8, 8, |i| [byte(i, 1), byte(i, 2), byte(i, 3), 255])),
        ("sh0.webp", webp(8, 8, |i| [byte(i, 4), byte(i, 5), byte(i, 6), 1 + byte(i, 3) % 254])),
        ("shN_centroids.webp", webp(192, 2, |i| [byte(i, 1), byte(i, 2), byte(i, 3), 255])),
        ("shN_labels.webp", webp(8, 8, |i| [(127 - i) as u8, 0, 0, 255])),
    ]
}

/// The same, bundled; textures stored, `meta.json` deflated.
pub fn sog(n: usize, version: u32) -> Vec<u8> {
    bundle(&sog_files(n, version))
}

/// Two leaves of one level, the 50 Gaussians of the folder 0_0.
pub const LEVELS: &str = r#"{ "version": 1, "counts": [50], "lodLevels": 1, "filenames": ["0_0/meta.json"],
    "tree": { "bound": { "min": [-9, -9, -9], "max": [9, 9, 9] }, "children": [
        { "lods": { "0": { "file": 0, "offset": 0, "count": 20 } } },
        { "lods": { "0": { "file": 0, "offset": 20, "count": 30 } } }] } }"#;

/// Files in a zip archive; all but textures are deflated.
pub fn bundle(files: &[(&str, Vec<u8>)]) -> Vec<u8> {
    let mut archive = zip::ZipWriter::new(Cursor::new(Vec::new()));
    for (name, content) in files {
        let is_texture = content.starts_with(b"RIFF");
        let method = if is_texture { zip::CompressionMethod::Stored } else { zip::CompressionMethod::Deflated };
        archive.start_file(*name, zip::write::SimpleFileOptions::default().compression_method(method)).unwrap();
        archive.write_all(content).unwrap();
    }
    archive.finish().unwrap().into_inner()
}
