//! A scene trained in blocks by tasks: as good as in one piece, and the same bytes whatever happens on the way.

use super::ended::{content, copy, end, rescale, works};
use super::shard::{FINGERPRINT, Stage, flip};
use crate::support::documented;
use serde_json::Value;
use std::collections::BTreeSet;
use std::fs;
use std::sync::OnceLock;

/// A strip of land seen by a drone.
const STRIP: [&str; 10] =
    ["synth", "strip", "--kind", "terrain", "--views", "28", "--size", "96x72", "--points", "1500"];

/// A folder with a copy of the strip (which is made once), and a plan to train it in three blocks with these further options.
fn planned(options: &[&str]) -> (Stage, Vec<super::shard::Listed>) {
    static MADE: OnceLock<Stage> = OnceLock::new();
    let made = MADE.get_or_init(|| {
        let stage = Stage::empty();
        stage.works(&STRIP);
        stage
    });
    let stage = Stage::empty();
    copy(&made.path("strip"), &stage.path("strip"));
    let tasks = stage.planned("a", &[&["run", "strip", "--blocks", "3"], options].concat());
    (stage, tasks)
}

fn figures(stage: &Stage, folder: &str) -> Value {
    serde_json::from_slice(&fs::read(stage.path(folder).join("metrics.json")).unwrap()).unwrap()
}

/// MiB of the device that these tasks took at most, as `said` on stderr.
fn most_memory(said: &str, tasks: &str) -> f64 {
    let taken = said.lines().filter(|line| line.starts_with(tasks)).map(|line| {
        let (_, memory) = line.split_once(" took ").and_then(|(_, taken)| taken.split_once(" and at most ")).unwrap();
        memory.strip_suffix(" MiB of device memory").unwrap().parse::<f64>().unwrap()
    });
    taken.reduce(f64::max).unwrap()
}

/// Mean PSNR of the photos that were trained on, in dB: less noise than a few held out have.
fn psnr(figures: &Value) -> f64 {
    figures["train"]["psnr"].as_f64().unwrap()
}

#[test]
fn a_strip_in_blocks_is_as_good_as_in_one_piece() {
    let options = ["--iterations", "300"];
    let (stage, tasks) = planned(&options);
    // Coarse, assign, dense, collect, evidence, choose, tune, collect, settle, collect, finish, join, score, report.
    assert_eq!(tasks.len(), 1 + 1 + 3 + 1 + 2 + 1 + 3 + 1 + 3 + 1 + 3 + 1 + 1 + 1);
    let said = stage.works(&["shard", "all", "a"]).said;
    stage.works(&[&["run", "strip", "-o", "one"], &options[..]].concat());

    let (blocks, one) = (figures(&stage, "a"), figures(&stage, "one"));
    documented("shard", &blocks);
    let evaluated = stage.works(&["eval", "a/model.ply", "strip", "--json"]).json();
    for field in ["test", "views", "train", "guards", "ply_bytes"] {
        assert_eq!(blocks[field], evaluated[field], "{field}");
    }
    println!("in blocks {:.2} dB, in one piece {:.2} dB; omega {}", psnr(&blocks), psnr(&one), blocks["omega"]);
    assert!(psnr(&blocks) > psnr(&one) - 0.3, "{} {}", psnr(&blocks), psnr(&one));
    let kept = |figures: &Value| figures["gaussians"]["final"].as_f64().unwrap();
    assert_eq!(kept(&blocks), kept(&one));
    let of_blocks: f64 = (0..3).map(|b| blocks["blocks"][b]["gaussians"].as_f64().unwrap()).sum();
    assert_eq!(of_blocks, kept(&blocks));
    assert!(blocks["omega"].as_f64().unwrap() < 2.5);
    let whole = one["memory"]["peak_bytes"].as_f64().unwrap() / f64::from(1 << 20);
    // Up to the prune a block sees what all have grown to; here nearly every photo shows all of it. Lists of pairs, of which a small
    // picture has as many for a block as for the whole, are most of what both hold.
    for (tasks, share) in [("dense/", 0.9), ("tune/", 1.0), ("settle/", 0.5), ("finish/", 0.5)] {
        let block = most_memory(&said, tasks);
        assert!(block <= share * whole, "{tasks}: {block} MiB of the device, in one piece {whole:.1}");
    }
    assert_eq!(stage.status("a", "dense/0001"), "done");
    assert_eq!(fs::read_dir(stage.path("a/work")).unwrap().count(), 0, "what tasks needed on their way is gone");
}

