//! The program as a user runs it: every command, every exit code, and bad input of every kind.

use qirf_vk::gaussians::{Gaussians, formats};
use serde_json::Value;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::{Command, Output};
use tempfile::TempDir;

/// A folder with a small model, a small scene without photos, and the program.
struct House {
    folder: TempDir,
}

impl House {
    fn new() -> Self {
        let house = Self { folder: tempfile::tempdir().unwrap() };
        formats::write(&house.path("model.ply"), &model(20)).unwrap();
        house.scene("scene", "1 PINHOLE 40 30 35 35 20 15", &["b/two.png", "one.jpg"]);
        house
    }

    fn path(&self, name: &str) -> PathBuf {
        self.folder.path().join(name)
    }

    /// A COLMAP text model, its cameras four units before the origin.
    fn scene(&self, name: &str, camera: &str, images: &[&str]) -> PathBuf {
        let folder = self.path(name).join("sparse/0");
        fs::create_dir_all(&folder).unwrap();
        let lines: Vec<String> = (1..).zip(images).map(|(i, n)| format!("{i} 1 0 0 0 0.1 0 4 1 {n}\n\n")).collect();
        fs::write(folder.join("cameras.txt"), format!("{camera}\n")).unwrap();
        fs::write(folder.join("images.txt"), lines.concat()).unwrap();
        fs::write(folder.join("points3D.txt"), "1 0 0 0 10 20 30 0.5 1 0\n").unwrap();
        self.path(name)
    }

    /// Runs the program in the folder.
    fn run(&self, arguments: &[&str]) -> Ran {
        let output = Command::new(env!("CARGO_BIN_EXE_qirf-vk"))
            .args(arguments)
            .current_dir(self.folder.path())
            .env("QIRF_VALIDATION", "1")
            .output()
            .unwrap();
        Ran::new(&output, arguments)
    }

    /// Runs the program, which must end with this exit code and a message that holds all of `says`.
    fn fails(&self, code: i32, arguments: &[&str], says: &[&str]) {
        let ran = self.run(arguments);
        assert_eq!(ran.code, code, "{arguments:?}: {}", ran.err);
        assert!(ran.err.contains("error: "), "{arguments:?}: {}", ran.err);
        for words in says {
            assert!(ran.err.contains(words), "{arguments:?} should say {words:?}: {}", ran.err);
        }
    }

    /// Runs the program, which must succeed.
    fn works(&self, arguments: &[&str]) -> Ran {
        let ran = self.run(arguments);
        assert_eq!(ran.code, 0, "{arguments:?}: {}", ran.err);
        ran
    }

    /// Every file with its content.
    fn content(&self) -> Vec<(PathBuf, Vec<u8>)> {
        let mut found = Vec::new();
        let mut folders = vec![self.folder.path().to_owned()];
        while let Some(folder) = folders.pop() {
            for entry in fs::read_dir(folder).unwrap() {
                let path = entry.unwrap().path();
                if path.is_dir() { folders.push(path) } else { found.push((path.clone(), fs::read(path).unwrap())) }
            }
        }
        found.sort();
        found
    }
}

struct Ran {
    code: i32,
    out: String,
    err: String,
}

impl Ran {
    fn new(output: &Output, arguments: &[&str]) -> Self {
        let text = |bytes: &[u8]| String::from_utf8_lossy(bytes).into_owned();
        let (out, err) = (text(&output.stdout), text(&output.stderr));
        assert!(!err.contains("panicked"), "{arguments:?}: {err}");
        assert!(!err.contains("validation:"), "{arguments:?}: {err}");
        assert!(!err.contains('\x1b') && !out.contains('\x1b'), "{arguments:?}: colour where nobody sees it");
        Self { code: output.status.code().expect("no signal ended it"), out, err }
    }

    fn json(&self) -> Value {
        serde_json::from_str(&self.out).expect("one JSON document on standard output")
    }
}

fn model(n: usize) -> Gaussians {
    Gaussians {
        means: (0..n).map(|i| [(i as f32).sin(), (i as f32).cos(), 0.01 * i as f32]).collect(),
        log_scales: vec![[-1.5, -2.0, -1.8]; n],
        rotations: vec![[0.9, 0.1, 0.3, -0.2]; n],
        opacity_logits: vec![1.5; n],
        sh: vec![vec![0.7; n * 3], vec![0.05; n * 9]],
    }
}

fn size(path: &Path) -> (u32, u32) {
    image::image_dimensions(path).unwrap()
}

