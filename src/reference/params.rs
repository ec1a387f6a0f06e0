//! The model's stored parameters in float64, so that finite differences can move each by a millionth.

use crate::gaussians::Gaussians;

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

    /// Whether there is no Gaussian.
    pub fn is_empty(&self) -> bool {
        self.means.is_empty()
    }

    /// The SH degree stored: the number of bands less one.
    pub fn degree(&self) -> usize {
        self.sh.len().saturating_sub(1)
    }

    /// Zeros of the same shape: where gradients accumulate.
    #[must_use]
    pub fn zeros_like(&self) -> Self {
        Self {
            means: vec![[0.0; 3]; self.means.len()],
            log_scales: vec![[0.0; 3]; self.log_scales.len()],
            rotations: vec![[0.0; 4]; self.rotations.len()],
            opacity_logits: vec![0.0; self.opacity_logits.len()],
            sh: self.sh.iter().map(|band| vec![0.0; band.len()]).collect(),
        }
    }

    /// The parameter groups by name, each as one flat array: what a test or an optimiser walks over.
    pub fn groups_mut(&mut self) -> Vec<(String, &mut [f64])> {
        let mut groups = vec![
            ("means".to_owned(), self.means.as_flattened_mut()),
            ("log_scales".to_owned(), self.log_scales.as_flattened_mut()),
            ("rotations".to_owned(), self.rotations.as_flattened_mut()),
            ("opacity_logits".to_owned(), self.opacity_logits.as_mut_slice()),
        ];
        groups.extend(self.sh.iter_mut().enumerate().map(|(l, band)| (format!("sh{l}"), band.as_mut_slice())));
        groups
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
        Self {
            means: model.means.iter().map(|v| v.map(f64::from)).collect(),
            log_scales: model.log_scales.iter().map(|v| v.map(f64::from)).collect(),
            rotations: model.rotations.iter().map(|v| v.map(f64::from)).collect(),
            opacity_logits: model.opacity_logits.iter().map(|&v| f64::from(v)).collect(),
            sh: model.sh.iter().map(|band| band.iter().map(|&v| f64::from(v)).collect()).collect(),
        }
    }
}
