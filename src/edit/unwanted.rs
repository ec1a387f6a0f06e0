//! Removal of Gaussians by their own values: faint, huge, invisible, needles.

use crate::gaussians::Gaussians;
use rayon::prelude::*;

/// Opacity below which no pixel blends a Gaussian: one step of eight bits.
pub const INVISIBLE: f64 = 1.0 / 255.0;

/// Default ratio of a needle's longest axis to its middle one.
pub const NEEDLE: f64 = 100.0;

/// A kind of Gaussian to remove.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Unwanted {
    /// Gaussians that no picture can show: with an opacity below [`INVISIBLE`], or with values that the projection skips.
    Invisible,
    /// Gaussians whose longest axis is this many times as long as the middle one.
    Needles(f64),
}

impl Unwanted {
    /// For each Gaussian: true if it is not of this kind.
    pub(super) fn kept(self, model: &Gaussians) -> Vec<bool> {
        match self {
            Self::Invisible => {
                let least = logit(INVISIBLE);
                let shown = |i: usize| f64::from(model.opacity_logits[i]) >= least && model.drawable(i);
                (0..model.len()).into_par_iter().map(shown).collect()
            }
            Self::Needles(ratio) => {
                let most = ratio.ln();
                let stout = |scales: &[f32; 3]| {
                    let mut sorted = *scales;
                    sorted.sort_unstable_by(f32::total_cmp);
                    f64::from(sorted[2]) - f64::from(sorted[1]) <= most
                };
                model.log_scales.par_iter().map(stout).collect()
            }
        }
    }
}

/// For each Gaussian: true if its opacity is at least this; false for NaN.
pub(super) fn at_least(model: &Gaussians, opacity: f64) -> Vec<bool> {
    let least = logit(opacity);
    model.opacity_logits.par_iter().map(|l| f64::from(*l) >= least).collect()
}

/// For each Gaussian: true if no axis has a larger standard deviation, in world units; false for NaN.
pub(super) fn at_most(model: &Gaussians, size: f64) -> Vec<bool> {
    let most = size.ln();
    model.log_scales.par_iter().map(|scales| scales.iter().all(|s| f64::from(*s) <= most)).collect()
}

/// The stored value of an opacity, 0 to 1.
fn logit(opacity: f64) -> f64 {
    (opacity / (1.0 - opacity)).ln()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn each_kind_is_told_by_its_values() {
        let mut model = Gaussians::balls(vec![[0.0; 3]; 5], 0.0, 0.0, 1);
        model.opacity_logits = vec![-5.6, -5.5, 0.0, 20.0, f32::NAN]; // 1/255 is -5.537
        assert_eq!(Unwanted::Invisible.kept(&model), [false, true, true, true, false]);
        assert_eq!(at_least(&model, 0.5), [false, false, true, true, false]);
        assert_eq!(at_least(&model, 0.0), [true, true, true, true, false]);
        model.rotations[2] = [0.0; 4];
        model.sh[1][3 * 9] = f32::INFINITY;
        assert_eq!(Unwanted::Invisible.kept(&model), [false, true, false, false, false]);

        model.log_scales =
            vec![[0.0, 4.5, 0.0], [0.0, 4.7, 0.0], [4.7, 0.0, 4.7], [-1.0, -1.0, 0.8], [f32::NAN, 0.0, 0.0]];
        assert_eq!(Unwanted::Needles(100.0).kept(&model), [true, false, true, true, false]);
        assert_eq!(at_most(&model, 100.0), [true, false, false, true, false]);
    }
}
