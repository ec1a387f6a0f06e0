//! Test options of a device: other limits, faults on demand, other orders of work, guarded buffers, mutated shaders.

mod device;
pub(in crate::gpu) mod fault;
pub(in crate::gpu) mod imitation;
pub(in crate::gpu) mod order;
mod permute;
pub(in crate::gpu) mod red_zone;

pub use fault::{Answer, Call, Fault};
pub use imitation::{Claim, Limits};
pub use order::{Derived, Forget, Order};
use std::path::PathBuf;

/// Options of a device for tests.
#[derive(Clone, Debug, Default)]
pub struct Harness {
    /// Limits of another device, where they are tighter.
    pub limits: Option<Limits>,
    /// Subgroup size that the driver is made to report (tests of the probe).
    pub claim: Option<Claim>,
    /// A folder whose modules, `ROOM-STAGE.spv`, replace the program's own (tests of mutants).
    pub shaders: Option<PathBuf>,
    /// Fill new buffers with NaN and give them red zones: see [`super::Device::overrun_buffers`].
    pub guarded: bool,
    /// A fault to inject.
    pub fault: Option<Fault>,
    /// Another order of commands that no barrier orders.
    pub order: Option<Order>,
}
