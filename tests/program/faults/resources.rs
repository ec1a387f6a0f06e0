//! Full disks, folders that cannot be written, outputs that are inputs, too little device memory: exit codes and
//! messages that name the cause, and no existing file is lost.
//!
//! A full disk is a small tmpfs in a namespace of the test's own, which needs no privileges where the system lets its
//! users have them; elsewhere only the limit on the size of files (`ulimit -f`) is tried, on a command without a
//! device: software devices keep their memory in files, which the limit would hit first.

use super::harness::{Ended, behind, content, end, killed, program, run, scene, undisturbed, whole, works};
use crate::support::{opened, skip};
use qirf_vk::gaussians::formats;
use qirf_vk::gpu::Device;
use qirf_vk::train::checkpoint::Snapshot;
use std::fs;
use std::path::Path;
use std::process::Command;
use tempfile::TempDir;

/// Returns true if the test can make its own mounts; prints a note if not.
fn mounts() -> bool {
    let made = Command::new("unshare").args(["-rm", "mount", "-t", "tmpfs", "tmpfs", "/mnt"]).output();
    let can = made.is_ok_and(|o| o.status.success());
    if !can {
        skip("no mounts of one's own");
    }
    can
}

/// Runs a command on a disk of this size that begins as a copy of the folder `from`; returns the outcome, and a copy of
/// the disk.
fn on_a_disk(kilobytes: usize, from: &Path, command: impl Fn(&Path) -> Command) -> (Ended, TempDir) {
    let folder = tempfile::tempdir().unwrap();
    let (disk, saved) = (folder.path().join("disk"), folder.path().join("saved"));
    fs::create_dir(&disk).unwrap();
    let shell = format!(
        "mount -t tmpfs -o size={kilobytes}k tmpfs '{0}' && cp -r '{2}/.' '{0}' || exit 99; \"$@\"; code=$?; \
         cp -r '{0}' '{1}'; exit $code",
        disk.display(),
        saved.display(),
        from.display()
    );
    let inside = behind(&shell, &command(&disk));
    let mut command = Command::new("unshare");
    command.arg("-rm").arg(inside.get_program()).args(inside.get_args());
    (end(&mut command), folder)
}

#[test]
fn a_checkpoint_that_does_not_fit_leaves_the_one_before() {
    if !mounts() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let (out, checkpoint) = (folder.path(), folder.path().join("checkpoint.safetensors"));
    killed(out, || checkpoint.exists());
    let before = fs::read(&checkpoint).unwrap();
    let kilobytes = before.len() / 1024 + 40;
    let (ended, disk) = on_a_disk(kilobytes, out, |disk| run(disk, &["--resume"]));
    ended.with(5, &["cannot write", "checkpoint.safetensors", "No space left on device", "free some space"]);
    let saved = disk.path().join("saved");
    assert!(fs::read(saved.join("checkpoint.safetensors")).unwrap() == before);
    whole(&saved);
    works(&mut run(&saved, &["--resume"]));
    assert!(undisturbed() == fs::read(saved.join("model.ply")).unwrap());
}

/// A folder with a model, and an earlier output.
fn with_earlier_output() -> TempDir {
    let folder = tempfile::tempdir().unwrap();
    fs::write(folder.path().join("model.ply"), undisturbed()).unwrap();
    fs::write(folder.path().join("small.ply"), b"earlier").unwrap();
    folder
}

