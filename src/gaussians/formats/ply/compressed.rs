//! PlayCanvas compressed PLY: chunks of 256 Gaussians with ranges, four packed words per Gaussian.
//!
//! Position and scale: 11, 10, 11 bits between the chunk's limits, first coordinate in the high bits. Rotation: 2 bits
//! for the greatest of (w, x, y, z), then the others in 10 bits each over +-sqrt(1/2). Colour: 8 bits each of red,
//! green, blue (between the chunk's limits where it has them) and opacity. SH: 8 bits over +-4, f_rest order
//! (github.com/playcanvas/splat-transform).

use rayon::prelude::*;

use super::super::Gaussians;
use super::super::bytes::{from_smallest_three, logit_of_byte, sh0_of_colour};
use super::super::fault::{Fault, malformed};
use super::standard::{gather, rest_bands, rest_slots};
use crate::ply::{Slot, Table};

/// Gaussians of a chunk.
pub(super) const CHUNK: usize = 256;
/// Quantities with limits per chunk and axis; the properties are `min_` and `max_` of each.
pub(super) const LIMITS: [[&str; 3]; 3] = [["x", "y", "z"], ["scale_x", "scale_y", "scale_z"], ["r", "g", "b"]];
/// Properties of a vertex.
pub(super) const PACKED: [&str; 4] = ["packed_position", "packed_rotation", "packed_scale", "packed_color"];
/// Width of the range of SH coefficients, of which 0 is the middle.
pub(super) const SH_RANGE: f32 = 8.0;

/// Least and greatest of position, log-scale and colour in a chunk.
#[derive(Clone, Copy)]
pub(super) struct Range {
    pub low: [f32; 9],
    pub high: [f32; 9],
}

/// Unpacks the vertex table by the chunk table; `sh` holds bands 1 and up.
pub(super) fn gaussians(chunk: &Table, vertex: &Table, sh: Option<&Table>) -> Result<Gaussians, Fault> {
    let [position, rotation, scale, colour] = PACKED.map(|name| vertex.packed(name));
    let (position, rotation, scale, colour) = (position?, rotation?, scale?, colour?);
    let n = vertex.len();
    let limits = limits(chunk)?;
    if limits.len() < n.div_ceil(CHUNK) {
        return Err(malformed(
            "element chunk",
            format!("{} chunks of {CHUNK} for {n} Gaussians; the counts disagree: export the file again", limits.len()),
        ));
    }

    let rows = || vertex.rows().par_chunks_exact(vertex.stride).enumerate();
    let mut model = Gaussians {
        means: rows().map(|(i, row)| limits[i / CHUNK].at(0, unpack_11_10_11(position.bits(row)))).collect(),
        log_scales: rows().map(|(i, row)| limits[i / CHUNK].at(1, unpack_11_10_11(scale.bits(row)))).collect(),
        rotations: rows().map(|(_, row)| unpack_rotation(rotation.bits(row))).collect(),
        opacity_logits: rows().map(|(_, row)| logit_of_byte(colour.bits(row) as u8)).collect(),
        sh: vec![vec![0.0; n * 3]],
    };
    model.sh[0].par_chunks_exact_mut(3).zip(rows()).for_each(|(out, (i, row))| {
        let [red, green, blue, _] = colour.bits(row).to_be_bytes().map(|byte| f32::from(byte) / 255.0);
        out.copy_from_slice(&limits[i / CHUNK].at(2, [red, green, blue]).map(sh0_of_colour));
    });
    if let Some(sh) = sh {
        if sh.len() != n {
            return Err(malformed(
                "element sh",
                format!("{} rows for {n} Gaussians; the counts disagree: export the file again", sh.len()),
            ));
        }
        for band in rest_bands(&rest_slots(sh)?) {
            model.sh.push(gather(sh, &band, |slot, row| unpack_sh(slot.float(row))));
        }
    }
    Ok(model)
}

fn limits(chunk: &Table) -> Result<Vec<Range>, Fault> {
    // Early writers had no colour limits: colours span [0, 1] there.
    let parts = if chunk.find("min_r").is_some() { 3 } else { 2 };
    let slots = |end: &str| -> Result<Vec<Slot>, Fault> {
        LIMITS[..parts].as_flattened().iter().map(|axis| Ok(chunk.slot(&format!("{end}_{axis}"))?)).collect()
    };
    let (low, high) = (slots("min")?, slots("max")?);
    let get = |row: &[u8], slots: &[Slot], usual: f32| {
        std::array::from_fn(|k| slots.get(k).map_or(usual, |slot| slot.float(row)))
    };
    let range = |row: &[u8]| Range { low: get(row, &low, 0.0), high: get(row, &high, 1.0) };
    Ok(chunk.rows().chunks_exact(chunk.stride).map(range).collect())
}

impl Range {
    /// Linear interpolation of a part: position, log-scale or colour; exact at both ends.
    fn at(&self, part: usize, t: [f32; 3]) -> [f32; 3] {
        [0, 1, 2].map(|axis: usize| self.low[3 * part + axis] * (1.0 - t[axis]) + self.high[3 * part + axis] * t[axis])
    }
}

fn unpack_11_10_11(word: u32) -> [f32; 3] {
    [(word >> 21) as f32 / 2047.0, (word >> 11 & 1023) as f32 / 1023.0, (word & 2047) as f32 / 2047.0]
}

fn unpack_rotation(word: u32) -> [f32; 4] {
    let smaller = [20, 10, 0].map(|shift| ((word >> shift & 1023) as f32 / 1023.0 - 0.5) * std::f32::consts::SQRT_2);
    from_smallest_three(smaller, (word >> 30) as usize)
}

/// Bucket centres, except that the outermost bytes stand for the ends of the range.
fn unpack_sh(byte: f32) -> f32 {
    let t = match byte {
        0.0 => 0.0,
        255.0 => 1.0,
        _ => (byte + 0.5) / 256.0,
    };
    (t - 0.5) * SH_RANGE
}
