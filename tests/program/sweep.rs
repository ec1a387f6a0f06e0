//! `qirf-vk sweep` by the real binary: files, figures, and the claims of each axis.

use super::ended::{Ended, capture, end, qirf};
use super::html;
use crate::support::documented;
use serde_json::Value;
use std::path::{Path, PathBuf};

fn scene(folder: &Path) -> PathBuf {
    capture(folder, 700)
}

fn sweep(arguments: &[&str]) -> Ended {
    end(qirf(["sweep"]).args(arguments))
}

fn works(arguments: &[&str]) -> Ended {
    sweep(arguments).with(0, &[])
}

fn read(out: &Path) -> Value {
    serde_json::from_str(&std::fs::read_to_string(out.join("sweep.json")).expect("sweep.json")).expect("JSON")
}

fn axis<'a>(swept: &'a Value, name: &str) -> &'a Value {
    let all = swept["axes"].as_array().expect("axes");
    all.iter().find(|a| a["axis"] == name).unwrap_or_else(|| panic!("axis {name}"))
}

fn rung<'a>(swept: &'a Value, name: &str, rung: &str) -> &'a Value {
    let all = axis(swept, name)["rungs"].as_array().expect("rungs");
    all.iter().find(|r| r["name"] == rung).unwrap_or_else(|| panic!("{name}: rung {rung}"))
}

fn figure(swept: &Value, name: &str, of: &str, key: &str) -> f64 {
    rung(swept, name, of)["figures"][key].as_f64().unwrap_or_else(|| panic!("{name}, {of}: {key}"))
}

#[test]
fn the_light_axes_of_a_scene() {
    let folder = tempfile::tempdir().unwrap();
    let (scene, out) = (scene(folder.path()), folder.path().join("out"));
    let [scene, to] = [&scene, &out].map(|p| p.to_str().unwrap().to_owned());
    // So short that the model has fewer Gaussians than the largest block that solvers are timed on, of 1024.
    let output = works(&[&scene, "-o", &to, "--train", "80", "--budget-per-axis", "0.2", "--json"]);
    let swept = read(&out);
    assert_eq!(output.json(), swept);
    assert_eq!(swept["schema"], 1);
    documented("sweep", &swept);
    assert!(swept["subject"]["origin"].as_str().unwrap().contains("trained briefly"));
    assert!(swept["subject"]["gaussians"].as_u64().unwrap() < 1024, "{}", swept["subject"]);

    let names = ["solver", "overlap", "epsilon", "culling", "stop", "gradients"];
    let listed: Vec<&str> = swept["axes"].as_array().unwrap().iter().map(|a| a["axis"].as_str().unwrap()).collect();
    assert_eq!(listed, names);
    for name in names {
        let a = axis(&swept, name);
        let rungs = a["rungs"].as_array().unwrap();
        assert!(rungs.len() >= if name == "gradients" { 1 } else { 3 }, "{name}");
        assert_eq!(rungs.iter().filter(|r| r["default"] == true).count(), 1, "{name}");
        assert!(rungs.iter().any(|r| r["front"] == true), "{name}");
        assert!(a["sentence"].as_str().unwrap().len() > 20, "{name}");
        for r in rungs {
            assert!(r["time"]["median"].as_f64().unwrap() > 0.0 && r["time"]["samples"].as_u64().unwrap() >= 3, "{r}");
            assert!(r["accuracy"].is_number() || r["exact"] == true, "{name}: {r}");
        }
    }

    // The same answer at several costs.
    assert_eq!(rung(&swept, "solver", "low-rank")["exact"], true);
    // P comes in float32.
    for way in ["dsygvd", "device"] {
        assert!(figure(&swept, "solver", way, "kept_jaccard") > 0.99, "{way}");
        assert!(rung(&swept, "solver", way)["accuracy"].as_f64().unwrap() < 1e-2, "{way}");
    }
    assert!(figure(&swept, "solver", "low-rank", "speedup_m256") > 1.0, "14 on an idle machine");
    // QR never fails, not even on discs; the formulas that form the sum fail there.
    for key in ["nan_share", "thin_nan_share", "flat_nan_share"] {
        assert!(figure(&swept, "overlap", "qr", key) == 0.0, "{key}");
    }
    let worst = |r: &str| figure(&swept, "overlap", r, "flat_largest_error");
    assert!(worst("qr") < 1e-3, "{}", worst("qr"));
    assert!(
        figure(&swept, "overlap", "determinant", "flat_nan_share") > 0.0 || worst("determinant") > 10.0 * worst("qr")
    );
    // The larger epsilon is, the better conditioned the metric.
    let condition = |r: &str| figure(&swept, "epsilon", r, "condition");
    assert!(condition("1e-6") >= condition("1e-4") && condition("1e-4") > condition("1e-2"));
    let times: Vec<_> = axis(&swept, "epsilon")["rungs"].as_array().unwrap().iter().map(|r| &r["time"]).collect();
    assert!(times.iter().all(|time| *time == times[0]), "the arithmetic does not depend on epsilon: {times:?}");
    // Exact culling loses nothing, and lists the fewest pairs.
    assert_eq!(rung(&swept, "culling", "exact")["accuracy"], 0.0);
    let pairs = |r: &str| figure(&swept, "culling", r, "pairs");
    assert!(pairs("exact") <= pairs("3-sigma") && pairs("3-sigma") < pairs("off"));
    assert_eq!(rung(&swept, "stop", "0")["exact"], true);
    assert_eq!(rung(&swept, "gradients", "ordered")["exact"], true);
    if axis(&swept, "gradients")["rungs"].as_array().unwrap().len() > 1 {
        assert!(figure(&swept, "gradients", "atomics", "against_ordered") < 1e-3, "the same sums in another order");
    }

    let lines = std::fs::read_to_string(out.join("sweep.csv")).expect("sweep.csv");
    let count: usize = names.iter().map(|n| axis(&swept, n)["rungs"].as_array().unwrap().len()).sum();
    assert_eq!(lines.lines().count(), 1 + count);
    let columns = |line: &str| line.split(',').count();
    assert!(lines.lines().all(|l| columns(l) == columns(lines.lines().next().unwrap())), "{lines}");

    let page = html::parse(&std::fs::read_to_string(out.join("sweep.html")).expect("sweep.html")).expect("sound HTML");
    for name in names {
        assert_eq!(page.select(&format!("section#{name} svg[role=img]")).len(), 1, "{name}");
        assert_eq!(page.select(&format!("section#{name} circle.ring")).len(), 1, "{name}: the default is marked");
    }
    assert!(page.texts("section#stop text").contains(&"exact"), "an infinite PSNR has no number on the axis");
}

