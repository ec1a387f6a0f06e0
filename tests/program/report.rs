//! The page of a run: well formed, self-contained and without NaN, whatever the results contain.

use super::ended::{capture, qirf, works};
use super::html::{Html, parse};
use qirf_vk::gpu::{self, DeviceClass, DeviceInfo, TunedDevice, Tuning};
use qirf_vk::job::Output;
use qirf_vk::job::records::{
    CameraErrors, Counts, CurvePoint, Guards, Memory, Protocol, PruneGuards, PruneRecord, PruneSeconds, RankRecord,
    RunRecord, Times, TrainScores, ViewScores,
};
use qirf_vk::metrics::Scores;
use qirf_vk::pipeline::evaluate::exhibits::exhibits;
use qirf_vk::qirf::participation::Eigensolver;
use qirf_vk::qirf::select::Selector;
use qirf_vk::qirf::study::{Merging, Seconds};
use qirf_vk::report::plot::{Axis, Bar, Columns, Front, Line, Lines, Mark, Point, bars};
use qirf_vk::report::{of_run, page};
use qirf_vk::scene::{Names, Skipped};
use qirf_vk::train::method::Cut;
use std::collections::BTreeMap;
use std::path::Path;

/// Text that becomes markup if it is not escaped.
const EVIL: &str = "a<b>&\"'</script><script>alert(1)</script>/é.png";

fn view(name: &str, psnr: Option<f64>) -> ViewScores {
    let scores = Scores { psnr, ssim: Some(0.9), lpips_vgg: Some(0.1), ..Scores::default() };
    ViewScores { name: name.to_owned(), scores }
}

fn prune(iteration: u32) -> PruneRecord {
    PruneRecord {
        attrition: None,
        iteration,
        selector: Selector::Gnso,
        before: 5000,
        after: 1400,
        detail: 250,
        blocks: 300,
        voxel: 0.125,
        occupancy: vec![3, 20, 80, 150, 40, 6, 1],
        kept_shares: [1, 4, 90, 120, 50, 20, 8, 4, 2, 1],
        solver: Some(Eigensolver::LowRank),
        spectrum_spread: [0.1, 0.05, 0.02, 0.01, 0.005, 0.002, 0.001, 0.0],
        effective_ranks: vec![RankRecord { rank: 2, blocks: 300, gaussians: 5000, kept: 1400 }],
        spectrum: [0.71, 0.17, 0.07, 0.03, 0.012, 0.006, 0.0019, 1e-7],
        modes: [30, 110, 100, 40, 20, 0, 0, 0],
        guards: PruneGuards { fallback_blocks: 3, canonical_blocks: 2, unseen_blocks: 0, repaired_values: 7 },
        pairs: None,
        merged: Some(Merging { accepted: 3, refused: 4 }),
        frames_per_second_before: Some(12.5),
        seconds: PruneSeconds {
            responses: 1.2,
            study: Seconds { solve: 0.3, wall: 0.5, ..Seconds::default() },
            total: 2.0,
            ..PruneSeconds::default()
        },
    }
}

/// A device with a name that must be escaped.
fn tuned() -> TunedDevice {
    TunedDevice {
        tuning: Tuning::new(DeviceClass::Cpu, 8, 1024),
        info: DeviceInfo {
            name: "Device <&>".into(),
            driver: "driver \"1\"".into(),
            ..gpu::list().expect("Vulkan").swap_remove(0)
        },
    }
}

