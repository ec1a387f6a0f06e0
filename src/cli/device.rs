//! `qirf-vk device`.

use super::Global;
use super::console::Console;
use super::values;
use crate::gpu::{self, Compiled, Device, DeviceInfo, Feature, Tuning};
use crate::job::Error;
use crate::pipeline::kernels::compiled;
use crate::pipeline::tune::{Tuned, tune};
use crate::selftest;
use serde_json::json;
use std::time::Duration;

const EXAMPLES: &str = "Examples:
  qirf-vk device
  qirf-vk device --json
  QIRF_DEVICE=llvmpipe qirf-vk device
  qirf-vk device --tuning gpu,sort_rows_max=8
  qirf-vk device --tune
  qirf-vk device --kernels
  qirf-vk device --fingerprint";

#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub(super) struct Arguments {
    /// Print one JSON document
    #[arg(long)]
    json: bool,
    /// Print statistics of each kernel from the driver's compiler, such as registers, spills and code size; nothing is run
    #[arg(long)]
    kernels: bool,
    /// Print the device's fingerprint, checksums of its results for an embedded scene (takes a few seconds). On devices with
    /// equal fingerprints, equal commands write equal bytes
    #[arg(long, conflicts_with = "kernels")]
    fingerprint: bool,
    /// Measure which tuning trains fastest on this device, and store it for later runs; takes about SECONDS, 50 without a value
    #[arg(long, value_name = "SECONDS", num_args = 0..=1, default_missing_value = "50")]
    #[arg(value_parser = values::seconds, conflicts_with_all = ["kernels", "tuning", "fingerprint"])]
    tune: Option<u64>,
}

