//! `qirf-vk compress`: kept Gaussians, written files, and refusals.

use super::ended::{Ended, capture, end, qirf, works};
use super::html::parse;
use crate::support::{device, finish};
use qirf_vk::gaussians::{Gaussians, formats};
use qirf_vk::job::config::PruneRule;
use qirf_vk::job::{Error, Session, Watcher};
#[cfg(unix)]
use qirf_vk::lab::curve::peer::Peer;
use qirf_vk::metrics::Networks;
use qirf_vk::pipeline::compress::fit::Target;
use qirf_vk::pipeline::compress::{CompressConfig, Input, ViewSource, compress_to};
use qirf_vk::pipeline::virtual_views::VirtualCameras;
use qirf_vk::qirf::select::Selector;
use qirf_vk::qirf::select::budget::Keep;
use qirf_vk::render::Style;
use qirf_vk::scene::orbit::UP;
use serde_json::Value;
use std::collections::HashSet;
use std::path::{Path, PathBuf};
use std::sync::atomic::{AtomicUsize, Ordering};

/// Sites of the hand-made model.
pub const SITES: usize = 150;
/// Gaussians per site: a visible one, and clones buried below it.
pub const CLONES: usize = 4;

/// A ball of coloured discs, each with three clones inside the ball.
pub fn ball() -> Gaussians {
    let n = SITES * CLONES;
    let mut model = Gaussians::zeroed(n, 1);
    for i in 0..n {
        let (site, clone) = (i / CLONES, i % CLONES);
        let height = 1.0 - (2.0 * site as f32 + 1.0) / SITES as f32;
        let angle = site as f32 * 2.399_963;
        let around = (1.0 - height * height).sqrt();
        let radius = if clone == 0 { 1.0 } else { 0.8 - 0.03 * clone as f32 };
        model.means[i] = [around * angle.cos(), height, around * angle.sin()].map(|x| x * radius);
        model.log_scales[i] = [if clone == 0 { 0.2_f32 } else { 0.06 }.ln(); 3];
        model.rotations[i] = [1.0, 0.0, 0.0, 0.0];
        model.opacity_logits[i] = 4.0 - clone as f32 * 0.1;
        for c in 0..3 {
            model.sh[0][3 * i + c] = ((site * (7 + 4 * c)) % 13) as f32 / 6.0 - 1.0;
            model.sh[1][9 * i + c] = 0.1 * (clone as f32 - 1.0);
        }
    }
    model
}

pub fn saved(folder: &Path, model: &Gaussians) -> PathBuf {
    let path = folder.join("model.ply");
    formats::write(&path, model, formats::RenderMode::Plain).expect("a model file");
    path
}

pub fn compressed(model: &Path, out: &Path, more: &[&str]) -> Ended {
    end(qirf(["compress".as_ref(), model, "-o".as_ref(), out]).args(more))
}

/// Few, small virtual views.
pub fn small(model: &Path, out: &Path, more: &[&str]) -> Value {
    compressed(model, out, &[&["--views", "16", "--size", "64x64", "--json"], more].concat()).with(0, &[]).json()
}

fn psnr(figures: &Value, stage: &str) -> f64 {
    figures["test"][stage]["psnr"].as_f64().unwrap_or_else(|| panic!("{stage}: {}", figures["test"]))
}

pub fn count(figures: &Value, file: &str) -> u64 {
    figures[file]["gaussians"].as_u64().unwrap_or_else(|| panic!("{file}"))
}

/// Each row's bits.
fn rows(model: &Gaussians) -> Vec<Vec<u32>> {
    let row = |i: usize| {
        let bands = model.sh.iter().enumerate();
        let sh = bands.flat_map(|(l, band)| &band[i * Gaussians::band_width(l)..][..Gaussians::band_width(l)]);
        let all = model.means[i].iter().chain(&model.log_scales[i]).chain(&model.rotations[i]);
        all.chain([&model.opacity_logits[i]]).chain(sh).map(|x| x.to_bits()).collect()
    };
    (0..model.len()).map(row).collect()
}

