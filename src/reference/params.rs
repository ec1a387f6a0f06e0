//! The model's stored parameters in float64, so that finite differences can move each by a millionth.

use crate::gaussians::{Attributes, Gaussians, rows};

/// Stored parameters of `n` Gaussians (see [`Gaussians`]) widened to float64; gradients by them have the same shape.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Params {
    /// Centres in world units, n.
    pub means: Vec<[f64; 3]>,
    /// Natural logarithms of the axes' standard deviations, n.
    pub log_scales: Vec<[f64; 3]>,
    /// Quaternions (w, x, y, z), not necessarily of unit length, n.
    pub rotations: Vec<[f64; 4]>,
    /// Opacity before the sigmoid, n.
    pub opacity_logits: Vec<f64>,
    /// Spherical harmonics, one array per degree l: n x (2l + 1) x 3.
    pub sh: Vec<Vec<f64>>,
}

impl Params {
    /// Number of Gaussians.
    pub fn len(&self) -> usize {
        self.means.len()
    }

    /// Returns true if there are no Gaussians.
    pub fn is_empty(&self) -> bool {
        self.means.is_empty()
    }

    /// The SH degree stored: the number of bands less one.
    pub fn degree(&self) -> usize {
        self.sh.len().saturating_sub(1)
    }

    /// Values of each attribute, Gaussian by Gaussian; none for bands that are not stored.
    pub fn attributes(&self) -> Attributes<&[f64]> {
        Attributes {
            means: self.means.as_flattened(),
            log_scales: self.log_scales.as_flattened(),
            rotations: self.rotations.as_flattened(),
            opacity_logits: &self.opacity_logits,
            sh: std::array::from_fn(|l| self.sh.get(l).map_or(&[][..], Vec::as_slice)),
        }
    }

    /// Parameters with these values and `bands` SH bands.
    pub fn of_attributes(attributes: Attributes<Vec<f64>>, bands: usize) -> Self {
        let Attributes { means, log_scales, rotations, opacity_logits, sh } = attributes;
        Self {
            means: rows(&means),
            log_scales: rows(&log_scales),
            rotations: rows(&rotations),
            opacity_logits,
            sh: sh.into_iter().take(bands).collect(),
        }
    }

    /// Zeros of the same shape, for accumulating gradients.
    #[must_use]
    pub fn zeros_like(&self) -> Self {
        Self::of_attributes(self.attributes().map(|values| vec![0.0; values.len()]), self.sh.len())
    }

    /// The attributes by name, each as one flat array, for tests and optimisers.
    pub fn groups_mut(&mut self) -> Vec<(&'static str, &mut [f64])> {
        let (bands, mut sh) = (self.sh.len(), self.sh.iter_mut());
        let all = Attributes {
            means: self.means.as_flattened_mut(),
            log_scales: self.log_scales.as_flattened_mut(),
            rotations: self.rotations.as_flattened_mut(),
            opacity_logits: &mut self.opacity_logits,
            sh: std::array::from_fn(|_| sh.next().map_or(&mut [][..], Vec::as_mut_slice)),
        };
        Attributes::NAMES.zip(all).up_to(bands.max(1) - 1).collect()
    }

    /// Adds `other`, of the same shape, element by element (gradients of several views).
    pub fn add(&mut self, other: &Self) {
        let mut other = other.clone();
        for ((_, into), (_, from)) in self.groups_mut().into_iter().zip(other.groups_mut()) {
            into.iter_mut().zip(from).for_each(|(a, b)| *a += *b);
        }
    }
}

impl From<&Gaussians> for Params {
    fn from(model: &Gaussians) -> Self {
        let widen = |values: &[f32]| values.iter().map(|&v| f64::from(v)).collect();
        Self::of_attributes(model.attributes().map(widen), model.sh.len())
    }
}
