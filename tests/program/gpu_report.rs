//! `tools/gpu-report`: the kit that measures a GPU, with shell scripts in its programs' place.

use serde_json::Value;
use std::fs;
use std::os::unix::fs::PermissionsExt;
use std::path::Path;
use std::process::{Command, Output};

/// The program: its device is a GPU with subgroups of 64 unless there is a file `no-device`; `synth` fails.
const PROGRAM: &str = r#"#!/usr/bin/env bash
if [ -e "$(dirname "$0")/no-device" ] && [ "$1" = device ]; then echo 'error: no "loader"' >&2; exit 4; fi
case "$*" in
  --version) echo qirf-vk 1 ;;
  "device --json") echo '{"tuning": {"subgroup": 64}, "of": "'"${QIRF_TUNING:-none}"'"}' ;;
  device) echo '* 0 Some GPU (R) (discrete)' ;;
  selftest*) printf '{"checks": [' ; exit 1 ;;
  synth*) echo 'error: no space left' >&2; exit 5 ;;
  *) echo '{}' ;;
esac
"#;

/// A measurement that fails after its first row.
const TRAINING: &str = r#"#!/usr/bin/env bash
while [ $# -gt 0 ]; do [ "$1" != --output ] || echo '{"rows": [{"round": 0}]}' >"$2"; shift; done
exit 1
"#;

fn add(kit: &Path, name: &str, text: &str) {
    fs::write(kit.join(name), text).unwrap();
    fs::set_permissions(kit.join(name), fs::Permissions::from_mode(0o755)).unwrap();
}

fn report(kit: &Path, out: &str) -> (Output, Value) {
    let mut script = Command::new("bash");
    let ran = script.arg(kit.join("gpu-report")).args(["-m", "1", "-o"]).arg(kit.join(out)).output();
    let ran = ran.expect("bash starts");
    let report = fs::read(kit.join(out).join("report.json")).expect("a report, whatever happens");
    (ran, serde_json::from_slice(&report).expect("JSON"))
}

#[test]
fn a_report_holds_what_was_measured_and_why_the_rest_was_not() {
    let folder = tempfile::tempdir().unwrap();
    let kit = folder.path();
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("tools/gpu-report");
    // These programs end at once: the script looks for their end more often.
    let (script, pause) = (fs::read_to_string(script).unwrap(), "sleep 0.2\n");
    assert_eq!(script.matches(pause).count(), 1);
    add(kit, "gpu-report", &script.replace(pause, "sleep 0.01\n"));
    add(kit, "qirf-vk", PROGRAM);
    add(kit, "training", TRAINING);

    let (ran, all) = report(kit, "report");
    assert!(ran.status.success() && all["complete"] == true, "{ran:?}");
    let stages = all["stages"].as_array().unwrap();
    let of = |name: &str| stages.iter().find(|stage| stage["name"] == name).unwrap_or_else(|| panic!("{name}: {all}"));
    for (name, result, why) in [
        ("training", "failed", "exit code 1"),
        ("selftest", "failed", "exit code 1"),
        ("synth", "failed", "exit code 5: error: no space left"),
        ("train", "left_out", "it needs synth, which did not pass"),
        ("compress", "left_out", "it needs million, which did not pass"),
        ("bench-gpu", "left_out", "the kit has no engine"),
        ("tests", "left_out", "the kit has no device"),
    ] {
        assert_eq!(of(name)["result"], result, "{name}");
        assert_eq!(of(name)["why"], why, "{name}");
    }
    assert_eq!(all["training"]["rows"][0]["round"], 0, "the rows before the failure");
    assert!(of("selftest")["output"].is_null(), "half a document is none");
    // Tiles of 8 fit the width; a GPU is not measured as a CPU.
    let tiles = "gpu,tile=8,rasterise_workgroup=64,rasterise_batch=64,backward_workgroup=64,backward_batch=64";
    assert_eq!(of("tuning-tiles-of-8")["output"]["of"], tiles);
    assert!(stages.iter().all(|stage| stage["name"] != "tuning-cpu"));
    assert_eq!(fs::read_dir(kit.join("report")).unwrap().count(), 4, "the files of docs/platforms.md");

    add(kit, "no-device", "");
    let (ran, none) = report(kit, "none");
    assert_eq!(ran.status.code(), Some(4), "{ran:?}");
    assert!(none["problem"].as_str().unwrap().contains("no \"loader\"") && none["complete"] == false, "{none}");
}