#[test]
fn blocks_have_the_same_bytes_whatever_happens() {
    let options = ["--iterations", "100", "--checkpoint-every", "12"];
    let (mut stage, tasks) = planned(&options);
    let said = works(stage.command(&["shard", "all", "a"]).env("QIRF_VALIDATION", "1")).said;
    assert!(!said.contains("VUID"), "{said}");
    stage.right = fs::read(stage.path("a/model.ply")).unwrap();
    let again = |folder: &str| stage.planned(folder, &[&["run", "strip", "--blocks", "3"], &options[..]].concat());

    assert_eq!(again("shuffled"), tasks);
    stage.shuffled("shuffled", tasks, 5, |command| command);
    stage.is_right("shuffled");
    for file in ["coarse.safetensors", "assign.json", "dense/0001.safetensors", "choose.json", "metrics.json"] {
        let bytes = |folder: &str| fs::read(stage.path(folder).join(file)).unwrap();
        assert!(bytes("a") == bytes("shuffled"), "{file}");
    }

    // Killed again and again, blocks go on from their checkpoints.
    again("killed");
    let foreign = b"another device's";
    let in_training = || {
        let files = content(&stage.path("killed/work")).into_iter().filter(|(_, bytes)| bytes != foreign);
        files.map(|(path, _)| path).filter(|path| path.ends_with("checkpoint.safetensors")).collect::<Vec<_>>()
    };
    let (mut hit, mut at, mut moved) = (BTreeSet::new(), 40, false);
    loop {
        let mut all = stage.command(&["shard", "all", "killed", "--mixed"]);
        // After the first checkpoint as another device, which does not read it.
        let fingerprint = if moved { "4567" } else { FINGERPRINT.1 };
        let fault = format!("submit:{at}:kill");
        let ended = end(all.env(FINGERPRINT.0, fingerprint).env("QIRF_DEVICE_FAULT", fault));
        at += 25; // a task without a checkpoint must end at some time
        if ended.code.is_some() {
            ended.with(0, &[]);
            break;
        }
        let checkpoints = in_training();
        if moved {
            hit.extend(checkpoints);
        } else {
            moved = !checkpoints.is_empty();
            for checkpoint in &checkpoints {
                fs::write(checkpoint, foreign).unwrap();
            }
        }
    }
    assert!(hit.len() >= 3, "kills hit {hit:?} alone");
    stage.is_right("killed");
    let told = stage.works(&["shard", "verify", "killed", "--share", "0.3"]).out;
    assert!(told.contains("repeated: the bytes are the same"), "{told}");
    assert!(content(&stage.path("killed/work")).is_empty(), "a verification leaves nothing to continue from");
}

#[test]
fn blocks_of_a_scene_without_photos_held_out_have_figures() {
    let (stage, _) = planned(&["--iterations", "30", "--no-prune", "--eval-every", "0"]);
    stage.works(&["shard", "all", "a"]);
    let figures = figures(&stage, "a");
    assert!(figures["test"].is_null() && figures["views"].as_array().unwrap().is_empty(), "{figures}");
    assert!(psnr(&figures) > 10.0 && figures["protocol"]["train_views"] == 28, "{figures}");
}

/// The same capture in kilometres.
#[test]
fn blocks_do_not_depend_on_the_unit_of_length() {
    let stage = Stage::empty();
    stage.works(&["synth", "m", "--views", "8", "--size", "48x36", "--points", "600"]);
    copy(&stage.path("m/sparse"), &stage.path("km/sparse"));
    rescale(&stage.path("km/sparse/0"), 1e-3);
    fs::rename(stage.path("m/images"), stage.path("km/images")).unwrap();
    let scored = |scene: &str, folder: &str| {
        stage.planned(folder, &["run", scene, "--blocks", "2", "--iterations", "60", "--grow-to", "300"]);
        stage.works(&["shard", "all", folder]);
        psnr(&figures(&stage, folder))
    };
    let of_km = scored("km", "b");
    fs::rename(stage.path("km/images"), stage.path("m/images")).unwrap();
    let of_m = scored("m", "a");
    // Coordinates round differently; training in the capture's own unit is 0.2 dB off.
    assert!((of_km - of_m).abs() < 0.03, "{of_km} dB in kilometres, {of_m} dB in metres");
    // Of the 600 points, of which there are more than the run grows to.
    let prune = &figures(&stage, "a")["prune"];
    assert!(prune["iteration"] == 30 && prune["after"] == 168, "{prune}");
}

