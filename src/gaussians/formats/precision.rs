//! Precision of stored models: each format's list of settings, from the fewest bytes to the least loss.

use super::{Gaussians, sog, spz};
use crate::extension::extension;
use serde::Serialize;
use std::path::Path;

/// Precision of a stored model.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
#[serde(rename_all = "kebab-case")]
pub enum Precision {
    /// The only precision of the format.
    Fixed,
    /// SH up to this degree, for formats with a single precision: fewer bands make a smaller file.
    Degree(usize),
    /// SPZ: bits of the means and of the SH coefficients.
    Spz(SpzPrecision),
    /// SOG: steps, and size of the palette.
    Sog(SogPrecision),
}

impl Precision {
    /// SPZ's bits; all of them unless these are of SPZ.
    pub(super) fn of_spz(self) -> SpzPrecision {
        if let Self::Spz(bits) = self { bits } else { SpzPrecision { first: 8, others: 8, means: None } }
    }

    /// The same, but with all bits of SPZ's means.
    #[must_use]
    pub fn with_all_means(self) -> Self {
        if let Self::Spz(bits) = self { Self::Spz(SpzPrecision { means: None, ..bits }) } else { self }
    }

    /// SOG's steps; the finest unless these are of SOG.
    pub(super) fn of_sog(self) -> SogPrecision {
        if let Self::Sog(steps) = self { steps } else { FINEST_SOG }
    }
}

/// Bits in SPZ.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
pub struct SpzPrecision {
    /// Bits of SH coefficients of band 1, 1 to 8.
    pub first: u8,
    /// Bits of SH coefficients of the other bands.
    pub others: u8,
    /// Bits of means below the median Gaussian's size: 4 move means by at most a 32nd of it. Null: 4, and at least 12
    /// fractional bits.
    pub means: Option<u8>,
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

    /// One precision for each attribute that SOG stores, with its name: these settings for it, and the finest for all
    /// others.
    pub fn alone(&self) -> [(&'static str, Self); 6] {
        let of = FINEST_SOG;
        [
            ("means", Self { mean: self.mean, ..of }),
            ("rotations", Self { rotation_levels: self.rotation_levels, ..of }),
            ("scales", Self { scale: self.scale, ..of }),
            ("colours", Self { colour: self.colour, ..of }),
            ("opacities", Self { opacity_levels: self.opacity_levels, ..of }),
            ("SH", Self { sh: self.sh, palette: self.palette, ..of }),
        ]
    }

    /// A share of the way to finer settings, by factors.
    fn towards(&self, finer: &Self, share: f64) -> Self {
        if share == 0.0 {
            return *self;
        }
        // The finest means have no step of their own: half of the last one stands for it.
        let between = |a: f64, b: f64| a * (b / a).powf(share);
        let levels = |a: u16, b: u16| between(f64::from(a), f64::from(b)).round() as u16;
        Self {
            mean: between(self.mean, if finer.mean > 0.0 { finer.mean } else { 0.5 * self.mean }),
            rotation_levels: levels(self.rotation_levels, finer.rotation_levels),
            scale: between(self.scale, finer.scale),
            colour: between(self.colour, finer.colour),
            opacity_levels: levels(self.opacity_levels, finer.opacity_levels),
            sh: between(self.sh, finer.sh),
            palette: between(self.palette, finer.palette),
        }
    }
}

/// The finest that SOG allows.
const FINEST_SOG: SogPrecision = SogPrecision::new([0.0, 0.018, 0.01, 0.005], [256, 256], 1.0);

/// Each step loses about half as much as the one before. The last one is the finest that the format allows.
const SOG: [SogPrecision; 7] = [
    SogPrecision::new([0.3, 0.35, 0.25, 0.1], [18, 12], 0.008),
    SogPrecision::new([0.2, 0.25, 0.18, 0.08], [26, 16], 0.0156),
    SogPrecision::new([0.16, 0.18, 0.12, 0.06], [36, 24], 0.06),
    SogPrecision::new([0.1, 0.1, 0.08, 0.05], [52, 32], 0.15),
    SogPrecision::new([0.06, 0.07, 0.05, 0.03], [86, 64], 0.3),
    SogPrecision::new([0.03, 0.05, 0.03, 0.02], [128, 128], 0.6),
    FINEST_SOG,
];
/// Rungs from one step to the next: 3 % of the bytes each.
const A_STEP: usize = 8;

/// Rungs between the usual settings of SOG for models with SH and the finest: those take 8 to 23 % of the bytes, and
/// pictures gain at most 2 dB (a chair: 285 kB and 58.9 dB, 368 kB and 58.1 dB; a fox: 227 kB and 51.5 dB, 293 kB and 51.4 dB).
const SPARED: usize = 3;

/// Bits of band 1, of the others and of means, by rung.
const SPZ: [(u8, u8, Option<u8>); 10] = [
    (4, 3, Some(3)),
    (5, 3, Some(3)),
    (5, 4, Some(4)),
    (6, 4, Some(4)),
    (6, 5, Some(5)),
    (7, 5, Some(5)),
    (7, 6, Some(6)),
    (8, 6, Some(6)),
    (8, 7, None),
    (8, 8, None),
];
const SPZ_STEPS: [usize; 4] = [0, 2, 4, 9];
/// Bits of means without SH, by rung.
const SPZ_MEANS: [Option<u8>; 5] = [Some(3), Some(4), Some(5), Some(6), None];
const SPZ_MEANS_STEPS: [usize; 4] = [0, 1, 2, 4];

/// The settings of a format, from the fewest bytes to the least loss.
#[derive(Clone, Debug, PartialEq)]
pub struct Ladder {
    /// The settings, at least one.
    pub rungs: Vec<Precision>,
    /// Rungs that are a visible step apart, in order; the last one is the last rung.
    pub steps: Vec<usize>,
}

impl Ladder {
    /// The settings of a file of a wanted size or PSNR: those of the format, or degrees of SH up to that of the model where it has only one.
    #[must_use]
    pub fn to_search(self, degree: usize) -> Self {
        if self.rungs != [Precision::Fixed] {
            return self;
        }
        let rungs = (0..degree).map(Precision::Degree).chain([Precision::Fixed]).collect();
        Self { rungs, steps: (0..=degree).collect() }
    }

