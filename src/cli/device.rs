//! `qirf-vk device`.

use super::Global;
use super::console::Console;
use crate::error::Error;
use crate::gpu::{self, DeviceInfo};
use serde_json::json;

const EXAMPLES: &str = "Examples:
  qirf-vk device
  qirf-vk device --json
  QIRF_DEVICE=llvmpipe qirf-vk device";

/// List the Vulkan devices, and which one would be used.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub(super) struct Arguments {
    /// Print one JSON document
    #[arg(long)]
    json: bool,
}

impl Arguments {
    pub fn run(&self, console: &Console, global: &Global) -> Result<(), Error> {
        let devices = gpu::list()?;
        // Opening is the test that matters: it checks features and, on CPU devices, the driver.
        let opened = global.open();
        let chosen = opened.as_ref().ok().map(|d| d.info().index);
        if self.json {
            let problem = opened.as_ref().err().map(ToString::to_string);
            console.json(&json!({ "devices": devices, "chosen": chosen, "problem": problem }))?;
        } else {
            for info in &devices {
                console.print(describe(info, chosen == Some(info.index)))?;
            }
        }
        opened.map(|_| ())
    }
}

fn describe(info: &DeviceInfo, chosen: bool) -> String {
    let mark = if chosen { "* " } else { "  " };
    let optional = if info.optional.is_empty() { "none".to_owned() } else { info.optional.join(", ") };
    let timestamps = if info.timestamp_period > 0.0 { format!("{} ns", info.timestamp_period) } else { "none".into() };
    let missing = info.missing.as_ref().map(|m| format!("\n    cannot be used: it lacks {m}")).unwrap_or_default();
    let [low, high] = info.subgroup_range;
    format!(
        "{mark}{} {} ({})\n    driver      {}, Vulkan {}\n    memory      {}, {} a buffer, {} shared by a workgroup\n    \
         subgroups   {} ({low} to {high}), workgroups of {}\n    timestamps  {timestamps}\n    optional    {optional}{missing}",
        info.index,
        info.name,
        info.kind,
        info.driver,
        info.api,
        bytes(info.memory_bytes),
        bytes(info.max_buffer_bytes),
        bytes(u64::from(info.shared_bytes)),
        info.subgroup_size,
        info.max_workgroup,
    )
}

/// Bytes in the unit that reads best.
pub(super) fn bytes(n: u64) -> String {
    let units = ["B", "KiB", "MiB", "GiB", "TiB"];
    let mut value = n as f64;
    let mut unit = 0;
    while value >= 1024.0 && unit + 1 < units.len() {
        value /= 1024.0;
        unit += 1;
    }
    if unit == 0 { format!("{n} B") } else { format!("{value:.1} {}", units[unit]) }
}
