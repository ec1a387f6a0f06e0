//! How finely files store models: the ladder of each format's settings, from the fewest bytes to the least loss.

use super::{Gaussians, spz};
use serde::Serialize;
use std::path::Path;

/// How finely a file stores a model.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Precision {
    /// As the format always does.
    Fixed,
    /// SPZ: bits of the SH coefficients.
    Spz(SpzPrecision),
    /// SOG: steps, and size of the palette.
    Sog(SogPrecision),
}

impl Precision {
    /// SPZ's bits; all of them unless these are of SPZ.
    pub(super) fn of_spz(self) -> SpzPrecision {
        if let Self::Spz(bits) = self { bits } else { SpzPrecision { first: 8, others: 8 } }
    }

    /// SOG's steps; the finest unless these are of SOG.
    pub(super) fn of_sog(self) -> SogPrecision {
        if let Self::Sog(steps) = self { steps } else { FINEST_SOG }
    }
}

/// Bits of SH coefficients in SPZ, 1 to 8: of band 1, and of the others.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct SpzPrecision {
    /// Of band 1.
    pub first: u8,
    /// Of the other bands.
    pub others: u8,
}

impl SpzPrecision {
    /// Steps of 1/128 that values of band `l` are rounded to.
    pub(super) fn bucket(self, l: usize) -> i32 {
        let bits = if l == 1 { self.first } else { self.others };
        1 << (8 - bits.clamp(1, 8))
    }
}

/// Steps of SOG's values; finer ones are not always possible in its eight bits.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct SogPrecision {
    /// Step of means, as a share of the Gaussians' size; at least the 65,535th part of the scene.
    pub mean: f64,
    /// Values of each component of a rotation, 2 to 256.
    pub rotation_levels: u16,
    /// Step of the logarithms of scales.
    pub scale: f64,
    /// Step of the zeroth SH coefficients.
    pub colour: f64,
    /// Values of opacities, 2 to 256.
    pub opacity_levels: u16,
    /// Step of the other SH coefficients.
    pub sh: f64,
    /// Palette entries for the other SH coefficients, as a share of the Gaussians.
    pub palette: f64,
}

impl SogPrecision {
    const fn new(steps: [f64; 4], [rotation_levels, opacity_levels]: [u16; 2], palette: f64) -> Self {
        let [mean, scale, colour, sh] = steps;
        Self { mean, rotation_levels, scale, colour, opacity_levels, sh, palette }
    }
}

const fn sog(steps: [f64; 4], levels: [u16; 2], palette: f64) -> Precision {
    Precision::Sog(SogPrecision::new(steps, levels, palette))
}

const fn bits(first: u8, others: u8) -> Precision {
    Precision::Spz(SpzPrecision { first, others })
}

/// The finest that SOG allows.
const FINEST_SOG: SogPrecision = SogPrecision::new([0.0, 0.03, 0.01, 0.005], [256, 256], 1.0);

/// Each rung loses about half as much as the one before. The last one is the finest that the format allows.
const SOG: [Precision; 7] = [
    sog([0.3, 0.35, 0.25, 0.1], [18, 12], 0.008),
    sog([0.2, 0.25, 0.18, 0.08], [26, 16], 0.0156),
    sog([0.16, 0.18, 0.12, 0.06], [36, 24], 0.06),
    sog([0.1, 0.1, 0.08, 0.05], [52, 32], 0.15),
    sog([0.06, 0.07, 0.05, 0.03], [86, 64], 0.3),
    sog([0.03, 0.05, 0.03, 0.02], [128, 128], 0.6),
    Precision::Sog(FINEST_SOG),
];

const SPZ: [Precision; 4] = [bits(4, 3), bits(5, 4), bits(6, 5), bits(8, 8)];

/// The settings of the format that a file's name asks for, from the fewest bytes to the least loss: one at least. `degree` is that of
/// the model's SH.
pub fn ladder(path: &Path, degree: usize) -> &'static [Precision] {
    match super::extension(path).as_str() {
        "sog" => &SOG,
        "spz" if degree > 0 => &SPZ,
        _ => &[Precision::Fixed],
    }
}

/// The finest settings of the format that a file's name asks for.
pub fn finest(path: &Path, degree: usize) -> Precision {
    ladder(path, degree).last().copied().unwrap_or(Precision::Fixed)
}

/// The settings that files have unless others are asked for: the fewest bits of SH that pictures do not show for SPZ, else the finest.
pub fn usual(path: &Path, model: &Gaussians) -> Precision {
    let ladder = ladder(path, model.degree());
    match ladder.last() {
        Some(Precision::Spz(_)) => spz::usual(model, ladder),
        last => last.copied().unwrap_or(Precision::Fixed),
    }
}
