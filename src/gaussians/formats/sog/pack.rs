//! Writing SOG version 2, as a bundle.
//!
//! Gaussians are written along a Z-order curve: neighbouring texels are then similar, which lossless textures exploit.

use std::io::{Cursor, Write};

use image::codecs::webp::WebPEncoder;
use image::{ExtendedColorType, ImageEncoder};
use rayon::prelude::*;
use serde_json::{Value, json};
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipWriter};

use super::super::bytes::to_smallest_three;
use super::super::fault::Fault;
use super::super::{Gaussians, RenderMode};
use super::codebook::Codebook;
use super::{ENTRIES_A_ROW, GREATEST, palette};

/// Labels have 16 bits.
const MOST_LEVELS: u32 = 16;

/// One texture: its name, width in texels, and RGBA.
struct Texture {
    name: &'static str,
    width: usize,
    texels: Vec<[u8; 4]>,
}

/// Packs a consistent model; fails where its means do not fit 16 bits finely enough.
pub(in super::super) fn pack(model: &Gaussians, mode: RenderMode) -> Result<Vec<u8>, Fault> {
    let [mins, maxs] = limits(model);
    refuse_coarse_means(model, mins, maxs)?;
    let order = z_order(model, mins, maxs);
    let by_gaussian = |name: &'static str, texel: &(dyn Fn(usize) -> [u8; 4] + Sync)| Texture {
        name,
        width: width(order.len()),
        texels: order.par_iter().map(|i| texel(*i as usize)).collect(),
    };
    let mean = |i: usize| [0, 1, 2].map(|axis| fixed(model.means[i][axis], mins[axis], maxs[axis]).to_le_bytes());
    let finite = |values: &[f32]| Codebook::fit(values.iter().copied().filter(|v| v.is_finite()).collect());
    let (scales, colours) =
        (finite(model.log_scales.as_flattened()), finite(model.sh.first().map_or(&[][..], Vec::as_slice)));
    let mut textures = vec![
        by_gaussian("means_l.webp", &|i| {
            let [x, y, z] = mean(i);
            [x[0], y[0], z[0], 255]
        }),
        by_gaussian("means_u.webp", &|i| {
            let [x, y, z] = mean(i);
            [x[1], y[1], z[1], 255]
        }),
        by_gaussian("quats.webp", &|i| smallest_three(model.rotations[i])),
        by_gaussian("scales.webp", &|i| {
            let [x, y, z] = model.log_scales[i].map(|s| scales.byte(s));
            [x, y, z, 255]
        }),
        by_gaussian("sh0.webp", &|i| {
            let [r, g, b] = [0, 1, 2].map(|c| colours.byte(model.sh[0][3 * i + c]));
            let opacity = 1.0 / (1.0 + (-model.opacity_logits[i]).exp());
            [r, g, b, (opacity * 255.0).round() as u8]
        }),
    ];
    let mut meta = json!({
        "version": 2,
        "asset": { "generator": concat!("qirf-vk ", env!("CARGO_PKG_VERSION")) },
        "count": model.len(),
        "means": { "mins": mins, "maxs": maxs, "files": ["means_l.webp", "means_u.webp"] },
        "scales": { "codebook": scales.0.as_slice(), "files": ["scales.webp"] },
        "quats": { "files": ["quats.webp"] },
        "sh0": { "codebook": colours.0.as_slice(), "files": ["sh0.webp"] },
    });
    if mode.antialiased() {
        meta["model"] = json!("antialiased");
    }
    if model.degree() > 0 && !model.is_empty() {
        let (rest, labels, entry) = rest_bands(model, &order);
        textures.extend([rest, labels]);
        meta["shN"] = entry;
    }
    bundle(&meta, textures).map_err(|what| Fault::Unsupported(format!("SOG cannot be packed ({what}); write .ply")))
}

/// Width of a texture with one texel per Gaussian: about square, in whole blocks of four.
fn width(gaussians: usize) -> usize {
    ((gaussians as f64).sqrt() / 4.0).ceil().max(1.0) as usize * 4
}

/// ln(1 + |x|) with the sign of x.
fn logarithm(x: f32) -> f64 {
    f64::from(x).abs().ln_1p().copysign(f64::from(x))
}

/// Least and greatest [`logarithm`] of the means by axis.
fn limits(model: &Gaussians) -> [[f64; 3]; 2] {
    let fold = |axis: usize, start: f64, pick: fn(f64, f64) -> f64| {
        let of_all = model.means.iter().map(|m| logarithm(m[axis])).filter(|v| v.is_finite()).fold(start, pick);
        if of_all.is_finite() { of_all } else { 0.0 }
    };
    [[0, 1, 2].map(|a| fold(a, f64::INFINITY, f64::min)), [0, 1, 2].map(|a| fold(a, f64::NEG_INFINITY, f64::max))]
}

/// A coordinate in 16 bits between limits.
fn fixed(x: f32, min: f64, max: f64) -> u16 {
    let range = if max > min { max - min } else { 1.0 };
    ((logarithm(x) - min) / range * 65535.0).round().clamp(0.0, 65535.0) as u16
}

