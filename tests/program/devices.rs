//! Devices as the environment describes them: what the program refuses by name, and what it starts on all the same.

use crate::support::mutants::Mistake;
use serde_json::Value;
use std::fs;
use std::path::PathBuf;
use std::process::{Command, Output};

fn device(variables: &[(&str, &str)]) -> Output {
    let mut program = Command::new(env!("CARGO_BIN_EXE_qirf-vk"));
    program.args(["device", "--json"]).env("QIRF_VALIDATION", "1").envs(variables.iter().copied());
    program.output().expect("the program starts")
}

fn opens(variables: &[(&str, &str)]) -> Value {
    let output = device(variables);
    let told = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success() && !told.contains("validation:"), "{variables:?}: {told}");
    serde_json::from_slice(&output.stdout).expect("one JSON document")
}

fn refused(variables: &[(&str, &str)], code: i32, says: &[&str]) {
    let output = device(variables);
    let told = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(code), "{variables:?}: {told}");
    for words in says {
        assert!(told.contains(words), "{variables:?} should say {words:?}: {told}");
    }
}

#[test]
fn a_driver_that_lies_about_its_subgroups_is_refused() {
    let width = opens(&[])["devices"][0]["subgroup_size"].as_u64().unwrap();
    let (told, unpinned) = (format!("{}", 2 * width), format!("{},unpinned", 2 * width));
    refused(
        &[("QIRF_SUBGROUP", &told)],
        4,
        &[&format!("subgroups have {width} invocations, not the {told}"), "not to be trusted"],
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
}

/// The manifest of an installed driver for CPUs by Mesa, as the loader would find it.
fn manifest() -> Option<PathBuf> {
    let shared = std::env::var("XDG_DATA_DIRS").ok().filter(|dirs| !dirs.is_empty());
    let shared = shared.unwrap_or_else(|| "/usr/local/share:/usr/share".to_owned());
    let folders = shared.split(':').map(|folder| PathBuf::from(folder).join("vulkan/icd.d"));
    let files = folders.filter_map(|folder| fs::read_dir(folder).ok()).flatten().flatten().map(|file| file.path());
    files.filter(|path| path.file_name().is_some_and(|name| name.to_string_lossy().contains("lvp"))).min()
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

/// A constant of SSIM that is a little wrong moves one check to twice its bound.
#[test]
fn a_device_that_rounds_differently_is_warned_of() {
    let mistake = Mistake {
        file: "lib/ssim.glsl",
        right: "const float C2 = 9e-4;",
        wrong: "const float C2 = 9.08e-4;",
        shaders: &["train/loss", "train/loss_tiles"],
    };
    let modules = mistake.modules();
    let mut program = Command::new(env!("CARGO_BIN_EXE_qirf-vk"));
    let output = program.args(["selftest", "--quick", "--json"]).env("QIRF_SHADERS", modules.path()).output().unwrap();
    let warned = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success() && warned.contains("this device rounds differently"), "{warned}");
    let told: Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!((&told["passed"], &told["counts"]["wrong"]), (&true.into(), &0.into()));
    let checks = told["checks"].as_array().unwrap();
    let beyond: Vec<&Value> = checks.iter().filter(|check| check["verdict"] == "rounding").collect();
    assert!(beyond.len() == 1 && beyond[0]["room"] == "ssim", "{beyond:?}");
}