/// A record of a run with every optional part.
fn rich() -> RunRecord {
    let names = ["one.png", EVIL, "three.png", "four.png", "five.png"];
    let point = |k: u32| CurvePoint {
        iteration: 100 * k,
        seconds: 2.5 * f64::from(k),
        psnr: 18.0 + f64::from(k),
        train_psnr: Some(19.0 + f64::from(k)),
        gaussians: if k > 4 { 1400 } else { 1000 * k as usize },
    };
    RunRecord {
        schema: 1,
        version: "0.0.0",
        device: tuned(),
        protocol: Protocol {
            test_split: "one photo in 8, by name".into(),
            train_views: 35,
            test_views: names.len(),
            image_size: [64, 48],
            downscaling: "none",
            background: [0.0; 3],
            lpips: "VGG16".into(),
            exposure: "none",
            iterations: Some(800),
            seed: Some(1),
        },
        gaussians: Counts { initial: Some(900), dense: Some(5000), last: 1400 },
        test: Some(Scores { psnr: Some(25.0), ssim: Some(0.9), lpips_vgg: Some(0.1), ..Scores::default() }),
        unfitted_psnr: None,
        train: TrainScores { psnr: Some(26.0) },
        views: names.iter().map(|n| view(n, Some(25.0))).collect(),
        camera_errors: Some(CameraErrors { views: 5, pixels: 1.25, psnr: 24.5, fitted_psnr: 25.75 }),
        frames_per_second: Some(31.0),
        model_bytes: 345_678,
        prunes: vec![prune(400)],
        floaters: None,
        cut: None,
        curve: (1..=8).map(point).collect(),
        time: Times {
            total_s: 30.0,
            load_s: 1.0,
            start_s: 0.5,
            train_s: 22.0,
            prune_s: 2.0,
            curve_s: 1.25,
            evaluate_s: 3.0,
            write_s: 0.75,
            report_s: 1.0,
            stages_s: BTreeMap::from([("rasterise", 9.0), ("project", 1.0), ("a_stage_with_a_very_long_name", 0.0)]),
        },
        effects: Vec::new(),
        guards: Guards {
            skipped_rows: 0,
            undrawable: 3,
            empty_views: 1,
            scene: Skipped {
                damaged_images: Names { count: 7, examples: vec![EVIL.to_owned()], last: None },
                choices: vec!["a choice".to_owned()],
                ..Skipped::default()
            },
        },
        memory: Memory { estimated_bytes: 200_000_000, peak_bytes: 100_000_000, limit_bytes: 8_000_000_000 },
    }
}

/// The record of a run without views, curve and prunes.
fn bare() -> RunRecord {
    let mut r = rich();
    (r.test, r.train.psnr, r.frames_per_second) = (None, None, None);
    (r.views, r.curve, r.prunes, r.time.stages_s) = Default::default();
    (r.protocol.test_views, r.gaussians.dense) = (0, Some(1400));
    r
}

/// Reads a page that must be well formed, load nothing from elsewhere, and draw with numbers only.
fn sound(page: &str) -> Html {
    const LENGTHS: [&str; 11] = ["x", "y", "x1", "x2", "y1", "y2", "cx", "cy", "r", "points", "viewBox"];
    let html = parse(page).unwrap_or_else(|wrong| panic!("{wrong}"));
    assert!(!page.contains("http://") && !page.contains("https://"));
    for element in &html.0 {
        let name = element.name.as_str();
        assert!(!["link", "iframe", "object", "base", "use", "image"].contains(&name), "{name}");
        for (key, value) in &element.attributes {
            match key.as_str() {
                "src" => assert!(value.starts_with("data:image/"), "{value}"),
                "href" => assert_eq!(html.select(value).len(), 1, "{value}"),
                _ => assert!(!key.starts_with("on") && !value.contains("url("), "{key}={value}"),
            }
            if LENGTHS.contains(&key.as_str()) || (name == "rect" && ["width", "height"].contains(&key.as_str())) {
                for number in value.split([' ', ',']).filter(|n| !n.is_empty()) {
                    let number: f64 = number.parse().unwrap_or_else(|_| panic!("{name} {key}={value}"));
                    assert!(number.is_finite(), "{name} {key}={value}");
                }
            }
        }
        if !["script", "style"].contains(&name) {
            let none = |t: &str| ["NaN", "inf", "-inf"].contains(&t);
            assert!(!element.text.split(|c: char| !c.is_alphanumeric() && c != '-').any(none), "{}", element.text);
        }
    }
    html
}

fn folder() -> (tempfile::TempDir, Output) {
    let folder = tempfile::tempdir().unwrap();
    let output = Output::new(folder.path()).unwrap();
    (folder, output)
}

