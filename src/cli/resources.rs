//! Resources and weights of a job, which are no part of its configuration.

use super::scratch::Scratch;
use super::{Global, values};
use crate::gpu::Device;
use crate::job::{Error, Session, Watcher};
use crate::lab::methods::make;
use crate::metrics::Networks;
use clap::Args;
use std::path::PathBuf;

/// Memory limits and LPIPS weights.
#[derive(Args, Clone, Debug)]
pub(super) struct Resources {
    /// Limit on device memory, such as 2G or 800M, and on the host memory that decoded photos take
    /// [default: the device's, and a quarter of the host's]
    #[arg(long, value_name = "BYTES", value_parser = values::bytes, help_heading = "Training")]
    memory_budget: Option<u64>,
    /// LPIPS weights: a file, or a folder of them, as the script lpips-weights writes them [default: $QIRF_LPIPS, else the
    /// folder qirf-vk in the user's data folder]
    #[arg(long, value_name = "PATH", help_heading = "Photos")]
    lpips_weights: Option<PathBuf>,
    #[command(flatten)]
    scratch: Scratch,
}

impl Resources {
    /// Opens the device within the memory budget.
    pub fn device(&self, global: &Global) -> Result<Device, Error> {
        global.open_with(self.memory_budget)
    }

    /// The networks of LPIPS; empty without weights.
    pub fn networks(&self) -> Result<Networks, Error> {
        Ok(Networks::find(self.lpips_weights.as_deref())?)
    }

    /// A session within these limits, whose configurations may name every method.
    pub fn session<'a>(&'a self, on: (&'a Device, &'a Networks), watcher: &'a (dyn Watcher + Sync)) -> Session<'a> {
        Session { methods: make, ..self.scratch.session(self.memory_budget, on, watcher) }
    }
}
