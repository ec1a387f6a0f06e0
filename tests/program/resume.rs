//! Runs that were killed or failed, and go on.

use super::run::{command, metrics, model, scene, works};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::time::Duration;

/// Starts a run and kills it after `after` milliseconds by a signal that cannot be caught.
fn killed(scene: &Path, out: &Path, after: u64) {
    let mut command = command(scene, out, &["--resume"]);
    let mut child: Child = command.stdout(Stdio::null()).stderr(Stdio::null()).spawn().expect("the program starts");
    std::thread::sleep(Duration::from_millis(after));
    let _ = child.kill();
    child.wait().expect("it ends");
}

#[test]
fn killed_and_resumed_it_ends_with_the_same_bytes() {
    let folder = tempfile::tempdir().unwrap();
    let scene = scene(folder.path());
    let (whole, broken) = (folder.path().join("whole"), folder.path().join("broken"));
    works(&mut command(&scene, &whole, &[]));
    for moment in 0..10_u64 {
        if broken.join("metrics.json").exists() {
            break;
        }
        killed(&scene, &broken, 300 + moment * 397 % 1500);
    }
    works(&mut command(&scene, &broken, &["--resume"]));
    assert_eq!(model(&whole), model(&broken));
}

/// Tuning decides on the last bits. It is the run's own, whatever the environment says when the run goes on.
#[test]
fn a_resumed_run_keeps_its_tuning() {
    const CHANGED: &str = "loss_rounds=2,overlap_columns=16,scan_rows=64";
    let folder = tempfile::tempdir().unwrap();
    let scene = scene(folder.path());
    let [whole, broken, again] = ["whole", "broken", "again"].map(|name| folder.path().join(name));
    let run = |out: &Path, more: &[&str]| {
        let mut run = command(&scene, out, more);
        run.env("QIRF_TUNING", "cpu");
        run
    };
    works(run(&whole, &[]).env("QIRF_TUNING", CHANGED));
    assert_eq!(metrics(&whole)["device"]["tuning"]["loss_rounds"], 2);
    // The fault ends it after some checkpoints.
    let failed = run(&broken, &[]).env("QIRF_TUNING", CHANGED).env("QIRF_DEVICE_FAULT", "wait:120:lost").output();
    assert_eq!(failed.expect("the program starts").status.code(), Some(4));
    assert!(broken.join("checkpoint.safetensors").exists());
    works(&mut run(&broken, &["--resume"]));
    assert_eq!(metrics(&broken)["device"]["tuning"], metrics(&whole)["device"]["tuning"]);
    assert_eq!(model(&whole), model(&broken));
    let mut repeated = Command::new(env!("CARGO_BIN_EXE_qirf-vk"));
    works(repeated.args(["run", "--config"]).arg(whole.join("config.toml")).arg("-o").arg(&again));
    assert_eq!(model(&whole), model(&again));

    let refused = |text: &str, named: &str| {
        let output = run(&again, &[]).env("QIRF_TUNING", text).output().expect("the program starts");
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(output.status.code() == Some(2) && said.contains(named), "{:?}: {said}", output.status);
    };
    refused("riva", "nvidia");
    refused("cpu,tiles=8", "'tiles'");
    refused("scan_workgroup=7", "scan_workgroup");
}

#[test]
fn other_options_and_damaged_checkpoints_are_refused() {
    let folder = tempfile::tempdir().unwrap();
    let scene = scene(folder.path());
    let out = folder.path().join("out");
    std::fs::create_dir(&out).unwrap();
    std::fs::write(out.join("checkpoint.safetensors"), b"no checkpoint at all").unwrap();
    let output = command(&scene, &out, &["--resume"]).output().unwrap();
    assert_eq!(output.status.code(), Some(3), "{}", String::from_utf8_lossy(&output.stderr));
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(said.contains("checkpoint.safetensors") && said.contains("delete"), "{said}");
    assert!(!out.join("model.ply").exists());

    let output = command(&folder.path().join("nowhere"), &out, &[]).output().unwrap();
    assert_eq!(output.status.code(), Some(3));
}