#[test]
fn the_kept_are_the_originals_and_as_many_as_asked_for() {
    let folder = tempfile::tempdir().unwrap();
    let (model, out, again) = (saved(folder.path(), &ball()), folder.path().join("a.ply"), folder.path().join("b.ply"));
    let report = folder.path().join("report.json");
    let n = (SITES * CLONES) as u64;
    let (file, exact) = (report.to_str().unwrap(), ["--selector", "css", "--merge=false", "--target-count", "123"]);
    let printed = small(&model, &out, &[&exact[..], &["--report", file]].concat());
    assert_eq!((count(&printed, "input"), count(&printed, "output")), (n, 123));
    assert_eq!(printed["prune"]["after"], 123);
    let written: Value = serde_json::from_str(&std::fs::read_to_string(&report).unwrap()).unwrap();
    assert_eq!(printed, written);
    for key in ["read_s", "truth_s", "responses_s", "keep_mask_s", "evaluate_s", "write_s", "total_s"] {
        assert!(printed["time"][key].as_f64().is_some_and(|s| s > 0.0), "{key}");
    }
    assert_eq!(printed["output"]["bytes"].as_u64(), Some(std::fs::metadata(&out).unwrap().len()));
    let memory = |key: &str| printed["memory"][key].as_u64().unwrap_or_else(|| panic!("{key}"));
    assert!(memory("peak_bytes") <= memory("estimated_bytes"), "{}", printed["memory"]);

    let kept = formats::read(&out).unwrap().gaussians;
    let originals: HashSet<_> = rows(&formats::read(&model).unwrap().gaussians).into_iter().collect();
    assert!(kept.len() == 123 && rows(&kept).iter().all(|row| originals.contains(row)));

    let page = folder.path().join("report.html");
    let more = ["--views", "16", "--size", "64x64", "--report", page.to_str().unwrap()];
    let said = compressed(&model, &again, &[&more, &exact[..]].concat()).out;
    let html = parse(&std::fs::read_to_string(&page).unwrap()).unwrap();
    assert_eq!(html.texts("h2"), ["Summary", "Held-out views", "Pruning", "What the blocks say", "Time"]);
    assert!(html.texts("#blocks dd").contains(&"low-rank"), "{:?}", html.texts("#blocks dd"));
    assert!(html.texts(".tile").iter().any(|t| t.contains("123") && t.contains("Gaussians")));
    let views = printed["views"].as_array().unwrap().iter().map(|view| view["pruned"]["psnr"].as_f64().unwrap());
    let worst = format!("(worst view {:.2} dB)", views.reduce(f64::min).unwrap());
    assert!(said.contains(&worst), "{worst}: {said}");
    let (total, parts) = said.lines().find_map(|l| l.strip_prefix("time")?.split_once(" s: ")).expect("times");
    let number = |text: &str| -> f64 { text.rsplit(' ').next().and_then(|v| v.parse().ok()).expect("a number") };
    let sum: f64 = parts.split(", ").map(number).sum();
    assert!((sum - number(total)).abs() < 0.35, "the parts are the whole but for rounding: {said}");
    assert!(std::fs::read(&out).unwrap() == std::fs::read(&again).unwrap(), "one input, one output");

    for (name, format) in [("c.spz", formats::Format::Spz), ("c.sog", formats::Format::Sog)] {
        let path = folder.path().join(name);
        let more = ["--keep", "0.5", "--selector", "css", "--merge", "--background", "0.1,0.2,0.3"];
        let figures = small(&model, &path, &more);
        assert_eq!(figures["protocol"]["background"], serde_json::json!([0.1, 0.2, 0.3]), "as given, not widened");
        let loaded = formats::read(&path).unwrap();
        assert_eq!((loaded.format, loaded.gaussians.len() as u64), (format, n / 2));
        assert!(figures["prune"]["merged"].is_object());
    }
}

#[test]
fn what_the_pictures_need_is_kept_not_what_chance_picks() {
    let folder = tempfile::tempdir().unwrap();
    let model = saved(folder.path(), &ball());
    let score = |name: &str, more: &[&str]| {
        let out = folder.path().join(format!("{name}.ply"));
        let figures = small(&model, &out, &[&["--keep", "0.28", "--selector", name], more].concat());
        assert_eq!(figures["protocol"]["truth"], "own-pictures");
        assert!(figures["test"]["before"].is_null() && figures["test"]["fine_tuned"].is_null());
        psnr(&figures, "pruned")
    };
    let chance = score("random", &[]);
    // Not gnso: where visible Gaussians overlap, the literal rule drops them (docs/method.md), here half a decibel
    // below chance.
    for name in ["importance", "css", "lowdin", "ordinary"] {
        let chosen = score(name, &[]);
        println!("{name} {chosen:.2} dB, random {chance:.2} dB");
        assert!(chosen > chance + 10.0, "{name}: {chosen} against {chance}");
    }
}

