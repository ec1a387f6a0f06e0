//! Resources and weights of a job, which are no part of its configuration.

use super::console::Console;
use super::scratch::Scratch;
use super::{Global, networks, values};
use crate::error::Error;
use crate::gpu::Device;
use crate::metrics::Networks;
use crate::pipeline::host_bytes;
use clap::Args;
use std::path::{Path, PathBuf};

/// Memory limits and LPIPS weights.
#[derive(Args, Clone, Debug)]
pub(super) struct Resources {
    /// Limit on the run's device memory, such as 2G or 800M, and on the host memory of decoded photos
    /// [default: the device's, and a quarter of the host's]
    #[arg(long, value_name = "BYTES", value_parser = values::bytes, help_heading = "Training")]
    memory_budget: Option<u64>,
    /// LPIPS weights: a file, or a folder of them (tools/lpips-weights makes them)
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
    pub fn networks(&self, console: &Console) -> Result<Networks, Error> {
        networks(self.lpips_weights.as_deref(), console)
    }

    /// Bytes of the host's memory that decoded photos may take.
    pub fn host_bytes(&self) -> u64 {
        host_bytes(self.memory_budget)
    }

    /// The folder of temporary files, if one was named.
    pub fn scratch(&self) -> Option<&Path> {
        self.scratch.folder()
    }
}
