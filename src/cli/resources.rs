//! What a job may use, and what it is judged with: no part of its configuration.

use super::console::Console;
use super::{Global, networks, values};
use crate::error::Error;
use crate::gpu::Device;
use crate::metrics::Networks;
use crate::pipeline::host_bytes;
use clap::Args;
use std::path::PathBuf;

/// Memory limits and LPIPS weights.
#[derive(Args, Clone, Debug)]
pub(super) struct Resources {
    /// Device memory that the run may use, such as 2G or 800M, and the most that decoded photos take of the host's
    /// [default: the device's, and a quarter of the host's]
    #[arg(long, value_name = "BYTES", value_parser = values::bytes, help_heading = "Training")]
    memory_budget: Option<u64>,
    /// LPIPS weights: a file, or a folder of them (tools/lpips-weights makes them)
    #[arg(long, value_name = "PATH", help_heading = "Photos")]
    lpips_weights: Option<PathBuf>,
}

impl Resources {
    /// Opens the device within the memory budget.
    pub fn device(&self, global: &Global) -> Result<Device, Error> {
        global.open_with(self.memory_budget)
    }

    /// The networks of LPIPS, where there are weights.
    pub fn networks(&self, console: &Console) -> Result<Networks, Error> {
        networks(self.lpips_weights.as_deref(), console)
    }

    /// Bytes of the host's memory that decoded photos may take.
    pub fn host_bytes(&self) -> u64 {
        host_bytes(self.memory_budget)
    }
}
