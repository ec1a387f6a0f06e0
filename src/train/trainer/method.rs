//! The method of another paper in a run, if it has one.

use super::Trainer;
use crate::train::error::Result;
use crate::train::method::{Cut, Method, Pause};
use std::sync::Arc;

impl Trainer {
    /// The method, until it is over.
    pub(super) fn method(&self) -> Option<&Arc<dyn Method>> {
        self.options.method.as_ref()
    }

    /// Returns true if a method replaces density control.
    fn grows_otherwise(&self) -> bool {
        self.method().is_some_and(|method| method.replaces_density_control())
    }

    /// Returns true if density control acts after iteration `iteration`.
    pub(super) fn densifies(&self, iteration: u32) -> bool {
        !self.grows_otherwise() && self.options.schedule.densifies(iteration)
    }

    /// Returns true if opacities are reset after iteration `iteration`.
    pub(super) fn resets_opacity(&self, iteration: u32) -> bool {
        !self.grows_otherwise() && self.options.schedule.resets_opacity(iteration)
    }

    /// Runs the method's work between two iterations, if it is due after this one.
    pub(super) fn follow_method(&mut self, iteration: u32) -> Result<()> {
        let schedule = &self.options.schedule;
        let Some(method) = self.method().filter(|method| method.acts(schedule, iteration)).cloned() else {
            return Ok(());
        };
        let (key, most, schedule) = ([self.options.seed, iteration], self.options.most, schedule.clone());
        let changed =
            self.aside(|device, model| method.between(&mut Pause { device, model, schedule: &schedule, key, most }))?;
        if changed.rows {
            self.responses = None;
        }
        if changed.cut.is_some() {
            self.state.cut = changed.cut;
            self.options.method = None;
            self.training.arrays.clear();
        }
        Ok(())
    }

    /// The cut that ended a method, once it is done.
    pub fn cut(&self) -> Option<Cut> {
        self.state.cut
    }
}
