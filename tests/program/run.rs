//! Whole runs of the real binary: their files and figures.

use super::cli::model as small_model;
use super::ended::{Ended, capture, end, qirf, works};
use crate::support::{new_device, runs};
use qirf_vk::gaussians::formats::{self, RenderMode};
use qirf_vk::gpu::Device;
use qirf_vk::job::run_log::LogLine;
use qirf_vk::job::{Init, Preset, RunConfig, Session, Silent};
use qirf_vk::metrics::Networks;
use qirf_vk::pipeline::setup::Setup;
use qirf_vk::pipeline::{prepare, run};
use qirf_vk::scene::{PhotoMemory, Pixels};
use std::ffi::OsStr;
use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::OnceLock;
use tempfile::TempDir;

pub fn scene(folder: &Path) -> PathBuf {
    capture(folder, 400)
}

pub fn command(scene: &Path, out: &Path, more: &[&str]) -> Command {
    let mut command = qirf(["run".as_ref(), scene, "-o".as_ref(), out]);
    command.args(["--iterations", "240", "--checkpoint-every", "20"]).args(more);
    command
}

/// A whole run, made once: its scene, its folder, and what it printed. Tests leave both folders as they are.
pub struct Finished {
    _folder: TempDir,
    pub scene: PathBuf,
    pub out: PathBuf,
    pub ended: Ended,
}

impl Finished {
    fn with(options: &[&str]) -> Self {
        let folder = tempfile::tempdir_in(env!("CARGO_TARGET_TMPDIR")).unwrap();
        let (scene, out) = (scene(folder.path()), folder.path().join("out"));
        let ended = works(&mut command(&scene, &out, &[options, &["--json", "-v", "-v"]].concat()));
        Self { _folder: folder, scene, out, ended }
    }
}

/// The default run.
pub fn finished() -> &'static Finished {
    static MADE: OnceLock<Finished> = OnceLock::new();
    MADE.get_or_init(|| Finished::with(&[]))
}

/// The run with the paper's choices.
pub fn finished_as_in_the_paper() -> &'static Finished {
    static MADE: OnceLock<Finished> = OnceLock::new();
    MADE.get_or_init(|| Finished::with(&["--preset", "paper"]))
}

pub fn model(out: &Path) -> Vec<u8> {
    std::fs::read(out.join("model.ply")).expect("model.ply")
}

#[test]
fn a_run_too_short_for_its_prune_says_so() {
    let folder = tempfile::tempdir().unwrap();
    let scene = scene(folder.path());
    for (iterations, told) in [("1", true), ("2", false)] {
        let (out, file) = (folder.path().join(iterations), folder.path().join(format!("{iterations}.safetensors")));
        let mut short = qirf(["run".as_ref(), &*scene, "-o".as_ref(), &*out, "--diagnostics".as_ref(), &*file]);
        let ended = works(short.args(["--iterations", iterations, "--no-report", "--grow-to", "500"]));
        assert_eq!(ended.said.contains("the model is not pruned"), told, "{}", ended.said);
        assert_eq!(ended.said.contains(".safetensors is not written: the model was not"), told, "{}", ended.said);
        assert!(ended.said.contains("--grow-to 500: the model grew to ") && file.exists() != told, "{}", ended.said);
    }
}