#[test]
fn outputs_that_do_not_fit_leave_those_before() {
    let folder = with_earlier_output();
    let before = content(folder.path());
    let mut command = program();
    command.args(["convert", "model.ply", "small.ply"]);
    let mut command = behind("ulimit -f 2 && exec \"$@\"", &command);
    end(command.current_dir(folder.path())).with(5, &["cannot write", "small.ply", "File too large"]);
    assert!(content(folder.path()) == before);
    if !mounts() {
        return;
    }
    let views = ["--views", "4", "--size", "40x30", "--keep", "0.9"];
    let cases: [(&[&str], &str); 2] = [
        (&["compress", "-o", "small.ply"], "small.ply"),
        (&["render", "--orbit", "4", "--size", "99x80", "-o", "new"], "new"),
    ];
    for (arguments, names) in cases {
        let kilobytes = undisturbed().len() / 1024 + 16;
        let (ended, disk) = on_a_disk(kilobytes, folder.path(), |disk| {
            let mut command = program();
            command.args(&arguments[..1]).arg(disk.join("model.ply"));
            for argument in &arguments[1..] {
                let is_file = *argument == names;
                if is_file {
                    command.arg(disk.join(argument))
                } else {
                    command.arg(argument)
                };
            }
            command.args(if arguments[0] == "compress" { &views[..] } else { &[] });
            command
        });
        ended.with(5, &["cannot write", names, "No space left on device"]);
        let saved = disk.path().join("saved");
        assert!(fs::read(saved.join("small.ply")).unwrap() == b"earlier", "{arguments:?}");
        assert!(fs::read(saved.join("model.ply")).unwrap() == undisturbed());
        fs::remove_file(saved.join("small.ply")).unwrap();
        whole(&saved);
    }
}

/// Disks of several sizes, full at several files of a run; files that fit are whole.
#[test]
fn a_full_disk_keeps_what_is_whole() {
    if !mounts() {
        return;
    }
    // KiB of the disk, iterations between checkpoints, the file that does not fit.
    let cases = [
        (8, "0", "renders"),
        (20, "0", "model.ply"),
        (50, "0", "renders"),
        (70, "0", "metrics.json"),
        (100, "0", "report.html"),
        (150, "7", "checkpoint.safetensors"),
    ];
    for (kilobytes, every, file) in cases {
        let empty = tempfile::tempdir().unwrap();
        let on = |disk: &Path| run(&disk.join("out"), &["--checkpoint-every", every]);
        let (ended, disk) = on_a_disk(kilobytes, empty.path(), on);
        let ended = ended.with(5, &["cannot write", "No space left on device"]);
        let said = ended.said.lines().last().unwrap_or_default();
        println!("{kilobytes} KiB: {said}");
        assert!(said.contains(file), "{file}: {said}");
        whole(&disk.path().join("saved"));
    }
}

#[test]
fn folders_that_cannot_be_written_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let model = folder.path().join("model.ply");
    fs::write(&model, undisturbed()).unwrap();
    let fails = |out: &Path, names: &str| {
        end(&mut run(out, &[])).with(5, &["cannot write", names]);
        let model = model.as_os_str();
        let small = out.join("small.ply");
        end(program().arg("compress").arg(model).arg("-o").arg(&small)).with(5, &["cannot write", names]);
        end(program().arg("convert").arg(model).arg(&small)).with(5, &["cannot write", names]);
        end(program().arg("eval").arg(model).arg(scene()).arg("-o").arg(out)).with(5, &["cannot write", names]);
    };
    // A file in place of a folder, which stops root as well.
    fails(&model.join("out"), "model.ply");
    // A system folder in which nobody can make files.
    if Path::new("/proc/self").exists() {
        fails(Path::new("/proc/qirf"), "/proc/qirf");
    }
    assert!(fs::read(&model).unwrap() == undisturbed());
}

#[test]
fn a_read_only_folder_is_named_and_keeps_its_run() {
    if !mounts() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let (out, checkpoint) = (folder.path().join("out"), folder.path().join("out/checkpoint.safetensors"));
    killed(&out, || checkpoint.exists());
    let before = content(&out);
    let shell = format!("mount --bind '{0}' '{0}' && mount -o remount,bind,ro '{0}' || exit 99; \"$@\"", out.display());
    let inside = behind(&shell, &run(&out, &["--resume"]));
    let mut command = Command::new("unshare");
    command.arg("-rm").arg(inside.get_program()).args(inside.get_args());
    end(&mut command).with(5, &["cannot write", "out", "Read-only file system"]);
    let same = |name: &str| {
        content(&out).iter().filter(|(p, _)| p.ends_with(name)).eq(before.iter().filter(|(p, _)| p.ends_with(name)))
    };
    assert!(same("checkpoint.safetensors") && same("config.toml"));
    works(&mut run(&out, &["--resume"]));
    assert!(undisturbed() == fs::read(out.join("model.ply")).unwrap());
}

