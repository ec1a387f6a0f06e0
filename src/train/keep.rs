//! Pruning a model in training by a keep mask, and fine-tuning.

use super::density::compact;
use super::error::Result;
use super::loss::Weights;
use super::trainer::Trainer;
use crate::gaussians::Gaussians;
use crate::gaussians::resident::Resident;

impl Trainer {
    /// Removes the trained Gaussians that `keep` does not mark; the others keep their moments. If `merged` is given (of as many
    /// Gaussians as there are now), parameters are taken from it.
    ///
    /// # Errors
    /// Device memory; device errors. The run is then unchanged.
    ///
    /// # Panics
    /// If `keep` does not hold one mark per trained Gaussian.
    pub fn keep(&mut self, keep: &[bool], merged: Option<&Gaussians>) -> Result<()> {
        assert_eq!(keep.len(), self.trainee.trained(), "one mark a Gaussian");
        let kept: Vec<u32> = (0..keep.len() as u32).filter(|i| keep[*i as usize]).collect();
        let merged = match merged {
            None => None,
            Some(model) => {
                let tail = self.trainee.trained()..self.trainee.model.len;
                let kept: Vec<usize> = kept.iter().map(|i| *i as usize).chain(tail).collect();
                Some(Resident::upload(&self.device, &model.select(&kept))?)
            }
        };
        compact(&self.device, &mut self.trainee, &kept)?;
        if let Some(merged) = merged {
            self.trainee.model.parameters = merged.parameters;
        }
        self.responses = None;
        Ok(())
    }

    /// Changes the weights of the loss.
    pub fn fine_tune(&mut self, weights: Weights) {
        self.objective.weights = weights;
    }
}
