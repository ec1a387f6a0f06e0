//! Devices as the environment describes them: what the program refuses by name, and what it starts on all the same.

use super::ended::{Ended, end, qirf, works};
use crate::support::mutants::Mistake;
use serde_json::Value;
use std::fs;
use std::io::{BufRead, BufReader};
use std::path::{Path, PathBuf};
use std::process::Stdio;

fn device(variables: &[(&str, &str)]) -> Ended {
    end(qirf(["device", "--json"]).env("QIRF_VALIDATION", "1").envs(variables.iter().copied()))
}

fn opens(variables: &[(&str, &str)]) -> Value {
    device(variables).with(0, &[]).json()
}

fn refused(variables: &[(&str, &str)], code: i32, says: &[&str]) {
    device(variables).with(code, says);
}

#[test]
fn a_driver_that_lies_about_its_subgroups_is_refused() {
    let width = opens(&[])["devices"][0]["subgroup_size"].as_u64().unwrap();
    let (told, unpinned) = (format!("{}", 2 * width), format!("{},unpinned", 2 * width));
    refused(
        &[("QIRF_SUBGROUP", &told)],
        4,
        &[&format!("subgroups have {width} invocations, not the {told}"), "is unreliable"],
    );
    // Where no size can be asked for, the width found counts.
    let opened = opens(&[("QIRF_SUBGROUP", &unpinned)]);
    assert_eq!(opened["tuning"]["subgroup"], width);
}

#[test]
fn variables_that_say_nothing_are_named() {
    refused(&[("QIRF_LIMITS", "riva")], 2, &["QIRF_LIMITS=riva", "small-buffers"]);
    refused(&[("QIRF_SUBGROUP", "wide")], 2, &["QIRF_SUBGROUP=wide"]);
    refused(&[("QIRF_DESCRIPTORS", "pull")], 2, &["QIRF_DESCRIPTORS=pull", "neither push nor sets"]);
    let ended = device(&[("QIRF_MAX_SUBMISSION", "x")]).with(2, &["QIRF_MAX_SUBMISSION=x"]);
    assert!(ended.out.is_empty(), "listed before the variable was read: {}", ended.out);
}

/// The manifest of an installed driver for CPUs by Mesa, as the loader would find it.
fn manifest() -> Option<PathBuf> {
    let shared = std::env::var("XDG_DATA_DIRS").ok().filter(|dirs| !dirs.is_empty());
    let shared = shared.unwrap_or_else(|| "/usr/local/share:/usr/share".to_owned());
    let folders = shared.split(':').map(|folder| PathBuf::from(folder).join("vulkan/icd.d"));
    let files = folders.filter_map(|folder| fs::read_dir(folder).ok()).flatten().flatten().map(|file| file.path());
    files.filter(|path| path.file_name().is_some_and(|name| name.to_string_lossy().contains("lvp"))).min()
}

/// As in a container that has a driver's manifest and lacks its libraries.
#[test]
fn without_a_driver_that_can_be_loaded_the_program_says_what_it_may_lack() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("broken.json");
    let icd = serde_json::json!({ "file_format_version": "1.0.0", "ICD": { "library_path": "libnone.so", "api_version": "1.3.0" } });
    fs::write(&path, icd.to_string()).unwrap();
    let path = path.to_str().unwrap();
    let variables = [("VK_DRIVER_FILES", path), ("VK_ICD_FILENAMES", path)];
    refused(&variables, 4, &["can load no driver", "libglvnd0", "VK_LOADER_DEBUG=error"]);
}

#[test]
fn portability_drivers_are_found() {
    let Some(installed) = manifest() else { return crate::support::skip("no manifest of llvmpipe") };
    let mut text: Value = serde_json::from_slice(&fs::read(&installed).unwrap()).unwrap();
    text["ICD"]["is_portability_driver"] = true.into();
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("portability.json");
    fs::write(&path, text.to_string()).unwrap();
    let path = path.to_str().unwrap();
    // Older loaders know the second name only.
    let opened = opens(&[("VK_DRIVER_FILES", path), ("VK_ICD_FILENAMES", path)]);
    assert!(opened["devices"][0]["name"].as_str().unwrap().contains("llvmpipe"), "{opened}");
}

/// A constant of SSIM that is a little wrong.
const OTHER_CONSTANT: Mistake = Mistake {
    file: "lib/ssim.glsl",
    right: "const float C2 = 9e-4;",
    wrong: "const float C2 = 9.08e-4;",
    shaders: &["train/loss", "train/loss_tiles"],
};

/// The mistake moves one check to twice its bound.
#[test]
fn a_device_that_rounds_differently_is_warned_of() {
    let modules = OTHER_CONSTANT.modules();
    let ended = end(qirf(["selftest", "--quick", "--json"]).env("QIRF_SHADERS", modules.path()));
    let told = ended.with(0, &["this device rounds differently"]).json();
    assert_eq!((&told["passed"], &told["counts"]["wrong"]), (&true.into(), &0.into()));
    let checks = told["checks"].as_array().unwrap();
    let beyond: Vec<&Value> = checks.iter().filter(|check| check["verdict"] == "rounding").collect();
    assert!(beyond.len() == 1 && beyond[0]["room"] == "ssim", "{beyond:?}");
}

