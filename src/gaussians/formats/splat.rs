//! antimatter15 `.splat`: no header, 32 bytes per Gaussian.
//!
//! f32 mean x 3, f32 linear scale x 3, u8 red, green, blue, opacity, u8 quaternion w, x, y, z as 128 + 128 q
//! (github.com/antimatter15/splat).

use rayon::prelude::*;

use super::bytes::{logit_of_byte, sh0_of_colour};
use super::fault::{Fault, malformed};
use super::{Format, Gaussians, Parsed, Tag};

const RECORD: usize = 32;

/// Reads a whole `.splat` file.
pub(super) fn read(bytes: &[u8]) -> Result<Parsed, Fault> {
    let (whole, rest) = (bytes.len() / RECORD, bytes.len() % RECORD);
    if rest != 0 {
        return Err(malformed(
            format!("record {whole} at byte {}", whole * RECORD),
            format!("{whole} whole records of {RECORD} bytes, then {rest} bytes; fetch or export the file again"),
        ));
    }
    let records = || bytes.par_chunks_exact(RECORD);
    let float = |r: &[u8], i: usize| f32::from_le_bytes([r[4 * i], r[4 * i + 1], r[4 * i + 2], r[4 * i + 3]]);
    let gaussians = Gaussians {
        means: records().map(|r| [float(r, 0), float(r, 1), float(r, 2)]).collect(),
        log_scales: records().map(|r| [3, 4, 5].map(|i| float(r, i).ln())).collect(),
        rotations: records().map(|r| [28, 29, 30, 31].map(|i| (f32::from(r[i]) - 128.0) / 128.0)).collect(),
        opacity_logits: records().map(|r| logit_of_byte(r[27])).collect(),
        sh: vec![records().flat_map_iter(|r| r[24..27].iter().map(|&c| sh0_of_colour(f32::from(c) / 255.0))).collect()],
    };
    Ok(Parsed { gaussians, format: Format::Splat, tag: Tag::default(), trailing_bytes: 0 })
}
