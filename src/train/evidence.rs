//! What pruning needs of a model in training: its responses, and the way from a keep mask to a smaller model.

use super::density::compact;
use super::error::Result;
use super::loss::Weights;
use super::trainer::Trainer;
use crate::gaussians::Gaussians;
use crate::gaussians::resident::Resident;
use crate::gpu;
use crate::qirf::response::{self, Gather, record_residual};
use crate::qirf::score::Scores;
use crate::qirf::study::Evidence;

impl Trainer {
    /// Responses and other methods' scores by a pass over all training views; neither model nor moments change.
    ///
    /// # Errors
    /// Device memory; device errors; photos that cannot be read.
    pub fn evidence(&mut self) -> Result<Evidence> {
        self.evidence_with(|_| Ok(()))
    }

    /// As [`Trainer::evidence`]; `follow` hears how many views were seen, and may end it.
    ///
    /// # Errors
    /// As [`Trainer::evidence`]; what `follow` says.
    pub fn evidence_with<E>(&mut self, mut follow: impl FnMut(usize) -> Result<(), E>) -> Result<Evidence, E>
    where
        E: From<gpu::Error> + From<super::Error>,
    {
        let gather = Gather::Mean { views: self.views.len() as u32 };
        let scores = Scores::zeros(&self.device, self.model.len)?;
        let cameras: Vec<_> = self.views.iter().map(|v| v.camera.clone()).collect();
        let (device, views, photos, loss) = (&self.device, &self.views, &mut self.photos, &self.loss);
        let (over, weights) = (self.options.transparent || self.options.masked, self.options.weights);
        let background = self.options.settings.background;
        let (renderer, model, gradient) = (&mut self.renderer, &self.model, &loss.gradient);
        let (exposure, mask) = (&self.exposure, &self.mask);
        let responses = response::full_pass(
            device,
            renderer,
            model,
            &cameras,
            gradient,
            Some(&scores),
            |recording, v, image| -> Result<(), E> {
                follow(v)?;
                let size = [cameras[v].width, cameras[v].height];
                let photo = photos.get(device, views, v, (v + 1) % cameras.len())?;
                let pixels = size[0] * size[1];
                let mut seen = exposure.as_ref().map_or(image, |e| {
                    e.apply(recording, v, image, pixels);
                    &e.image
                });
                if let Some(mask) = mask {
                    mask.apply(recording, photo, seen, pixels);
                    seen = &mask.image;
                }
                loss.record(recording, seen, photo, size, over, background, weights);
                if let Some(mask) = mask {
                    mask.backward(recording, photo, gradient, pixels);
                }
                if let Some(e) = exposure {
                    e.backward(recording, v, image, gradient, pixels, None);
                }
                record_residual(recording, seen, photo, gradient, size, over, background);
                Ok(())
            },
        )?;
        follow(cameras.len())?;
        Ok(Evidence { responses: responses.read(device, gather)?, scores: scores.values.read(device)? })
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

    /// From now on the loss has these weights, and positions learn `position` times as fast as the schedule says.
    pub fn fine_tune(&mut self, weights: Weights, position: f64) {
        self.options.weights = weights;
        self.position = position;
    }
}
