//! PlayCanvas SOG: `meta.json` and lossless WebP textures, one texel per Gaussian, row by row; a bundle is all of them
//! in a zip archive.
//!
//! Means: low and high bytes of 16 bits between limits, of sign(x) ln(|x| + 1). Quaternions: three smaller components
//! over +-sqrt(1/2), alpha 252 + index of the greatest of (w, x, y, z). Scales, colours and SH: bytes into codebooks
//! (version 2) or between limits (version 1). SH: labels into a palette of 64 entries a row
//! (developer.playcanvas.com, github.com/playcanvas/splat-transform).

mod book;
mod levels;
mod means;
mod pack;
mod palette;
mod turn;
mod unpack;
mod webp;

pub(super) use levels::{LEVELS, folders_of_levels, pack as pack_levels, read_level};
pub(super) use pack::{pack, suffices};
pub(super) use unpack::{parts, read_bundle, read_folder};

/// A rotation's alpha less the index of its greatest component.
const GREATEST: u8 = 252;
/// Palette entries in a row of its texture.
const ENTRIES_A_ROW: usize = 64;
