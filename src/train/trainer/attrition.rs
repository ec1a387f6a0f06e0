//! Attrition and re-warming of a run.

use super::Trainer;
use crate::gpu::Buffer;
use crate::train::attrition::{Attrition, AttritionState};
use crate::train::error::Result;

impl Trainer {
    /// Begins attrition down to `survivors` Gaussians.
    pub fn begin_attrition(&mut self, settings: Attrition, survivors: usize) -> Result<()> {
        let logits = self.trained_logits()?;
        let moments = self.training.moments.opacity_logits.read(&self.device)?;
        let times = [self.iteration, self.options.schedule.iterations];
        let [_, decay] = self.options.schedule.decays();
        self.state.attrition = Some(AttritionState::new(settings, survivors, times, &logits, (&moments, decay)));
        Ok(())
    }

    /// Opacity logits of the trained Gaussians.
    fn trained_logits(&self) -> Result<Vec<f32>> {
        let mut logits = self.training.model.parameters.opacity_logits.read(&self.device)?;
        logits.truncate(self.training.trained());
        Ok(logits)
    }

    /// The attrition in progress.
    pub fn attrition(&self) -> Option<&AttritionState> {
        self.state.under_way()
    }

    /// Ends attrition: pressure stops, and the opacities' learning rate soon returns to the schedule's.
    pub fn end_attrition(&mut self) {
        if let Some(attrition) = &mut self.state.attrition {
            attrition.ended.get_or_insert(self.iteration);
        }
    }

    /// Adapts the pressure and removes faded Gaussians.
    pub(super) fn attrite(&mut self, iteration: u32) -> Result<()> {
        let Some(attrition) = self.attrition().filter(|a| a.acts(iteration)) else { return Ok(()) };
        let (mut attrition, logits) = (*attrition, self.trained_logits()?);
        let stay = attrition.judge(iteration, &logits);
        tracing::debug!("after iteration {iteration}: {} Gaussians, pressure {:e}", stay.len(), attrition.pressure);
        self.state.attrition = Some(attrition);
        if stay.len() < logits.len() {
            self.thin(&stay)?;
        }
        Ok(())
    }

    /// Takes longer steps again from here: the positions' rate is rewound and falls to the same end, scales and
    /// rotations move faster for a while, and first moments become 0.
    pub fn rewarm(&mut self) -> Result<()> {
        let device = &self.device;
        let still = |moments: &Buffer<[f32; 2]>| -> Result<Buffer<[f32; 2]>> {
            let mut values = moments.read(device)?;
            for [first, _] in &mut values {
                *first = 0.0;
            }
            Ok(device.upload("moments", &values)?)
        };
        self.training.moments = self.training.moments.each_ref().try_map(still)?;
        self.state.rewarmed = Some(self.iteration);
        Ok(())
    }
}
