//! Whole runs of the real binary: files, figures, and what survives being killed.

use qirf_vk::synth::{SynthOptions, write};
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Output, Stdio};
use std::time::Duration;

fn scene(folder: &Path) -> PathBuf {
    let scene = folder.join("scene");
    let options = SynthOptions { views: 9, width: 48, height: 36, points: 400, ..SynthOptions::default() };
    write(&scene, &options, &|_| ()).expect("a synthetic scene");
    scene
}

fn command(scene: &Path, out: &Path, more: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_qirf-vk"));
    command.arg("run").arg(scene).arg("-o").arg(out);
    command.args(["--no-prune", "--iterations", "240", "--checkpoint-every", "20"]).args(more);
    command
}

fn works(command: &mut Command) -> Output {
    let output = command.output().expect("the program starts");
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    output
}

fn model(out: &Path) -> Vec<u8> {
    std::fs::read(out.join("model.ply")).expect("model.ply")
}

#[test]
fn a_run_leaves_what_reproduces_it() {
    let folder = tempfile::tempdir().unwrap();
    let scene = scene(folder.path());
    let (first, second) = (folder.path().join("first"), folder.path().join("second"));
    let output = works(&mut command(&scene, &first, &["--json"]));
    let printed: serde_json::Value = serde_json::from_slice(&output.stdout).expect("one JSON document");
    let text = std::fs::read_to_string(first.join("metrics.json")).expect("metrics.json");
    let metrics: serde_json::Value = serde_json::from_str(&text).expect("metrics.json is JSON");
    assert_eq!(printed, metrics);
    for key in ["/test/psnr", "/test/ssim", "/gaussians/dense", "/gaussians/final", "/time/total_s", "/curve/0/psnr"] {
        assert!(metrics.pointer(key).is_some_and(serde_json::Value::is_number), "{key}");
    }
    assert!(metrics["test"]["psnr"].as_f64().unwrap() > 15.0, "{}", metrics["test"]);
    assert_eq!(metrics["schema"], 1);
    assert_eq!(std::fs::read_dir(first.join("renders")).unwrap().count(), 2);
    assert!(!first.join("checkpoint.safetensors").exists(), "a whole run leaves no checkpoint");

    // Its own config.toml gives the same bytes.
    let mut again = Command::new(env!("CARGO_BIN_EXE_qirf-vk"));
    works(again.args(["run", "--no-prune", "--config"]).arg(first.join("config.toml")).arg("-o").arg(&second));
    assert_eq!(model(&first), model(&second), "the same run gives the same bytes");
}

/// Starts a run and kills it after some milliseconds, in the way that no program can prepare for.
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

    let output = Command::new(env!("CARGO_BIN_EXE_qirf-vk")).args(["run", "nowhere", "-o"]).arg(&out).output().unwrap();
    assert_eq!(output.status.code(), Some(2), "without --no-prune");
    let output = command(&folder.path().join("nowhere"), &out, &[]).output().unwrap();
    assert_eq!(output.status.code(), Some(3));
}
