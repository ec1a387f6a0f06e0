//! Writing PlayCanvas' compressed layout: chunks of 256 neighbours, along a Z-order curve.

use std::io::{self, Write};

use rayon::prelude::*;

use super::super::bytes::{SH_C0, to_smallest_three};
use super::super::{Gaussians, RenderMode};
use super::compressed::{CHUNK, LIMITS, PACKED, Range, SH_RANGE};
use super::write::{above_band_0, begin};
use crate::gaussians::opacity;
use crate::gaussians::order::z_order;

/// Log-scales beyond this, of infinite or vanishing size, would spoil the others of their chunk.
const SCALE_LIMIT: f32 = 20.0;

/// Writes a whole file; the order of the Gaussians is not kept. `origin` is the local origin of the means.
pub(in super::super) fn write(
    out: &mut dyn Write,
    model: &Gaussians,
    mode: RenderMode,
    origin: [f64; 3],
) -> io::Result<()> {
    let order = z_order(model);
    let rest: usize = (1..=model.degree()).map(Gaussians::band_width).sum();
    begin(out, mode, origin)?;
    header(out, model.len(), rest)?;
    let chunks: Vec<(Range, Vec<u8>)> = order.par_chunks(CHUNK).map(|chunk| pack(model, chunk)).collect();
    for (range, _) in &chunks {
        for part in 0..3 {
            for value in range.low[3 * part..3 * part + 3].iter().chain(&range.high[3 * part..3 * part + 3]) {
                out.write_all(&value.to_le_bytes())?;
            }
        }
    }
    for (_, words) in &chunks {
        out.write_all(words)?;
    }
    let mut row = Vec::with_capacity(rest);
    for i in order.iter().filter(|_| rest > 0) {
        row.clear();
        row.extend(above_band_0(model, *i as usize).map(sh_byte));
        out.write_all(&row)?;
    }
    Ok(())
}

fn header(out: &mut dyn Write, n: usize, rest: usize) -> io::Result<()> {
    writeln!(out, "element chunk {}", n.div_ceil(CHUNK))?;
    for axes in LIMITS {
        for end in ["min", "max"] {
            for axis in axes {
                writeln!(out, "property float {end}_{axis}")?;
            }
        }
    }
    writeln!(out, "element vertex {n}")?;
    for name in PACKED {
        writeln!(out, "property uint {name}")?;
    }
    if rest > 0 {
        writeln!(out, "element sh {n}")?;
        for i in 0..rest {
            writeln!(out, "property uchar f_rest_{i}")?;
        }
    }
    writeln!(out, "end_header")
}

/// Position, log-scale and colour of a Gaussian.
fn ranged(model: &Gaussians, i: usize) -> [f32; 9] {
    let mut values = [0.0; 9];
    values[..3].copy_from_slice(&model.means[i]);
    values[3..6].copy_from_slice(&model.log_scales[i].map(|s| s.clamp(-SCALE_LIMIT, SCALE_LIMIT)));
    for (value, sh) in values[6..].iter_mut().zip(&model.sh[0][3 * i..3 * i + 3]) {
        *value = sh * SH_C0 + 0.5;
    }
    values
}

/// The limits of a chunk, and its Gaussians' packed words.
fn pack(model: &Gaussians, chunk: &[u32]) -> (Range, Vec<u8>) {
    let mut range = Range { low: [f32::INFINITY; 9], high: [f32::NEG_INFINITY; 9] };
    for i in chunk.iter().map(|i| *i as usize) {
        for (k, value) in ranged(model, i).into_iter().enumerate().filter(|(_, value)| value.is_finite()) {
            range.low[k] = range.low[k].min(value);
            range.high[k] = range.high[k].max(value);
        }
    }
    for k in 0..9 {
        if range.low[k] > range.high[k] {
            (range.low[k], range.high[k]) = (0.0, 0.0); // nothing was finite
        }
    }
    let mut words = Vec::with_capacity(16 * chunk.len());
    for i in chunk.iter().map(|i| *i as usize) {
        let values = ranged(model, i);
        let share = |k: usize| {
            let span = f64::from(range.high[k]) - f64::from(range.low[k]);
            if span > 0.0 { (f64::from(values[k]) - f64::from(range.low[k])) / span } else { 0.0 }
        };
        let wide = |k: usize| units(share(k), 11) << 21 | units(share(k + 1), 10) << 11 | units(share(k + 2), 11);
        let opacity = opacity(model.opacity_logits[i]);
        let colour = (6..9).map(share).chain([opacity]).fold(0, |word, share| word << 8 | units(share, 8));
        for word in [wide(0), rotation(model.rotations[i]), wide(3), colour] {
            words.extend(word.to_le_bytes());
        }
    }
    (range, words)
}

/// A share of 1 in whole steps; NaN is none.
fn units(share: f64, bits: u32) -> u32 {
    (share.clamp(0.0, 1.0) * f64::from((1 << bits) - 1)).round() as u32
}

fn rotation(q: [f32; 4]) -> u32 {
    let (smaller, greatest) = to_smallest_three(q, 0);
    let component = |word: u32, c: &f64| word << 10 | units(c * std::f64::consts::FRAC_1_SQRT_2 + 0.5, 10);
    smaller.iter().fold(greatest as u32, component)
}

/// The bucket of a coefficient, of 256 over the range.
fn sh_byte(value: f32) -> u8 {
    ((value / SH_RANGE + 0.5) * 256.0).clamp(0.0, 255.0) as u8
}