#[test]
fn a_run_leaves_what_reproduces_it() {
    let folder = tempfile::tempdir().unwrap();
    let (first, second) = (&finished().out, folder.path().join("second"));
    let metrics = self::metrics(first);
    assert_eq!(finished().ended.json(), metrics);
    assert!(finished().ended.said.contains(" MiB of device memory, of "), "{}", finished().ended.said);
    for key in ["/test/psnr", "/test/ssim", "/gaussians/dense", "/gaussians/final", "/time/total_s", "/curve/0/psnr"] {
        assert!(metrics.pointer(key).is_some_and(serde_json::Value::is_number), "{key}");
    }
    assert!(metrics["test"]["psnr"].as_f64().unwrap() > 15.0, "{}", metrics["test"]);
    assert_eq!(metrics["schema"], 1);
    let time = |name: &str| metrics["time"][name].as_f64().unwrap();
    let parts = ["load_s", "start_s", "train_s", "curve_s", "evaluate_s", "write_s", "report_s"].map(time);
    let (named, total) = (parts.iter().sum::<f64>(), time("total_s"));
    assert!(parts.iter().all(|s| *s > 0.0) && named <= total && named > 0.9 * total, "{}", metrics["time"]);
    let renders = std::fs::read_dir(first.join("renders")).unwrap().flatten();
    assert_eq!(renders.filter(|e| e.path().is_file()).count(), 2);
    assert!(!first.join("checkpoint.safetensors").exists(), "a whole run leaves no checkpoint");

    // Its own config.toml gives the same bytes.
    let mut again = qirf(["run", "--json-progress", "--no-report", "--config"]);
    let printed = works(again.arg(first.join("config.toml")).arg("-o").arg(&second)).out;
    assert_eq!(model(first), model(&second), "the same run gives the same bytes");

    assert!(first.join("report.html").exists() && !second.join("report.html").exists());
    assert_eq!(self::metrics(&second)["time"]["report_s"], 0.0);

    // What it printed is its log, which agrees with its record.
    assert_eq!(printed, std::fs::read_to_string(second.join("log.jsonl")).expect("log.jsonl"));
    let log: Vec<LogLine> = printed.lines().map(|line| serde_json::from_str(line).expect("a line of JSON")).collect();
    assert!(log.len() >= 15 && log.windows(2).all(|w| w[0].iteration < w[1].iteration && w[0].seconds <= w[1].seconds));
    let (last, metrics) = (log.last().unwrap(), self::metrics(&second));
    assert_eq!(
        (last.iteration, last.iterations, last.gaussians as u64),
        (240, 240, metrics["gaussians"]["final"].as_u64().unwrap())
    );
    let curve =
        metrics["curve"].as_array().unwrap().iter().map(|point| (point["iteration"].as_u64(), point["psnr"].as_f64()));
    let logged = log.iter().filter(|line| line.psnr.is_some()).map(|line| (Some(u64::from(line.iteration)), line.psnr));
    assert!(logged.eq(curve), "{printed}");
    assert!(log.iter().all(|line| line.loss.is_some() && line.rates.means > 0.0 && line.device_bytes > 0));
}

/// Hides all of a photo by a mask.
fn hide(scene: &Path, photo: &str) {
    std::fs::create_dir_all(scene.join("masks")).unwrap();
    image::GrayImage::new(48, 36).save(scene.join("masks").join(photo)).unwrap();
}

/// Nothing of such a photo is scored, and equal backgrounds are no success.
#[test]
fn photos_hidden_by_masks_have_no_score() {
    let folder = tempfile::tempdir().unwrap();
    let scene = scene(folder.path());
    hide(&scene, "view_0000.png");
    let out = folder.path().join("out");
    let told = works(&mut command(&scene, &out, &[]));
    assert!(told.said.contains("1 of 2 held-out views have no score"), "{}", told.said);
    assert!(told.said.contains("8 photos without a mask, used as a whole (view_0001.png, "), "{}", told.said);
    let run = metrics(&out);
    let views = run["views"].as_array().unwrap();
    assert!(views[0]["psnr"].is_null() && views[0]["ssim"].is_null() && views[1]["ssim"].as_f64() < Some(0.99));
    assert_eq!((&run["test"]["psnr"], &run["test"]["ssim"]), (&views[1]["psnr"], &views[1]["ssim"]));
    let last = &run["curve"].as_array().unwrap().last().unwrap()["psnr"];
    assert_eq!((last, &run["camera_errors"]["views"]), (&views[1]["psnr"], &1.into()));
    let model = out.join("model.ply");
    let table = eval(&[model.as_ref(), scene.as_ref()]).with(0, &["1 of 2 held-out"]).out;
    assert!(table.contains("hidden") && table.contains("mean of 1 "), "{table}");

    // A training photo counts in no mean, either; and if all are hidden, there is none.
    hide(&scene, "view_0003.png");
    hide(&scene, "view_0008.png");
    let all = eval(&["--json".as_ref(), model.as_ref(), scene.as_ref()]).json();
    assert!(all["test"].is_null() && all["camera_errors"].is_null() && all["train"]["psnr"].as_f64() > Some(5.0));
}

