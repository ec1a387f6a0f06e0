//! Reading SOG, versions 1 and 2.

use std::borrow::Cow;
use std::io::{Cursor, Read};
use std::path::{Component, Path};

use image::codecs::webp::WebPDecoder;
use image::{DynamicImage, ImageDecoder, RgbaImage};
use rayon::prelude::*;
use serde::Deserialize;
use serde_json::{Number, Value};

use super::super::bytes::{from_smallest_three, logit_of_byte};
use super::super::fault::{Fault, malformed};
use super::super::limit::fits;
use super::super::{Format, Gaussians, Parsed, Tag};
use super::GREATEST;
use crate::gaussians::MAX_SH_DEGREE;
use crate::scene::text_of;
use crate::wording::shown;

const AGAIN: &str = "fetch or export the model again";

#[derive(Deserialize)]
struct Meta {
    /// A number, also as a string.
    version: Option<Value>,
    count: Option<Number>,
    model: Option<Value>,
    antialias: Option<Value>,
    means: Means,
    scales: Values,
    quats: Quats,
    sh0: Values,
    #[serde(rename = "shN")]
    sh_rest: Option<Rest>,
}

#[derive(Deserialize)]
struct Means {
    shape: Option<Vec<Number>>,
    mins: [f64; 3],
    maxs: [f64; 3],
    files: [String; 2],
}

#[derive(Deserialize)]
struct Quats {
    files: [String; 1],
}

#[derive(Deserialize)]
struct Values {
    codebook: Option<Vec<Option<f32>>>,
    mins: Option<Vec<f32>>,
    maxs: Option<Vec<f32>>,
    files: [String; 1],
}

#[derive(Deserialize)]
struct Rest {
    codebook: Option<Vec<Option<f32>>>,
    mins: Option<f32>,
    maxs: Option<f32>,
    files: [String; 2],
}

/// The value of each byte of a channel.
type Lookup = [f32; 256];

/// Reads `meta.json` and the textures beside it; links are followed, since caches of downloads consist of them.
pub(in super::super) fn read_folder(folder: &Path) -> Result<Parsed, Fault> {
    read(|name| {
        let path = folder.join(name);
        std::fs::read(&path).map_err(|source| Fault::Io { path, source })
    })
}

/// Reads a `.sog` bundle: the same files in a zip archive.
pub(in super::super) fn read_bundle(bytes: &[u8]) -> Result<Parsed, Fault> {
    let damaged = |what: String| malformed("zip archive", format!("{what}; {AGAIN}"));
    let mut archive = zip::ZipArchive::new(Cursor::new(bytes)).map_err(|error| damaged(error.to_string()))?;
    let names = archive.file_names().filter_map(Result::ok);
    let metas = names.filter(|name| name == "meta.json" || name.ends_with("/meta.json"));
    let Some(meta) = metas.min_by_key(|name| name.len()).map(Cow::into_owned) else {
        let what = "holds no meta.json, so no SOG; if it is a checkpoint of PyTorch, export a PLY with the program that trained it; if it is a capture, unpack it and give its folder";
        return Err(malformed("zip archive", what));
    };
    let prefix = meta.trim_end_matches("meta.json").to_owned();
    read(|name| {
        let entry = archive.by_name(&format!("{prefix}{name}"));
        let entry = entry.map_err(|error| damaged(format!("{name}: {error}")))?;
        // WebP hardly shrinks in a zip, and JSON by no more than this, except for codebooks of equal numbers, of which each takes 6 kB at
        // most: content that grows beyond is no model.
        let most = entry.compressed_size().min(bytes.len() as u64) * 16 + 16_384;
        let mut content = Vec::new();
        let read = entry.take(most + 1).read_to_end(&mut content);
        read.map_err(|error| damaged(format!("{name}: {error}")))?;
        if content.len() as u64 > most {
            return Err(damaged(format!("{name} grows beyond {most} bytes")));
        }
        Ok(content)
    })
}