#[test]
fn pictures_of_a_scene_are_named_after_its_images() {
    let house = House::new();
    let ran = house.works(&["render", "model.ply", "--scene", "scene", "-o", "out"]);
    assert!(ran.out.is_empty() && ran.err.contains("2 pictures"), "{}", ran.err);
    let first = fs::read(house.path("out/one.png")).unwrap();
    assert_eq!((size(&house.path("out/one.png")), size(&house.path("out/b/two.png"))), ((40, 30), (40, 30)));
    let picture = image::open(house.path("out/one.png")).unwrap().into_rgb8();
    assert!(picture.pixels().any(|p| p.0[0] > 60), "something is drawn");

    // Again: the same bytes in the same place. Half the size; quiet.
    house.works(&["render", "model.ply", "--scene", "scene", "-o", "out"]);
    assert_eq!(fs::read(house.path("out/one.png")).unwrap(), first);
    let ran = house.works(&["-q", "render", "model.ply", "--scene", "scene", "-o", "half", "--resolution", "/2"]);
    assert!(ran.err.is_empty() && ran.out.is_empty());
    assert_eq!(size(&house.path("half/b/two.png")), (20, 15));
    house.works(&["render", "model.ply", "--scene", "scene/sparse/0", "-o", "w", "--resolution", "10"]);
    assert_eq!(size(&house.path("w/one.png")), (10, 8));
}

#[test]
fn npy_holds_float32_height_width_4() {
    let house = House::new();
    let background = ["--background", "0.25,0.5,1"];
    house.works(
        &[&["render", "model.ply", "--scene", "scene", "-o", "out", "--format", "npy"], &background[..]].concat(),
    );
    let file =
        npyz::NpyFile::new(fs::File::open(house.path("out/one.npy")).map(std::io::BufReader::new).unwrap()).unwrap();
    assert_eq!(file.shape(), [30, 40, 4]);
    assert_eq!(file.order(), npyz::Order::C);
    let values: Vec<f32> = file.into_vec().unwrap();
    let empty = values.chunks_exact(4).find(|p| p[3] == 0.0).expect("a pixel without Gaussians");
    assert_eq!(empty, [0.25, 0.5, 1.0, 0.0]);

    // The PNG holds the same values in 8 bits.
    house.works(&[&["render", "model.ply", "--scene", "scene", "-o", "out"], &background[..]].concat());
    let picture = image::open(house.path("out/one.png")).unwrap().into_rgb8();
    for (pixel, value) in picture.pixels().zip(values.chunks_exact(4)) {
        for c in 0..3 {
            assert!((f32::from(pixel.0[c]) / 255.0 - value[c].clamp(0.0, 1.0)).abs() < 0.51 / 255.0);
        }
    }
}

#[test]
fn orbits_of_any_model_show_it() {
    let house = House::new();
    house.works(&["render", "model.ply", "--orbit", "3", "-o", "out", "--size", "64x48", "--up", "-z", "--fov", "60"]);
    for i in 0..3 {
        let path = house.path(&format!("out/orbit_00{i}.png"));
        assert_eq!(size(&path), (64, 48));
        let picture = image::open(path).unwrap().into_rgb8();
        assert!(picture.pixels().filter(|p| p.0[0] > 30).count() > 100);
    }
    house.works(&[
        "render",
        "model.ply",
        "--orbit",
        "1",
        "-o",
        "clear",
        "--size",
        "64x48",
        "--transparent",
        "--antialias",
    ]);
    let picture = image::open(house.path("clear/orbit_000.png")).unwrap();
    assert!(picture.color().has_alpha());
    assert!(picture.into_rgba8().pixels().any(|p| p.0[3] == 0));

    // One Gaussian, none at all, a picture of one pixel, a model a thousandth the size.
    let mut tiny = model(20);
    tiny.means.iter_mut().flatten().for_each(|v| *v *= 1e-3);
    tiny.log_scales.iter_mut().flatten().for_each(|v| *v -= 6.9);
    for (name, model) in [("lone.ply", model(1)), ("none.ply", model(0)), ("tiny.ply", tiny)] {
        formats::write(&house.path(name), &model).unwrap();
        house.works(&["render", name, "--orbit", "1", "-o", name.trim_end_matches(".ply"), "--size", "32x32"]);
        house.works(&["render", name, "--orbit", "1", "-o", "one", "--size", "1x1"]);
    }
    let shown = |name: &str| {
        let picture = image::open(house.path(name).join("orbit_000.png")).unwrap().into_rgb8();
        picture.pixels().filter(|p| p.0[0] > 30).count()
    };
    assert!(shown("lone") > 20 && shown("tiny") > 50 && shown("none") == 0);
}