/// The ball stretched into discs of its surface, three to a site: neighbours show the same, so that merging loses less than
/// dropping. The fourth of a site is hidden.
#[test]
fn pairs_lose_less_than_dropping() {
    let folder = tempfile::tempdir().unwrap();
    let mut model = ball();
    for i in (0..model.len()).filter(|i| i % CLONES != CLONES - 1) {
        let (site, angle) = (i / CLONES, 0.1 * (i % CLONES) as f32);
        let [x, y, z] = model.means[site * CLONES];
        model.means[i] = [x * angle.cos() + z * angle.sin(), y, z * angle.cos() - x * angle.sin()];
        model.log_scales[i] = [0.1_f32.ln(); 3];
        model.sh[0].copy_within(3 * site * CLONES..3 * (site * CLONES + 1), 3 * i);
    }
    let path = saved(folder.path(), &model);
    let score = |name: &str| {
        let figures = small(&path, &folder.path().join("out.ply"), &["--keep", "0.25", "--selector", name]);
        (psnr(&figures, "pruned"), figures)
    };
    let (merged, figures) = score("pairs");
    for name in ["removal", "css", "importance", "contribution"] {
        let (dropped, _) = score(name);
        println!("pairs {merged:.2} dB, {name} {dropped:.2} dB");
        assert!(merged > dropped + 1.0, "{name}: {dropped} against {merged}");
    }
    let number = |key: &str| figures["prune"]["pairs"][key].as_u64().unwrap_or_else(|| panic!("{key}"));
    assert_eq!((count(&figures, "output"), number("merged") + number("dropped")), (150, 450));
    assert!((100..=150).contains(&number("clusters")), "{}", number("clusters"));
}

/// A model compressed by any tool is scored in the same way as `compress` scores its own.
#[test]
fn models_are_scored_against_their_originals() {
    let folder = tempfile::tempdir().unwrap();
    let (model, out) = (saved(folder.path(), &ball()), folder.path().join("small.ply"));
    let page = folder.path().join("report.html");
    let compressed = compressed(&model, &out, &["--json", "--report", page.to_str().unwrap()]).with(0, &[]).json();
    // Without blocks, training and photos, the page says nothing of them.
    let html = parse(&std::fs::read_to_string(&page).unwrap()).unwrap();
    assert_eq!(html.texts("h2"), ["Summary", "Held-out views", "Pruning", "Time"]);
    assert_eq!(html.texts("#views th"), ["view", "pruned", "file"]);
    assert!(!html.texts("#pruning dt").contains(&"after iteration") && !html.texts("text").contains(&"partition"));
    let eval = |more: &Path| end(&mut qirf(["eval".as_ref(), &*out, "--against".as_ref(), &model, more]));
    let scored = eval("--json".as_ref()).with(0, &[]).json();
    assert_eq!(scored["test"]["psnr"], compressed["test"]["pruned"]["psnr"]);
    assert_eq!(scored["gaussians"], serde_json::json!({ "model": 168, "original": 600 }));
    assert_eq!(scored["views"].as_array().unwrap().len(), 6);
    eval(folder.path()).with(2, &[]); // a scene and a model cannot both be given
}

#[test]
fn fine_tuning_on_the_models_own_pictures_raises_the_score() {
    let folder = tempfile::tempdir().unwrap();
    let model = saved(folder.path(), &ball());
    let out = folder.path().join("tuned.ply");
    let figures = small(&model, &out, &["--keep", "0.2", "--fine-tune", "120"]);
    let (pruned, tuned) = (psnr(&figures, "pruned"), psnr(&figures, "fine_tuned"));
    println!("{pruned:.2} dB, fine-tuned {tuned:.2} dB");
    assert!(tuned > pruned + 0.3);
    assert_eq!(count(&figures, "output"), 120);
    let memory = |key: &str| figures["memory"][key].as_u64().unwrap_or_else(|| panic!("{key}"));
    assert!(memory("peak_bytes") <= memory("estimated_bytes"), "{}", figures["memory"]);
}

