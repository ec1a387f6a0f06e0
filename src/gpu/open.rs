//! Opening a device.

use super::choose;
use super::choose::{lease, select};
use super::context::Context;
use super::device::Device;
use super::error::Error;
use super::harness::imitation::Limits;
use super::instance::Instance;
use super::options::DeviceOptions;
use super::probe;
use super::tuning::store;

impl Device {
    /// Opens the device that the options or the ranking choose, and checks its driver.
    ///
    /// # Errors
    /// No loader, no device, no device of that name, a missing feature, a tuning that does not exist or fit, or a
    /// driver that computes wrong results.
    pub fn open(options: &DeviceOptions) -> Result<Self, Error> {
        let instance = Instance::new(options.validation)?;
        let limits = options.harness.limits.unwrap_or(Limits::NONE);
        let candidates = select::candidates(&instance, limits, options.harness.claim)?;
        let leases = options.leases.clone().unwrap_or_else(lease::folder);
        let candidate = choose::choose(candidates, options.device.as_deref(), &leases)?;
        let choice = options.tuning.clone();
        let stored = if choice.is_none() { store::read(&candidate.info) } else { None };
        let choice = choice.unwrap_or_default();
        let tuning = stored.map_or_else(|| choice.on(&candidate.info), Ok)?;
        let device = Self::of(Context::new(instance, candidate, tuning.class, options)?, tuning);
        if options.compile_only {
            return Ok(device);
        }
        let width = probe::check(&device)?;
        device.context().memory.enforce();
        if width == device.info().subgroup_size { Ok(device) } else { device.with_subgroups_of(width, &choice) }
    }
}