/// A run's paths hold from any folder, and a relative scene is none of the same name elsewhere.
#[test]
fn a_configuration_can_be_used_from_another_folder() {
    let folder = tempfile::tempdir().unwrap();
    let [here, there] = ["here", "there"].map(|name| folder.path().join(name));
    for place in [&here, &there] {
        std::fs::create_dir(place).unwrap();
        capture(place, if place == &here { 400 } else { 100 });
    }
    let run = |arguments: &[&str], place: &Path| drop(works(qirf(["run"]).args(arguments).current_dir(place)));
    run(&["scene", "-o", "out", "--iterations", "20", "--no-report"], &here);
    run(&["--config", "../here/out/config.toml", "-o", "out", "--no-report"], &there);
    assert_eq!(model(&here.join("out")), model(&there.join("out")));
}

fn eval(arguments: &[&OsStr]) -> Ended {
    end(qirf(["eval"]).args(arguments))
}

pub fn metrics(out: &Path) -> serde_json::Value {
    serde_json::from_str(&std::fs::read_to_string(out.join("metrics.json")).expect("metrics.json")).expect("JSON")
}

#[test]
fn eval_gives_a_runs_model_the_runs_scores() {
    let folder = tempfile::tempdir().unwrap();
    let scene = scene(folder.path());
    let (out, again) = (folder.path().join("out"), folder.path().join("again"));
    let more = ["--iterations", "60", "--antialias", "--eval-every", "3", "--background", "0.2,0.4,0.6"];
    let mut command = qirf(["run".as_ref(), &*scene, "-o".as_ref(), &out]);
    works(command.args(["--no-prune", "--resolution", "40"]).args(more));
    let (model, config) = (out.join("model.ply"), out.join("config.toml"));
    let run = metrics(&out);
    assert_eq!(formats::read(&model).unwrap().mode.to_string(), "anti-aliased");

    let [config_flag, o] = ["--config", "-o"].map(OsStr::new);
    let text = eval(&[model.as_ref(), config_flag, config.as_ref(), o, again.as_ref()]).with(0, &[]).out;
    let scored = metrics(&again);
    for key in ["test", "train", "views"] {
        assert_eq!(run[key], scored[key], "{key}");
    }
    for key in ["background", "image_size", "test_views", "train_views", "test_split", "lpips"] {
        assert_eq!(run["protocol"][key], scored["protocol"][key], "{key}");
    }
    assert_eq!(run["gaussians"]["final"], scored["gaussians"]["final"]);
    assert_eq!(run["ply_bytes"], scored["ply_bytes"]);
    assert!(scored["gaussians"]["dense"].is_null() && scored["protocol"]["iterations"].is_null());
    let names = |v: &serde_json::Value| v.as_object().unwrap().keys().cloned().collect::<Vec<_>>();
    assert_eq!(names(&run), names(&scored), "one schema");
    for view in scored["views"].as_array().unwrap() {
        let name = view["name"].as_str().unwrap();
        let picture = Path::new("renders").join(name).with_extension("png");
        assert!(std::fs::read(out.join(&picture)).unwrap() == std::fs::read(again.join(&picture)).unwrap(), "{name}");
        assert!(text.contains(name) && text.contains(&format!("{:.3}", view["psnr"].as_f64().unwrap())), "{text}");
    }
    assert!(text.contains(&format!("{:.4}", scored["test"]["ssim"].as_f64().unwrap())), "{text}");

    // Options on the command line override the file: other options, other scores.
    let mut arguments = vec![model.as_os_str(), config_flag, config.as_ref()];
    arguments.extend(["--eval-every", "1", "--json"].map(OsStr::new));
    let json = eval(&arguments).json();
    assert_eq!((&json["protocol"]["test_views"], &json["protocol"]["train_views"]), (&9.into(), &0.into()));
    assert!(json["train"]["psnr"].is_null());
    // The model's tag says that it is anti-aliased, also in another format.
    let converted = folder.path().join("model.spz");
    works(&mut qirf(["convert".as_ref(), &*model, &converted]));
    let more = ["--resolution", "40", "--eval-every", "3", "--background", "0.2,0.4,0.6", "--json"].map(OsStr::new);
    let of = |model: &Path, options: &[&str]| -> f64 {
        let mut arguments = vec![model.as_os_str(), scene.as_ref()];
        arguments.extend(more.iter().copied().chain(options.iter().map(OsStr::new)));
        eval(&arguments).json()["test"]["psnr"].as_f64().unwrap()
    };
    let own = run["test"]["psnr"].as_f64().unwrap();
    assert_eq!(of(&model, &[]), own);
    assert!((of(&converted, &[]) - own).abs() < 0.3, "{} {own}", of(&converted, &[]));
    assert_ne!(of(&model, &["--antialias=off"]), own);
    assert_ne!(of(&model, &["--dilation", "0.3"]), own);
    // Without the file the scene's own size and background are used.
    let plain = eval(&[model.as_ref(), scene.as_ref(), "--json".as_ref()]).json();
    assert_eq!(plain["protocol"]["image_size"], serde_json::json!([48, 36]));
    assert_ne!(plain["test"], run["test"]);
}

