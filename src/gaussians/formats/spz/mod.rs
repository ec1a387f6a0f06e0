//! Niantic SPZ (github.com/nianticlabs/spz): 8- to 24-bit attributes, gzip (versions 1 to 3) or zstd (version 4).
//!
//! Coordinates: an SPZ file is right-up-back unless an extension says otherwise, while 3DGS PLY, and so our model, is
//! right-down-front. Reading and writing rotate by 180 degrees about x, as the official library does for a cloud
//! declared RDF. (Its command-line tools leave the system unspecified and rotate nothing.)

mod pack;
mod unpack;

pub(super) use pack::{LOG_SCALES, pack, usual};
pub(super) use unpack::{Around, is_inside, parts, read, read_in};

/// Flag of the header: the model is anti-aliased.
const FLAG_ANTIALIASED: u8 = 1;
/// Bytes of version 4's header.
const HEADER: usize = 32;
const MAGIC: u32 = u32::from_le_bytes(*b"NGSP");

/// Greatest magnitudes of SH coefficients that are not cut off: in band 0, with half a step of a byte, and above it; 1 itself is stored
/// as 127/128.
pub(super) const SH_LIMITS: [f32; 2] = [128.0 / 255.0 / COLOUR_SCALE, 1.0];

/// Colours are stored as 0.15 SH + 0.5, not 0.282 SH + 0.5: headroom for values that higher bands bring back.
const COLOUR_SCALE: f32 = 0.15;
