//! SH bands: their effect on colours, and the bands without visible effect.

use super::Gaussians;
use std::f64::consts::PI;

/// Smallest change of a colour that counts: a whole step of eight bits.
const STEP: f64 = 1.0 / 255.0;

impl Gaussians {
    /// For each band above 0: the greatest change of any Gaussian's red, green or blue in any direction. For
    /// coefficients c of a band it is |c| sqrt((2 l + 1) / 4 pi), by the addition theorem.
    pub fn most_by_band(&self) -> Vec<f64> {
        (1..self.sh.len()).map(|l| self.turns(l).fold(0.0, f64::max)).collect()
    }

    /// The lowest SH degree at which no colour differs by 1/255 from its value with all bands. A pixel is a weighted
    /// mean of colours, with weights that sum to at most 1, and so does not differ by more.
    pub fn degree_in_effect(&self) -> usize {
        let mut rest = vec![0.0; 3 * self.len()];
        for l in (1..self.sh.len()).rev() {
            rest.iter_mut().zip(self.turns(l)).for_each(|(rest, own)| *rest += own);
            // NaN counts as a change.
            if !rest.iter().all(|r| *r < STEP) {
                return l;
            }
        }
        0
    }

    /// By Gaussian and channel: the greatest change by band `l`.
    fn turns(&self, l: usize) -> impl Iterator<Item = f64> {
        let peak = (((2 * l + 1) as f64) / (4.0 * PI)).sqrt();
        let norm = move |row: &[f32], c: usize| {
            peak * row.iter().skip(c).step_by(3).map(|v| f64::from(*v).powi(2)).sum::<f64>().sqrt()
        };
        self.sh[l].chunks_exact(Self::band_width(l)).flat_map(move |row| [0, 1, 2].map(|c| norm(row, c)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gaussians::sh::basis;
    use glam::DVec3;

    #[test]
    fn no_direction_turns_a_colour_further() {
        let mut model = Gaussians::zeroed(1, 3);
        for (i, value) in model.sh.iter_mut().skip(1).flatten().enumerate() {
            *value = ((i * 37 % 19) as f32 - 9.0) / 50.0;
        }
        let most = model.most_by_band();
        let mut seen = [0.0_f64; 3];
        for k in 0..4000 {
            let (z, turn) = (1.0 - (f64::from(k) + 0.5) / 2000.0, f64::from(k) * 2.399963229728653);
            let side = (1.0 - z * z).sqrt();
            let basis = basis(DVec3::new(side * turn.cos(), side * turn.sin(), z));
            for l in 1..=3 {
                for c in 0..3 {
                    let term = |m: usize| basis[l * l + m] * f64::from(model.sh[l][3 * m + c]);
                    seen[l - 1] = seen[l - 1].max((0..=2 * l).map(term).sum::<f64>().abs());
                }
            }
        }
        for (seen, most) in seen.iter().zip(&most) {
            assert!(seen <= &(most * (1.0 + 1e-12)) && *seen > 0.5 * most, "{seen} {most}");
        }
        // At degree 1 the bound is attained.
        assert!(seen[0] > 0.999 * most[0]);
    }

    #[test]
    fn bands_in_effect_are_those_that_a_picture_may_show() {
        let mut model = Gaussians::zeroed(3, 3);
        assert_eq!((model.degree_in_effect(), model.most_by_band()), (0, vec![0.0; 3]));
        assert_eq!(Gaussians::default().degree_in_effect(), 0);
        // Two bands of 0.6 steps each exceed one step together.
        let peak = |l: usize| ((2 * l + 1) as f64 / (4.0 * PI)).sqrt();
        model.sh[3][21 + 4] = (0.6 * STEP / peak(3)) as f32;
        assert_eq!(model.degree_in_effect(), 0);
        model.sh[1][9 + 1] = (0.6 * STEP / peak(1)) as f32;
        assert_eq!(model.degree_in_effect(), 1);
        model.sh[2][15] = f32::NAN;
        assert_eq!(model.degree_in_effect(), 2);
        model.sh[3][0] = 1.0;
        assert_eq!(model.degree_in_effect(), 3);
    }
}
