//! `convert`, `inspect`, `synth`, `device`, `selftest`, help and completions.

use super::{Sandbox, model};
use crate::program::ended::{Ended, end, qirf};
use crate::support::{documented, skip};
use qirf_vk::gaussians::formats;
use std::fs;
use std::process::{Command, Stdio};
use std::time::{Duration, SystemTime};

#[test]
fn models_are_converted_and_never_over_themselves() {
    let sandbox = Sandbox::new();
    // A writer that was killed; no system numbers processes so high.
    let left = sandbox.path(".model.spz.4194305-0.tmp");
    fs::File::create(&left).unwrap().set_modified(SystemTime::now() - Duration::from_secs(7200)).unwrap();
    sandbox.converts(&["model.ply", "model.spz"]);
    assert!(!left.exists(), "its file goes");
    sandbox.works(&["convert", "model.ply", "copy.ply"]);
    assert_eq!(formats::read(&sandbox.path("copy.ply")).unwrap().gaussians, model(20));
    let ran = sandbox.works(&["inspect", "model.spz", "--json"]);
    assert_eq!(ran.json()["gaussians"], 20);

    let before = sandbox.content();
    sandbox.fails(2, &["convert", "model.ply", "model.ply"], &["model.ply", "another name"]);
    sandbox.fails(2, &["convert", "model.ply", "./scene/../model.ply"], &["another name"]);
    sandbox.fails(2, &["convert", "model.ply", "model.obj"], &["model.obj", ".ply, .compressed.ply, .spz"]);
    sandbox.fails(2, &["convert", "model.ply", "scene"], &["scene", "folder"]);
    sandbox.fails(3, &["convert", "absent.ply", "out.ply"], &["absent.ply", "check"]);
    sandbox.fails(5, &["convert", "model.ply", "absent/out.ply"], &["absent"]);
    assert_eq!(sandbox.content(), before, "nothing was written or changed");
}

#[test]
fn inspect_tells_what_is_there() {
    let sandbox = Sandbox::new();
    let model = sandbox.works(&["inspect", "model.ply", "--json"]).json();
    assert_eq!((&model["kind"], &model["format"]), (&"model".into(), &"PLY".into()));
    assert_eq!((&model["gaussians"], &model["sh_degree"]), (&20.into(), &1.into()));
    assert_eq!(model["bytes"], fs::metadata(sandbox.path("model.ply")).unwrap().len());
    assert!(model["opacity"]["p50"].as_f64().is_some_and(|o| (o - 0.8176).abs() < 1e-3));
    assert_eq!(model["repairs"]["non_finite_rows"], 0);

    let scene = sandbox.works(&["inspect", "scene", "--json"]).json();
    assert_eq!((&scene["kind"], &scene["views"]), (&"scene".into(), &2.into()));
    assert_eq!((&scene["points"], &scene["photos_present"]), (&1.into(), &0.into()));
    assert_eq!((&scene["test_views"], &scene["train_views"]), (&1.into(), &1.into()));
    documented("inspect", &model);
    documented("inspect", &scene);
    let masked = sandbox.works(&["inspect", "scene", "--pole-mask", "20", "--json"]).json();
    assert!(masked["skipped"].to_string().contains("--pole-mask masks nothing"), "{masked:#}");
    for path in ["model.ply", "scene"] {
        let ran = sandbox.works(&["inspect", path]);
        assert!(ran.out.lines().count() > 8 && !ran.out.contains('{'), "{}", ran.out);
    }
}