#[test]
fn a_page_holds_all_of_a_run_and_escapes_what_files_say() {
    let (_folder, output) = folder();
    let results = rich();
    std::fs::write(output.config(), format!("scene = '{EVIL}'\n")).unwrap();
    let names: Vec<&str> = results.views.iter().map(|v| v.name.as_str()).collect();
    for (k, exhibit) in exhibits(&names).iter().enumerate() {
        // One view lacks its dense picture.
        let files = [Some(&exhibit.photo), (k != 2).then_some(&exhibit.dense), Some(&exhibit.last)];
        for (shade, file) in files.into_iter().flatten().enumerate() {
            let path = output.renders().join(file);
            std::fs::create_dir_all(path.parent().unwrap()).unwrap();
            image::RgbImage::from_pixel(64, 48, image::Rgb([60 * shade as u8; 3])).save(path).unwrap();
        }
    }
    let page = of_run(&results, &output, None);
    let html = sound(&page);
    let titles = html.texts("h2");
    let expected = [
        "Summary",
        "Pictures",
        "Quality over time",
        "Pruning",
        "What the blocks say",
        "Time by stage",
        "Held-out views",
        "Protocol",
        "Effects",
        "Guards",
        "Memory",
        "Configuration",
    ];
    assert_eq!(titles, expected);
    assert_eq!(html.select("script").len(), 1, "only the page's own");
    assert!(html.texts("#views td").contains(&EVIL), "the name is there, as text");
    assert!(html.texts("pre")[0].contains(EVIL));
    assert_eq!(html.select(".stack").len(), 4);
    assert_eq!(html.select(".stack img").len(), 15);
    assert_eq!(html.texts("button[data-side=left]"), ["ground truth", "dense", "compressed", "error"]);
    assert_eq!(html.select("svg[role=img]").len(), 2 + 2 + 5 + 2);
    assert_eq!(html.select("svg line.event").len(), 2, "the prune, in time and by iterations");
    let tiles = html.texts(".tile");
    assert!(tiles.iter().any(|t| t.contains("1,400") && t.contains("5,000") && t.contains("72.0 %")), "{tiles:?}");
    assert!(tiles.iter().any(|t| t.contains("before pruning: 12.5")), "{tiles:?}");
    assert_eq!(html.texts("#effects p"), ["No effect was decided on."]);
    // Names of bars are whole; the spread of a spectrum is no part of a mode's name.
    let times = html.texts("#time text");
    let told = ["a_stage_with_a_very_long_name", "start", "quality curve", "files", "pictures of this page", "other"];
    assert!(told.iter().all(|name| times.contains(name)), "{times:?}");
    let blocks = html.texts("#blocks text");
    assert!(
        blocks.contains(&"71") && blocks.contains(&"0.19") && !blocks.iter().any(|t| t.contains('±')),
        "{blocks:?}"
    );
    let guards = html.texts("#guards tr");
    assert!(guards.iter().any(|g| g.contains("damaged photos7")), "{guards:?}");
    assert_eq!(html.texts("#guards p"), ["a choice"]);
    assert!(guards.iter().filter(|g| g.contains("none")).count() >= 7, "{guards:?}");
}

