//! `tools/benchmark`: the protocol of cited benchmarks, on synthetic captures laid out as those sets.

use super::ended::{end, works};
use crate::support::skip;
use qirf_vk::synth::{SynthOptions, write};
use serde_json::Value;
use std::fs;
use std::path::Path;
use std::process::Command;

/// In the program's place, with 300 Gaussians at most. With `FAKE_WAITS` it waits for a signal, then takes 0.6 s to write its
/// checkpoint; a second signal, unless a hang-up, ends it without, as it ends the program.
#[cfg(unix)]
const FAKE: &str = r#"#!/usr/bin/env python3
import json, os, pathlib, signal, sys, time
out, told = pathlib.Path(sys.argv[4]), []
def note(number, _):
    told.append(number)
    if len(told) > 1 and number != signal.SIGHUP:
        os._exit(99)
for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
    signal.signal(number, note)
(out / "started").touch()
if os.environ.get("FAKE_WAITS"):
    end = time.monotonic() + 60
    while not told and time.monotonic() < end:
        time.sleep(0.01)
    time.sleep(0.6)
    (out / "checkpoint").touch()
    sys.exit(130)
count = int(sys.argv[sys.argv.index("--target-count") + 1]) if "--target-count" in sys.argv else 300
metrics = {"test": {"psnr": 20.0, "ssim": 0.9, "lpips_vgg": None}, "gaussians": {"final": min(count, 300)}}
metrics |= {"ply_bytes": 1000, "time": {"total_s": 1.0}, "device": {"name": "none"}}
(out / "metrics.json").write_text(json.dumps(metrics))
"#;

fn command(set: &str, folder: &Path, more: &[&str]) -> Command {
    let tool = Path::new(env!("CARGO_MANIFEST_DIR")).join("tools/benchmark");
    let mut program = Command::new("python3");
    program.arg(tool).arg(set).arg(folder).arg("-o").arg(folder.join("out")).args(more);
    program.env("QIRF", env!("CARGO_BIN_EXE_qirf-vk"));
    program
}

/// Returns true if there is Python; prints a note if not.
fn python() -> bool {
    let there = Command::new("python3").arg("--version").output().is_ok();
    if !there {
        skip("no python3");
    }
    there
}

#[test]
fn sets_are_trained_by_the_protocol_and_others_are_refused() {
    if !python() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let options = SynthOptions { views: 9, width: 48, height: 36, points: 150, ..SynthOptions::default() };
    for scene in ["truck", "train", "bonsai"] {
        write(&folder.path().join(scene), &options, &|_| ()).expect("a synthetic scene");
    }
    fs::rename(folder.path().join("bonsai/images"), folder.path().join("bonsai/images_2")).unwrap();

    let short = ["--iterations", "30", "--counts", "own,50"];
    let ran = works(&mut command("tanks", folder.path(), &short));
    let table = &ran.out;
    assert!(table.contains("30 iterations, which is not the protocol"), "{table}{}", ran.said);
    let rows = |with: &str| table.lines().filter(|line| line.contains(with)).count();
    assert_eq!([rows("| train |"), rows("| truck |"), rows("**mean**"), rows("as published")], [2, 2, 2, 1], "{table}");
    assert_eq!(fs::read_to_string(folder.path().join("out/table.md")).unwrap().trim(), table.trim());
    let results: Value = serde_json::from_slice(&fs::read(folder.path().join("out/table.json")).unwrap()).unwrap();
    let results = results.as_array().unwrap();
    assert!(results.len() == 4 && results.iter().all(|r| r["PSNR"].as_f64().is_some_and(|psnr| psnr > 5.0)));
    assert!(results.iter().filter(|r| r["count"] == "50").all(|r| r["Gaussians"] == 50), "{results:?}");

    // What is done is not trained again.
    let again = works(&mut command("tanks", folder.path(), &short));
    assert!(again.out == ran.out && again.said.is_empty());
    // Neither a trial of another length nor another set in the same folder passes for it.
    let other = ["--iterations", "31", "--counts", "own"];
    end(&mut command("tanks", folder.path(), &other)).with(2, &["iterations is 30, not 31"]);
    // The set's own photos, and a part of its scenes.
    let part = ["--iterations", "30", "--counts", "own", "--scenes", "bonsai"];
    let ran = end(&mut command("mipnerf360", folder.path(), &part));
    assert!(ran.out.contains("; 1 of 9 scenes"), "{}{}", ran.out, ran.said);

    for (set, more, code, says) in [
        ("mipnerf360", vec![], 3, "is not the set mipnerf360: bicycle/images_4 is not there"),
        ("blender", vec!["--scenes", "truck"], 2, "blender has no scene truck"),
        ("tanks", vec!["--counts", "half"], 2, "write own or whole numbers"),
        ("tanks", vec!["--counts", "own,0"], 2, "write own or whole numbers above 0"),
        ("tanks", vec!["--program", "absent", "--scenes", "train, truck"], 2, "there is no program absent"),
    ] {
        end(&mut command(set, folder.path(), &more)).with(code, &[says]);
    }
}

#[cfg(unix)]
#[test]
fn signals_leave_time_for_a_checkpoint_and_damaged_files_and_short_counts_are_told() {
    use std::os::unix::{fs::PermissionsExt, process::CommandExt};
    use std::time::{Duration, Instant};
    if !python() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let (fake, run) = (folder.path().join("fake"), folder.path().join("out/own/train"));
    fs::create_dir_all(folder.path().join("train/images")).unwrap();
    fs::create_dir_all(folder.path().join("train/sparse/0")).unwrap();
    fs::write(&fake, FAKE).unwrap();
    fs::set_permissions(&fake, fs::Permissions::from_mode(0o755)).unwrap();
    let with = |counts: &str| {
        let program = fake.to_str().unwrap();
        command("tanks", folder.path(), &["--scenes", "train", "--program", program, "--counts", counts])
    };

    // Ctrl-C reaches the whole group.
    for (signal, whom) in [("INT", "-"), ("TERM", "")] {
        let mut stopped = with("own").env("FAKE_WAITS", "1").process_group(0).spawn().expect("python3 starts");
        let begun = Instant::now();
        while !run.join("started").exists() {
            assert!(begun.elapsed() < Duration::from_secs(60), "nothing happens");
            std::thread::sleep(Duration::from_millis(5));
        }
        let whom = format!("{whom}{}", stopped.id());
        assert!(Command::new("kill").args(["-s", signal, "--", &whom]).status().unwrap().success());
        let code = stopped.wait().unwrap().code();
        assert_eq!((code, run.join("checkpoint").exists()), (Some(130), true), "{signal}");
        fs::remove_dir_all(&run).unwrap();
    }

    let table = end(&mut with("own,200,400")).out;
    assert!(table.matches("| 300† |").count() == 2 && table.contains("† fewer Gaussians than the count"), "{table}");
    let results: Value = serde_json::from_slice(&fs::read(folder.path().join("out/table.json")).unwrap()).unwrap();
    let short: Vec<_> = results.as_array().unwrap().iter().map(|r| r["short"].as_bool()).collect();
    assert_eq!(short, [Some(false), Some(false), Some(true)]);

    for (file, text, code, says) in [
        ("metrics.json", "{\"test\":", 3, "is not that of a finished run: delete"),
        ("benchmark.json", "", 2, "is another run: scene is unknown"),
        ("benchmark.json", "[]", 2, "is another run: scene is unknown"),
    ] {
        fs::write(run.join(file), text).unwrap();
        end(&mut with("own")).with(code, &[says]);
    }
}