/// Reads a model whose files `load` gives by name.
fn read(mut load: impl FnMut(&str) -> Result<Vec<u8>, Fault>) -> Result<Parsed, Fault> {
    let text = text_of(load("meta.json")?).map_err(|(place, what)| malformed(format!("meta.json, {place}"), what))?;
    let meta: Meta =
        serde_json::from_str(&text).map_err(|error| malformed("meta.json", format!("{error}; {AGAIN}")))?;
    if let Some(version) = meta.version.as_ref().filter(|v| ![Some(1.0), Some(2.0)].contains(&number(v))) {
        let version = shown(&version.as_str().map_or_else(|| version.to_string(), ToOwned::to_owned), 40);
        return Err(Fault::Unsupported(format!("SOG version {version}; versions 1 and 2 are read; export it as one")));
    }
    let claimed = meta.count.as_ref().or_else(|| meta.means.shape.as_ref()?.first());
    let is_whole = |count: &f64| *count >= 0.0 && count.fract() == 0.0;
    let Some((claimed, count)) = claimed.zip(claimed.and_then(Number::as_f64).filter(is_whole)) else {
        let what = format!("neither count nor means.shape is a number of Gaussians; {AGAIN}");
        return Err(malformed("meta.json", what));
    };

    let rest_files = meta.sh_rest.as_ref().map_or(&[][..], |rest| &rest.files);
    let files: Vec<&String> =
        meta.means.files.iter().chain(&meta.quats.files).chain(&meta.scales.files).chain(&meta.sh0.files).collect();
    let mut webps = Vec::new();
    for &name in files.iter().chain(&rest_files.iter().collect::<Vec<_>>()) {
        if !Path::new(name).components().all(|part| matches!(part, Component::Normal(_))) {
            return Err(malformed("meta.json", format!("file name `{name}` leaves the folder; {AGAIN}")));
        }
        webps.push((name, load(name)?));
    }
    let packed = webps.iter().map(|(_, bytes)| bytes.len()).sum();
    let degree = if meta.sh_rest.is_some() { MAX_SH_DEGREE } else { 0 };
    let n = count as usize; // saturates
    if !fits(n, degree, packed) {
        let what = format!("{claimed} Gaussians claimed, more than textures of {packed} bytes can hold; {AGAIN}");
        return Err(malformed("meta.json", what));
    }
    let textures: Vec<RgbaImage> = webps
        .par_iter()
        .enumerate()
        .map(|(i, (name, bytes))| {
            let is_palette = i == 5;
            decode(bytes, if is_palette { None } else { Some(n) })
                .map_err(|what| malformed(name.as_str(), format!("{what}; {AGAIN}")))
        })
        .collect::<Result<_, _>>()?;
    let texels = |i: usize| textures[i].par_chunks_exact(4).take(n);

    let scales = lookups(&meta.scales, "scales")?;
    let colours = lookups(&meta.sh0, "sh0")?;
    let opacity = if meta.sh0.codebook.is_some() { bytes_to(logit_of_byte) } else { colours[3] };
    let axis = |low: &[u8], high: &[u8], axis: usize| {
        let t = f64::from(u16::from_le_bytes([low[axis], high[axis]])) / 65535.0;
        let log = meta.means.mins[axis] + (meta.means.maxs[axis] - meta.means.mins[axis]) * t;
        log.abs().exp_m1().copysign(log) as f32
    };
    let mut model = Gaussians {
        means: texels(0).zip(texels(1)).map(|(low, high)| [0, 1, 2].map(|i| axis(low, high, i))).collect(),
        rotations: texels(2).map(|texel| rotation([texel[0], texel[1], texel[2], texel[3]])).collect(),
        log_scales: texels(3).map(|texel| [0, 1, 2].map(|i: usize| scales[i][usize::from(texel[i])])).collect(),
        opacity_logits: texels(4).map(|texel| opacity[usize::from(texel[3])]).collect(),
        sh: vec![vec![0.0; 3 * n]],
    };
    model.sh[0].par_chunks_exact_mut(3).zip(texels(4)).for_each(|(out, texel)| {
        for channel in 0..3 {
            out[channel] = colours[channel][usize::from(texel[channel])];
        }
    });
    if let Some(rest) = &meta.sh_rest {
        rest_bands(&mut model, rest, &textures[5], &textures[6])?;
    }
    let tag = Tag::of_sog(meta.model.as_ref(), meta.antialias.as_ref());
    Ok(Parsed { gaussians: model, format: Format::Sog, tag, trailing_bytes: 0 })
}

/// A number, which may be written as a string.
fn number(value: &Value) -> Option<f64> {
    value.as_f64().or_else(|| value.as_str()?.trim().parse().ok())
}

/// Adds bands 1 and up: each Gaussian's label names a palette entry of K texels, K = 3, 8 or 15.
fn rest_bands(model: &mut Gaussians, rest: &Rest, palette: &RgbaImage, labels: &RgbaImage) -> Result<(), Fault> {
    let lookup = match (&rest.codebook, rest.mins, rest.maxs) {
        (Some(codebook), ..) => of_codebook(codebook),
        (None, Some(low), Some(high)) => bytes_to(|byte| low + (high - low) * (f32::from(byte) / 255.0)),
        _ => return Err(malformed("meta.json", format!("shN has neither codebook nor limits; {AGAIN}"))),
    };
    let degree = match palette.width() {
        192 => 1,
        512 => 2,
        960 => 3,
        width => {
            let what = format!("{width} texels wide; 64 entries of SH degree 1 to 3 are 192, 512 or 960, {AGAIN}");
            return Err(malformed(rest.files[0].as_str(), what));
        }
    };
    let n = model.len();
    let per_entry = (degree + 1) * (degree + 1) - 1;
    let entries: Vec<&[u8]> = palette.chunks_exact(4 * per_entry).collect();
    for l in 1..=degree {
        let width = Gaussians::band_width(l);
        let mut band = vec![0.0; n * width];
        let rows = band.par_chunks_exact_mut(width).zip(labels.par_chunks_exact(4));
        rows.enumerate().try_for_each(|(i, (out, label))| {
            let label = u16::from_le_bytes([label[0], label[1]]);
            let entry = entries.get(usize::from(label)).ok_or_else(|| {
                let what = format!("label {label} beyond the palette's {} entries; {AGAIN}", entries.len());
                malformed(format!("{}, texel {i}", rest.files[1]), what)
            })?;
            let texels = entry.chunks_exact(4).skip(l * l - 1);
            for (out, texel) in out.chunks_exact_mut(3).zip(texels) {
                for channel in 0..3 {
                    out[channel] = lookup[usize::from(texel[channel])];
                }
            }
            Ok::<_, Fault>(())
        })?;
        model.sh.push(band);
    }
    Ok(())
}