#[test]
fn whatever_is_missing_leaves_a_sound_page() {
    let (_folder, output) = folder();
    let html = sound(&of_run(&bare(), &output, None));
    assert_eq!((html.select("h2").len(), html.select("#blocks").len()), (11, 0));
    assert_eq!(html.select("img").len(), 0);

    let mut one = bare();
    one.views = vec![view("one.png", None)];
    one.test = Some(one.views[0].scores.clone());
    one.curve = vec![CurvePoint { iteration: 1, seconds: 0.0, psnr: 20.0, train_psnr: None, gaussians: 0 }];
    assert!(sound(&of_run(&one, &output, None)).texts(".tile").iter().any(|t| t.contains('∞')));

    let points = |last: f64| {
        let point = |(k, psnr): (usize, f64)| CurvePoint { iteration: 100 * k as u32, psnr, ..one.curve[0] };
        [20.0, 22.0, last].into_iter().enumerate().map(point).collect::<Vec<_>>()
    };
    let past = |curve: Vec<CurvePoint>| {
        let html = sound(&of_run(&RunRecord { curve, ..one.clone() }, &output, None));
        html.texts("p").iter().any(|t| t.contains("past its best: after iteration 100 held-out views had 22.00 dB"))
    };
    assert!(past(points(21.0)) && !past(points(21.95)) && !past(points(23.0)));
    let pruned = |dense: f64, end: f64| {
        let large = points(dense).into_iter().map(|p| CurvePoint { gaussians: 9, ..p });
        large.chain([CurvePoint { iteration: 300, psnr: end, ..one.curve[0] }]).collect::<Vec<_>>()
    };
    assert!(past(pruned(21.0, 20.5)) && !past(pruned(21.95, 20.5)) && !past(pruned(21.0, 22.5)), "before the prune");

    one.cut = Some(Cut { iteration: 1500, before: 5000, shown: 1800, after: 1400 });
    let told = "After iteration 1,500, the method would have kept 1,800 of 5,000 Gaussians; 1,400 were kept.";
    assert_eq!(sound(&of_run(&one, &output, None)).texts("#pruning p"), [told]);

    // A file that is not a picture, among the pictures of a run.
    std::fs::create_dir_all(output.renders()).unwrap();
    std::fs::write(output.renders().join("one.png"), "no picture").unwrap();
    sound(&of_run(&one, &output, None));
}

#[test]
fn numbers_that_are_none_stay_out_of_drawings() {
    let (_folder, output) = folder();
    let mut r = rich();
    let wild = [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 1e300, 0.0];
    for (point, v) in r.curve.iter_mut().zip(wild) {
        (point.psnr, point.seconds) = (v, v);
    }
    let mut broken = prune(0);
    (broken.before, broken.after, broken.blocks, broken.voxel) = (0, 0, 0, f64::NAN);
    broken.spectrum_spread = [f64::NAN; 8];
    (broken.occupancy, broken.spectrum, broken.modes) = (Vec::new(), [f64::NAN; 8], [0; 8]);
    broken.seconds.total = f64::NAN;
    r.prunes = vec![broken, prune(4_000_000_000), prune(100), prune(100)];
    r.time.stages_s.insert("nothing", f64::NAN);
    (r.time.total_s, r.frames_per_second, r.train.psnr) = (f64::NAN, Some(f64::INFINITY), Some(f64::NAN));
    sound(&of_run(&r, &output, None));
}

/// Plots for other pages.
#[test]
fn plots_are_sound_on_their_own() {
    let points = |k: f64| (0..5).map(|i| [f64::from(i), k * f64::from(i)]).collect::<Vec<_>>();
    let lines = Lines {
        title: EVIL,
        x: Axis::from_zero("seconds"),
        y: Axis::log("PSNR / dB"),
        lines: vec![Line { name: EVIL, points: points(1.0) }, Line { name: "b", points: points(-2.0) }],
        marks: vec![Mark { x: 2.0, label: EVIL.into() }, Mark { x: f64::NAN, label: String::new() }],
    };
    let point = |x: f64| {
        let (label, told) = (EVIL.to_owned(), EVIL.to_owned());
        Point { label, told, at: [x; 2], spread: [x; 2], front: x == 0.0, default: x == 9.0 }
    };
    let front = Front {
        title: "front",
        x: Axis::new("MB"),
        y: Axis::new("dB"),
        legend: &["ours", "theirs"],
        points: vec![point(0.0), point(9.0), point(f64::NAN)],
    };
    let bins: Vec<(String, f64)> = (0..40).map(|i| (i.to_string(), f64::from(i % 7) - 1.0)).collect();
    let (y, text) = (Axis::from_zero("n"), |v: f64| v.to_string());
    let columns = Columns { title: "histogram", x: "bin", y, bins: &bins, spreads: &[0.5, f64::NAN, 0.5], text };
    let named = |value: f64| Bar { name: EVIL.into(), value, text: EVIL.into() };
    let bars = bars("bars", &[named(1.0), named(-1.0), named(f64::INFINITY)]);
    let body = page::side_by_side(&[lines.drawing().figure(), front.drawing().figure(), columns.draw(), bars.figure()]);
    let html = sound(&page::page(EVIL, EVIL, &[page::Section("plots", "Plots", body)]));
    assert_eq!(html.texts("h1"), [EVIL]);
    assert_eq!((html.select("svg[role=img]").len(), html.select(".legend").len()), (4, 2));
}

