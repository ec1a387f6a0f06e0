//! Writing SPZ, version 4 (zstd, one frame for each attribute) or 3 (gzip round everything): the stored values are the same.
//!
//! The number of fractional bits fits the model, whereas the official writer always uses 12 and lets greater coordinates wrap.

use std::io::{self, Write};
use std::ops::RangeInclusive;

use flate2::Compression;
use flate2::write::GzEncoder;
use rayon::prelude::*;

use super::super::axes::{RIGHT_DOWN_FRONT, RIGHT_UP_BACK, convert};
use super::super::bytes::to_smallest_three;
use super::super::fault::Fault;
use super::super::weight::{FAINT, colour_change};
use super::super::{Gaussians, Ladder, Precision, RenderMode, SpzPrecision, SpzVersion};
use super::{COLOUR_SCALE, FLAG_ANTIALIASED, HEADER, MAGIC};
use crate::scene::median;

/// Greatest magnitude of a 24-bit coordinate.
const FIXED_MAX: f32 = 8_388_607.0;
const DEFAULT_FRACTIONAL_BITS: i32 = 12;
/// Largest number of fractional bits: the reference reader shifts a 32-bit one by it.
const MAX_FRACTIONAL_BITS: i32 = 30;
/// Level 19 makes files 2 to 3 % smaller than level 9, in ten times the time.
const ZSTD_LEVEL: i32 = 12;

/// Packs a consistent model as version 3 or 4; fails where its means do not fit 24 bits finely enough.
pub(in super::super) fn pack(
    model: &Gaussians,
    mode: RenderMode,
    (version, precision): (SpzVersion, SpzPrecision),
) -> Result<Vec<u8>, Fault> {
    let n =
        u32::try_from(model.len()).map_err(|_| Fault::Unsupported("more than 2^32 Gaussians; write .ply".into()))?;
    let mut model = model.clone();
    convert(&mut model, RIGHT_DOWN_FRONT, RIGHT_UP_BACK);
    let bits = fractional_bits(&model, precision.means)?;
    let streams = streams(&model, bits, precision);
    let number = match version {
        SpzVersion::Three => 3u32,
        SpzVersion::Four => 4,
    };
    let flags = if mode.antialiased() { FLAG_ANTIALIASED } else { 0 };
    let count = if number == 3 { 0 } else { streams.len() as u8 };
    let mut header = [MAGIC, number, n].map(u32::to_le_bytes).concat();
    header.extend([model.degree() as u8, bits as u8, flags, count]);
    let packed = if number == 3 { gzip(&header, &streams) } else { frames(header, &streams) };
    packed.map_err(|error| Fault::Unsupported(format!("compression failed ({error}); write .ply")))
}

/// The attributes that are not empty, in the format's order.
fn streams(model: &Gaussians, bits: i32, precision: SpzPrecision) -> Vec<Vec<u8>> {
    let unit = 2f32.powi(bits);
    let fixed = |coordinate: &f32| {
        let fixed = (coordinate * unit).round().clamp(-FIXED_MAX, FIXED_MAX) as i32;
        let [low, middle, high, _] = fixed.to_le_bytes();
        [low, middle, high]
    };
    let colours = model.sh.first().map_or(&[][..], Vec::as_slice);
    let mut rest = Vec::new();
    for i in 0..model.len() {
        for (l, band) in model.sh.iter().enumerate().skip(1) {
            let width = Gaussians::band_width(l);
            let bucket = precision.bucket(l);
            rest.extend(band[i * width..(i + 1) * width].iter().map(|&value| quantise_sh(value, bucket)));
        }
    }
    let mut streams = vec![
        model.means.as_flattened().iter().flat_map(fixed).collect(),
        model.opacity_logits.iter().map(|logit| byte(255.0 / (1.0 + (-logit).exp()))).collect(),
        colours.iter().map(|c| byte(c * (COLOUR_SCALE * 255.0) + 127.5)).collect(),
        model.log_scales.as_flattened().iter().map(|scale| byte((scale + 10.0) * 16.0)).collect(),
        model.rotations.iter().flat_map(|q| smallest_three(*q)).collect(),
        rest,
    ];
    streams.retain(|stream: &Vec<u8>| !stream.is_empty());
    streams
}

/// Version 3: header and attributes, in one gzip stream.
fn gzip(header: &[u8], streams: &[Vec<u8>]) -> io::Result<Vec<u8>> {
    let mut encoder = GzEncoder::new(Vec::new(), Compression::default());
    encoder.write_all(header)?;
    streams.iter().try_for_each(|stream| encoder.write_all(stream))?;
    encoder.finish()
}