#[test]
fn a_run_from_an_antialiased_model_is_antialiased() {
    let folder = tempfile::tempdir().unwrap();
    let scene = scene(folder.path());
    let [smooth, out] = ["smooth.ply", "out"].map(|name| folder.path().join(name));
    formats::write(&smooth, &small_model(4), RenderMode::AntiAliased).unwrap();
    for (more, antialias, says) in [
        (&[][..], true, "anti-aliased, and so is the run"),
        (&["--antialias=off"], false, "tagged as anti-aliased; the run is plain, as requested"),
        (&["--effect", "antialias=off"], false, "the run is plain"),
        (&["--antialias", "--dilation", "0.3"], true, ""),
        (
            &["--antialias", "--max-gaussians", "3"],
            true,
            "begins with all its 4 Gaussians; --max-gaussians 3 limits growth only",
        ),
    ] {
        let mut command = qirf(["run".as_ref(), &*scene, "-o".as_ref(), &out, "--init".as_ref(), &smooth]);
        command.args(["--iterations", "3", "--no-prune", "--resolution", "24", "--overwrite"]);
        let said = works(command.args(more)).said;
        assert!(said.contains(says) && says.is_empty() != said.contains("smooth.ply: "), "{more:?}: {said}");
        let config = std::fs::read_to_string(out.join("config.toml")).unwrap();
        assert!(config.contains(&format!("\nantialias = {antialias}\n")), "{more:?}: {config}");
        assert_eq!(config.contains("\ndilation = 0.3\n"), more.contains(&"0.3"), "{more:?}: {config}");
        assert_eq!(formats::read(&out.join("model.ply")).unwrap().mode, RenderMode::of(antialias), "{more:?}");
    }
}