/// A short run's coarse model lacks bands, which some blocks add.
#[test]
fn many_blocks_of_a_short_run_fit_together() {
    let stage = Stage::empty();
    stage.works(&["synth", "m", "--views", "8", "--size", "48x36", "--points", "600"]);
    stage.planned("a", &["run", "m", "--blocks", "16", "--iterations", "4"]);
    stage.works(&["shard", "all", "a"]);
    assert!(psnr(&figures(&stage, "a")) > 5.0);
}

#[test]
fn damaged_blocks_and_lost_photos_are_named() {
    let options = ["--iterations", "60", "--no-prune"];
    let (stage, tasks) = planned(&options);
    assert_eq!(tasks.len(), 1 + 1 + 3 + 1 + 3 + 1 + 3 + 1 + 3 + 1 + 1 + 1, "nothing is chosen");
    stage.refused(3, &["assign is not done; run `qirf-vk shard task a assign`"], &["shard", "task", "a", "dense/0001"]);
    stage.refused(3, &["task coarse is not done", "shard task a coarse"], &["shard", "task", "a", "assign"]);
    stage.works(&["shard", "all", "a"]);
    // A state, figures, a model, notes beside a state and beside a model, a block's result, and scores.
    for (file, id, reader, written) in [
        ("coarse.safetensors", "coarse", "assign", "assign.json"),
        ("assign.json", "assign", "dense/0000", "dense/0000.safetensors"),
        ("collect/0000.ply", "collect/0000", "tune/0002", "tune/0002.safetensors"),
        ("tune/0001.json", "tune/0001", "settle/0001", "settle/0001.safetensors"),
        ("collect/0002.json", "collect/0002", "finish/0001", "finish/0001.ply"),
        ("finish/0000.ply", "finish/0000", "join", "join.json"),
        ("score/0000.json", "score/0000", "report", "metrics.json"),
    ] {
        let length = fs::metadata(stage.path("a").join(file)).unwrap().len() as usize;
        flip(&stage.path("a").join(file), length / 2);
        assert_eq!(stage.status("a", id), "damaged", "{file}");
        fs::remove_file(stage.path("a").join(written)).unwrap();
        stage.refused(3, &[file], &["shard", "task", "a", reader]);
        stage.works(&["shard", "all", "a"]);
    }
    let photos = stage.path("strip/images");
    let last = fs::read_dir(&photos).unwrap().flatten().map(|e| e.path()).max().unwrap();
    fs::remove_file(&last).unwrap();
    fs::remove_file(stage.path("a/coarse.safetensors")).unwrap();
    let name = last.file_name().unwrap().to_str().unwrap();
    stage.refused(3, &[name, "when the job was planned"], &["shard", "task", "a", "coarse"]);

    for options in [&["--schedule", "gradual"][..], &["--preset", "paper"]] {
        stage.refused(2, &["in blocks cannot"], &[&["shard", "plan", "run", "strip", "-o", "b"], options].concat());
    }
    stage.works(&["shard", "plan", "run", "strip", "-o", "b", "--memory-budget", "30M"]);
    let plan: Value = serde_json::from_slice(&fs::read(stage.path("b/plan.json")).unwrap()).unwrap();
    assert!(plan["job"]["run"]["blocks"].as_u64().unwrap() > 1, "blocks that fit: {plan}");
    // Blocks whose buffers fit: 168 bytes a row, for half as many again as an eighth of these, and for twice as many around them.
    let mut small = stage.command(&["shard", "plan", "run", "strip", "-o", "d", "--grow-to", "30000"]);
    works(small.args(["--sh-degree", "3"]).env("QIRF_LIMITS", "buffers=3000000"));
    let plan: Value = serde_json::from_slice(&fs::read(stage.path("d/plan.json")).unwrap()).unwrap();
    assert_eq!(plan["job"]["run"]["blocks"], 8, "{plan}");
    stage.refused(5, &["smallest block"], &["shard", "plan", "run", "strip", "-o", "c", "--memory-budget", "1M"]);
}