#[test]
fn models_are_converted_and_never_over_themselves() {
    let house = House::new();
    house.works(&["convert", "model.ply", "model.spz"]);
    house.works(&["convert", "model.ply", "copy.ply"]);
    assert_eq!(formats::read(&house.path("copy.ply")).unwrap().gaussians, model(20));
    let ran = house.works(&["inspect", "model.spz", "--json"]);
    assert_eq!(ran.json()["gaussians"], 20);

    let before = house.content();
    house.fails(2, &["convert", "model.ply", "model.ply"], &["model.ply", "another name"]);
    house.fails(2, &["convert", "model.ply", "./scene/../model.ply"], &["another name"]);
    house.fails(2, &["convert", "model.ply", "model.obj"], &["model.obj", ".ply, .spz or .sog"]);
    house.fails(2, &["convert", "model.ply", "scene"], &["scene", "folder"]);
    house.fails(3, &["convert", "absent.ply", "out.ply"], &["absent.ply", "check"]);
    house.fails(5, &["convert", "model.ply", "absent/out.ply"], &["absent"]);
    assert_eq!(house.content(), before, "nothing was written or changed");
}

#[test]
fn inspect_tells_what_is_there() {
    let house = House::new();
    let model = house.works(&["inspect", "model.ply", "--json"]).json();
    assert_eq!((&model["kind"], &model["format"]), (&"model".into(), &"PLY".into()));
    assert_eq!((&model["gaussians"], &model["sh_degree"]), (&20.into(), &1.into()));
    assert_eq!(model["bytes"], fs::metadata(house.path("model.ply")).unwrap().len());
    assert!(model["opacity"]["p50"].as_f64().is_some_and(|o| (o - 0.8176).abs() < 1e-3));
    assert_eq!(model["repairs"]["non_finite_rows"], 0);

    let scene = house.works(&["inspect", "scene", "--json"]).json();
    assert_eq!((&scene["kind"], &scene["views"]), (&"scene".into(), &2.into()));
    assert_eq!((&scene["points"], &scene["photos_present"]), (&1.into(), &0.into()));
    assert_eq!((&scene["test_views"], &scene["train_views"]), (&1.into(), &1.into()));
    for path in ["model.ply", "scene"] {
        let ran = house.works(&["inspect", path]);
        assert!(ran.out.lines().count() > 8 && !ran.out.contains('{'), "{}", ran.out);
    }
}

#[test]
fn a_synthetic_capture_can_be_made_inspected_and_rendered() {
    let house = House::new();
    let make = ["synth", "made", "--views", "3", "--size", "32x24", "--seed", "7", "--points", "50", "--effects"];
    house.works(&[&make[..], &["distortion,alpha"]].concat());
    let scene = house.works(&["inspect", "made", "--json"]).json();
    assert_eq!((&scene["views"], &scene["photos_with_alpha"]), (&3.into(), &3.into()));
    assert!(scene["cameras"][0]["distortion_px"].as_f64().is_some_and(|d| d > 0.1));
    house.works(&["render", "model.ply", "--scene", "made", "-o", "out"]);
    assert_eq!(fs::read_dir(house.path("out")).unwrap().count(), 3);

    let before = house.content();
    // Pictures never land among photos.
    house.fails(2, &["render", "model.ply", "--scene", "made", "-o", "made/images"], &["photos", "-o"]);
    house.fails(2, &[&make[..], &["gloss"]].concat(), &["gloss", "glossy"]);
    house.fails(2, &["synth", "made", "--effects", "glossy,matte"], &["exclude"]);
    house.fails(2, &["synth", "scene"], &["not empty"]);
    house.fails(2, &["synth", "model.ply"], &["file"]);
    house.fails(2, &["synth", "new", "--views", "0"], &["views"]);
    assert_eq!(house.content(), before, "nothing was written or changed");
}

#[test]
fn this_machine_tells_and_checks_its_device() {
    let house = House::new();
    let devices = house.works(&["device", "--json"]).json();
    let index = devices["chosen"].as_u64().unwrap();
    assert!(devices["devices"].as_array().unwrap().iter().any(|d| d["index"] == index));
    let chosen = index.to_string();
    assert!(house.works(&["device", "--device", &chosen]).out.lines().any(|l| l.starts_with(&format!("* {chosen} "))));
    house.fails(4, &["device", "--device", "no such device"], &["no such device", "there are"]);
    house.fails(4, &["render", "model.ply", "--orbit", "1", "-o", "o", "--device", "99"], &["99"]);
    assert!(!house.path("o").exists());

    let told = house.works(&["selftest", "--quick", "--json"]).json();
    assert_eq!(told["passed"], true);
    let checks = told["checks"].as_array().unwrap();
    assert!(checks.len() > 8 && checks.iter().all(|c| c["seen"].as_f64() <= c["allowed"].as_f64()));
}