#[test]
fn output_never_takes_the_place_of_its_input() {
    let folder = tempfile::tempdir().unwrap();
    let path = |name: &str| folder.path().join(name);
    fs::create_dir(path("out")).unwrap();
    fs::write(path("out/model.ply"), undisturbed()).unwrap();
    std::os::unix::fs::symlink(path("out"), path("link")).unwrap();
    fs::hard_link(path("out/model.ply"), path("hard.ply")).unwrap();
    let before = content(folder.path());
    // A link to an output, say on a larger disk, stays one.
    std::os::unix::fs::symlink(path("elsewhere.ply"), path("linked.ply")).unwrap();
    for _ in 0..2 {
        works(program().arg("convert").arg(path("hard.ply")).arg(path("linked.ply")));
        assert!(path("linked.ply").is_symlink() && fs::read(path("elsewhere.ply")).unwrap() == undisturbed());
    }
    fs::remove_file(path("linked.ply")).unwrap();
    fs::remove_file(path("elsewhere.ply")).unwrap();
    // A run that begins on a model does not write its own over it.
    for init in ["out/model.ply", "link/model.ply", "hard.ply"] {
        let init = path(init);
        end(&mut run(&path("out"), &["--init", init.to_str().unwrap()])).with(2, &["model.ply", "another name"]);
    }
    for (model, out) in
        [("out/model.ply", "link/model.ply"), ("hard.ply", "out/model.ply"), ("out/model.ply", "hard.ply")]
    {
        for command in [["compress", "-o"].as_slice(), &["convert"]] {
            let mut refused = program();
            refused.arg(command[0]).arg(path(model)).args(&command[1..]).arg(path(out));
            end(&mut refused).with(2, &["another name"]);
        }
    }
    let mut reported = program();
    reported.arg("compress").arg(path("hard.ply")).arg("-o").arg(path("small.ply"));
    end(reported.arg("--report").arg(path("out/model.ply"))).with(2, &["another name"]);
    assert!(content(folder.path()) == before);
}

#[test]
fn too_little_device_memory_says_what_to_do() {
    let folder = tempfile::tempdir().unwrap();
    let (model, out) = (folder.path().join("model.ply"), folder.path().join("small.ply"));
    fs::write(&model, undisturbed()).unwrap();
    let words = [" MiB of device memory", "--memory-budget", "give"];
    let compress = |more: &[&str]| {
        let mut command = program();
        command.arg("compress").arg(&model).arg("-o").arg(&out).args(["--memory-budget", "100k"]).args(more);
        end(&mut command).with(5, &words);
    };
    compress(&[]);
    compress(&["--fine-tune", "10", "--scene", scene().to_str().unwrap()]);
    let mut compare = program();
    compare.arg("compare").arg(scene()).arg("-o").arg(folder.path().join("compared"));
    end(compare.args(["--iterations", "60", "--memory-budget", "100k"])).with(5, &words);
    end(&mut run(&folder.path().join("run"), &["--memory-budget", "100k"])).with(5, &words);
    assert!(!out.exists() && !folder.path().join("run/config.toml").exists());
    // More memory than any device has.
    end(&mut run(&folder.path().join("run"), &["--max-gaussians", "18446744073709551615"]))
        .with(2, &["--max-gaussians"]);
}

