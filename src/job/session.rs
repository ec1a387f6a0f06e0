//! The context of every job besides its own configuration.

use super::config::{Methods, RunConfig, no_methods};
use super::error::Error;
use super::host_memory::physical;
use super::records::Memory;
use super::watcher::{Silent, Watcher};
use crate::gpu::Device;
use crate::metrics::Networks;
use crate::scene::PhotoMemory;
use crate::train::method::Method;
use std::path::Path;
use std::sync::Arc;

/// Assumed host memory in bytes, if the system does not report it.
const HOST: u64 = 8 << 30;
/// Divisor of it that gives the memory for decoded photos.
const HOST_SHARE: u64 = 4;
/// The device, the limits and the watcher of a job.
#[derive(Clone, Copy)]
pub struct Session<'a> {
    /// The device.
    pub device: &'a Device,
    /// The networks of LPIPS.
    pub networks: &'a Networks,
    /// Bytes of the host's memory that decoded photos may take; beyond them they go to a file.
    pub host_bytes: u64,
    /// The folder of that file, if it is not to be beside the outputs.
    pub scratch: Option<&'a Path>,
    /// Follows the job, and may end it.
    pub watcher: &'a (dyn Watcher + Sync),
    /// Makes the methods that configurations may name.
    pub methods: Methods,
}

impl<'a> Session<'a> {
    /// A session that prints nothing and knows no methods, whose photos may take a quarter of the host's memory.
    pub fn new(device: &'a Device, networks: &'a Networks) -> Self {
        Self { device, networks, host_bytes: host_bytes(None), scratch: None, watcher: &Silent, methods: no_methods }
    }

    /// The method that trains a configuration's model, if it names one.
    ///
    /// # Errors
    /// [`Error::Usage`] for a name or a setting that is unknown or wrong; device memory.
    pub fn method(&self, config: &RunConfig) -> Result<Option<Arc<dyn Method>>, Error> {
        config.method.as_ref().map(|method| (self.methods)(method, self.device)).transpose()
    }

    /// The memory limit of decoded photos, and the folder of the temporary file for the rest: the session's own, else
    /// `folder`.
    pub fn photo_memory<'f>(&self, folder: &'f Path) -> PhotoMemory<'f>
    where
        'a: 'f,
    {
        PhotoMemory { bytes: self.host_bytes, folder: self.scratch.unwrap_or(folder) }
    }

    /// The device's memory use so far, with an estimate made before the start.
    pub fn memory(&self, estimated_bytes: u64) -> Memory {
        Memory { estimated_bytes, peak_bytes: self.device.memory_used().1, limit_bytes: self.device.memory_limit() }
    }
}

/// Bytes of the host's memory that decoded photos may take: a quarter of it, or the given budget if that is less.
pub fn host_bytes(given: Option<u64>) -> u64 {
    let quarter = physical().unwrap_or(HOST) / HOST_SHARE;
    given.map_or(quarter, |given| given.min(quarter))
}
