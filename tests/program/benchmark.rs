//! `tools/benchmark`: the protocol of cited benchmarks, on synthetic captures laid out as those sets.

use crate::support::skip;
use qirf_vk::synth::{SynthOptions, write};
use serde_json::Value;
use std::fs;
use std::path::Path;
use std::process::{Command, Output};

fn benchmark(set: &str, folder: &Path, more: &[&str]) -> Output {
    let tool = Path::new(env!("CARGO_MANIFEST_DIR")).join("tools/benchmark");
    let mut program = Command::new("python3");
    program.arg(tool).arg(set).arg(folder).arg("-o").arg(folder.join("out")).args(more);
    program.env("QIRF", env!("CARGO_BIN_EXE_qirf-vk")).output().expect("python3 starts")
}

#[test]
fn sets_are_trained_by_the_protocol_and_others_are_refused() {
    if Command::new("python3").arg("--version").output().is_err() {
        return skip("no python3");
    }
    let folder = tempfile::tempdir().unwrap();
    let options = SynthOptions { views: 9, width: 48, height: 36, points: 150, ..SynthOptions::default() };
    for scene in ["truck", "train", "bonsai"] {
        write(&folder.path().join(scene), &options, &|_| ()).expect("a synthetic scene");
    }
    fs::rename(folder.path().join("bonsai/images"), folder.path().join("bonsai/images_2")).unwrap();

    let short = ["--iterations", "30", "--counts", "own,50"];
    let ran = benchmark("tanks", folder.path(), &short);
    let (table, told) = (String::from_utf8_lossy(&ran.stdout), String::from_utf8_lossy(&ran.stderr));
    assert!(ran.status.success() && table.contains("30 iterations, which is not the protocol"), "{table}{told}");
    let rows = |with: &str| table.lines().filter(|line| line.contains(with)).count();
    assert_eq!([rows("| train |"), rows("| truck |"), rows("**mean**"), rows("as published")], [2, 2, 2, 1], "{table}");
    assert_eq!(fs::read_to_string(folder.path().join("out/table.md")).unwrap().trim(), table.trim());
    let results: Value = serde_json::from_slice(&fs::read(folder.path().join("out/table.json")).unwrap()).unwrap();
    let results = results.as_array().unwrap();
    assert!(results.len() == 4 && results.iter().all(|r| r["PSNR"].as_f64().is_some_and(|psnr| psnr > 5.0)));
    assert!(results.iter().filter(|r| r["count"] == "50").all(|r| r["Gaussians"] == 50), "{results:?}");

    // What is done is not trained again.
    let again = benchmark("tanks", folder.path(), &short);
    assert!(again.status.success() && again.stdout == ran.stdout && again.stderr.is_empty());
    // Neither a trial of another length nor another set in the same folder passes for it.
    let other = benchmark("tanks", folder.path(), &["--iterations", "31", "--counts", "own"]);
    let told = String::from_utf8_lossy(&other.stderr);
    assert!(!other.status.success() && told.contains("iterations is 30, not 31"), "{told}");
    // The set's own photos, and a part of its scenes.
    let part = ["--iterations", "30", "--counts", "own", "--scenes", "bonsai"];
    let ran = benchmark("mipnerf360", folder.path(), &part);
    assert!(String::from_utf8_lossy(&ran.stdout).contains("; 1 of 9 scenes"), "{ran:?}");

    for (set, more, says) in [
        ("mipnerf360", vec![], "is not the set mipnerf360: bicycle/images_4 is not there"),
        ("blender", vec!["--scenes", "truck"], "blender has no scene truck"),
        ("tanks", vec!["--counts", "half"], "write own or whole numbers"),
        ("tanks", vec!["--counts", "own,0"], "write own or whole numbers above 0"),
        ("tanks", vec!["--program", "absent", "--scenes", "train, truck"], "there is no program absent"),
    ] {
        let refused = benchmark(set, folder.path(), &more);
        assert!(!refused.status.success() && String::from_utf8_lossy(&refused.stderr).contains(says), "{refused:?}");
    }
}