/// `qirf-vk device --device WANTED`, with leases in `folder`.
fn ask(wanted: &str, folder: &Path) -> Ended {
    end(qirf(["device", "--json", "--device", wanted]).env("QIRF_LEASES", folder))
}

#[test]
fn a_device_is_named_by_its_uuid_and_its_place_on_the_bus() {
    let folder = tempfile::tempdir().unwrap();
    let told = opens(&[]);
    let chosen = &told["devices"][told["chosen"].as_u64().unwrap() as usize];
    let uuid = chosen["uuid"].as_str().expect("Vulkan 1.2 has UUIDs");
    for wanted in [format!("uuid:{uuid}"), format!("uuid:GPU-{}", uuid.to_uppercase())] {
        ask(&wanted, folder.path()).with(0, &[]);
    }
    if let Some(pci) = chosen["pci"].as_str() {
        ask(&format!("pci:{pci}"), folder.path()).with(0, &[]);
    }
    let other = if uuid.starts_with('0') { uuid.replacen('0', "1", 1) } else { format!("0{}", &uuid[1..]) };
    for (wanted, code, says) in [
        (format!("uuid:{other}"), 4, "no device matches"),
        ("pci:ffffffff:ff:1f.7".to_owned(), 4, "no device matches"),
        ("uuid:12".to_owned(), 2, "'12' is not a UUID"),
        ("pci:zero".to_owned(), 2, "'zero' is not a PCI address"),
    ] {
        ask(&wanted, folder.path()).with(code, &[says]);
    }
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 0, "none of these takes a lease");
}

/// Two processes on one device: the second finds none free until the first is gone, however it went.
#[cfg(unix)]
#[test]
fn a_free_device_is_held_by_one_process_until_it_dies() {
    let folder = tempfile::tempdir().unwrap();
    ask("free", folder.path()).with(0, &[]);
    let count = opens(&[])["devices"].as_array().unwrap().len();
    if count > 1 {
        return crate::support::skip("several devices: who gets which is not told");
    }
    // It prints its device's name once it holds it, and then waits for work that never ends.
    let mut holder = qirf(["selftest", "--device", "free"]);
    holder.env("QIRF_LEASES", folder.path());
    holder.env("QIRF_DEVICE_FAULT", "wait:4:hang").stdout(Stdio::piped()).stderr(Stdio::null());
    let mut holder = holder.spawn().expect("the program starts");
    let mut device = String::new();
    let mut printed = BufReader::new(holder.stdout.take().unwrap()); // a closed pipe would end it
    printed.read_line(&mut device).unwrap();
    assert!(!device.is_empty(), "the holder ended without a device");
    ask("free", folder.path()).with(4, &["held by other processes"]);
    ask("0", folder.path()).with(0, &[]); // who names the device gets it
    holder.kill().unwrap(); // SIGKILL
    holder.wait().unwrap();
    drop(printed);
    ask("free", folder.path()).with(0, &[]); // the lease died with its holder
}

/// Variables of vendors whose devices are not here change nothing.
#[test]
fn variables_of_other_vendors_hide_nothing() {
    let other = ["CUDA_VISIBLE_DEVICES", "ROCR_VISIBLE_DEVICES", "HIP_VISIBLE_DEVICES", "SLURM_JOB_GPUS"];
    let told = opens(&[]);
    let vendors: Vec<u64> = told["devices"].as_array().unwrap().iter().filter_map(|d| d["vendor"].as_u64()).collect();
    if vendors.iter().any(|vendor| [0x10de, 0x1002].contains(vendor)) {
        return crate::support::skip("their devices are here");
    }
    assert_eq!(told, opens(&other.map(|name| (name, ""))));
}

/// `qirf-vk device --fingerprint` with these variables.
fn fingerprint(variables: &[(&str, &str)]) -> String {
    works(qirf(["device", "--fingerprint"]).envs(variables.iter().copied())).out.trim().to_owned()
}

#[test]
fn a_fingerprint_is_the_devices_own() {
    let own = fingerprint(&[]);
    let parts: Vec<&str> = own.split('-').collect();
    assert!(
        parts.len() == 6 && parts.iter().all(|part| part.len() == 8 && u32::from_str_radix(part, 16).is_ok()),
        "{own}"
    );
    // Threads of the device and of the host change nothing.
    assert_eq!(fingerprint(&[("LP_NUM_THREADS", "1"), ("RAYON_NUM_THREADS", "1")]), own);
    assert_eq!(fingerprint(&[("QIRF_FINGERPRINT", "another machine")]), "another machine");
    // A kernel that computes a little else is another device, in the parts that use it.
    let modules = OTHER_CONSTANT.modules();
    let other = fingerprint(&[("QIRF_SHADERS", modules.path().to_str().unwrap())]);
    let differs: Vec<bool> = parts.iter().zip(other.split('-')).map(|(a, b)| *a != b).collect();
    assert!(!differs[0] && !differs[1] && differs[2] && differs[3], "{own} {other}");
}