#[test]
fn a_models_own_axes_with_chosen_rungs() {
    let folder = tempfile::tempdir().unwrap();
    let scene = scene(folder.path());
    let [scene, first, second] =
        [scene, folder.path().join("first"), folder.path().join("second")].map(|p| p.to_str().unwrap().to_owned());
    let short = ["--train", "40", "--budget-per-axis", "0"];
    works(&[&[scene.as_str(), "-o", &first, "--axis", "stop=1e-4"], &short[..]].concat());
    let model = format!("{first}/light/model.ply");
    let axes = ["--axis", "stop=1e-2,0.3", "--axis", "epsilon=1e-3,t=0.2", "--size", "40x30", "--budget-per-axis", "0"];
    works(&[&[model.as_str(), "-o", &second], &axes[..]].concat());
    let swept = read(Path::new(&second));
    assert_eq!(swept["axes"].as_array().unwrap().len(), 2);
    assert!(axis(&swept, "stop")["sentence"].as_str().unwrap().contains("was not among the rungs"));
    let loss = |r: &str| rung(&swept, "stop", r)["accuracy"].as_f64().unwrap_or(f64::INFINITY);
    assert!(loss("1e-2") >= loss("0.3"), "a later stop loses less");
    assert!(swept["subject"]["origin"].as_str().unwrap().contains("virtual cameras"));
    let page = std::fs::read_to_string(Path::new(&second).join("sweep.html")).unwrap();
    assert!(page.contains("on the Pareto front") && !page.contains("ring: default"), "no default was measured");
}

