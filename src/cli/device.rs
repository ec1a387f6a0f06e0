//! `qirf-vk device`.

use super::Global;
use super::console::Console;
use crate::error::Error;
use crate::gpu::{self, Compiled, Device, DeviceInfo, Feature, Tuning};
use crate::pipeline::kernels::compiled;
use crate::selftest;
use serde_json::json;

const EXAMPLES: &str = "Examples:
  qirf-vk device
  qirf-vk device --json
  QIRF_DEVICE=llvmpipe qirf-vk device
  QIRF_TUNING=gpu qirf-vk device
  qirf-vk device --kernels
  qirf-vk device --fingerprint";

/// List the Vulkan devices, the default one, and the tuning of its kernels.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub(super) struct Arguments {
    /// Print one JSON document
    #[arg(long)]
    json: bool,
    /// Print what the driver's compiler makes of each kernel: registers, spills, code size; nothing is run
    #[arg(long)]
    kernels: bool,
    /// Print what tells this device from others: checksums of all that it computes for an embedded scene (some seconds).
    /// Where they are equal, equal commands write equal bytes
    #[arg(long, conflicts_with = "kernels")]
    fingerprint: bool,
}

impl Arguments {
    pub fn run(&self, console: &Console, global: &Global) -> Result<(), Error> {
        if self.kernels {
            return self.kernels(console, global);
        }
        if self.fingerprint {
            return self.fingerprint(console, global);
        }
        let devices = gpu::list()?;
        // Opening the device is the real test: it checks features and, on CPU devices, the driver.
        let opened = global.open();
        let chosen = opened.as_ref().ok().map(|d| d.info().index);
        let tuning = opened.as_ref().ok().map(Device::tuning);
        if self.json {
            let problem = opened.as_ref().err().map(ToString::to_string);
            console.json(&json!({ "devices": devices, "chosen": chosen, "tuning": tuning, "problem": problem }))?;
        } else {
            for info in &devices {
                let tuning = tuning.filter(|_| chosen == Some(info.index));
                console.print(describe(info, tuning))?;
            }
        }
        opened.map(|_| ())
    }

    fn fingerprint(&self, console: &Console, global: &Global) -> Result<(), Error> {
        let device = global.open()?;
        let fingerprint = selftest::fingerprint(&device)?;
        if self.json {
            return console.json(&json!({ "device": device.tuned(), "fingerprint": fingerprint }));
        }
        console.print(fingerprint)
    }

    fn kernels(&self, console: &Console, global: &Global) -> Result<(), Error> {
        let device = global.open_to_compile()?;
        let compiled = compiled(&device)?;
        if self.json {
            return console.json(&json!({ "device": device.tuned(), "kernels": compiled }));
        }
        console.print(format_args!("{} ({})", device.info().name, device.info().driver))?;
        if !device.info().has(Feature::KernelStatistics) {
            console.print("its driver tells nothing of compiled kernels (VK_KHR_pipeline_executable_properties)")?;
        }
        console.print(table(&compiled))
    }
}

/// Statistics that matter for occupancy, by the names that drivers give them (RADV, ANV, NVIDIA).
const SHOWN: [&str; 14] = [
    "VGPRs",
    "SGPRs",
    "Register Count",
    "Spilled VGPRs",
    "Spilled SGPRs",
    "Spill count",
    "Fill count",
    "Scratch size",
    "Scratch Memory Size",
    "LDS size",
    "Subgroups per SIMD",
    "Instructions",
    "Instruction Count",
    "Code size",
];

/// A row for each kernel, a column for each statistic of [`SHOWN`] that the driver tells.
fn table(compiled: &[Compiled]) -> String {
    let told = |name: &&&str| compiled.iter().any(|c| c.statistics.iter().any(|(n, _)| n == **name));
    let shown: Vec<&str> = SHOWN.iter().filter(told).copied().collect();
    let head = ["kernel", "constants", "subgroup"].into_iter().chain(shown.iter().copied());
    let mut text =
        format!("| {} |\n|---|---|---:|{}", head.collect::<Vec<_>>().join(" | "), "---:|".repeat(shown.len()));
    for kernel in compiled {
        let value =
            |name: &&str| kernel.statistics.iter().find(|(n, _)| n == *name).map(|(_, value)| value.to_string());
        let values = shown.iter().map(|name| value(name).unwrap_or_default());
        let constants = kernel.constants.iter().map(ToString::to_string).collect::<Vec<_>>().join(" ");
        let cells = [kernel.kernel.to_owned(), constants, kernel.subgroup.to_string()].into_iter().chain(values);
        text += &format!("\n| {} |", cells.collect::<Vec<_>>().join(" | "));
    }
    text
}

/// A device as text; the default one with its tuning.
fn describe(info: &DeviceInfo, tuning: Option<&Tuning>) -> String {
    let mark = if tuning.is_some() { "* " } else { "  " };
    let optional: Vec<String> = info.optional.iter().map(ToString::to_string).collect();
    let optional = if optional.is_empty() { "none".to_owned() } else { optional.join(", ") };
    let tuning = tuning.map(shapes).unwrap_or_default();
    let timestamps = if info.timestamp_period > 0.0 { format!("{} ns", info.timestamp_period) } else { "none".into() };
    let missing = info.missing.as_ref().map(|m| format!("\n    cannot be used: it lacks {m}")).unwrap_or_default();
    let hidden =
        info.hidden_by.map(|v| format!("\n    hidden by {v}: used only where it is named")).unwrap_or_default();
    let names = [info.pci.map(|pci| format!("pci:{pci}")), info.uuid.map(|uuid| format!("uuid:{uuid}"))];
    let names: Vec<String> = names.into_iter().flatten().collect();
    let address = if names.is_empty() { String::new() } else { format!("\n    address     {}", names.join(", ")) };
    let [low, high] = info.subgroup_range;
    format!(
        "{mark}{} {} ({})\n    driver      {}, Vulkan {}{address}\n    memory      {}, {} a buffer, {} shared by a workgroup\n    \
         subgroups   {} ({low} to {high}), workgroups of {}\n    timestamps  {timestamps}\n    optional    {optional}{tuning}{hidden}{missing}",
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

/// A tuning's fields, four per line.
fn shapes(tuning: &Tuning) -> String {
    let json = json!(tuning);
    let fields =
        json.as_object().into_iter().flatten().filter(|(name, _)| !["class", "subgroup"].contains(&name.as_str()));
    let fields: Vec<String> = fields.map(|(name, value)| format!("{} {value}", name.replace('_', " "))).collect();
    let lines: Vec<String> = fields.chunks(4).map(|line| line.join(", ")).collect();
    format!("\n    tuning      {}: {}", tuning.class, lines.join(",\n                "))
}

/// Bytes in a suitable unit.
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