/// Version 4: header, table, and a zstd frame for each attribute.
fn frames(header: Vec<u8>, streams: &[Vec<u8>]) -> io::Result<Vec<u8>> {
    let frames =
        streams.par_iter().map(|stream| zstd::bulk::compress(stream, ZSTD_LEVEL)).collect::<io::Result<Vec<_>>>()?;
    let mut out = header;
    out.extend((HEADER as u32).to_le_bytes());
    out.resize(HEADER, 0);
    for (frame, stream) in frames.iter().zip(streams) {
        out.extend([frame.len() as u64, stream.len() as u64].map(u64::to_le_bytes).concat());
    }
    out.extend(frames.concat());
    Ok(out)
}

/// Logarithms of the scales that a byte can hold, in steps of 1/16.
pub(in super::super) const LOG_SCALES: RangeInclusive<f32> = -10.0..=255.0 / 16.0 - 10.0;

/// Fractional bits of the means: the official 12, or more for small Gaussians, as 24 bits allow; or as many `below` the median
/// Gaussian's size, if these are fewer.
///
/// A step of 1/16 of the median Gaussian's size moves nothing visibly; a step beyond that size ruins the picture.
fn fractional_bits(model: &Gaussians, below: Option<u8>) -> Result<i32, Fault> {
    let reach = model.means.as_flattened().iter().fold(0f32, |reach, x| reach.max(x.abs()));
    if !reach.is_finite() || reach > FIXED_MAX {
        return Err(Fault::Unsupported(format!(
            "a mean at {reach} is beyond the {FIXED_MAX} that SPZ can store; remove far Gaussians, move the model to the origin, or write .ply"
        )));
    }
    let mut sizes: Vec<f32> = model.log_scales.iter().map(|s| s.iter().fold(f32::MIN, |a, &b| a.max(b))).collect();
    let Some(median) = median(&mut sizes) else { return Ok(DEFAULT_FRACTIONAL_BITS) };
    if !LOG_SCALES.contains(&median) {
        let ([low, high], size) = ([LOG_SCALES.start(), LOG_SCALES.end()].map(|s| s.exp()), median.exp());
        return Err(Fault::Unsupported(format!(
            "the median Gaussian's size, {size:.1e}, is beyond the {low:.1e} to {high:.1e} that SPZ can store; scale the model or write .ply"
        )));
    }
    let median = median / std::f32::consts::LN_2;
    let fit = if reach > 0.0 { (FIXED_MAX / reach).log2().floor() as i32 } else { MAX_FRACTIONAL_BITS };
    let bits = ((4.0 - median).ceil() as i32).clamp(DEFAULT_FRACTIONAL_BITS, MAX_FRACTIONAL_BITS).min(fit);
    if (bits as f32) < -median {
        return Err(Fault::Unsupported(format!(
            "means reach {reach}, so SPZ's 24 bits would move them by more than the median Gaussian's size (2^{median:.1}); \
             remove far Gaussians, move the model to the origin, or write .ply"
        )));
    }
    let fewer = below.map_or(bits, |below| (f32::from(below) - median).ceil().max(0.0) as i32);
    Ok(bits.min(fewer))
}

/// The fewest bits, from the official 5 and 4 on, whose rounding of SH changes colours by less than [`FAINT`].
pub(in super::super) fn usual(model: &Gaussians, ladder: &Ladder) -> Precision {
    let fine = |precision: &Precision| matches!(precision, Precision::Spz(bits) if bits.first >= 5 && change(model, *bits) < FAINT);
    ladder.coarse().find(fine).unwrap_or(ladder.finest()).with_all_means()
}

/// The change of Gaussians' colours by rounding SH to these bits.
fn change(model: &Gaussians, precision: SpzPrecision) -> f64 {
    colour_change(model, |i| {
        let mut square = 0.0;
        for (l, band) in model.sh.iter().enumerate().skip(1) {
            let (width, bucket) = (Gaussians::band_width(l), precision.bucket(l));
            for &value in &band[i * width..(i + 1) * width] {
                let stored = (f32::from(quantise_sh(value, bucket)) - 128.0) / 128.0;
                square += f64::from(value - stored).powi(2);
            }
        }
        square
    })
}

fn byte(value: f32) -> u8 {
    value.round().clamp(0.0, 255.0) as u8
}

/// 8 bits over [-1, 1), rounded to the centre of a bucket so that 0 stays 0.
fn quantise_sh(value: f32, bucket: i32) -> u8 {
    let fine = (value * 128.0).round().clamp(-1024.0, 1024.0) as i32 + 128;
    ((fine + bucket / 2).div_euclid(bucket) * bucket).clamp(0, 255) as u8
}

/// The greatest of (x, y, z, w) in 2 bits, then sign and 9 bits each of the others; zero becomes the identity.
fn smallest_three([w, x, y, z]: [f32; 4]) -> [u8; 4] {
    let (smaller, greatest) = to_smallest_three([x, y, z, w], 3);
    let mut word = greatest as u32;
    for value in smaller {
        let magnitude = (value.abs() * std::f64::consts::SQRT_2 * 511.0).round().min(511.0) as u32;
        word = word << 10 | u32::from(value < 0.0) << 9 | magnitude;
    }
    word.to_le_bytes()
}