/// Beside `sparse`, named from within the capture, photos may lie in any folder.
#[test]
fn a_model_in_the_current_folder_has_its_photos_beside_it() {
    let sandbox = Sandbox::new();
    let capture = sandbox.scene("capture", "1 PINHOLE 40 30 35 35 20 15", &["b/two.png", "one.png"]);
    let pictures = capture.join("pictures");
    fs::create_dir_all(pictures.join("b")).unwrap();
    for name in ["one.png", "b/two.png"] {
        image::RgbImage::new(40, 30).save(pictures.join(name)).unwrap();
    }
    let mut command = sandbox.command(&["inspect", "sparse", "--json"]);
    let ran = end(command.current_dir(capture)).with(0, &[]);
    assert_eq!(ran.json()["photos_present"], 2);
}

#[test]
fn inspect_tells_of_exif_rotations() {
    use exif::{Field, In, Tag, Value, experimental::Writer};
    use image::ImageEncoder;
    let sandbox = Sandbox::new();
    let images = sandbox.scene("capture", "1 PINHOLE 40 30 35 35 20 15", &["a.png", "b.png"]).join("images");
    fs::create_dir_all(&images).unwrap();
    for (name, orientation) in [("a.png", 1), ("b.png", 3)] {
        let field = Field { tag: Tag::Orientation, ifd_num: In::PRIMARY, value: Value::Short(vec![orientation]) };
        let mut writer = Writer::new();
        writer.push_field(&field);
        let mut header = std::io::Cursor::new(Vec::new());
        writer.write(&mut header, false).unwrap();
        let mut encoder = image::codecs::png::PngEncoder::new(fs::File::create(images.join(name)).unwrap());
        encoder.set_exif_metadata(header.into_inner()).unwrap();
        encoder.write_image(&[90; 3 * 40 * 30], 40, 30, image::ExtendedColorType::Rgb8).unwrap();
    }
    let advice = sandbox.works(&["inspect", "capture", "--json"]).json()["advice"].to_string();
    assert!(advice.contains("1 photo with an EXIF rotation, which is ignored, as in COLMAP"), "{advice}");
}

#[test]
fn a_synthetic_capture_can_be_made_inspected_and_rendered() {
    let sandbox = Sandbox::new();
    let make = ["synth", "made", "--views", "3", "--size", "32x24", "--seed", "7", "--points", "50", "--effects"];
    sandbox.works(&[&make[..], &["distortion,alpha"]].concat());
    let scene = sandbox.works(&["inspect", "made", "--json"]).json();
    assert_eq!((&scene["views"], &scene["photos_with_alpha"]), (&3.into(), &3.into()));
    assert!(scene["cameras"][0]["distortion_px"].as_f64().is_some_and(|d| d > 0.1));
    sandbox.works(&["render", "model.ply", "--scene", "made", "-o", "out"]);
    assert_eq!(fs::read_dir(sandbox.path("out")).unwrap().count(), 3);

    let before = sandbox.content();
    // Pictures are never written among photos.
    sandbox.fails(2, &["render", "model.ply", "--scene", "made", "-o", "made/images"], &["photos", "-o"]);
    sandbox.fails(2, &[&make[..], &["gloss"]].concat(), &["gloss", "glossy"]);
    sandbox.fails(2, &["synth", "made", "--effects", "glossy,matte"], &["exclude"]);
    sandbox.fails(2, &["synth", "scene"], &["not empty"]);
    sandbox.fails(2, &["synth", "model.ply"], &["file"]);
    sandbox.fails(2, &["synth", "new", "--views", "0"], &["views"]);
    assert_eq!(sandbox.content(), before, "nothing was written or changed");
}

