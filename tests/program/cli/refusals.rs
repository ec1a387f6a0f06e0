//! Wrong command lines, bad models, bad scenes, pictures too large, outputs that cannot be written: exit codes and
//! messages.

use super::{Sandbox, model};
#[cfg(target_os = "linux")]
use crate::program::ended::{end, qirf};
use crate::support::documented;
use qirf_vk::gaussians::formats;
use std::fs;

#[test]
fn a_wrong_command_line_is_usage() {
    let sandbox = Sandbox::new();
    let render = ["render", "model.ply", "-o", "out"];
    let with = |more: &[&'static str]| [&render[..], more].concat();
    for arguments in [
        vec!["paint"],
        vec!["render"],
        vec!["render", "model.ply", "--orbit", "2"],
        with(&[]),
        with(&["--orbit", "0"]),
        with(&["--orbit", "-1"]),
        with(&["--orbit", "many"]),
        with(&["--orbit", "2", "--scene", "scene"]),
        with(&["--orbit", "2", "--resolution", "/2"]),
        with(&["--orbit", "2", "--size", "0x5"]),
        with(&["--orbit", "2", "--size", "99999999999x5"]),
        with(&["--orbit", "2", "--fov", "nan"]),
        with(&["--orbit", "2", "--up", "w"]),
        with(&["--orbit", "2", "--format", "gif"]),
        with(&["--orbit", "2", "--background", "1,2,3"]),
        with(&["--orbit", "2", "--format", "npy", "--transparent"]),
        with(&["--orbit", "2", "--fps", "25"]),
        with(&["--orbit", "2", "--at", "0,0,0"]),
        with(&["--path", "orbit", "--elevation", "10", "--resolution", "/4"]),
        with(&["--path", "orbit", "--fov", "20", "--images", "images_4"]),
        with(&["--scene", "scene", "--resolution", "/0"]),
        with(&["--scene", "scene", "--size", "5x5"]),
        with(&["--scene", "scene", "--images", "images_4"]),
        vec!["render", "model.ply", "--orbit", "1", "-o", "model.ply"],
        vec!["synth", "x", "--size", "2x2"],
        vec!["inspect", "model.ply", "-q", "-v"],
        vec!["completions", "cobol"],
        vec!["inspect", "model.ply", "--images", "images_4"],
        vec!["inspect", "scene", "--html", "model.ply"],
        vec!["convert", "model.ply", "model.sog", "--spz-version", "3"],
        vec!["compress", "model.ply", "-o", "small.ply", "--report", "./small.ply"],
        vec!["compress", "model.ply", "-o", "out", "--curve", "sog", "--peer", "none", "--view"],
        vec!["compress", "model.ply", "-o", "out", "--curve", "sog", "--peer", "none", "--port", "8080"],
        vec!["compress", "model.ply", "-o", "out", "--curve", "sog", "--peer", "none", "--host", "127.0.0.1"],
        vec!["eval", "model.ply", "--against", "model.ply", "--pole-mask", "20"],
        vec!["eval", "model.ply", "--against", "model.ply", "--scratch", "."],
        vec!["compress", "model.ply", "-o", "small.ply", "--scratch", "."],
        vec!["compress", "model.ply", "-o", "small.ply", "--views", "16", "--scratch", "."],
        vec!["compress", "model.ply", "-o", "small.ply", "--views", "16", "--eval-every", "4"],
        vec!["compress", "model.ply", "-o", "small.ply", "--up", "y", "--resolution", "100"],
        vec!["edit", "model.ply", "-o", "cut.ply", "--min-opacity", "0.1", "--dilation", "0.1"],
        vec!["device", "--tune", "9", "--fingerprint"],
        vec!["run", "scene", "-o", "out", "--antialias", "--effect", "antialias=off"],
        vec!["run", "scene", "-o", "out", "--sh-degree", "1", "--effect", "view_dependence=off"],
        vec!["run", "scene", "-o", "out", "--effect", "exposure=on", "--effect", "exposure=off"],
        vec!["run", "scene", "-o", "out", "--no-prune", "--keep", "0.2"],
        vec!["run", "scene", "-o", "-"],
        vec!["pose", "scene", "-o", "-"],
        vec!["synth", "-"],
        vec!["shard", "plan", "compress", "model.ply", "-o", "-"],
        vec!["run", "scene", "-o", "out", "--no-prune", "--schedule", "one-shot"],
        vec!["shard", "plan", "run", "scene", "-o", "out", "--no-prune", "--selector", "css"],
    ] {
        sandbox.fails(2, &arguments, &[]);
    }
    assert!(!sandbox.path("out").exists() && !sandbox.path("-").exists());
    // The checkpoint of a comparison is no interrupted run's.
    fs::create_dir_all(sandbox.path("out/arms")).unwrap();
    sandbox.fails(2, &["run", "scene", "-o", "out", "--resume"], &["holds a comparison"]);
    assert_eq!(formats::read(&sandbox.path("model.ply")).unwrap().gaussians, model(20));
}

/// A run would end with a `config.toml` that cannot be read, and the device's solver would compute something else.
#[test]
fn options_are_refused_by_the_ranges_of_a_configuration() {
    let sandbox = Sandbox::new();
    let raw = ["--selector", "gnso", "--overlap", "raw", "--solver", "device"];
    let refused = |command: &[&str], more: &[&str], says: &[&str]| {
        sandbox.fails(2, &[command, &["-o", "out"], more].concat(), says);
    };
    for command in [
        &["run", "scene"][..],
        &["compare", "scene"],
        &["sweep", "scene", "--axis", "selector"],
        &["shard", "plan", "run", "scene"],
        &["shard", "plan", "compress", "model.ply"],
    ] {
        refused(command, &raw, &["--overlap raw with --solver device: ", "\"low-rank\""]);
        let far = ["--selector", "css", "--epsilon", "1e7"];
        if !command.contains(&"compress") {
            refused(command, &far, &["--epsilon = 10000000: write a number from 0 to 1000000"]);
        }
    }
    sandbox.fails(2, &[&["compress", "model.ply", "-o", "out.ply"], &raw[..]].concat(), &["--solver device"]);
    for (option, value) in [
        ("--dilate", "1e7"),
        ("--keep", "5e-10"),
        ("--partition", "2000000"),
        ("--partition", "1e-31"),
        ("--target-count", "200000000"),
        ("--init-count", "200000000"),
    ] {
        refused(&["run", "scene"], &[option, value], &[option, " = ", "write a number from "]);
    }
    assert!(!sandbox.path("out").exists() && !sandbox.path("out.ply").exists());
}

#[test]
fn a_number_of_random_points_is_refused_where_a_run_begins_with_others() {
    let sandbox = Sandbox::new();
    sandbox.works(&["synth", "made", "--views", "3", "--size", "32x24", "--points", "50"]);
    for (init, first) in [("points", "points of made"), ("model.ply", "the model model.ply")] {
        let run = ["run", "made", "-o", "out", "--iterations", "1", "--init", init, "--init-count", "300"];
        sandbox.fails(2, &run, &["--init-count", first, "--init random"]);
    }
}

#[test]
fn bad_models_are_refused_by_name_or_salvaged() {
    let sandbox = Sandbox::new();
    let good = fs::read(sandbox.path("model.ply")).unwrap();
    let body = good.windows(11).position(|w| w == b"end_header\n").unwrap() + 11;
    let write = |name: &str, bytes: &[u8]| fs::write(sandbox.path(name), bytes).unwrap();
    write("cut.ply", &good[..good.len() - 5]);
    write("header.ply", &good[..40]);
    write("empty.ply", b"");
    let header = String::from_utf8_lossy(&good[..body]).replace("vertex 20", "vertex 4000000000");
    write("claims.ply", &[header.as_bytes(), &good[body..]].concat());
    write("noise.spz", &[7; 300]);
    write("noise.sog", b"PK\x03\x04nothing");
    write("photo.jpg", &[0xff, 0xd8, 0xff, 0xe0]);
    fs::create_dir(sandbox.path("sog")).unwrap();
    write("sog/meta.json", b"{\"version\": 2, \"count\": 99999999999}");
    for name in
        ["cut.ply", "header.ply", "empty.ply", "claims.ply", "noise.spz", "noise.sog", "photo.jpg", "sog", "absent.ply"]
    {
        sandbox.fails(3, &["inspect", name], &[name]);
        sandbox.fails(3, &["render", name, "--orbit", "1", "-o", "out"], &[name]);
        sandbox.fails(3, &["convert", name, "out.ply"], &[name]);
    }
    assert!(!sandbox.path("out").exists() && !sandbox.path("out.ply").exists());
    write("cameras_sphere.npz", b"PK\x03\x04nothing");
    sandbox.fails(3, &["inspect", "cameras_sphere.npz"], &["perhaps from NeuS"]);

    // The error names the page, not the SPZ in it.
    let mut far = model(3);
    far.means[0][0] = 1e9;
    formats::write(&sandbox.path("far.ply"), &far, formats::RenderMode::Plain).unwrap();
    sandbox.fails(2, &["convert", "far.ply", "page.html"], &["page.html: ", "remove far Gaussians"]);

    // A NaN row is left out, infinite logits are clamped, and both are reported.
    let mut hurt = model(20);
    hurt.means[3][1] = f32::NAN;
    hurt.opacity_logits[5] = f32::INFINITY;
    formats::write(&sandbox.path("hurt.ply"), &hurt, formats::RenderMode::Plain).unwrap();
    let ran = sandbox.works(&["render", "hurt.ply", "--orbit", "1", "-o", "hurt", "--size", "16x16"]);
    assert!(ran.said.contains("warning:") && ran.said.contains("1 Gaussian removed"), "{}", ran.said);
    let told = sandbox.works(&["inspect", "hurt.ply", "--json"]).json();
    assert_eq!((&told["gaussians"], &told["repairs"]["clamped_opacities"]), (&19.into(), &1.into()));
}

#[test]
fn bad_scenes_are_refused_with_file_and_record() {
    let sandbox = Sandbox::new();
    let render = |scene: &str, says: &[&str]| {
        sandbox.fails(3, &["render", "model.ply", "--scene", scene, "-o", "out"], says);
        sandbox.fails(3, &["inspect", scene], says);
    };
    render("absent", &["absent"]);
    sandbox.scene("model", "1 FISHY 40 30 35 35 20 15 0.1", &["a.jpg"]);
    render("model", &["cameras.txt", "FISHY", "undistort"]);
    sandbox.scene("short", "1 PINHOLE 40 30 35", &["a.jpg"]);
    render("short", &["cameras.txt"]);
    sandbox.scene("nothing", "1 PINHOLE 40 30 35 35 20 15", &[]);
    render("nothing", &["images.txt"]);
    sandbox.scene("nowhere", "2 PINHOLE 40 30 35 35 20 15", &["a.jpg"]);
    render("nowhere", &["images.txt"]);
    sandbox.scene("huge", "1 PINHOLE 4000000000 4000000000 35 35 20 15", &["a.jpg"]);
    let ran = sandbox.run(&["render", "model.ply", "--scene", "huge", "-o", "out"]);
    assert!(matches!(ran.code, Some(3 | 5)), "{}", ran.said);

    let cut = sandbox.path("cut/sparse/0");
    fs::create_dir_all(&cut).unwrap();
    fs::write(cut.join("cameras.bin"), [9, 0, 0, 0, 0, 0, 0, 0, 1, 0]).unwrap();
    fs::write(cut.join("images.bin"), [1, 0, 0, 0, 0, 0, 0, 0]).unwrap();
    fs::write(cut.join("points3D.bin"), [0; 8]).unwrap();
    render("cut", &["cameras.bin"]);

    fs::create_dir_all(sandbox.path("photos/images")).unwrap();
    image::RgbImage::new(8, 8).save(sandbox.path("photos/images/a.png")).unwrap();
    render("photos", &["qirf-vk pose photos"]);
    fs::write(sandbox.path("transforms.json"), "{\"frames\": [").unwrap();
    render("transforms.json", &["transforms.json"]);
    assert!(!sandbox.path("out").exists());

    // A NaN pose is left out and counted; the other view is rendered.
    let scene = sandbox.scene("pose", "1 PINHOLE 40 30 35 35 20 15", &["a.jpg"]);
    let images = scene.join("sparse/0/images.txt");
    let text = fs::read_to_string(&images).unwrap() + "7 1 0 0 0 nan 0 4 1 b.jpg\n\n";
    fs::write(&images, text).unwrap();
    let ran = sandbox.works(&["render", "model.ply", "--scene", "pose", "-o", "posed"]);
    assert!(ran.said.contains("b.jpg"), "{}", ran.said);
    assert!(sandbox.path("posed/a.png").is_file() && !sandbox.path("posed/b.png").exists());
}

/// Names of files are bytes, which are not always UTF-8.
#[test]
#[cfg(target_os = "linux")]
fn names_in_other_encodings_are_names() {
    use std::os::unix::ffi::OsStrExt;
    let sandbox = Sandbox::new();
    let named = |name: &[u8]| sandbox.path("x").with_file_name(std::ffi::OsStr::from_bytes(name));
    let (model, out) = (named(b"m\xe9.ply"), named(b"o\xe9.ply"));
    fs::rename(sandbox.path("model.ply"), &model).unwrap();
    let works = |arguments: &[&std::ffi::OsStr]| end(&mut qirf(arguments)).with(0, &[]);
    works(&["inspect".as_ref(), model.as_ref(), "--json".as_ref()]);
    works(&["edit".as_ref(), model.as_ref(), "-o".as_ref(), out.as_ref(), "--json".as_ref()]);
    assert!(out.is_file());
}

#[test]
fn what_cannot_be_held_or_written_is_resources() {
    let sandbox = Sandbox::new();
    // More pixels than any device binds in one buffer.
    sandbox.fails(
        5,
        &["render", "model.ply", "--orbit", "1", "-o", "out", "--size", "65535x65535"],
        &["65535 x 65535", "memory"],
    );
    assert!(!sandbox.path("out").exists());
    // A file where a folder must be made.
    sandbox.fails(5, &["render", "model.ply", "--orbit", "1", "-o", "model.ply/out", "--size", "8x8"], &["model.ply"]);
    #[cfg(target_os = "linux")]
    {
        let pipe = sandbox.path("pipe.ply");
        assert!(std::process::Command::new("mkfifo").arg(&pipe).status().unwrap().success());
        for command in [&["convert", "model.ply", "pipe.ply"][..], &["compress", "model.ply", "-o", "pipe.ply"]] {
            sandbox.fails(2, command, &["pipe.ply: this is a device, a pipe or a socket", "results are files"]);
        }
        let full = fs::OpenOptions::new().write(true).open("/dev/full").unwrap();
        end(qirf(["completions", "bash"]).stdout(full)).with(5, &["standard output"]);
    }
}

#[test]
fn a_largest_number_below_what_there_is_says_so() {
    let sandbox = Sandbox::new();
    sandbox.works(&["synth", "made", "--views", "9", "--size", "48x36", "--points", "400"]);
    let run = ["run", "made", "-o", "out", "--iterations", "2", "--max-gaussians", "90", "--target-count", "500"];
    let ended = sandbox.works(&[&run[..], &["--no-report", "--size", "9kB", "--json"]].concat()).with(
        0,
        &[
            " points are thinned out to 90, as many as are allowed",
            "500 Gaussians were asked for, and the model has ",
            ": --max-gaussians 90 allows no more",
        ],
    );
    assert!(ended.json()["packed"]["output"]["bytes"].as_u64().is_some_and(|bytes| bytes <= 9000), "{}", ended.out);
    documented("metrics.json", &serde_json::json!({ "packed": null }));
}
