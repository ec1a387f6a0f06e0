//! Devices that are lost, run out of memory, or hang, at a call chosen by `QIRF_DEVICE_FAULT`. The program ends with
//! the code of the cause, existing files stay whole, and a resumed run ends with the bytes of the undisturbed run.

use super::harness::{
    Ended, FIRST_PRUNE, end, program, run, scene, start_telling, undisturbed, validated, whole, works,
};
use crate::support::options;
use qirf_vk::gpu::{Device, Error};
use serde_json::Value;
use std::fs;
use std::path::Path;
use std::process::Command;
use std::time::Duration;

/// A number of submissions that no command reaches.
const NEVER: u64 = 1 << 40;

/// The command with a fault at call `number`, validated: so is what it does with a device that is lost.
fn with_fault<'a>(command: &'a mut Command, call: &str, number: u64, answer: &str) -> &'a mut Command {
    validated(command).env("QIRF_DEVICE_FAULT", format!("{call}:{number}:{answer}"))
}

/// Resumes a run, which must succeed.
#[track_caller]
fn resumed(out: &Path) -> Ended {
    works(validated(&mut run(out, &["--resume"])))
}

/// Number of submissions that an undisturbed command makes.
fn submissions(command: &mut Command) -> u64 {
    let said = works(with_fault(command, "submit", NEVER, "lost").arg("-v")).said;
    let counted = said.split("had not yet come after ").nth(1).and_then(|rest| rest.split(' ').next());
    counted.and_then(|n| n.parse().ok()).unwrap_or_else(|| panic!("no count: {said}"))
}

/// Asserts that it ended as on a lost device: a single line that says so, since nothing else was wrong.
#[track_caller]
fn is_lost(ended: Ended) {
    let ended = ended.with(4, &["the device was lost during ", "driver", "--resume", "--device"]);
    let lines: Vec<&str> = ended.said.lines().filter(|l| l.to_lowercase().contains("error")).collect();
    assert!(lines.len() == 1 && ended.said.matches("lost").count() == 1, "{}", ended.said);
}

/// The stage that a run had reached, judged by its files.
fn reached(out: &Path) -> &'static str {
    match ["metrics.json", "model.ply", "renders", "checkpoint.safetensors", "config.toml"]
        .map(|f| out.join(f).exists())
    {
        [true, ..] => "all",
        [_, true, ..] => "the evaluation",
        [_, _, true, ..] => "the first prune",
        [_, _, _, true, _] => "a checkpoint",
        [.., true] => "the beginning",
        _ => "nothing",
    }
}

/// Losses from the first submission, which probes the device, to the evaluation; the resumed run is lost once more.
#[test]
fn lost_at_any_moment_a_run_ends_with_the_same_bytes() {
    let folder = tempfile::tempdir().unwrap();
    let all = submissions(&mut run(&folder.path().join("all"), &[]));
    println!("{all} submissions");
    let mut stages = Vec::new();
    for (k, part) in [0.0, 0.25, 0.75, 0.97].into_iter().enumerate() {
        let out = folder.path().join(k.to_string());
        let number = 1 + (part * all as f64) as u64;
        is_lost(end(with_fault(&mut run(&out, &[]), "submit", number, "lost")));
        whole(&out);
        stages.push(reached(&out));
        println!("submission {number}: {}", reached(&out));
        if k == 1 {
            // And again some way on.
            is_lost(end(with_fault(&mut run(&out, &["--resume"]), "submit", 1 + all / 6, "lost")));
            whole(&out);
        }
        let said = resumed(&out).said;
        assert_eq!(said.contains("no checkpoint yet: starting from the beginning"), k == 0, "{said}");
        if part == 0.75 {
            // In fine-tuning: it knows what it pruned.
            let after = said.split("resuming after iteration ").nth(1).and_then(|rest| rest.lines().next());
            assert!(after.and_then(|n| n.parse::<u32>().ok()) > Some(FIRST_PRUNE), "{said}");
            let figures: Value = serde_json::from_slice(&fs::read(out.join("metrics.json")).unwrap()).unwrap();
            assert_eq!(figures["prunes"].as_array().unwrap().len(), 4);
            assert!(figures["gaussians"]["dense"].as_u64() > figures["gaussians"]["final"].as_u64());
        }
        whole(&out);
        assert!(undisturbed() == fs::read(out.join("model.ply")).unwrap(), "submission {number}: other bytes");
        assert!(!out.join("checkpoint.safetensors").exists());
    }
    for stage in ["nothing", "a checkpoint", "the first prune", "the evaluation"] {
        assert!(stages.contains(&stage), "no loss after {stage}: {stages:?}");
    }
}

/// The commands that use a device (`selftest` has a test of its own), given in a folder with a model.
const COMMANDS: [&str; 7] = [
    "device",
    "render model.ply --orbit 4 --size 40x30 -o pictures",
    "eval model.ply SCENE -o scores",
    "compress model.ply -o small.ply --views 4 --size 40x30 --fine-tune 20",
    "compress model.ply -o small.ply --scene SCENE",
    "compare SCENE -o compared --resume --iterations 40 --arms default,dense",
    "sweep SCENE -o swept --axis stop --train 20 --budget-per-axis 0.001",
];

