//! Kills and interruptions: a resumed run ends with the bytes of the undisturbed run.

use super::harness::{ITERATIONS, content, end, killed, program, run, start, start_telling, undisturbed, whole, works};
use qirf_vk::job::run_log::LogLine;
use qirf_vk::random;
use qirf_vk::train::checkpoint::Snapshot;
use std::fs;
use std::path::Path;
use std::process::Command;
use std::time::{Duration, SystemTime};

/// The seed of the times of kills: `QIRF_FAULTS_SEED`, if it is given.
fn seed() -> u64 {
    std::env::var("QIRF_FAULTS_SEED").ok().and_then(|s| s.parse().ok()).unwrap_or(1)
}

fn changed(path: &Path) -> Option<SystemTime> {
    fs::metadata(path).and_then(|m| m.modified()).ok()
}

/// The checkpoint's iteration; it is whole, or absent.
fn at(checkpoint: &Path) -> u32 {
    if checkpoint.exists() { Snapshot::read(checkpoint).expect("a whole checkpoint").iteration } else { 0 }
}

/// Kills that cannot be caught: at the start, between checkpoints, while one is written, and at the end, before and
/// after prunes.
#[test]
fn killed_in_training_and_fine_tuning_it_ends_with_the_same_bytes() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path();
    let checkpoint = out.join("checkpoint.safetensors");
    let seed = seed();
    let mut moments = Vec::new();
    for kill in 0..7_u64 {
        if out.join("metrics.json").exists() {
            break;
        }
        let draw = |what: u64| random::bits(&[seed, kill, what]);
        let before = changed(&checkpoint);
        let mut child = start(&mut run(out, &["--resume"]));
        match draw(0) % 4 {
            0 => std::thread::sleep(Duration::from_millis(draw(1) % 700)),
            // While the next checkpoint is written, if it is caught.
            1 => drop(child.until(|| {
                let temporary = |e: fs::DirEntry| e.file_name().to_string_lossy().starts_with(".checkpoint");
                fs::read_dir(out).is_ok_and(|entries| entries.flatten().any(temporary))
            })),
            // Somewhat after some checkpoint.
            _ => {
                for _ in 0..=draw(2) % 4 {
                    let before = changed(&checkpoint);
                    child.until(|| changed(&checkpoint) != before);
                }
                std::thread::sleep(Duration::from_millis(draw(1) % 60));
            }
        }
        let ended = child.signal("KILL");
        assert!(ended.code.is_none() || ended.code == Some(0), "{}", ended.said);
        moments.push((at(&checkpoint), changed(&checkpoint) != before));
    }
    println!("killed after checkpoints of {moments:?}");
    works(&mut run(out, &["--resume"]));
    assert!(undisturbed() == fs::read(out.join("model.ply")).unwrap(), "other bytes");
    assert!(moments.iter().any(|(at, _)| *at > 0), "some kill came in training");
    let log = fs::read_to_string(out.join("log.jsonl")).unwrap();
    let iteration = |line| serde_json::from_str::<LogLine>(line).expect("a line of JSON").iteration;
    let logged: Vec<u32> = log.lines().map(iteration).collect();
    assert!(logged.is_sorted_by(|a, b| a < b) && logged.last() == Some(&ITERATIONS), "{logged:?}");
    // Leftovers of killed writers are gone, and so is the checkpoint.
    whole(out);
    assert!(!checkpoint.exists());
}

#[test]
fn interrupted_it_keeps_a_checkpoint_and_ends_with_130() {
    let folder = tempfile::tempdir().unwrap();
    for (name, milliseconds) in [("HUP", 90), ("TERM", 50)] {
        let out = folder.path().join(name);
        let mut child = start(&mut by("env", &["--default-signal=HUP"], &run(&out, &["--checkpoint-every", "0"])));
        child.until(|| out.join("config.toml").exists());
        std::thread::sleep(Duration::from_millis(milliseconds));
        child.signal(name).with(130, &["interrupted"]);
        let reached = at(&out.join("checkpoint.safetensors"));
        println!("{name} after iteration {reached}");
        assert!(reached > 0 && !out.join("model.ply").exists());
    }
    let out = folder.path().join("TERM");
    works(&mut run(&out, &["--checkpoint-every", "0", "--resume"]));
    assert!(undisturbed() == fs::read(out.join("model.ply")).unwrap());
}

/// The same command, by way of another program.
fn by(program: &str, options: &[&str], command: &Command) -> Command {
    let mut by = Command::new(program);
    by.args(options).arg(command.get_program()).args(command.get_args());
    by
}

/// Under nohup the terminal may close, once and twice.
#[test]
fn under_nohup_it_goes_on() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path();
    let mut child = start(&mut by("nohup", &[], &run(out, &[])));
    child.until(|| out.join("config.toml").exists());
    child.tell("HUP");
    child.signal("HUP").with(0, &[]);
    assert!(undisturbed() == fs::read(out.join("model.ply")).unwrap());
}

