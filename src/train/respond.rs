//! Responses of the training photos to each Gaussian: from a pass over all photos, or averaged over iterations.

use super::error::Result;
use super::objective::Current;
use super::trainer::Trainer;
use crate::gpu;
use crate::response::{Gather, Responses, Term, Views, Wanted, full_pass};

impl Trainer {
    /// Responses and scores, as `wanted`, by a pass over all photos. Neither model nor moments change.
    ///
    /// # Errors
    /// Device memory; device errors; photos that cannot be read.
    pub fn responses(&mut self, wanted: Wanted) -> Result<Responses> {
        self.responses_with(wanted, |_| Ok(()))
    }

    /// As [`Trainer::responses`]; `follow` receives the number of photos done, and may end the pass by an error.
    ///
    /// # Errors
    /// As [`Trainer::responses`]; errors of `follow`.
    pub fn responses_with<E>(
        &mut self,
        wanted: Wanted,
        follow: impl FnMut(usize) -> Result<(), E>,
    ) -> Result<Responses, E>
    where
        E: From<gpu::Error> + From<super::Error>,
    {
        let cameras: Vec<_> = self.photos.iter().map(|p| p.camera.clone()).collect();
        let (device, photos, device_photos) = (&self.device, &self.photos, &mut self.device_photos);
        let objective = &self.objective;
        full_pass(
            &mut self.renderer,
            &self.trainee.model,
            Views { cameras: &cameras, follow },
            &objective.loss.gradient,
            wanted,
            |recording, v, image, term| -> Result<(), E> {
                let pixels = device_photos.get(device, photos, v, (v + 1) % cameras.len())?;
                let current = Current { number: v, pixels, size: [cameras[v].width, cameras[v].height] };
                if term == Term::Squares {
                    objective.record_squares(recording, image, current);
                } else {
                    let seen = objective.record(recording, image, current, false, None);
                    objective.record_residual(recording, seen, current);
                }
                Ok(())
            },
        )
    }

    /// Responses averaged over [`super::Options::averaged`], decayed to the last iteration done; none before those iterations.
    ///
    /// # Errors
    /// Device errors.
    pub fn averages(&self) -> Result<Option<Responses>> {
        let gather = Gather::Average { iteration: self.iteration };
        let Some(responses) = &self.responses else { return Ok(None) };
        Ok(Some(Responses { channels: responses.read(&self.device, gather)?, ..Responses::default() }))
    }
}
