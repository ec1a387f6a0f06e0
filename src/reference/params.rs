//! The model's stored parameters in float64, so that finite differences can move each by a millionth.

use crate::gaussians::{Attributes, Gaussians};

/// Stored parameters widened to float64; gradients by them have the same shape.
pub type Params = Gaussians<f64>;

impl Gaussians<f64> {
    /// Zeros of the same shape, for accumulating gradients.
    #[must_use]
    pub fn zeros_like(&self) -> Self {
        Self::of_attributes(self.attributes().map(|values| vec![0.0; values.len()]), self.sh.len())
    }

    /// The attributes by name, each as one flat array, for tests and optimisers.
    pub fn groups_mut(&mut self) -> Vec<(&'static str, &mut [f64])> {
        let bands = self.sh.len();
        Attributes::NAMES.zip(self.attributes_mut()).up_to(bands.max(1) - 1).collect()
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