#[test]
fn photos_give_evidence_scores_and_fine_tuning() {
    let folder = tempfile::tempdir().unwrap();
    let (scene, trained) = (capture(folder.path(), 400), folder.path().join("trained"));
    let mut run = qirf(["run".as_ref(), &*scene, "-o".as_ref(), &trained]);
    run.args(["--no-prune", "--iterations", "200", "--sh-degree", "1", "--size", "12kB", "--with-model"]);
    run.args(["--background", "0.5,0.5,0.5", "--antialias"]);
    let run = works(&mut run);
    let packed = std::fs::metadata(trained.join("model.sog")).unwrap().len();
    assert!((11_400..=12_000).contains(&packed), "{packed}: {}", run.out);
    let html = parse(&std::fs::read_to_string(trained.join("report.html")).unwrap()).unwrap();
    assert!(html.select("#model iframe")[0].attribute("srcdoc").is_some_and(|page| {
        page.contains("id=\"model\"")
            && page.contains("\"background\":[0.5,0.5,0.5]")
            && page.contains("\"antialiased\":true")
    }));
    let out = folder.path().join("small.ply");
    let scene = scene.to_str().unwrap();
    let pruned = ["--scene", scene, "--selector", "importance", "--keep", "0.1"];
    let more = [&pruned[..], &["--fine-tune", "80", "--eval-every", "3", "--json"]].concat();
    let figures = compressed(&trained.join("model.ply"), &out, &more).with(0, &[]).json();
    let [before, pruned, tuned] = ["before", "pruned", "fine_tuned"].map(|stage| psnr(&figures, stage));
    println!("{before:.2} dB, pruned {pruned:.2} dB, fine-tuned {tuned:.2} dB");
    assert!(tuned > pruned && before > 10.0);
    assert_eq!(figures["protocol"]["truth"], "photos");
    assert_eq!((&figures["protocol"]["train_views"], &figures["protocol"]["test_views"]), (&6.into(), &3.into()));
    assert_eq!(figures["views"].as_array().unwrap().len(), 3);
    let memory = |key: &str| figures["memory"][key].as_u64().unwrap_or_else(|| panic!("{key}"));
    assert!(memory("peak_bytes") <= memory("estimated_bytes"), "{}", figures["memory"]);
}

#[test]
fn strange_models_are_no_trouble() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out.ply");
    let few = |n: usize| ball().select(&(0..n).collect::<Vec<_>>());
    for (n, more, kept) in [
        (0, &["--keep", "0.28"][..], 0),
        (0, &["--fine-tune", "3", "--selector", "css", "--merge"], 0),
        (1, &["--keep", "0.28"], 1),
        (1, &["--fine-tune", "3", "--preset", "paper"], 1),
        (3, &["--keep", "0.01"], 1),
        (7, &["--target-count", "1000"], 7),
    ] {
        let model = saved(folder.path(), &few(n));
        let figures = small(&model, &out, more);
        assert_eq!(count(&figures, "output"), kept, "{n} with {more:?}");
        assert_eq!(formats::read(&out).unwrap().gaussians.len() as u64, kept);
    }
    // If all are kept, pictures are the same and have no PSNR.
    let all = small(&saved(folder.path(), &few(40)), &out, &["--keep", "1"]);
    assert!(all["test"]["pruned"]["psnr"].is_null() && all["test"]["pruned"]["ssim"].as_f64() > Some(0.999));

    let mut damaged = ball();
    for i in (0..damaged.len()).step_by(5) {
        damaged.means[i][i % 3] = f32::NAN;
        damaged.log_scales[i + 1] = [f32::INFINITY, 80.0, -90.0];
        damaged.opacity_logits[i + 2] = f32::INFINITY;
        damaged.rotations[i + 3] = [0.0; 4];
    }
    let figures = small(&saved(folder.path(), &damaged), &out, &["--target-count", "50"]);
    assert_eq!(count(&figures, "output"), 50);
    let figures =
        small(&saved(folder.path(), &damaged), &out, &["--target-count", "50", "--selector", "css", "--merge"]);
    assert_eq!(count(&figures, "output"), 50);
}

