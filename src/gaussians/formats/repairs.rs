//! Repairs that all readers share, and their counts.

use std::fmt;

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::super::edit::{is_huge, lengthen};
use super::Gaussians;
use crate::wording::counted;

/// Infinite opacity logits become this value with their sign.
///
/// sigmoid(20) is 1 in float32 and sigmoid(-20) = 2e-9 lies far below the 1/255 that is ever drawn, so no picture
/// changes, while the logit and its gradient stay finite.
pub const OPACITY_LOGIT_LIMIT: f32 = 20.0;

/// A log-scale of minus infinity, the logarithm of a stored zero, becomes this value.
///
/// e^-20 = 2e-9 world units is flatter than any pixel sees, and its square (4e-18) is still a normal float32.
pub const LOG_SCALE_FLOOR: f32 = -20.0;

/// Counts of what a reader changed, left out or doubts; all zero for a clean file.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Repairs {
    /// Gaussians removed because of a NaN or an infinity in mean, scale, rotation or SH, or of a NaN opacity.
    pub non_finite_rows: usize,
    /// Gaussians removed because their quaternion was zero.
    pub zero_quaternions: usize,
    /// Gaussians whose quaternion was too short for float32's squares, and is normalised.
    #[serde(default)]
    pub short_quaternions: usize,
    /// Infinite opacity logits clamped to plus or minus [`OPACITY_LOGIT_LIMIT`]; 8-bit opacities of 0 and 255 give
    /// such.
    pub clamped_opacities: usize,
    /// Gaussians with a scale of zero, raised to e^[`LOG_SCALE_FLOOR`].
    pub floored_scales: usize,
    /// Gaussians of e^30 world units and more, which are kept, although pictures may leave them out.
    #[serde(default)]
    pub huge_scales: usize,
    /// Bytes ignored after the last record.
    pub trailing_bytes: u64,
}

impl Repairs {
    /// True if anything was counted.
    pub fn any(&self) -> bool {
        *self != Self::default()
    }
}

impl fmt::Display for Repairs {
    /// One line; empty if nothing was counted.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let limit = OPACITY_LOGIT_LIMIT;
        let repaired: Vec<String> = [
            (self.non_finite_rows as u64, "Gaussian", "removed for NaN or infinite values".to_owned()),
            (self.zero_quaternions as u64, "Gaussian", "removed for a zero quaternion".to_owned()),
            (self.short_quaternions as u64, "Gaussian", "with very short quaternions, normalised".to_owned()),
            (self.clamped_opacities as u64, "infinite opacity logit", format!("clamped to +-{limit}")),
            (self.floored_scales as u64, "Gaussian", format!("with zero scales, raised to e^{LOG_SCALE_FLOOR}")),
            (self.trailing_bytes, "byte", "after the last record ignored".to_owned()),
        ]
        .into_iter()
        .filter(|(count, ..)| *count > 0)
        .map(|(count, noun, what)| format!("{} {what}", counted(count, noun)))
        .collect();
        let repaired = (!repaired.is_empty()).then(|| format!("repaired on reading: {}", repaired.join(", ")));
        let huge = (self.huge_scales > 0).then(|| {
            let huge = counted(self.huge_scales as u64, "Gaussian");
            format!(
                "{huge} of e^30 units or more, which pictures may leave out: are the stored scales really logarithms?"
            )
        });
        f.write_str(&repaired.into_iter().chain(huge).collect::<Vec<_>>().join("; "))
    }
}

/// Clamps what can be clamped, removes the other rows that are not finite, and counts both. Also returns the numbers of the removed
/// rows, ascending.
pub(super) fn repair(model: &mut Gaussians) -> (Repairs, Vec<usize>) {
    let mut repairs = Repairs::default();
    for scales in &mut model.log_scales {
        if scales.contains(&f32::NEG_INFINITY) {
            repairs.floored_scales += 1;
            for scale in scales.iter_mut().filter(|scale| **scale == f32::NEG_INFINITY) {
                *scale = LOG_SCALE_FLOOR;
            }
        }
    }
    let mut bad: Vec<bool> = (0..model.len()).into_par_iter().map(|i| !model.is_finite(i)).collect();
    for (i, bad) in bad.iter_mut().enumerate() {
        if *bad {
            repairs.non_finite_rows += 1;
        } else if model.rotations[i] == [0.0; 4] {
            repairs.zero_quaternions += 1;
            *bad = true;
        } else if lengthen(&mut model.rotations[i]) {
            repairs.short_quaternions += 1;
        }
    }
    let removed: Vec<usize> = (0..bad.len()).filter(|i| bad[*i]).collect();
    if !removed.is_empty() {
        model.compact(&bad.into_iter().map(|bad| !bad).collect::<Vec<_>>());
    }
    repairs.huge_scales = model.log_scales.iter().filter(|scales| is_huge(scales)).count();
    for logit in model.opacity_logits.iter_mut().filter(|logit| logit.is_infinite()) {
        repairs.clamped_opacities += 1;
        *logit = OPACITY_LOGIT_LIMIT.copysign(*logit);
    }
    (repairs, removed)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn counts_each_kind_once() {
        let mut m = Gaussians::balls(vec![[0.0; 3]; 9], 0.0, 0.0, 2);
        m.means[0][1] = f32::NAN;
        m.log_scales[1][2] = f32::INFINITY;
        m.sh[2][2 * 15 + 7] = f32::NEG_INFINITY;
        m.opacity_logits[3] = f32::NAN;
        m.rotations[4] = [0.0, -0.0, 0.0, 0.0];
        m.opacity_logits[5] = f32::INFINITY;
        m.opacity_logits[6] = f32::NEG_INFINITY;
        m.log_scales[7] = [f32::NEG_INFINITY, 1.0, f32::NEG_INFINITY];
        m.log_scales[8][2] = 50.0;
        m.rotations[8] = [0.0, 3e-30, -4e-30, 0.0];
        let (repairs, removed) = repair(&mut m);
        assert_eq!(removed, [0, 1, 2, 3, 4]);
        assert_eq!(m.rotations[3], [0.0, 0.6, -0.8, 0.0]);
        let expected = Repairs {
            non_finite_rows: 4,
            zero_quaternions: 1,
            short_quaternions: 1,
            clamped_opacities: 2,
            floored_scales: 1,
            huge_scales: 1,
            trailing_bytes: 0,
        };
        assert_eq!(repairs, expected);
        assert_eq!(m.len(), 4);
        assert_eq!(m.opacity_logits, [20.0, -20.0, 0.0, 0.0]);
        assert_eq!(m.log_scales[2], [LOG_SCALE_FLOOR, 1.0, LOG_SCALE_FLOOR]);
        let sentence = repairs.to_string();
        assert!(
            sentence.starts_with("repaired on reading: ") && sentence.contains("4 Gaussians removed for NaN"),
            "{sentence}"
        );
        let huge = Repairs { huge_scales: 2, ..Repairs::default() }.to_string();
        assert!(huge.starts_with("2 Gaussians of e^30 units or more, which pictures"), "{huge}");
        assert!(sentence.contains("raised to e^-20; 1 Gaussian of e^30"), "{sentence}");
    }
}
