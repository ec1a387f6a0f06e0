//! The Vulkan devices of this machine and their capabilities.

use crate::gpu::choose::properties::{Candidate, Report};
use crate::gpu::choose::visible::{Named, Visibility, visibility};
use crate::gpu::error::{During, Error};
use crate::gpu::harness::{Claim, Limits};
use crate::gpu::info::DeviceInfo;
use crate::gpu::instance::Instance;

/// Lists every Vulkan device of this machine, usable or not, in Vulkan's order.
///
/// # Errors
/// [`Error::NoLoader`] without a Vulkan loader; Vulkan's own errors.
pub fn list() -> Result<Vec<DeviceInfo>, Error> {
    let instance = Instance::new(false)?;
    Ok(candidates(&instance, Limits::NONE, None)?.into_iter().map(|c| c.info).collect())
}

/// The devices, as they are or imitating others.
pub(in crate::gpu) fn candidates(
    instance: &Instance,
    limits: Limits,
    claim: Option<Claim>,
) -> Result<Vec<Candidate>, Error> {
    // SAFETY: the instance is alive.
    let physical = unsafe { instance.raw.enumerate_physical_devices() }.during("enumerate devices")?;
    let candidate = |(i, p)| {
        let report = Report::of(&instance.raw, p)?;
        let mut info = report.info(i);
        limits.on(&mut info);
        claim.inspect(|claim| claim.on(&mut info));
        info.missing = report.missing(&info);
        Ok(report.candidate(p, info))
    };
    let mut all: Vec<Candidate> = physical.into_iter().enumerate().map(candidate).collect::<Result<_, Error>>()?;
    let named: Vec<Named> = all.iter().map(|c| Named::of(&c.info)).collect();
    let visible = visibility(&named, &|name| std::env::var(name).ok());
    for (candidate, visible) in all.iter_mut().zip(visible) {
        match visible {
            Visibility::Place(place) => candidate.place = place,
            Visibility::Hidden(variable) => candidate.info.hidden_by = Some(variable),
        }
    }
    Ok(all)
}
