//! Runs that were killed or failed, and go on.

use super::ended::{copy, end, qirf, works};
use super::run::{command, finished, metrics, model, scene};
use qirf_vk::job::Output;
use qirf_vk::train::checkpoint::Snapshot;
use std::ffi::OsStr;
use std::path::Path;
use std::process::Command;

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
    end(run(&broken, &[]).env("QIRF_TUNING", CHANGED).env("QIRF_DEVICE_FAULT", "wait:120:lost")).with(4, &[]);
    assert!(broken.join("checkpoint.safetensors").exists());
    works(&mut run(&broken, &["--resume"]));
    assert_eq!(metrics(&broken)["device"]["tuning"], metrics(&whole)["device"]["tuning"]);
    assert_eq!(model(&whole), model(&broken));
    works(qirf(["run", "--config"]).arg(whole.join("config.toml")).arg("-o").arg(&again));
    assert_eq!(model(&whole), model(&again));

    let refused =
        |text: &str, named: &str| drop(end(run(&again, &["--overwrite"]).env("QIRF_TUNING", text)).with(2, &[named]));
    refused("riva", "nvidia");
    refused("cpu,tiles=8", "'tiles'");
    refused("scan_workgroup=7", "scan_workgroup");
}

fn says(command: &mut Command, code: i32, parts: &[&str]) {
    end(command).with(code, parts);
}

/// Hours of training must not be lost by a forgotten option.
#[test]
fn an_interrupted_run_is_not_overwritten_and_other_options_are_named_at_once() {
    let folder = tempfile::tempdir().unwrap();
    let scene = scene(folder.path());
    let out = folder.path().join("out");
    end(command(&scene, &out, &[]).env("QIRF_DEVICE_FAULT", "wait:120:lost")).with(4, &[]);
    let checkpoint = || std::fs::read(out.join("checkpoint.safetensors")).expect("a checkpoint");
    let before = checkpoint();
    says(&mut command(&scene, &out, &[]), 2, &["checkpoint.safetensors", "--resume", "delete"]);
    let changed = ["--resume", "--seed", "5", "--no-prune"];
    says(&mut command(&scene, &out, &changed), 2, &["seed was 1, is 5", "prune was set, is none", "config.toml"]);
    assert!(before == checkpoint(), "a refused run changes nothing");
    // Its state belongs to its photos.
    let (photo, aside) = (scene.join("images/view_0001.png"), folder.path().join("aside.png"));
    std::fs::rename(&photo, &aside).unwrap();
    says(&mut command(&scene, &out, &["--resume"]), 2, &["photos to train on were", "view_0001.png is missing"]);
    std::fs::rename(&aside, &photo).unwrap();
    // Half of a run on one photo, and half on another under its name, reproduces nothing.
    let refused = |name: &str| says(&mut command(&scene, &out, &["--resume"]), 2, &[name, "changed since then"]);
    for name in ["view_0003.png", "view_0008.png"] {
        let photo = scene.join("images").join(name);
        let before = std::fs::read(&photo).unwrap();
        let mut changed = image::open(&photo).unwrap().into_rgb8();
        changed.get_pixel_mut(7, 5).0[1] ^= 64;
        changed.save(&photo).unwrap();
        refused(name);
        std::fs::write(&photo, before).unwrap();
    }
    std::fs::create_dir(scene.join("masks")).unwrap();
    let mut mask = image::GrayImage::from_pixel(48, 36, image::Luma([255]));
    mask.get_pixel_mut(9, 9).0[0] = 0;
    mask.save(scene.join("masks/view_0002.png")).unwrap();
    refused("view_0002.png");
    std::fs::remove_dir_all(scene.join("masks")).unwrap();
    let claimed = Output::claim(&out).unwrap();
    for mut busy in [command(&scene, &out, &[]), command(&scene, &out, &["--resume"])] {
        says(&mut busy, 2, &["another process is working in", "wait until it ends"]);
    }
    drop(claimed);
    assert!(before == checkpoint(), "nor does one with other photos or beside another process");
    // The run's options are those in its checkpoint.
    let config = out.join("config.toml");
    let text = std::fs::read_to_string(&config).unwrap();
    std::fs::write(&config, text.replace("seed = 1\n", "seed = 4\n")).unwrap();
    let mut edited = qirf(["run", "--resume", "--config"]);
    edited.arg(&config).arg("-o").arg(&out);
    says(&mut edited, 2, &["seed was 1, is 4", "config.toml no longer names: it was changed", "To begin anew, delete"]);
    // So are the figures of its earlier parts.
    let mut state = Snapshot::read(&out.join("checkpoint.safetensors")).unwrap();
    state.notes.insert("peak".to_owned(), (1_u64 << 40).to_string());
    state.write(&out.join("checkpoint.safetensors")).unwrap();
    // Another spelling of the scene is the same run.
    let spelt = folder.path().join("out/../scene/");
    works(&mut command(&spelt, &out, &["--resume"]));
    assert_eq!(model(&finished().out), model(&out));
    assert_eq!(std::fs::read_to_string(&config).unwrap(), text, "written again from the checkpoint");
    assert_eq!(metrics(&out)["memory"]["peak_bytes"], 1_u64 << 40);
}

