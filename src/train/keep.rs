//! From a keep mask to a smaller model in training.

use super::density::compact;
use super::error::Result;
use super::loss::Weights;
use super::trainer::Trainer;
use crate::gaussians::resident::Resident;
use crate::gaussians::{Attributes, Gaussians};

impl Trainer {
    /// Goes on with the Gaussians marked in `keep` alone, moments and all. Where `merged` is given (as many Gaussians as
    /// there are now), opacities and colours are its.
    ///
    /// # Errors
    /// Device memory; device errors. The run is then as it was.
    ///
    /// # Panics
    /// When `keep` has not one mark a Gaussian.
    pub fn keep(&mut self, keep: &[bool], merged: Option<&Gaussians>) -> Result<()> {
        assert_eq!(keep.len(), self.trainee.model.len, "one mark a Gaussian");
        let kept: Vec<u32> = (0..keep.len() as u32).filter(|i| keep[*i as usize]).collect();
        let colours = match merged {
            None => None,
            Some(model) => {
                let kept: Vec<usize> = kept.iter().map(|i| *i as usize).collect();
                Some(Resident::upload(&self.device, &model.select(&kept))?)
            }
        };
        compact(&self.device, &mut self.trainee, &kept)?;
        if let Some(Resident { parameters: Attributes { opacity_logits, sh, .. }, .. }) = colours {
            let parameters = &mut self.trainee.model.parameters;
            (parameters.opacity_logits, parameters.sh) = (opacity_logits, sh);
        }
        self.responses = None;
        Ok(())
    }

    /// From now on the loss has these weights.
    pub fn fine_tune(&mut self, weights: Weights) {
        self.objective.weights = weights;
    }
}
