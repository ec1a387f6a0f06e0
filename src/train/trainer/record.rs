//! The recording of one iteration: from the lists of tiles to the step of Adam.

use super::Trainer;
use crate::gpu::Recording;
use crate::render::Backward;
use crate::response::Gather;
use crate::train::adam;
use crate::train::depth_loss;
use crate::train::dropout;
use crate::train::error::Result;
use crate::train::exposure;
use crate::train::method::Iteration;
use crate::train::objective::Current;
use crate::train::options::Exposures;
use crate::train::poses::Poses;

impl Trainer {
    /// The recording of the next iteration, for tests of what it runs and of its work.
    pub fn recording(&mut self) -> Result<Recording> {
        let mut recording = Recording::new();
        self.record(&mut recording, self.iteration + 1, false)?;
        Ok(recording)
    }

    /// Records iteration `iteration`; the loss's value as well if `with_value`.
    pub(super) fn record(&mut self, recording: &mut Recording, iteration: u32, with_value: bool) -> Result<()> {
        let (next, at) = (self.view_of(iteration + 1), self.view_of(iteration));
        let halved = self.halved(at, iteration);
        let mut photo = self.device_photos.get(recording, &self.photos, at, next)?;
        let (options, model) = (&self.options, &self.training.model);
        let mut camera = &self.photos[at].camera;
        if let (Some(half), Some(halved)) = (&self.half, &halved) {
            half.record(recording, photo, [camera.width, camera.height]);
            (photo, camera) = (&half.photo, halved);
        }
        self.renderer.record_lists(recording, model, camera);
        let responses = self.responses.as_ref().filter(|_| options.averaged.contains(&iteration));
        let (renderer, gradient) = (&self.renderer, &self.objective.loss.gradient);
        let adam_step = self.state.step(&options.schedule, iteration, self.extent);
        let now = Iteration {
            renderer,
            camera,
            model: &self.training,
            key: [options.seed, iteration],
            image_gradient: gradient,
            colours: responses.is_some(),
            rates: adam_step.rates,
        };
        let (length, photos) = (options.schedule.iterations, self.photos.len());
        if options.dropout {
            let share = dropout::share(iteration, length, photos);
            dropout::record(recording, renderer, (model, camera), now.key, share);
        }
        if let Some(method) = &options.method {
            method.before_blending(recording, &now);
        }
        self.renderer.record_blending(recording, camera);
        let slots = self.renderer.slots(camera);
        // Known exposures are not updated.
        let gains = options.exposure.as_ref().and_then(Exposures::learnt);
        let step = gains.map(|gains| exposure::Step {
            pairs: slots.pairs,
            limit: slots.limit,
            // Each photo is drawn once per round.
            number: (iteration - 1) / photos as u32 + 1,
            rate: exposure::rate(gains, iteration, length, photos),
        });
        let current = Current::new(at, photo, camera);
        let (objective, rendered) = (&self.objective, self.renderer.image());
        let seen = objective.record(recording, rendered, current, with_value, step);
        if responses.is_some() {
            objective.record_residual(recording, seen, current);
        }
        let growth = options.schedule.gathers(iteration).then_some(&self.training.growth);
        let absolute = options.schedule.growth.is_some_and(|g| g.absolute);
        let backward = Backward {
            residual: responses.is_some(),
            growth,
            absolute: growth.is_some() && absolute,
            ..Backward::default()
        };
        renderer.record_backward(recording, model, camera, gradient, backward);
        if let Some(poses) = self.poses.as_ref().filter(|_| Poses::gathers(iteration, length)) {
            poses.record(recording, renderer, &self.training, (at, camera));
        }
        if let Some(method) = &options.method {
            method.before_adam(recording, &now);
        }
        // Responses read the photo's picture.
        if let Some(depths) = self.depth_loss.as_ref().filter(|_| responses.is_none()) {
            let weight = depth_loss::weight(iteration, length) * current.share;
            depths.record(recording, renderer, (model, camera), (at, weight), gradient);
        }
        adam::record(recording, renderer, &self.training, adam_step);
        if let Some(method) = &options.method {
            method.after_adam(recording, &now);
        }
        if let Some(responses) = responses {
            responses.record(recording, renderer, model, camera, Gather::Average { iteration });
        }
        Ok(())
    }
}
