//! `qirf-vk device --kernels`: kernels as a driver compiles them, without running any.

use crate::program::ended::{qirf, works};
use crate::support::{skip, source};
use serde_json::Value;
use std::collections::BTreeSet;
use std::path::{Path, PathBuf};
use std::process::Command;

fn kernels(environment: &[(&str, &Path)]) -> Vec<Value> {
    let mut printed = works(qirf(["device", "--kernels", "--json"]).envs(environment.iter().copied())).json();
    let kernels: Vec<Value> = serde_json::from_value(printed["kernels"].take()).expect("a list");
    let named = |name: &str| kernels.iter().any(|k| k["kernel"].as_str().is_some_and(|k| k.starts_with(name)));
    for name in ["render/rasterise_backward", "train/adam", "response/score", "qirf/overlap", "qirf/participation"] {
        assert!(named(name), "no {name}");
    }
    kernels
}

#[test]
fn every_kernel_of_a_run_is_compiled_and_none_runs() {
    // A submission would answer that the device is lost.
    let kernels = kernels(&[("QIRF_DEVICE_FAULT", Path::new("submit:1:lost"))]);
    let names: BTreeSet<&str> = kernels.iter().filter_map(|kernel| kernel["kernel"].as_str()).collect();
    assert!(names.len() >= 20 && kernels.len() > names.len(), "{names:?}");
}

/// The manifest of Mesa's driver of AMD's GPUs, where the loader looks for it.
fn radv() -> Option<PathBuf> {
    let folders = ["/usr/share/vulkan/icd.d", "/usr/local/share/vulkan/icd.d", "/etc/vulkan/icd.d"];
    let files = folders.iter().filter_map(|folder| std::fs::read_dir(folder).ok()).flatten().flatten();
    let paths = files.map(|entry| entry.path());
    paths.into_iter().find(|path| path.file_name().is_some_and(|n| n.to_string_lossy().starts_with("radeon_icd")))
}

/// Mesa compiles for AMD's GPUs without one: a real GPU's compiler sees every kernel.
#[test]
fn no_kernel_spills_registers_on_amd() {
    let Some(manifest) = radv() else { return skip("no driver of AMD's GPUs") };
    for family in ["navi31", "navi21", "vega10"] {
        let kernels = kernels(&[("VK_DRIVER_FILES", &manifest), ("RADV_FORCE_FAMILY", Path::new(family))]);
        for kernel in &kernels {
            let statistics = kernel["statistics"].as_array().expect("a list");
            let value = |name: &str| {
                let pair = statistics.iter().find(|s| s[0] == name);
                pair.and_then(|s| s[1].as_f64()).unwrap_or_else(|| panic!("{family}, {}: no {name}", kernel["kernel"]))
            };
            for wasted in ["Spilled VGPRs", "Spilled SGPRs", "Scratch size"] {
                assert_eq!(value(wasted), 0.0, "{family}, {}: {wasted}", kernel["kernel"]);
            }
            assert!(value("Instructions") > 0.0 && value("LDS size") <= 16384.0, "{family}, {}", kernel["kernel"]);
        }
    }
}

/// Kernels that wait for each load before they ask for the next one leave a GPU's memory idle.
#[test]
fn hot_kernels_have_several_loads_in_flight_on_amd() {
    if radv().is_none() {
        return skip("no driver of AMD's GPUs");
    }
    let mut command = Command::new(source("tools/isa"));
    let table = works(command.env("QIRF_PROGRAM", env!("CARGO_BIN_EXE_qirf-vk"))).out;
    assert!(!table.contains('?'), "{table}");
    let rows: Vec<Vec<&str>> = table.lines().map(|row| row.split('|').map(str::trim).collect()).collect();
    for (kernel, least) in
        [("render/rasterise", 3), ("train/adam", 4), ("render/project_backward", 6), ("train/loss_tiles", 8)]
    {
        let of: Vec<_> = rows.iter().filter(|row| row.get(1) == Some(&kernel)).collect();
        assert!(!of.is_empty(), "no {kernel} in\n{table}");
        for row in of {
            assert!(
                row[9].parse::<u32>().is_ok_and(|most| most >= least),
                "{kernel}: {row:?}, not {least} loads in flight"
            );
        }
    }
}
