//! Pruning a model in training by a keep mask, fine-tuning, and the mean of iterates.

use super::Trainer;
use crate::gaussians::Gaussians;
use crate::gaussians::resident::Resident;
use crate::gpu::{self, Device};
use crate::train::density;
use crate::train::error::Result;
use crate::train::loss::Weights;
use crate::train::mean::Mean;
use crate::train::training_model::TrainingModel;

impl Trainer {
    /// Removes the trained Gaussians that `keep` does not mark; the others keep their moments. Parameters are taken
    /// from `merged` (as many Gaussians as there are now) if it is given.
    ///
    /// # Errors
    /// Device memory; device errors. The run is then unchanged.
    ///
    /// # Panics
    /// If `keep` does not hold one mark per trained Gaussian.
    pub fn keep(&mut self, keep: &[bool], merged: Option<&Gaussians>) -> Result<()> {
        assert_eq!(keep.len(), self.training.trained(), "one mark a Gaussian");
        let kept: Vec<u32> = (0..keep.len() as u32).filter(|i| keep[*i as usize]).collect();
        let merged = match merged {
            None => None,
            Some(model) => {
                let tail = self.training.trained()..self.training.model.len;
                let kept: Vec<usize> = kept.iter().map(|i| *i as usize).chain(tail).collect();
                Some(Resident::upload(&self.device, &model.select(&kept))?)
            }
        };
        self.reshaped(|device, model| density::compact(device, model, &kept))?;
        if let Some(merged) = merged {
            self.training.model.parameters = merged.parameters;
        }
        Ok(())
    }

    /// Runs work on the model while the renderer's buffers are freed; they fit the model's number of Gaussians afterwards.
    pub(super) fn aside<T, E: From<gpu::Error>>(
        &mut self,
        work: impl FnOnce(&Device, &mut TrainingModel) -> Result<T, E>,
    ) -> Result<T, E> {
        // Work under way would keep arrays that are replaced.
        self.catch_up()?;
        let released = self.renderer.release()?;
        let done = work(&self.device, &mut self.training);
        let restored = self.renderer.restore(released, self.training.model.len);
        let done = done?;
        restored?;
        Ok(done)
    }

    /// Changes the number of Gaussians, which ends averages over responses.
    pub(super) fn reshaped<T>(
        &mut self,
        change: impl FnOnce(&Device, &mut TrainingModel) -> gpu::Result<T>,
    ) -> Result<T> {
        self.responses = None;
        Ok(self.aside(change)?)
    }

    /// Keeps only the trained Gaussians `stay`. The renderer keeps its buffers if that needs no more memory than the run
    /// has needed before.
    pub(super) fn thin(&mut self, stay: &[u32]) -> Result<()> {
        let (used, peak) = self.device.memory_used();
        if used + density::bytes_of_thinning(&self.training, stay.len()) > peak {
            return self.reshaped(|device, model| density::compact(device, model, stay));
        }
        self.responses = None;
        Ok(density::thin(&self.device, &mut self.training, stay)?)
    }

    /// Lends the model to work that needs memory; the renderer's buffers are freed meanwhile.
    pub fn lend<T, E: From<gpu::Error>>(&mut self, work: impl FnOnce(&Resident) -> Result<T, E>) -> Result<T, E> {
        self.aside(|_, training| work(&training.model))
    }

    /// Changes the weights of the loss.
    pub fn fine_tune(&mut self, weights: Weights) {
        self.objective.weights = weights;
    }

    /// Adds the model to the mean if that is due after iteration `iteration`. After the last, the mean becomes the
    /// model.
    pub(super) fn average(&mut self, iteration: u32) -> Result<()> {
        let schedule = &self.options.schedule;
        if !schedule.averages_iterates(iteration) {
            return Ok(());
        }
        let mean = Mean::with(self.training.mean.take(), &self.device, &self.training.model)?;
        if iteration < schedule.iterations {
            self.training.mean = Some(mean);
        } else if mean.iterates > 1 {
            let parameters = self.training.model.parameters.each_ref().zip(mean.model.attributes());
            parameters.try_map(|(buffer, values)| match values {
                [] => Ok(()),
                _ => buffer.write(&self.device, values),
            })?;
        }
        Ok(())
    }
}