#[test]
fn what_cannot_be_is_refused_before_any_work() {
    let folder = tempfile::tempdir().unwrap();
    let model = saved(folder.path(), &ball());
    let out = folder.path().join("out.ply");
    let refused = |code: i32, says: &str, out: &Path, more: &[&str]| {
        let said = compressed(&model, out, more).with(code, &[says]).said;
        assert!(said.lines().count() <= 12, "{said}");
    };
    refused(2, ".spz", &folder.path().join("out.txt"), &[]);
    refused(2, "input file itself", &model, &[]);
    let taken = tempfile::tempdir().unwrap();
    std::fs::create_dir(taken.path().join("out.ply")).unwrap();
    refused(2, "is a folder", &taken.path().join("out.ply"), &[]);
    refused(2, "--target-count", &out, &["--keep", "0.5", "--target-count", "3"]);
    refused(2, "--views", &out, &["--scene", "nowhere", "--views", "9"]);
    refused(2, "--resolution", &out, &["--resolution", "/2"]);
    refused(2, "0.28", &out, &["--keep", "0"]);
    refused(2, "does not read --budget", &out, &["--budget", "global"]);
    refused(2, "model and report", &out, &["--report", out.to_str().unwrap()]);
    refused(2, "input file itself", &out, &["--report", model.to_str().unwrap()]);
    refused(3, "nowhere", &out, &["--scene", "nowhere"]);
    refused(5, "absent", &folder.path().join("absent/out.ply"), &[]);
    refused(5, "--size", &out, &["--memory-budget", "100k"]);
    compressed(&folder.path().join("nothing.ply"), &out, &[]).with(3, &[]);
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 1, "nothing was written");
}

#[cfg(unix)]
#[test]
fn an_interrupted_comparison_leaves_no_files_of_the_other_tool() {
    let (tools, folder) = (tempfile::tempdir().unwrap(), tempfile::tempdir().unwrap());
    let script = tools.path().join("tool");
    std::fs::write(&script, "echo v1.0\n").unwrap();
    let peer = Peer::find(&format!("sh {}", script.display()), folder.path()).unwrap();
    let (device, networks, watcher) = (device(), Networks::default(), Impatient(AtomicUsize::new(0), 0));
    let session = Session { watcher: &watcher, ..Session::new(&device, &networks) };
    let ended = peer.files(&session, &ball(), formats::RenderMode::Plain);
    assert!(matches!(ended, Err(Error::Interrupted)));
    assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
    finish(&device);
}

/// Ends a job after the given number of polls.
struct Impatient(AtomicUsize, usize);

impl Watcher for Impatient {
    fn stop(&self) -> bool {
        self.0.fetch_add(1, Ordering::Relaxed) >= self.1
    }
}

#[test]
fn an_interrupted_job_writes_nothing() {
    interrupted(Selector::Importance);
    interrupted(Selector::Pairs);
}

fn interrupted(selector: Selector) {
    let folder = tempfile::tempdir().unwrap();
    let device = device();
    let path = folder.path().join("model.ply");
    let config = CompressConfig {
        compression: PruneRule { selector, keep: Keep::Count(90), ..PruneRule::default() },
        views: ViewSource::OwnPictures {
            cameras: VirtualCameras { views: 8, size: (40, 40), up: UP },
            background: [0.0; 3],
        },
        style: Style::default(),
        exposure: false,
        fine_tune: 20,
        seed: 1,
    };
    let out = folder.path().join("out.ply");
    let attempt = |looks: usize| {
        let input = Input { path: &path, model: ball(), read_s: 0.0 };
        let watcher = Impatient(AtomicUsize::new(0), looks);
        let networks = Networks::default();
        let session = Session { watcher: &watcher, ..Session::new(&device, &networks) };
        compress_to(&session, input, &config, None, &Target::new(&out))
    };
    for looks in [0, 3, 10, 17, 19, 20] {
        let error = attempt(looks).expect_err("interrupted");
        assert!(matches!(error, Error::Interrupted), "{looks}: {error}");
        assert_eq!(std::fs::read_dir(folder.path()).unwrap().count(), 0);
    }
    assert!(attempt(usize::MAX).is_ok() && out.exists());
    finish(&device);
}