/// Commands without steps keep nothing, and say so by their exit code, too.
#[test]
fn commands_without_steps_end_with_130() {
    let folder = tempfile::tempdir().unwrap();
    for name in ["INT", "TERM", "HUP"] {
        let capture = folder.path().join(name);
        let mut command = program();
        command.arg("synth").arg(&capture).args(["--views", "9999", "--size", "640x480"]);
        // A shell's background jobs ignore INT, and so would the command.
        let mut child = start(&mut by("env", &["--default-signal=INT,HUP"], &command));
        child.until(|| capture.join("synth.json").exists());
        assert_eq!(child.signal(name).code, Some(130), "{name}");
    }
}

/// Compression has no checkpoint: a killed or interrupted job leaves nothing, and a repeated one gives the same bytes.
#[test]
fn compression_is_whole_or_absent() {
    let folder = tempfile::tempdir().unwrap();
    let (model, out) = (folder.path().join("model.ply"), folder.path().join("small.ply"));
    fs::write(&model, undisturbed()).unwrap();
    let compress = |tuning: &str| {
        let mut command = program();
        command.arg("compress").arg(&model).arg("-o").arg(&out).args(["--views", "4", "--size", "40x30"]);
        command.args(["--fine-tune", tuning, "--keep", "0.5"]);
        command
    };
    works(&mut compress("20"));
    let right = fs::read(&out).unwrap();
    // An earlier output stays whole, too.
    for (name, code) in [("KILL", None), ("TERM", Some(130)), ("INT", Some(130))] {
        let told = tempfile::NamedTempFile::new().unwrap();
        let mut child = start_telling(compress("1000000").arg("-v"), told.path());
        child.until(|| fs::read_to_string(told.path()).is_ok_and(|t| t.contains("the compression needs")));
        std::thread::sleep(Duration::from_millis(300));
        assert_eq!(child.signal(name).code, code, "{name}: {}", fs::read_to_string(told.path()).unwrap());
        let files = content(folder.path());
        assert!(files.len() == 2 && files.iter().any(|(path, bytes)| *path == out && *bytes == right), "{name}");
    }
    fs::remove_file(&out).unwrap();
    works(&mut compress("20"));
    assert!(fs::read(&out).unwrap() == right);
}

/// Damaged, foreign and empty checkpoints: refused by name, and nothing is touched.
#[test]
fn damaged_checkpoints_are_refused_and_kept() {
    let folder = tempfile::tempdir().unwrap();
    let (out, checkpoint) = (folder.path().join("out"), folder.path().join("out/checkpoint.safetensors"));
    killed(&out, || checkpoint.exists());
    let good = fs::read(&checkpoint).unwrap();
    fs::write(out.join("model.ply"), undisturbed()).unwrap();
    let refused = |bytes: &[u8], says: &str| {
        fs::write(&checkpoint, bytes).unwrap();
        let before = content(&out);
        let ended = end(&mut run(&out, &["--resume"]));
        ended.with(3, &["checkpoint.safetensors", says, "delete"]);
        assert!(content(&out) == before, "nothing is touched");
    };
    refused(b"", "header");
    refused(&good[..good.len() - 1], "header");
    // One bit of one weight.
    let mut flipped = good.clone();
    let middle = flipped.len() - 1000;
    flipped[middle] ^= 4;
    refused(&flipped, "damaged");
    // In-process: every file that differs by one bit.
    for k in 0..400_u64 {
        let mut flipped = good.clone();
        let at = (random::bits(&[7, k]) % (8 * flipped.len() as u64)) as usize;
        flipped[at / 8] ^= 1 << (at % 8);
        fs::write(&checkpoint, &flipped).unwrap();
        let read = Snapshot::read(&checkpoint);
        // A changed letter of a name may pass if two tensors swap places; any file that is accepted gives the same
        // state.
        if let Ok(read) = read {
            fs::write(&checkpoint, &good).unwrap();
            assert!(read == Snapshot::read(&checkpoint).unwrap(), "bit {at}");
        }
    }
    // Whole, but with a note that this version cannot read: a run that forgot its prunes would prune again.
    fs::write(&checkpoint, &good).unwrap();
    let mut newer = Snapshot::read(&checkpoint).unwrap();
    newer.notes.insert("prunes".to_owned(), r#"[{"iteration":52,"by":"another version"}]"#.to_owned());
    newer.write(&checkpoint).unwrap();
    refused(&fs::read(&checkpoint).unwrap(), "another version");
    fs::write(&checkpoint, &good).unwrap();
    end(&mut run(&out, &["--resume", "--seed", "9"])).with(2, &["seed was 1, is 9", "other options"]);
    assert!(fs::read(&checkpoint).unwrap() == good);
    works(&mut run(&out, &["--resume"]));
    assert!(undisturbed() == fs::read(out.join("model.ply")).unwrap());
}