/// Opens a report in a browser: it complains of nothing, asks for nothing else, and its sliders move.
#[cfg(unix)]
pub fn works_in_a_browser(page: &Path) {
    use crate::support::browser::Browser;
    let url = format!("file://{}", page.display());
    let Some(mut browser) = Browser::open(&url) else { return };
    browser.until("document.readyState === 'complete'");
    let sliders = browser.value("document.querySelectorAll('.stack input').length").as_u64().unwrap();
    assert!(sliders > 0, "no slider in {url}");
    let moved = "[...document.querySelectorAll('.stack')].every((s) => { const i = s.querySelector('input'); \
        i.value = 20; i.dispatchEvent(new Event('input')); return s.style.getPropertyValue('--at') === '20%' })";
    assert_eq!(browser.value(moved), serde_json::json!(true), "{url}");
    let pictures = "[...document.images].every((i) => i.complete && i.naturalWidth > 0)";
    assert_eq!(browser.value(pictures), serde_json::json!(true), "{url}");
    // Each button brings another picture to its side.
    let buttons = "[...document.querySelectorAll('.compare button')].every((b) => { b.click(); return b.ariaPressed === 'true' })";
    assert_eq!(browser.value(buttons), serde_json::json!(true), "{url}");
    // On paper nothing scrolls, and the background is white.
    browser.call("Emulation.setEmulatedMedia", &serde_json::json!({ "media": "print" }));
    let whole = "[...document.querySelectorAll('.table')].every((t) => getComputedStyle(t).overflow === 'visible') && \
        getComputedStyle(document.body).backgroundColor === 'rgb(255, 255, 255)'";
    assert_eq!(browser.value(whole), serde_json::json!(true), "{url}");
    assert_eq!(browser.complaints, Vec::<String>::new());
    let foreign: Vec<_> = browser.requests.iter().filter(|r| **r != url && !r.starts_with("data:")).collect();
    assert!(foreign.iter().all(|r| *r == "about:blank"), "{foreign:?}");
}

fn run(scene: &Path, out: &Path, more: &[&str]) -> (String, Html) {
    let mut command = qirf(["run".as_ref(), scene, "-o".as_ref(), out]);
    let said = works(command.args(["--iterations", "120"]).args(more)).out;
    let page = std::fs::read_to_string(out.join("report.html")).expect("report.html");
    (said, sound(&page))
}

#[test]
fn a_run_leaves_its_report_and_names_it() {
    let folder = tempfile::tempdir().unwrap();
    let (scene, out) = (capture(folder.path(), 400), folder.path().join("out"));
    let (said, html) = run(&scene, &out, &[]);
    let last = said.lines().last().unwrap_or_default();
    assert!(last.ends_with(&out.join("report.html").display().to_string()), "{said}");
    assert_eq!(html.select(".stack img").len(), 2 * 4, "photo, dense, compressed and error of two views");
    assert_eq!(html.select("#pruning svg").len(), 2);
    assert_eq!(html.select("#blocks svg").len(), 5);
    assert!(html.texts("pre")[0].contains("iterations = 120"));
    #[cfg(unix)]
    works_in_a_browser(&out.join("report.html"));

    // The dense pictures of that run do not belong to another run that does not prune.
    let (said, html) = run(&scene, &out, &["--no-prune", "--json", "--overwrite"]);
    assert!(serde_json::from_str::<serde_json::Value>(&said).is_ok());
    assert_eq!(html.select(".stack img").len(), 2 * 3);
}