#[test]
fn heavy_axes_train() {
    let folder = tempfile::tempdir().unwrap();
    let (scene, out) = (scene(folder.path()), folder.path().join("out"));
    let [scene, to] = [&scene, &out].map(|p| p.to_str().unwrap().to_owned());
    let axes = ["--axis", "keep=1,0.28", "--axis", "selector=default,random", "--axis", "iterations=1,1/4"];
    let more = ["--axis", "effects=exposure=on", "--iterations", "80", "--sh-degree", "0"];
    works(&[&[scene.as_str(), "-o", &to], &axes[..], &more[..]].concat());
    let swept = read(&out);
    for (name, rungs) in [("keep", 2), ("selector", 2), ("iterations", 2), ("effects", 2)] {
        let there = axis(&swept, name)["rungs"].as_array().unwrap();
        assert_eq!(there.len(), rungs, "{name}");
        assert!(
            there.iter().all(|r| r["accuracy"].is_number() && r["time"]["median"].is_number()),
            "{name}: {there:?}"
        );
    }
    assert!(figure(&swept, "keep", "1", "gaussians") > figure(&swept, "keep", "0.28", "gaussians"));
    let count = |r: &str| figure(&swept, "selector", r, "gaussians");
    assert_eq!(count("default"), count("random"), "at equal count");
    assert_eq!(figure(&swept, "iterations", "1/4", "iterations"), 20.0);
    assert!(out.join("fork").join("checkpoint.safetensors").is_file());
}

#[test]
fn what_cannot_be_swept_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let scene = scene(folder.path());
    let out = folder.path().join("out");
    let [scene, to, nowhere] =
        [&scene, &out, &folder.path().join("nowhere.ply")].map(|p| p.to_str().unwrap().to_owned());
    let earlier = out.join("sweep.json");
    std::fs::create_dir(&out).unwrap();
    std::fs::write(&earlier, "of an earlier sweep").unwrap();
    let cases: [(&[&str], i32); 8] = [
        (&[&scene, "-o", &to, "--axis", "stop", "--size", "40x40"], 2),
        (&[&scene, "-o", &to, "--axis", "speed"], 2),
        (&[&scene, "-o", &to, "--axis", "solver=qr"], 2),
        (&[&scene, "-o", &to, "--axis", "stop", "--axis", "stop=0"], 2),
        (&[&nowhere, "-o", &to, "--axis", "keep"], 2),
        (&[&nowhere, "-o", &to, "--model", &nowhere], 2),
        (&[&nowhere, "-o", &to, "--axis", "stop"], 3),
        (&[&scene, "-o", &to, "--axis", "stop", "--model", &nowhere], 3),
    ];
    for (arguments, code) in cases {
        assert!(!sweep(arguments).with(code, &[]).said.is_empty());
    }
    for (option, value) in [
        ("--epsilon", "0.5"),
        ("--keep", "0.9"),
        ("--selector", "css"),
        ("--schedule", "gradual"),
        ("--iterations", "50"),
        ("--grow-to", "99"),
    ] {
        sweep(&[&scene, "-o", &to, "--axis", "epsilon", option, value]).with(2, &[option, "no effect on light axes"]);
    }
    let model = "tools/examples/ring.ply";
    sweep(&[model, "-o", &to, "--axis", "stop", "--seed", "5"]).with(2, &["read only --background"]);
    assert_eq!(std::fs::read_to_string(&earlier).unwrap(), "of an earlier sweep");
}

#[cfg(unix)]
#[test]
fn an_interrupted_sweep_has_the_axes_that_it_measured() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let mut command = qirf(["sweep", "tools/examples/ring.ply", "--axis", "stop=1e-2", "--axis", "culling"]);
    command.args(["--size", "40x30", "--budget-per-axis", "2", "-o"]).arg(&out);
    let mut child = super::faults::harness::start(&mut command);
    child.until(|| out.join("sweep.json").exists());
    child.signal("TERM").with(130, &["sweep.json has the axes measured so far; the same command"]);
    let swept = read(&out);
    assert_eq!(swept["axes"].as_array().unwrap().len(), 1);
    assert!(rung(&swept, "stop", "1e-2")["time"]["median"].is_number());
    assert!(out.join("sweep.csv").exists() && out.join("sweep.html").exists());
}