    /// The settings at each step.
    pub fn coarse(&self) -> impl Iterator<Item = Precision> + '_ {
        self.steps.iter().map(|rung| self.rungs[*rung])
    }

    /// The finest settings.
    pub fn finest(&self) -> Precision {
        self.rungs.last().copied().unwrap_or(Precision::Fixed)
    }
}

/// The settings of the format that a file's name asks for. `degree` is that of the model's SH.
pub fn ladder(path: &Path, degree: usize) -> Ladder {
    match extension(path).as_str() {
        "sog" => {
            let between = |k: usize| {
                let (step, share) = (k / A_STEP, (k % A_STEP) as f64 / A_STEP as f64);
                Precision::Sog(SOG[step].towards(&SOG[(step + 1).min(SOG.len() - 1)], share))
            };
            let last = A_STEP * (SOG.len() - 1);
            Ladder { rungs: (0..=last).map(between).collect(), steps: (0..=last).step_by(A_STEP).collect() }
        }
        "spz" if degree > 0 => Ladder {
            rungs: SPZ.map(|(first, others, means)| Precision::Spz(SpzPrecision { first, others, means })).to_vec(),
            steps: SPZ_STEPS.to_vec(),
        },
        "spz" => Ladder {
            rungs: SPZ_MEANS.map(|means| Precision::Spz(SpzPrecision { first: 8, others: 8, means })).to_vec(),
            steps: SPZ_MEANS_STEPS.to_vec(),
        },
        _ => Ladder { rungs: vec![Precision::Fixed], steps: vec![0] },
    }
}

/// The settings that pictures are first measured with, unless others are asked for. For models with SH: for SPZ the fewest bits that
/// pictures do not show, for SOG those a few rungs below the finest. Else the finest.
pub fn usual(path: &Path, model: &Gaussians) -> Precision {
    let ladder = ladder(path, model.degree());
    match ladder.finest() {
        Precision::Spz(_) if model.degree() > 0 => spz::usual(model, &ladder),
        finest @ Precision::Sog(_) if model.degree() > 0 => *ladder.rungs.iter().nth_back(SPARED).unwrap_or(&finest),
        finest => finest,
    }
}

/// The settings of a file whose pictures are not measured: the usual ones, or for SOG the finest if the palette of those would show.
pub fn unmeasured(path: &Path, model: &Gaussians) -> Precision {
    let usual = usual(path, model);
    if !matches!(usual, Precision::Sog(_)) {
        return usual;
    }
    if sog::suffices(model, &usual.of_sog()) { usual } else { ladder(path, model.degree()).finest() }
}