impl Arguments {
    pub fn run(&self, console: &Console, global: &Global) -> Result<(), Error> {
        if self.kernels {
            return self.kernels(console, global);
        }
        if self.fingerprint {
            return self.fingerprint(console, global);
        }
        if let Some(seconds) = self.tune {
            return self.tune(console, global, Duration::from_secs(seconds));
        }
        // A variable without meaning is refused before anything is printed.
        global.options()?;
        let devices = gpu::list()?;
        // Opening the device is the real test: it checks features and, on CPU devices, the driver.
        let opened = global.open();
        let chosen = opened.as_ref().ok().map(|d| d.info().index);
        let tuning = opened.as_ref().ok().map(Device::tuning);
        let stored = opened.as_ref().ok().filter(|d| d.stored_tuning().is_some_and(|t| t == *d.tuning()));
        if self.json {
            let problem = opened.as_ref().err().map(ToString::to_string);
            console.json(&json!({ "devices": devices, "chosen": chosen, "tuning": tuning, "problem": problem }))?;
        } else {
            for info in &devices {
                let tuning = tuning.filter(|_| chosen == Some(info.index));
                let origin = if stored.is_some() { ", as measured by --tune" } else { "" };
                console.print(describe(info, tuning.map(|t| shapes(t, origin))))?;
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

    fn tune(&self, console: &Console, global: &Global, within: Duration) -> Result<(), Error> {
        let device = global.open()?;
        let tuned = tune(&device, within, |what| console.note(what))?;
        let best = &tuned.tried[tuned.best];
        if tuned.tried.len() < 2 && !tuned.left.is_empty() {
            let seconds = within.as_secs();
            return Err(Error::Usage(format!(
                "--tune {seconds}: that was only enough to make the kernels of the usual tuning, and nothing is changed; give more \
                 seconds, such as {}",
                (4 * seconds).max(50)
            )));
        }
        let stored = if tuned.best == 0 {
            device.forget_tuning().map(|()| None)
        } else {
            device.store_tuning(&best.tuning).map(Some)
        };
        let stored = stored.map_err(|source| Error::Write { path: "tuning in the cache folder".into(), source })?;
        if self.json {
            return console.json(&json!({ "device": device.info(), "tuned": tuned, "stored": stored }));
        }
        console.print(format_args!("{} ({})", device.info().name, device.info().driver))?;
        console.print(measured(&tuned))?;
        console.print(match stored {
            Some(path) => format!("{}: stored in {} for later runs; --tuning overrides it", best.name, path.display()),
            None => "no other is measurably faster: later runs use the usual tuning".to_owned(),
        })
    }

    fn kernels(&self, console: &Console, global: &Global) -> Result<(), Error> {
        let device = global.open_to_compile()?;
        let compiled = compiled(&device)?;
        if self.json {
            return console.json(&json!({ "device": device.tuned(), "kernels": compiled }));
        }
        console.print(format_args!("{} ({})", device.info().name, device.info().driver))?;
        if !device.info().has(Feature::KernelStatistics) {
            console.print(
                "its driver reports no statistics of compiled kernels (VK_KHR_pipeline_executable_properties)",
            )?;
        }
        console.print(table(&compiled))
    }
}

/// A row for each tuning that was measured.
fn measured(tuned: &Tuned) -> String {
    let ratio = |ratio: Option<f64>| ratio.map(|r| format!("{r:.3}")).unwrap_or_default();
    let mut text = "| tuning | ms per iteration | of the usual tuning | again |\n|---|---:|---:|---:|".to_owned();
    for (k, tried) in tuned.tried.iter().enumerate() {
        let mark = if k == tuned.best { " *" } else { "" };
        let [first, again] = [tried.ratio, tried.again].map(ratio);
        text += &format!("\n| {}{mark} | {:.3} | {first} | {again} |", tried.name, tried.ms);
    }
    if !tuned.left.is_empty() {
        text += &format!("\nno time was left for: {}", tuned.left.join(", "));
    }
    text
}

/// Statistics that matter for occupancy, by the names that drivers give them (RADV, ANV, NVIDIA).
const SHOWN: &str = "VGPRs, SGPRs, Register Count, Spilled VGPRs, Spilled SGPRs, Spill count, Fill count, \
                     Scratch size, Scratch Memory Size, Stack Size, LDS size, Shared Memory Size, \
                     Subgroups per SIMD, Instructions, Instruction Count, Code size, Binary Size";

/// A row for each kernel, a column for each statistic of [`SHOWN`] that the driver tells.
fn table(compiled: &[Compiled]) -> String {
    let told = |name: &&str| compiled.iter().any(|c| c.statistics.iter().any(|(n, _)| n == *name));
    let shown: Vec<&str> = SHOWN.split(", ").filter(told).collect();
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

/// A device as text; the default one with the text of its tuning.
fn describe(info: &DeviceInfo, tuning: Option<String>) -> String {
    let mark = if tuning.is_some() { "* " } else { "  " };
    let optional: Vec<String> = info.optional.iter().map(ToString::to_string).collect();
    let optional = if optional.is_empty() { "none".to_owned() } else { optional.join(", ") };
    let tuning = tuning.unwrap_or_default();
    let timestamps = if info.timestamp_period > 0.0 { format!("{} ns", info.timestamp_period) } else { "none".into() };
    let missing = info.missing.as_ref().map(|m| format!("\n    cannot be used: it lacks {m}")).unwrap_or_default();
    let hidden =
        info.hidden_by.map(|v| format!("\n    hidden by {v}: used only where it is named")).unwrap_or_default();
    let names = [info.pci.map(|pci| format!("pci:{pci}")), info.uuid.map(|uuid| format!("uuid:{uuid}"))];
    let names: Vec<String> = names.into_iter().flatten().collect();
    let address = if names.is_empty() { String::new() } else { format!("\n    address     {}", names.join(", ")) };
    let [low, high] = info.subgroup_range;
    format!(
        "{mark}{} {} ({})\n    driver      {}, Vulkan {}{address}\n    memory      {}, {} per buffer, {} shared by a workgroup\n    \
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

/// A tuning's class and origin, and its fields, four per line.
fn shapes(tuning: &Tuning, origin: &str) -> String {
    let json = json!(tuning);
    let fields =
        json.as_object().into_iter().flatten().filter(|(name, _)| !["class", "subgroup"].contains(&name.as_str()));
    let fields: Vec<String> = fields.map(|(name, value)| format!("{} {value}", name.replace('_', " "))).collect();
    let lines: Vec<String> = fields.chunks(4).map(|line| line.join(", ")).collect();
    format!("\n    tuning      {}{origin}: {}", tuning.class, lines.join(",\n                "))
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