#[test]
fn a_finished_run_is_left_as_it_is() {
    let folder = tempfile::tempdir().unwrap();
    let (scene, out) = (finished().scene.clone(), folder.path().join("out"));
    copy(&finished().out, &out);
    let written = |name: &str| std::fs::metadata(out.join(name)).and_then(|m| m.modified()).expect("a file");
    let files = ["model.ply", "metrics.json", "config.toml", "report.html"];
    let before = files.map(written);
    says(&mut command(&scene, &out, &["--resume"]), 0, &["finished"]);
    assert_eq!(works(&mut command(&scene, &out, &["--resume", "--json"])).json(), metrics(&out));
    says(&mut command(&scene, &out, &["--seed", "2", "--resume"]), 2, &["seed was 1, is 2"]);
    assert_eq!(before, files.map(written));
    let sized = || command(&scene, &out, &["--resume", "--size", "9kB"]);
    says(&mut sized(), 0, &["only model.sog is missing"]);
    let packed = std::fs::read(out.join("model.sog")).unwrap();
    assert!(packed.len() <= 9000);
    says(&mut sized(), 0, &["nothing to do"]);
    // A new run takes away what was made of the old one.
    let newer = folder.path().join("newer");
    std::fs::create_dir(&newer).unwrap();
    for folder in ["renders/photos", "renders/dense"] {
        std::fs::create_dir_all(newer.join(folder)).unwrap();
    }
    let pictures = ["renders/a.png", "renders/photos/a.png", "renders/dense/a.png"];
    for file in ["report.html", "model.sog", "renders/own.png"].iter().chain(&pictures) {
        std::fs::write(newer.join(file), "of an older run").unwrap();
    }
    std::fs::write(newer.join("metrics.json"), r#"{"views": [{"name": "a.jpg", "psnr": 9.0}]}"#).unwrap();
    works(&mut command(&scene, &newer, &["--no-report"]));
    assert!(!newer.join("report.html").exists() && !newer.join("model.sog").exists());
    assert!(pictures.iter().all(|file| !newer.join(file).exists()) && newer.join("renders/own.png").exists());
    says(&mut command(&scene, &newer, &["--resume"]), 0, &["it has no report.html"]);
    let own = folder.path().join("scene");
    copy(&scene, &own);
    let (scene, photos) = (own.clone(), own.join("images"));
    says(&mut command(&scene, &photos, &[]), 2, &["among the scene's own photos"]);
    assert!(!photos.join("config.toml").exists());
    let foreign = folder.path().join("foreign");
    std::fs::create_dir(&foreign).unwrap();
    std::fs::copy(out.join("model.ply"), foreign.join("model.ply")).unwrap();
    says(&mut command(&scene, &foreign, &[]), 2, &["foreign/model.ply does not belong to a run"]);
    for pictures in ["renders", "renders/photos"] {
        says(&mut command(&scene, &out.join(pictures), &[]), 2, &["holds the pictures of another run"]);
    }
    let mut compare = qirf(["compare".as_ref(), scene.as_os_str(), "-o".as_ref(), out.as_os_str()]);
    says(&mut compare, 2, &["holds a run and its figures"]);
    let (model, renders) = (out.join("model.ply"), out.join("renders"));
    for (command, input, output) in [("render", &model, &out), ("render", &model, &renders), ("sweep", &scene, &out)] {
        let mut over = qirf([command.as_ref(), input.as_os_str(), "-o".as_ref(), output.as_os_str()]);
        if command == "render" {
            over.args(["--orbit", "2"]);
        }
        says(&mut over, 2, &["holds a run and its figures"]);
    }
    let small = ["compress", "tools/examples/ring.ply", "-o"].map(OsStr::new);
    says(&mut qirf(small.into_iter().chain([model.as_os_str()])), 2, &["is a run's model"]);
    assert_eq!(before, files.map(written));
    let mut eval = qirf([
        "eval".as_ref(),
        out.join("model.ply").as_os_str(),
        scene.as_os_str(),
        "-o".as_ref(),
        photos.as_os_str(),
    ]);
    says(&mut eval, 2, &["metrics.json would lie among the scene's own photos"]);
}

/// Before any work: a folder in which another process works, and files that cannot be written.
#[test]
fn figures_that_cannot_be_written_are_told_at_once() {
    let folder = tempfile::tempdir().unwrap();
    let ring = "tools/examples/ring.ply";
    let curve = (["compress", ring, "--curve", "sog"], "curve.json");
    let sweep = (["sweep", ring, "--axis", "culling"], "sweep.json");
    for (words, file) in [curve, sweep] {
        let out = folder.path().join(file).join("out");
        let job = || qirf(words.iter().map(OsStr::new).chain(["-o".as_ref(), out.as_os_str()]));
        let claimed = Output::claim(&out).unwrap();
        says(&mut job(), 2, &["another process is working in", "wait until it ends"]);
        drop(claimed);
        std::fs::create_dir(out.join(file)).unwrap();
        says(&mut job(), 2, &[file, "is a folder"]);
    }
}