/// Too small a budget ends the job before a photo is decoded, and advises a size that fits; a run stays within its
/// estimate.
#[test]
fn memory_is_estimated_before_the_start() {
    let folder = tempfile::tempdir().unwrap();
    let scene = scene(folder.path());
    let refused = |command: &mut Command| end(command).with(5, &[" MiB of device memory", "--memory-budget"]).said;
    let out = folder.path().join("out");
    let sizes = ["--init", "random", "--init-count", "20000", "--max-gaussians", "50000"];
    let said = refused(command(&scene, &out, &sizes).args(["--memory-budget", "40M"]));
    assert!(said.contains("allows 40 MiB") && said.contains("20000 Gaussians") && said.contains("48 x 36"), "{said}");
    assert!(!out.join("config.toml").exists(), "nothing was begun");
    // The advised size works, and the run's peak is within its estimate.
    let advised = said.split("--max-gaussians ").nth(1).and_then(|t| t.split(',').next()).expect("advice").to_owned();
    println!("advised {advised}");
    let fitting = ["--iterations", "60", "--memory-budget", "40M", "--max-gaussians", &advised, "--init", "random"];
    works(qirf(["run"]).arg(&scene).arg("-o").arg(&out).args(fitting).args(["--init-count", "20000"]));
    let memory = &metrics(&out)["memory"];
    let [estimated, peak, limit] =
        ["estimated_bytes", "peak_bytes", "limit_bytes"].map(|k| memory[k].as_u64().unwrap_or_else(|| panic!("{k}")));
    println!("estimated {estimated}, peak {peak}, limit {limit}");
    assert!(peak <= estimated && estimated <= limit && limit == 40 << 20);

    let new = folder.path().join("new");
    let said = refused(command(&scene, &new, &["--memory-budget", "1k"]).arg("--resume"));
    assert!(!said.contains("--max-gaussians"), "nothing fits: {said}");
    refused(qirf(["eval", "--memory-budget", "100k"]).arg(out.join("model.ply")).arg(&scene));
}

/// A device may bind only small buffers, whatever its memory, and the largest come with the last SH band, late in a run: that is
/// known before it begins, too.
#[test]
fn buffers_are_estimated_before_the_start() {
    let folder = tempfile::tempdir().unwrap();
    let (scene, out) = (scene(folder.path()), folder.path().join("out"));
    let run = |limit: &str, more: &[&str]| {
        let mut run = qirf(["run".as_ref(), &*scene, "-o".as_ref(), &*out]);
        run.args(["--iterations", "60", "--resolution", "24", "--no-prune", "--sh-degree", "3", "--grow-to", "3000"]);
        end(run.args(["--init", "random", "--init-count", "900"]).args(more).env("QIRF_LIMITS", limit))
    };
    let said = run("buffers=400000", &[]).with(5, &["'sh3.moments'", "504000 bytes", "binds at most 400000"]).said;
    for advice in ["--max-gaussians 2380,", "--sh-degree 2,", "another --device", "shard plan run"] {
        assert!(said.contains(advice), "{advice}: {said}");
    }
    assert!(!said.contains("--memory-budget") && !out.join("config.toml").exists(), "{said}");
    run("buffers=400000", &["--max-gaussians", "2380"]).with(0, &[]);
    // Pictures that are too large, however few Gaussians there are.
    std::fs::remove_dir_all(&out).unwrap();
    let said = run("buffers=15000", &[]).with(5, &["pictures of 24 x 18", "give a smaller --resolution, or"]).said;
    assert!(!said.contains("--max-gaussians") && !said.contains("sh3"), "{said}");
}

/// Photos in memory and photos in a file give the same bytes and the same scores; the file leaves nothing behind.
#[test]
fn photos_beyond_the_hosts_memory_change_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let config = RunConfig {
        resolution: Some("40".into()),
        seed: 3,
        eval_every: 4,
        init: Init::Random,
        init_count: Some(900),
        max_gaussians: 5000,
        prune: Some(Preset::Quick.pruning()),
        ..runs::config(&scene(folder.path()), 60)
    };
    let device = new_device();
    let mut results = Vec::new();
    let elsewhere = folder.path().join("nowhere");
    for (name, host_bytes) in [("memory", u64::MAX), ("file", 0)] {
        let networks = Networks::default();
        let session = Session { host_bytes, ..Session::new(&device, &networks) };
        let opened = prepare::open(&config.selection()).unwrap();
        let prepared = opened.load(PhotoMemory { bytes: host_bytes, folder: folder.path() }, &Silent).unwrap();
        assert!(prepared.views().all(|v| matches!(v.pixels, Pixels::Filed { .. }) == (host_bytes == 0)));
        let output = qirf_vk::job::Output::new(&folder.path().join(name)).unwrap();
        let r = run::run(&session, &config, &output, false).unwrap();
        assert_eq!(r.gaussians.initial, Some(900));
        let mut files: Vec<_> = std::fs::read_dir(output.folder()).unwrap().map(|e| e.unwrap().file_name()).collect();
        files.sort();
        assert_eq!(files, ["config.toml", "log.jsonl", "metrics.json", "model.ply", "renders"]);
        // A scratch folder takes the file: where there is none, only photos in memory can be read.
        let scratch = Session { scratch: Some(&elsewhere), ..session };
        assert_eq!(Setup::load(&scratch, &config, &output, false).is_ok(), host_bytes > 0);
        results.push((model(output.folder()), r.test, r.train.psnr, r.views.len()));
    }
    assert!(results[0] == results[1]);
    assert_eq!(Device::validation_messages(), 0);
}