#[test]
fn a_wrong_command_line_is_usage() {
    let house = House::new();
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
        with(&["--scene", "scene", "--resolution", "/0"]),
        with(&["--scene", "scene", "--size", "5x5"]),
        with(&["--scene", "scene", "--images", "images_4"]),
        vec!["render", "model.ply", "--orbit", "1", "-o", "model.ply"],
        vec!["synth", "x", "--size", "2x2"],
        vec!["inspect", "model.ply", "-q", "-v"],
        vec!["completions", "cobol"],
    ] {
        house.fails(2, &arguments, &[]);
    }
    assert!(!house.path("out").exists());
    assert_eq!(formats::read(&house.path("model.ply")).unwrap().gaussians, model(20));
}

#[test]
fn help_and_completions_are_there() {
    let house = House::new();
    for command in ["render", "convert", "inspect", "synth", "device", "selftest", "completions"] {
        let ran = house.works(&[command, "--help"]);
        assert!(ran.out.contains("Examples:") && ran.out.contains("Global options:"), "{command}");
        assert!(house.works(&["--help"]).out.contains(command));
    }
    for shell in ["bash", "zsh", "fish", "powershell", "elvish"] {
        assert!(house.works(&["completions", shell]).out.contains("selftest"), "{shell}");
    }
    assert!(house.works(&["--version"]).out.starts_with("qirf-vk "));
}

#[test]
fn bad_models_are_refused_by_name_or_salvaged() {
    let house = House::new();
    let good = fs::read(house.path("model.ply")).unwrap();
    let body = good.windows(11).position(|w| w == b"end_header\n").unwrap() + 11;
    let write = |name: &str, bytes: &[u8]| fs::write(house.path(name), bytes).unwrap();
    write("cut.ply", &good[..good.len() - 5]);
    write("header.ply", &good[..40]);
    write("empty.ply", b"");
    let header = String::from_utf8_lossy(&good[..body]).replace("vertex 20", "vertex 4000000000");
    write("claims.ply", &[header.as_bytes(), &good[body..]].concat());
    write("noise.spz", &[7; 300]);
    write("noise.sog", b"PK\x03\x04nothing");
    write("photo.jpg", &[0xff, 0xd8, 0xff, 0xe0]);
    fs::create_dir(house.path("sog")).unwrap();
    write("sog/meta.json", b"{\"version\": 2, \"count\": 99999999999}");
    for name in
        ["cut.ply", "header.ply", "empty.ply", "claims.ply", "noise.spz", "noise.sog", "photo.jpg", "sog", "absent.ply"]
    {
        house.fails(3, &["inspect", name], &[name]);
        house.fails(3, &["render", name, "--orbit", "1", "-o", "out"], &[name]);
        house.fails(3, &["convert", name, "out.ply"], &[name]);
    }
    assert!(!house.path("out").exists() && !house.path("out.ply").exists());

    // A NaN row is left out, infinite logits are clamped, and both are told.
    let mut hurt = model(20);
    hurt.means[3][1] = f32::NAN;
    hurt.opacity_logits[5] = f32::INFINITY;
    formats::write(&house.path("hurt.ply"), &hurt).unwrap();
    let ran = house.works(&["render", "hurt.ply", "--orbit", "1", "-o", "hurt", "--size", "16x16"]);
    assert!(ran.err.contains("warning:") && ran.err.contains("1 Gaussians removed"), "{}", ran.err);
    let told = house.works(&["inspect", "hurt.ply", "--json"]).json();
    assert_eq!((&told["gaussians"], &told["repairs"]["clamped_opacities"]), (&19.into(), &1.into()));
}

