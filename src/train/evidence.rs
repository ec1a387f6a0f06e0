//! What pruning needs of a model in training: its responses, and the way from a keep mask to a smaller model.

use super::density::compact;
use super::error::Result;
use super::loss::Weights;
use super::objective::Target;
use super::trainer::Trainer;
use crate::gaussians::Gaussians;
use crate::gaussians::resident::Resident;
use crate::gpu;
use crate::qirf::response::{self, Evidence, Gather};

impl Trainer {
    /// Responses, and where asked for other methods' scores, by a pass over all training views; neither model nor moments
    /// change.
    ///
    /// # Errors
    /// Device memory; device errors; photos that cannot be read.
    pub fn evidence(&mut self, with_scores: bool) -> Result<Evidence> {
        self.evidence_with(with_scores, |_| Ok(()))
    }

    /// As [`Trainer::evidence`]; `follow` hears how many views were seen, and may end it.
    ///
    /// # Errors
    /// As [`Trainer::evidence`]; what `follow` says.
    pub fn evidence_with<E>(
        &mut self,
        with_scores: bool,
        mut follow: impl FnMut(usize) -> Result<(), E>,
    ) -> Result<Evidence, E>
    where
        E: From<gpu::Error> + From<super::Error>,
    {
        let cameras: Vec<_> = self.views.iter().map(|v| v.camera.clone()).collect();
        let (device, views, photos) = (&self.device, &self.views, &mut self.photos);
        let (objective, options) = (&self.objective, &self.options);
        let evidence = response::full_pass(
            device,
            &mut self.renderer,
            &self.model,
            &cameras,
            &objective.loss.gradient,
            with_scores,
            |recording, v, image| -> Result<(), E> {
                follow(v)?;
                let photo = photos.get(device, views, v, (v + 1) % cameras.len())?;
                let target = Target { view: v, photo, size: [cameras[v].width, cameras[v].height] };
                let seen = objective.record(recording, image, target, options, false, None);
                objective.record_residual(recording, seen, target, options);
                Ok(())
            },
        )?;
        follow(cameras.len())?;
        Ok(evidence)
    }

    /// The responses averaged over [`super::Options::averaged`], decayed to the last iteration done; none before.
    ///
    /// # Errors
    /// Device errors.
    pub fn averages(&self) -> Result<Option<Evidence>> {
        let gather = Gather::Average { iteration: self.iteration };
        let Some(responses) = &self.responses else { return Ok(None) };
        Ok(Some(Evidence { responses: responses.read(&self.device, gather)?, scores: Vec::new() }))
    }

    /// Goes on with the Gaussians marked in `keep` alone, moments and all. Where `merged` is given (as many Gaussians as
    /// there are now), opacities and colours are its.
    ///
    /// # Errors
    /// Device memory; device errors. The run is then as it was.
    ///
    /// # Panics
    /// When `keep` has not one mark a Gaussian.
    pub fn keep(&mut self, keep: &[bool], merged: Option<&Gaussians>) -> Result<()> {
        assert_eq!(keep.len(), self.model.len, "one mark a Gaussian");
        let kept: Vec<u32> = (0..keep.len() as u32).filter(|i| keep[*i as usize]).collect();
        let colours = match merged {
            None => None,
            Some(model) => {
                let kept: Vec<usize> = kept.iter().map(|i| *i as usize).collect();
                Some(Resident::upload(&self.device, &model.select(&kept))?)
            }
        };
        compact(&self.device, &mut self.model, &mut self.state, &mut self.growth, &kept)?;
        if let Some(Resident { opacity_logits, sh, .. }) = colours {
            (self.model.opacity_logits, self.model.sh) = (opacity_logits, sh);
        }
        self.responses = None;
        Ok(())
    }

    /// From now on the loss has these weights.
    pub fn fine_tune(&mut self, weights: Weights) {
        self.options.weights = weights;
    }
}