#[test]
fn eval_refuses_what_it_cannot_score() {
    let folder = tempfile::tempdir().unwrap();
    let scene = scene(folder.path());
    let model = folder.path().join("model.ply");
    std::fs::write(&model, b"no model").unwrap();
    let refused = |code: i32, says: &str, arguments: &[&OsStr]| drop(eval(arguments).with(code, &[says]));
    let [o, every, zero] = ["-o", "--eval-every", "0"].map(OsStr::new);
    eval(&[model.as_ref()]).with(2, &["name a scene", "--config", "--against", "model.ply capture`"]);
    refused(3, "model.ply", &[model.as_ref(), scene.as_ref()]);
    formats::write(&model, &small_model(1), RenderMode::Plain).unwrap();
    refused(2, "--eval-every 1", &[model.as_ref(), scene.as_ref(), every, zero]);
    let run = folder.path().join("run");
    std::fs::create_dir(&run).unwrap();
    std::fs::write(run.join("config.toml"), "").unwrap();
    refused(2, "name another folder", &[model.as_ref(), scene.as_ref(), o, run.as_ref()]);
    refused(3, "nowhere", &[model.as_ref(), folder.path().join("nowhere").as_ref()]);
}

/// The paper's choices end to end; a gradual schedule prunes four times.
#[test]
fn presets_and_schedules_prune() {
    let pruned = metrics(&finished_as_in_the_paper().out);
    assert_eq!(pruned["prunes"].as_array().unwrap().len(), 1);
    assert_eq!(pruned["prunes"][0]["iteration"], 120);
    // The voxel is 0.03 world units in every scene: here most blocks have one Gaussian, which is kept.
    assert_eq!(
        (&pruned["prunes"][0]["selector"], &pruned["prunes"][0]["before"]),
        (&"gnso".into(), &pruned["gaussians"]["dense"])
    );

    let folder = tempfile::tempdir().unwrap();
    let (scene, gradual) = (scene(folder.path()), folder.path().join("gradual"));
    works(&mut command(&scene, &gradual, &["--schedule", "gradual", "--target-count", "77", "--merge"]));
    let pruned = metrics(&gradual);
    let iterations: Vec<_> = pruned["prunes"].as_array().unwrap().iter().map(|p| p["iteration"].clone()).collect();
    assert_eq!(iterations, [104, 120, 136, 160]);
    assert_eq!(pruned["gaussians"]["final"], 77);
}

/// A black model of black photos: the PSNR is infinite.
#[test]
fn equal_pictures_are_called_equal() {
    let folder = tempfile::tempdir().unwrap();
    let scene = scene(folder.path());
    for photo in std::fs::read_dir(scene.join("images")).unwrap() {
        image::RgbImage::new(48, 36).save(photo.unwrap().path()).unwrap();
    }
    let (black, out) = (folder.path().join("black.ply"), folder.path().join("out"));
    let mut model = small_model(20);
    model.sh[0].fill(-9.0);
    formats::write(&black, &model, RenderMode::Plain).unwrap();
    let mut run = qirf(["run".as_ref(), &*scene, "-o".as_ref(), &*out]);
    let told = works(run.args(["--iterations", "2", "--no-prune", "--no-report", "--init"]).arg(&black)).out;
    assert!(told.contains("test   PSNR equal  SSIM 1.0000") && told.contains("train  PSNR equal\n"), "{told}");
}