#[test]
fn bad_scenes_are_refused_with_file_and_record() {
    let house = House::new();
    let render = |scene: &str, says: &[&str]| {
        house.fails(3, &["render", "model.ply", "--scene", scene, "-o", "out"], says);
        house.fails(3, &["inspect", scene], says);
    };
    render("absent", &["absent"]);
    house.scene("model", "1 FOV 40 30 35 35 20 15 0.1", &["a.jpg"]);
    render("model", &["cameras.txt", "FOV", "undistort"]);
    house.scene("short", "1 PINHOLE 40 30 35", &["a.jpg"]);
    render("short", &["cameras.txt"]);
    house.scene("nothing", "1 PINHOLE 40 30 35 35 20 15", &[]);
    render("nothing", &["images.txt"]);
    house.scene("nowhere", "2 PINHOLE 40 30 35 35 20 15", &["a.jpg"]);
    render("nowhere", &["images.txt"]);
    house.scene("huge", "1 PINHOLE 4000000000 4000000000 35 35 20 15", &["a.jpg"]);
    let ran = house.run(&["render", "model.ply", "--scene", "huge", "-o", "out"]);
    assert!(ran.code == 3 || ran.code == 5, "{}", ran.err);

    let cut = house.path("cut/sparse/0");
    fs::create_dir_all(&cut).unwrap();
    fs::write(cut.join("cameras.bin"), [9, 0, 0, 0, 0, 0, 0, 0, 1, 0]).unwrap();
    fs::write(cut.join("images.bin"), [1, 0, 0, 0, 0, 0, 0, 0]).unwrap();
    fs::write(cut.join("points3D.bin"), [0; 8]).unwrap();
    render("cut", &["cameras.bin"]);

    fs::create_dir_all(house.path("photos/images")).unwrap();
    image::RgbImage::new(8, 8).save(house.path("photos/images/a.png")).unwrap();
    render("photos", &["colmap mapper"]);
    fs::write(house.path("transforms.json"), "{\"frames\": [").unwrap();
    render("transforms.json", &["transforms.json"]);
    assert!(!house.path("out").exists());

    // A pose that is no number is left out and counted; the other view is rendered.
    let scene = house.scene("pose", "1 PINHOLE 40 30 35 35 20 15", &["a.jpg"]);
    let images = scene.join("sparse/0/images.txt");
    let text = fs::read_to_string(&images).unwrap() + "7 1 0 0 0 nan 0 4 1 b.jpg\n\n";
    fs::write(&images, text).unwrap();
    let ran = house.works(&["render", "model.ply", "--scene", "pose", "-o", "posed"]);
    assert!(ran.err.contains("b.jpg"), "{}", ran.err);
    assert!(house.path("posed/a.png").is_file() && !house.path("posed/b.png").exists());
}

#[test]
fn what_cannot_be_held_or_written_is_resources() {
    let house = House::new();
    // More pixels than any device binds in one buffer.
    house.fails(5, &["render", "model.ply", "--orbit", "1", "-o", "out", "--size", "65535x65535"], &["bytes"]);
    assert!(!house.path("out").exists());
    // A file where a folder must be made.
    house.fails(5, &["render", "model.ply", "--orbit", "1", "-o", "model.ply/out", "--size", "8x8"], &["model.ply"]);
    #[cfg(target_os = "linux")]
    {
        let full = fs::OpenOptions::new().write(true).open("/dev/full").unwrap();
        let ran =
            Command::new(env!("CARGO_BIN_EXE_qirf-vk")).args(["completions", "bash"]).stdout(full).output().unwrap();
        assert_eq!(ran.status.code(), Some(5));
        assert!(String::from_utf8_lossy(&ran.stderr).contains("standard output"));
    }
}

#[cfg(unix)]
#[test]
fn ctrl_c_ends_with_130_and_whole_pictures() {
    use std::process::Stdio;
    let house = House::new();
    let mut child = Command::new(env!("CARGO_BIN_EXE_qirf-vk"))
        .args(["render", "model.ply", "--orbit", "100000", "-o", "out", "--size", "64x48"])
        .current_dir(house.folder.path())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let begun = std::time::Instant::now();
    while !house.path("out/orbit_000003.png").exists() {
        assert!(begun.elapsed().as_secs() < 60 && child.try_wait().unwrap().is_none(), "no picture came");
        std::thread::sleep(std::time::Duration::from_millis(10));
    }
    assert!(Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap().success());
    let output = child.wait_with_output().unwrap();
    assert_eq!(output.status.code(), Some(130));
    assert!(String::from_utf8_lossy(&output.stderr).contains("interrupted"));
    for entry in fs::read_dir(house.path("out")).unwrap() {
        let path = entry.unwrap().path();
        assert!(path.extension().is_some_and(|e| e == "png") && image::open(&path).is_ok(), "{}", path.display());
    }
}

#[test]
fn a_reader_that_goes_away_is_no_error() {
    let mut child = Command::new(env!("CARGO_BIN_EXE_qirf-vk"))
        .args(["completions", "zsh"])
        .stdout(std::process::Stdio::piped())
        .stderr(std::process::Stdio::piped())
        .spawn()
        .unwrap();
    drop(child.stdout.take());
    let output = child.wait_with_output().unwrap();
    assert_eq!(output.status.code(), Some(0));
    assert!(output.stderr.is_empty());
}