/// The quaternion of a texel; zero, which the common repairs remove, if its tag is invalid.
fn rotation([a, b, c, tag]: [u8; 4]) -> [f32; 4] {
    let component = |byte: u8| (f32::from(byte) / 255.0 * 2.0 - 1.0) * std::f32::consts::FRAC_1_SQRT_2;
    match tag {
        GREATEST.. => from_smallest_three([a, b, c].map(component), usize::from(tag - GREATEST)),
        _ => [0.0; 4],
    }
}

/// The meaning of the bytes of four channels: one codebook for all (version 2) or limits of each (version 1).
fn lookups(values: &Values, name: &str) -> Result<[Lookup; 4], Fault> {
    match (&values.codebook, &values.mins, &values.maxs) {
        (Some(codebook), ..) => Ok([of_codebook(codebook); 4]),
        (None, Some(mins), Some(maxs)) if mins.len() >= 3 && mins.len() == maxs.len() => Ok([0, 1, 2, 3].map(|i| {
            let (low, high) = (mins.get(i).copied().unwrap_or(0.0), maxs.get(i).copied().unwrap_or(0.0));
            bytes_to(|byte| low + (high - low) * (f32::from(byte) / 255.0))
        })),
        _ => Err(malformed("meta.json", format!("{name} has neither codebook nor limits of each channel; {AGAIN}"))),
    }
}

fn bytes_to(value: impl Fn(u8) -> f32) -> Lookup {
    std::array::from_fn(|byte| value(byte as u8))
}

/// A codebook; bytes beyond its end give NaN, so that the common repairs remove and count the Gaussians that use them.
fn of_codebook(codebook: &[Option<f32>]) -> Lookup {
    let get = |i: usize| codebook.get(i).copied().flatten().unwrap_or(f32::NAN);
    let mut lookup: Lookup = std::array::from_fn(get);
    // Early exporters wrote null for the first entry; PlayCanvas' engine extends the range by one mean step.
    if codebook.first() == Some(&None) {
        lookup[0] = lookup[1] + (lookup[1] - lookup[255]) / 255.0;
    }
    lookup
}

/// Decodes a texture of `n` texels, or a palette, if its size is plausible.
fn decode(bytes: &[u8], n: Option<usize>) -> Result<RgbaImage, String> {
    let decoder = WebPDecoder::new(Cursor::new(bytes)).map_err(|error| error.to_string())?;
    let (width, height) = decoder.dimensions();
    let texels = u64::from(width) * u64::from(height);
    match n {
        Some(n) if texels < n as u64 => return Err(format!("{width} x {height} texels for {n} Gaussians")),
        // Writers pad the last rows only; a palette has at most 65,536 entries of 15.
        Some(n) if texels > 4 * n as u64 + 65536 => {
            return Err(format!("{width} x {height} texels for only {n} Gaussians"));
        }
        None if width > 960 || height > 1024 => return Err(format!("a palette of {width} x {height} texels")),
        _ => {}
    }
    let image = DynamicImage::from_decoder(decoder).map_err(|error| error.to_string())?;
    Ok(image.into_rgba8())
}

/// Bytes of each attribute's textures in a bundle; nothing if it cannot be read.
pub(in super::super) fn parts(bytes: &[u8]) -> Vec<(&'static str, u64)> {
    const ATTRIBUTES: [(&str, &str); 6] = [
        ("means", "means"),
        ("rotations", "quats"),
        ("scales", "scales"),
        ("colours and opacities", "sh0"),
        ("SH palette", "shN_centroids"),
        ("SH labels", "shN_labels"),
    ];
    let Ok(mut archive) = zip::ZipArchive::new(Cursor::new(bytes)) else { return Vec::new() };
    let mut parts = ATTRIBUTES.map(|(attribute, _)| (attribute, 0)).to_vec();
    for number in 0..archive.len() {
        let Ok(file) = archive.by_index_raw(number) else { continue };
        if let Some(known) =
            file.name().ok().and_then(|name| ATTRIBUTES.iter().position(|(_, start)| name.starts_with(start)))
        {
            parts[known].1 += file.compressed_size();
        }
    }
    parts.retain(|(_, bytes)| *bytes > 0);
    parts
}
