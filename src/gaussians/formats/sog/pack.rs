//! Writing SOG version 2, as a bundle.
//!
//! Gaussians are written along a Z-order curve: neighbouring texels are then similar, which lossless textures exploit.

use std::io::{Cursor, Write};

use rayon::prelude::*;
use serde_json::{Value, json};
use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, System, ZipWriter};

use super::super::fault::Fault;
use super::super::weight::{FAINT, colour_change, weight};
use super::super::{Gaussians, META, RenderMode, SogPrecision};
use super::book::Book;
use super::means::Means;
use super::palette::{self, Palette};
use super::turn::least_turn;
use super::webp::Texture;
use super::{ENTRIES_A_ROW, GREATEST};
use crate::gaussians::opacity;

/// Labels have 16 bits.
const MOST_ENTRIES: usize = 1 << 16;
/// Least log of a Gaussian's axis less that of its longest: 1/1000, which no picture tells from less.
const THINNEST: f32 = -6.9;
/// Least weight of a Gaussian in the palette, as a share of the mean.
const LEAST_WEIGHT: f64 = 1e-3;

/// Packs a consistent model; fails where its means do not fit 16 bits finely enough.
pub(in super::super) fn pack(model: &Gaussians, mode: RenderMode, precision: &SogPrecision) -> Result<Vec<u8>, Fault> {
    let means = Means::new(model, precision.mean)?;
    let order = means.order(model);
    bundle(&files(model, mode, (precision, &means, &order))?)
}

/// True if a larger palette would show nothing more: it has as many entries as it can have, or changes colours faintly.
pub(in super::super) fn suffices(model: &Gaussians, precision: &SogPrecision) -> bool {
    let n = model.len();
    if entries(n, precision) >= n.min(MOST_ENTRIES) {
        return true;
    }
    let order: Vec<u32> = (0..n as u32).collect();
    let (vectors, Palette { values, labels }) = fitted(model, &order, precision);
    let numbers = vectors.len() / n;
    let square = |i: usize| {
        let own = &vectors[i * numbers..][..numbers];
        let shown = &values[labels[i] as usize * numbers..][..numbers];
        own.iter().zip(shown).map(|(a, b)| f64::from(a - b).powi(2)).sum::<f64>()
    };
    colour_change(model, square) < FAINT
}

/// The files of a consistent model in this order: `meta.json` first.
pub(super) fn files(
    model: &Gaussians,
    mode: RenderMode,
    (precision, means, order): (&SogPrecision, &Means, &[u32]),
) -> Result<Vec<(&'static str, Vec<u8>)>, Fault> {
    let turned: Vec<([f64; 4], [f32; 3])> = order
        .par_iter()
        .map(|i| least_turn(model.rotations[*i as usize], thickened(model.log_scales[*i as usize])))
        .collect();
    let by_gaussian = |name: &'static str, texel: &(dyn Fn(usize) -> [u8; 4] + Sync)| Texture {
        name,
        width: width(order.len()),
        texels: (0..order.len()).into_par_iter().map(texel).collect(),
    };
    let mean = |k: usize| means.bytes(model.means[order[k] as usize]);
    let scales = Book::equal(turned.iter().flat_map(|(_, scales)| *scales), precision.scale);
    let colours = Book::dense(model.sh.iter().take(1).flatten().copied(), precision.colour);
    let [mins, maxs] = means.limits();
    let mut textures = vec![
        by_gaussian("means_l.webp", &|k| {
            let [x, y, z] = mean(k);
            [x[0], y[0], z[0], 255]
        }),
        by_gaussian("means_u.webp", &|k| {
            let [x, y, z] = mean(k);
            [x[1], y[1], z[1], 255]
        }),
        by_gaussian("quats.webp", &|k| {
            let [_, x, y, z] = turned[k].0;
            let [x, y, z] =
                [x, y, z].map(|v| level(v * std::f64::consts::FRAC_1_SQRT_2 + 0.5, precision.rotation_levels));
            [x, y, z, GREATEST]
        }),
        by_gaussian("scales.webp", &|k| {
            let [x, y, z] = turned[k].1.map(|s| scales.byte(s));
            [x, y, z, 255]
        }),
        by_gaussian("sh0.webp", &|k| {
            let i = order[k] as usize;
            let [r, g, b] = [0, 1, 2].map(|c| colours.byte(model.sh[0][3 * i + c]));
            let opacity = opacity(model.opacity_logits[i]);
            [r, g, b, level(opacity, precision.opacity_levels)]
        }),
    ];
    let mut meta = json!({
        "version": 2,
        "asset": { "generator": concat!("qirf-vk ", env!("CARGO_PKG_VERSION")) },
        "count": model.len(),
        "means": { "mins": mins, "maxs": maxs, "files": ["means_l.webp", "means_u.webp"] },
        "scales": { "codebook": scales.json(), "files": ["scales.webp"] },
        "quats": { "files": ["quats.webp"] },
        "sh0": { "codebook": colours.json(), "files": ["sh0.webp"] },
    });
    if mode.antialiased() {
        meta["model"] = json!("antialiased");
    }
    if model.degree() > 0 && !model.is_empty() {
        let (rest, labels, entry) = rest_bands(model, order, precision);
        textures.extend([rest, labels]);
        meta["shN"] = entry;
    }
    let encoded = textures.into_par_iter().map(|t| Ok((t.name, t.encode()?))).collect::<Result<Vec<_>, String>>();
    let mut files = vec![(META, meta.to_string().into_bytes())];
    files.extend(encoded.map_err(unpackable)?);
    Ok(files)
}