#[test]
fn this_machine_tells_and_checks_its_device() {
    let sandbox = Sandbox::new();
    let devices = sandbox.works(&["device", "--json"]).json();
    let index = devices["chosen"].as_u64().unwrap();
    assert!(devices["devices"].as_array().unwrap().iter().any(|d| d["index"] == index));
    let chosen = index.to_string();
    assert!(
        sandbox.works(&["device", "--device", &chosen]).out.lines().any(|l| l.starts_with(&format!("* {chosen} ")))
    );
    sandbox.fails(4, &["device", "--device", "no such device"], &["no such device", "there are"]);
    sandbox.fails(4, &["render", "model.ply", "--orbit", "1", "-o", "o", "--device", "99"], &["99"]);
    assert!(!sandbox.path("o").exists());

    let told = sandbox.validated(&["selftest", "--quick", "--json"]).json();
    assert_eq!(told["passed"], true);
    let checks = told["checks"].as_array().unwrap();
    assert_eq!(told["counts"]["pass"], checks.len());
    assert!(checks.iter().all(|c| c["verdict"] == "pass"));
    assert!(checks.len() > 8 && checks.iter().all(|c| c["seen"].as_f64() <= c["allowed"].as_f64()));
}

#[test]
fn help_and_completions_are_there() {
    let sandbox = Sandbox::new();
    for command in ["render", "edit", "convert", "inspect", "synth", "device", "selftest", "completions"] {
        let ran = sandbox.works(&[command, "--help"]);
        assert!(ran.out.contains("Examples:") && ran.out.contains("Global options:"), "{command}");
        assert!(sandbox.works(&["--help"]).out.contains(command));
    }
    // Help offers nothing that is always refused, and says what an option does in its command.
    for (command, there, not_there) in [
        (&["shard", "plan", "compress"][..], "--size <WxH>", "--psnr"),
        (&["shard", "plan", "run"], "--schedule <attrition|one-shot>", "gradual"),
        (&["edit"], "For --remove floaters only. Variance", "--psnr"),
        (&["run"], "`qirf-vk train` is another name", "--init-count"),
        (&["compress"], "`qirf-vk compare --help` lists options for experiments", "--epsilon"),
        (&["shard", "plan", "run"], "`qirf-vk compare --help` lists options for experiments", "--solver <"),
    ] {
        let help = sandbox.works(&[command, &["--help"]].concat()).out;
        assert!(help.contains(there) && !help.contains(not_there), "{help}");
    }
    assert!(sandbox.works(&["help"]).out.contains("Training and compression:"));
    assert!(sandbox.works(&["help", "run"]).out.contains("--grow-to"));
    sandbox.fails(2, &["trian"], &["'train'"]);
    for shell in ["bash", "zsh", "fish", "powershell", "elvish"] {
        assert!(sandbox.works(&["completions", shell]).out.contains("selftest"), "{shell}");
    }
    assert!(sandbox.works(&["--version"]).out.starts_with("qirf-vk "));
}

/// Options and values after a command, in a shell that is there.
#[test]
fn bash_completes_what_follows_a_command() {
    let sandbox = Sandbox::new();
    let script = sandbox.works(&["completions", "bash"]).out;
    let asked = r#"
        complete_words() {
            COMP_WORDS=("$@"); COMP_CWORD=$(($# - 1)); COMPREPLY=()
            _qirf__vk qirf-vk "${@: -1}" "${@: -2:1}"
            echo "${COMPREPLY[@]}"
        }
        complete_words qirf-vk run --
        complete_words qirf-vk shard plan compress --ke
        complete_words qirf-vk run --color al
    "#;
    let file = sandbox.path("completions.bash");
    fs::write(&file, script + asked).unwrap();
    let Ok(output) = Command::new("bash").arg(&file).output() else { return skip("no bash") };
    let told = String::from_utf8_lossy(&output.stdout);
    let lines: Vec<&str> = told.lines().collect();
    assert!(lines.len() == 3 && lines[0].contains("--schedule "), "{told}");
    assert_eq!(lines[1..], ["--keep", "always"], "{told}");
}

#[test]
fn a_reader_that_goes_away_is_no_error() {
    let mut command = qirf(["completions", "zsh"]);
    let mut child = command.stdout(Stdio::piped()).stderr(Stdio::piped()).spawn().unwrap();
    drop(child.stdout.take());
    assert!(Ended::of(&child.wait_with_output().unwrap()).with(0, &[]).said.is_empty());
}