#[test]
fn every_command_tells_of_a_lost_device_and_leaves_files_whole() {
    for line in COMMANDS {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path();
        // An earlier output stays unchanged, too.
        let begin = || ["model.ply", "small.ply"].map(|name| fs::write(path.join(name), undisturbed()).unwrap());
        let command = || {
            let mut command = program();
            for word in line.split(' ') {
                command.arg(if word == "SCENE" { scene().as_os_str() } else { word.as_ref() });
            }
            command.current_dir(path);
            command
        };
        begin();
        // Twice before anything was finished, the second time on the leftovers of the first; then the command succeeds.
        // Opening a device is one submission.
        let numbers: &[u64] = if line == "device" { &[1] } else { &[5, 10] };
        for &number in numbers {
            is_lost(end(with_fault(&mut command(), "submit", number, "lost")));
            whole(path);
            for name in ["model.ply", "small.ply"] {
                assert!(fs::read(path.join(name)).unwrap() == undisturbed(), "{line}: {name} is unchanged");
            }
        }
        let all = submissions(&mut command());
        println!("{line}: {all} submissions");
        begin();
        if line.starts_with("compare") {
            fs::remove_dir_all(path.join("compared")).unwrap();
        }
        // Near the end: turns that are timed make their number vary.
        is_lost(end(with_fault(&mut command(), "submit", all - all / 10, "lost")));
        whole(path);
        assert!(fs::read(path.join("model.ply")).unwrap() == undisturbed());
    }
}

/// A selftest of a lost device says nothing about its numbers, nor does one without memory.
#[test]
fn a_selftest_blames_no_numbers() {
    for (answer, code) in [("lost", 4), ("device-memory", 5)] {
        let ended = end(with_fault(program().args(["selftest", "--quick"]), "submit", 100, answer)).with(code, &[]);
        assert!(!ended.said.contains("trusted") && !ended.said.contains("checks"), "{}", ended.said);
    }
}

#[test]
fn memory_that_a_call_lacks_is_named_and_the_run_is_resumed() {
    let folder = tempfile::tempdir().unwrap();
    for (answer, says) in [("host-memory", "the host's memory"), ("device-memory", "the device's memory")] {
        let out = folder.path().join(answer);
        // Some checkpoints were written by then.
        let ended = end(with_fault(&mut run(&out, &[]), "submit", 220, answer));
        let kept = ["the checkpoint of iteration ", "`run` and `compare` with --resume"];
        let ended = ended.with(5, &[says, "ran out during queue submit", "fewer Gaussians", kept[0], kept[1]]);
        assert_eq!(ended.said.to_lowercase().matches("error").count(), 1, "{}", ended.said);
        whole(&out);
    }
    let out = folder.path().join("device-memory");
    resumed(&out);
    assert!(undisturbed() == fs::read(out.join("model.ply")).unwrap());
    // The work itself goes on: the program waits for it in another way.
    let out = folder.path().join("wait");
    works(with_fault(&mut run(&out, &[]), "wait", 150, "host-memory"));
    assert!(undisturbed() == fs::read(out.join("model.ply")).unwrap());
}

/// A hang cannot be distinguished from slow work, but the user is warned, a second signal ends the program at once, and
/// the run can be resumed.
#[test]
fn a_hang_is_told_and_can_be_ended() {
    let folder = tempfile::tempdir().unwrap();
    let (out, told) = (folder.path().join("out"), folder.path().join("told"));
    let mut child = start_telling(with_fault(&mut run(&out, &[]), "wait", 200, "hang"), &told);
    let says = || fs::read_to_string(&told).unwrap();
    assert!(child.until(|| says().contains("it is slow, or it hangs")), "{}", says());
    child.tell("TERM");
    std::thread::sleep(Duration::from_millis(300));
    child.signal("TERM").with(130, &[]);
    assert!(!says().contains("validation:") && !says().contains("panicked"), "{}", says());
    assert!(says().contains("a hang, this program ends with an error"), "{}", says());
    whole(&out);
    assert!(out.join("checkpoint.safetensors").exists());
    resumed(&out);
    assert!(undisturbed() == fs::read(out.join("model.ply")).unwrap());
}

/// A fault with a malformed text is not ignored silently.
#[test]
fn a_fault_that_is_none_is_refused() {
    let mut command = program();
    end(command.arg("device").env("QIRF_DEVICE_FAULT", "submit:0:lost"))
        .with(2, &["QIRF_DEVICE_FAULT=submit:0:lost", "counts no call"]);
}

/// In a process that continues, every later call reports the same error, all memory is freed, and another device works.
#[test]
fn a_process_outlives_its_device() {
    for fault in ["submit:40:lost", "wait:40:lost"] {
        let mut options = options();
        options.harness.fault = fault.parse().ok();
        let device = Device::open(&options).unwrap();
        let numbers: Vec<u32> = (0..1000).collect();
        let buffer = device.buffer::<u32>("numbers", numbers.len()).unwrap();
        let lost = (0..100).find_map(|_| buffer.write(&device, &numbers).err()).expect("it is lost");
        assert!(matches!(lost, Error::Lost(_)), "{lost}");
        for _ in 0..3 {
            assert!(buffer.read(&device).is_err_and(|e| e.is_lost()));
            assert!(device.upload("more", &numbers).is_err_and(|e| e.is_lost()));
        }
        drop(buffer);
        assert_eq!(device.memory_used().0, 0);
        drop(device);
        options.harness.fault = None;
        let device = Device::open(&options).unwrap();
        assert_eq!(device.upload("numbers", &numbers).unwrap().read(&device).unwrap(), numbers);
        assert_eq!(Device::validation_messages(), 0);
    }
}