/// Running out of memory in the middle of the work is an error with the buffer's name, and all memory is freed.
#[test]
fn device_memory_that_runs_out_comes_back() {
    let folder = tempfile::tempdir().unwrap();
    let model = folder.path().join("model.ply");
    fs::write(&model, undisturbed()).unwrap();
    let gaussians = formats::read(&model).unwrap().gaussians;
    let mut refused = 0;
    for kilobytes in (8..=4096).step_by(408) {
        let device = opened(|options| options.memory_limit = Some(kilobytes << 10));
        let resident = qirf_vk::gaussians::resident::Resident::upload(&device, &gaussians);
        let made = resident.and_then(|resident| {
            let settings = qirf_vk::render::Settings::default();
            let mut renderer = qirf_vk::render::Renderer::new(&device, settings, gaussians.len(), 64, 48)?;
            let up = glam::DVec3::NEG_Y;
            let camera =
                qirf_vk::scene::camera::Camera::look_at(3.0 * glam::DVec3::Z, glam::DVec3::ZERO, up, 0.8, 64, 48);
            renderer.render(&resident, &camera)
        });
        if let Err(e) = made {
            refused += 1;
            let said = e.to_string();
            assert!(e.is_resources() && said.contains("out of memory"), "{said}");
        }
        assert_eq!(device.memory_used().0, 0, "at {kilobytes} KiB");
        assert_eq!(Device::validation_messages(), 0);
    }
    println!("{refused} of 11 budgets too small");
    assert!((1..11).contains(&refused));
}

/// A log that cannot be written ends no job.
#[test]
#[cfg(target_os = "linux")]
fn a_full_log_is_none() {
    let folder = tempfile::tempdir().unwrap();
    let mut render = program();
    render
        .args(["-v", "render", "tools/examples/ring.ply", "--orbit", "1", "--size", "32x24", "-o"])
        .arg(folder.path());
    let full = fs::OpenOptions::new().write(true).open("/dev/full").unwrap();
    assert!(render.stderr(full).status().unwrap().success());
    assert_eq!(fs::read_dir(folder.path()).unwrap().count(), 1);
}

#[test]
fn threads_that_the_system_refuses_are_told() {
    let mut inspect = program();
    inspect.args(["inspect", "tools/examples/ring.ply"]);
    let mut limited = behind("ulimit -v 1500000 && \"$@\"", &inspect);
    end(limited.env("RAYON_NUM_THREADS", "5000")).with(5, &["starts no more threads", "RAYON_NUM_THREADS"]);
}

/// Meaningless numbers in a configuration file.
#[test]
fn configurations_are_refused_by_field() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    killed(&out, || out.join("config.toml").exists());
    let text = fs::read_to_string(out.join("config.toml")).unwrap();
    let edited = folder.path().join("edited.toml");
    let begin = || {
        let mut command = program();
        command.arg("run").arg("--config").arg(&edited).arg("-o").arg(folder.path().join("new"));
        command
    };
    for (field, old, new) in [
        ("schedule.iterations", "iterations = 120", "iterations = 4000000000"),
        ("prune.average_from", "average_from = 0.43333333333333335", "average_from = 1e10"),
        ("max_gaussians", "max_gaussians = 4000000", "max_gaussians = 9223372036854775807"),
        ("sh_degree", "sh_degree = 3", "sh_degree = 10"),
        ("unknown field `sead`", "seed = 1", "sead = 1"),
        ("missing field `seed`", "seed = 1\n", ""),
    ] {
        assert!(text.contains(old), "{old} in {text}");
        fs::write(&edited, text.replace(old, new)).unwrap();
        end(&mut begin()).with(3, &["edited.toml", field]);
    }
    fs::write(&edited, text.as_bytes().iter().rev().copied().collect::<Vec<u8>>()).unwrap();
    end(&mut begin()).with(3, &["edited.toml"]);
    fs::write(&edited, [0xff, 0xfe, 0]).unwrap();
    end(&mut begin()).with(3, &["edited.toml"]);
    assert!(!folder.path().join("new/config.toml").exists());
    assert!(Snapshot::read(&out.join("config.toml")).is_err());
}