/// Refuses a model whose median Gaussian would move by more than its size.
fn refuse_coarse_means(model: &Gaussians, mins: [f64; 3], maxs: [f64; 3]) -> Result<(), Fault> {
    let mut moves: Vec<f64> = (0..model.len())
        .map(|i| {
            let step = (0..3)
                .map(|a| (maxs[a] - mins[a]) / 65535.0 * (1.0 + f64::from(model.means[i][a]).abs()))
                .fold(0.0, f64::max);
            let size = model.log_scales[i].iter().fold(f32::MIN, |a, s| a.max(*s));
            0.5 * step / f64::from(size).exp()
        })
        .collect();
    if moves.is_empty() {
        return Ok(());
    }
    let middle = moves.len() / 2;
    let median = *moves.select_nth_unstable_by(middle, f64::total_cmp).1;
    if median > 1.0 {
        return Err(Fault::Unsupported(format!(
            "SOG's 16 bits would move the median Gaussian by {median:.1} of its size; remove far Gaussians or write .ply"
        )));
    }
    Ok(())
}

/// Gaussians along a Z-order curve of 10 bits an axis.
fn z_order(model: &Gaussians, mins: [f64; 3], maxs: [f64; 3]) -> Vec<u32> {
    let spread = |word: u16| (0..10).fold(0_u32, |key, bit| key | u32::from(word >> (6 + bit) & 1) << (3 * bit));
    let key = |i: &u32| {
        let [x, y, z] = [0, 1, 2].map(|a| spread(fixed(model.means[*i as usize][a], mins[a], maxs[a])));
        (x | y << 1 | z << 2, *i)
    };
    let mut order: Vec<u32> = (0..model.len() as u32).collect();
    order.par_sort_by_cached_key(key);
    order
}

/// A rotation's texel; zero becomes the identity.
fn smallest_three(q: [f32; 4]) -> [u8; 4] {
    let (smaller, greatest) = to_smallest_three(q, 0);
    let [a, b, c] =
        smaller.map(|v| ((v * std::f64::consts::SQRT_2 * 0.5 + 0.5) * 255.0).round().clamp(0.0, 255.0) as u8);
    [a, b, c, GREATEST + greatest as u8]
}

/// Bands 1 and up: the palette's texture, the labels' texture and their entry of `meta.json`.
fn rest_bands(model: &Gaussians, order: &[u32]) -> (Texture, Texture, Value) {
    let per_entry = (model.degree() + 1).pow(2) - 1;
    let numbers = 3 * per_entry;
    let mut vectors = vec![0.0_f32; model.len() * numbers];
    vectors.par_chunks_exact_mut(numbers).zip(order).for_each(|(vector, i)| {
        let mut start = 0;
        for (l, band) in model.sh.iter().enumerate().skip(1) {
            let w = Gaussians::band_width(l);
            vector[start..start + w].copy_from_slice(&band[*i as usize * w..][..w]);
            start += w;
        }
    });
    let levels = model.len().ilog2().min(MOST_LEVELS);
    let palette = palette::fit(&vectors, numbers, levels);
    let codebook = Codebook::fit(palette.values.iter().copied().filter(|v| v.is_finite()).collect());
    let texel = |rgb: &[f32]| [codebook.byte(rgb[0]), codebook.byte(rgb[1]), codebook.byte(rgb[2]), 255];
    let centroids = Texture {
        name: "shN_centroids.webp",
        width: ENTRIES_A_ROW * per_entry,
        texels: palette.values.par_chunks_exact(3).map(texel).collect(),
    };
    let label = |label: &u32| [*label as u8, (*label >> 8) as u8, 0, 255];
    let labels = Texture {
        name: "shN_labels.webp",
        width: width(order.len()),
        texels: palette.labels.iter().map(label).collect(),
    };
    let entry = json!({
        "count": palette.values.len() / numbers,
        "bands": model.degree(),
        "codebook": codebook.0.as_slice(),
        "files": ["shN_centroids.webp", "shN_labels.webp"],
    });
    (centroids, labels, entry)
}

fn bundle(meta: &Value, textures: Vec<Texture>) -> Result<Vec<u8>, String> {
    let webps: Vec<(&str, Vec<u8>)> =
        textures.into_par_iter().map(|t| Ok((t.name, webp(t)?))).collect::<Result<_, String>>()?;
    let mut archive = ZipWriter::new(Cursor::new(Vec::new()));
    // WebP does not shrink further, and readers may seek in uncompressed entries.
    let stored = SimpleFileOptions::default().compression_method(CompressionMethod::Stored);
    let mut add = |name: &str, content: &[u8]| {
        archive.start_file(name, stored).map_err(|e| e.to_string())?;
        archive.write_all(content).map_err(|e| e.to_string())
    };
    add("meta.json", meta.to_string().as_bytes())?;
    for (name, content) in &webps {
        add(name, content)?;
    }
    archive.finish().map(Cursor::into_inner).map_err(|e| e.to_string())
}

fn webp(mut texture: Texture) -> Result<Vec<u8>, String> {
    let height = texture.texels.len().div_ceil(texture.width).max(1);
    texture.texels.resize(texture.width * height, [0, 0, 0, 255]);
    let mut bytes = Vec::new();
    WebPEncoder::new_lossless(&mut bytes)
        .write_image(texture.texels.as_flattened(), texture.width as u32, height as u32, ExtendedColorType::Rgba8)
        .map_err(|error| error.to_string())?;
    Ok(bytes)
}