fn unpackable(what: impl std::fmt::Display) -> Fault {
    Fault::Unsupported(format!("SOG cannot be packed ({what}); write .ply"))
}

/// Width of a texture with one texel per Gaussian: about square, in whole blocks of four.
fn width(gaussians: usize) -> usize {
    ((gaussians as f64).sqrt() / 4.0).ceil().max(1.0) as usize * 4
}

/// A share of 0 to 1 as one of `levels` bytes from 0 to 255.
fn level(share: f64, levels: u16) -> u8 {
    let most = f64::from(levels - 1);
    ((share * most).round().clamp(0.0, most) * (255.0 / most)).round() as u8
}

/// Scales of which none is less than 1/1000 of the greatest.
fn thickened(scales: [f32; 3]) -> [f32; 3] {
    let least = scales.iter().fold(f32::MIN, |a, s| a.max(*s)) + THINNEST;
    scales.map(|s| s.max(least))
}

/// Most entries of a palette for this many Gaussians.
fn entries(gaussians: usize, precision: &SogPrecision) -> usize {
    (gaussians as f64 * precision.palette).ceil().clamp(1.0, MOST_ENTRIES as f64) as usize
}

/// Coefficients of bands 1 and up, Gaussian by Gaussian in this order, and their palette.
fn fitted(model: &Gaussians, order: &[u32], precision: &SogPrecision) -> (Vec<f32>, Palette) {
    let numbers = 3 * ((model.degree() + 1).pow(2) - 1);
    let mut vectors = vec![0.0_f32; model.len() * numbers];
    vectors.par_chunks_exact_mut(numbers).zip(order).for_each(|(vector, i)| {
        let mut start = 0;
        for (l, band) in model.sh.iter().enumerate().skip(1) {
            let w = Gaussians::band_width(l);
            vector[start..start + w].copy_from_slice(&band[*i as usize * w..][..w]);
            start += w;
        }
    });
    let palette = palette::fit(&vectors, &weights(model, order), numbers, entries(model.len(), precision));
    (vectors, palette)
}

/// Bands 1 and up: the palette's texture, the labels' texture and their entry of `meta.json`.
fn rest_bands(model: &Gaussians, order: &[u32], precision: &SogPrecision) -> (Texture, Texture, Value) {
    let per_entry = (model.degree() + 1).pow(2) - 1;
    let (_, palette) = fitted(model, order, precision);
    let book = Book::dense(palette.values.iter().copied(), precision.sh);
    let texel = |rgb: &[f32]| [book.byte(rgb[0]), book.byte(rgb[1]), book.byte(rgb[2]), 255];
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
        "count": palette.values.len() / (3 * per_entry),
        "bands": model.degree(),
        "codebook": book.json(),
        "files": ["shN_centroids.webp", "shN_labels.webp"],
    });
    (centroids, labels, entry)
}

/// Weight of each Gaussian in the palette, in this order.
fn weights(model: &Gaussians, order: &[u32]) -> Vec<f32> {
    let weights: Vec<f64> = order.iter().map(|i| weight(model, *i as usize)).collect();
    let mean = weights.iter().sum::<f64>() / weights.len() as f64;
    if mean > 0.0 {
        weights.iter().map(|w| (w / mean).max(LEAST_WEIGHT) as f32).collect()
    } else {
        vec![1.0; weights.len()]
    }
}

fn bundle(files: &[(&str, Vec<u8>)]) -> Result<Vec<u8>, Fault> {
    let mut archive = ZipWriter::new(Cursor::new(Vec::new()));
    // The system's name is a byte of each entry.
    let stored = SimpleFileOptions::default().compression_method(CompressionMethod::Stored).system(System::Unix);
    let deflated = stored.compression_method(CompressionMethod::Deflated).compression_level(Some(9));
    for (name, content) in files {
        // WebP does not shrink further, and readers may seek in uncompressed entries.
        let options = if *name == META { deflated } else { stored };
        archive.start_file(*name, options).map_err(unpackable)?;
        archive.write_all(content).map_err(unpackable)?;
    }
    archive.finish().map(Cursor::into_inner).map_err(unpackable)
}
