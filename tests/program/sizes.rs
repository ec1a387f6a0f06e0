//! Files of a wanted size or PSNR, pages, copies, and curves of quality against bytes.

use super::compress::{CLONES, SITES, ball, compressed, count, saved, small};
use super::ended::{Ended, end, qirf, works};
use super::html::parse;
use qirf_vk::gaussians::{Gaussians, formats};
use serde_json::Value;
use std::ffi::OsStr;

/// Files of 95 to 100 % of the size in at most nine trials, the same ones again; the line says what was chosen.
#[test]
fn files_have_the_size_that_was_asked_for() {
    let folder = tempfile::tempdir().unwrap();
    let model = saved(folder.path(), &ball());
    for (name, size, bytes) in [("a.sog", "3kB", 3000), ("a.spz", "3kB", 3000), ("a.ply", "0.03MB", 30_000)] {
        let path = folder.path().join(name);
        let made = small(&model, &path, &["--size", size]);
        let on_disk = std::fs::metadata(&path).unwrap().len();
        assert!(on_disk <= bytes && 20 * on_disk >= 19 * bytes, "{name}: {on_disk} of {bytes}, {}", made["aim"]);
        assert_eq!(made["output"]["bytes"].as_u64(), Some(on_disk));
        assert_eq!(made["aim"]["bytes"].as_u64(), Some(bytes));
        assert_eq!(made["aim"]["chosen"]["gaussians"], made["output"]["gaussians"]);
        assert!(made["aim"]["tried"].as_array().is_some_and(|tried| tried.len() <= 9), "{}", made["aim"]);
        assert!(made["aim"]["chosen"]["psnr"].as_f64().is_some_and(|psnr| psnr > 15.0));
        assert_eq!(formats::read(&path).unwrap().gaussians.len() as u64, count(&made, "output"));
    }
    let (first, again) = (folder.path().join("a.sog"), folder.path().join("b.sog"));
    let said = compressed(&model, &again, &["--views", "16", "--size", "64x64", "--size", "3kB"]).out;
    assert!(said.contains(" of 3 kB, ") && said.contains(" Gaussians, ") && said.contains(" dB"), "{said}");
    // The line's PSNR is that of the file, which is not that before packing.
    let (_, after) = said.split_once("file       PSNR ").expect("the file's own PSNR");
    let psnr: f64 = after.split(' ').next().and_then(|v| v.parse().ok()).expect("a number");
    assert!(said.contains(&format!(" Gaussians, {psnr:.1} dB")) && said.contains("before packing"), "{said}");
    assert!(std::fs::read(&first).unwrap() == std::fs::read(&again).unwrap(), "one input, one output");
    // Tuned after the search, the file still fits.
    let tuned = folder.path().join("tuned.sog");
    let made = small(&model, &tuned, &["--size", "3kB", "--fine-tune", "5"]);
    let bytes = std::fs::metadata(&tuned).unwrap().len();
    assert!((2850..=3000).contains(&bytes), "{bytes}");
    assert_eq!(made["aim"]["written"]["bytes"].as_u64(), Some(bytes), "{}", made["aim"]);
    assert_eq!(made["aim"]["written"]["gaussians"].as_u64(), Some(count(&made, "output")));
}

/// A file of the same format that is small enough already is better than any that is made from it.
#[test]
fn an_input_that_fits_is_written_as_it_is() {
    let folder = tempfile::tempdir().unwrap();
    let model = saved(folder.path(), &ball());
    let packed = folder.path().join("packed.sog");
    formats::write(&packed, &ball(), formats::RenderMode::Plain).unwrap();
    for (input, name) in [(&model, "a.ply"), (&packed, "a.sog")] {
        let (before, out) = (std::fs::read(input).unwrap(), folder.path().join(name));
        for (size, is_same) in [(before.len(), true), (before.len() - 1, false)] {
            let made = small(input, &out, &["--size", &format!("{size}B")]);
            let written = std::fs::read(&out).unwrap();
            assert!(written.len() <= size && (written == before) == is_same, "{name}: {}", made["aim"]);
            assert_eq!(made["aim"]["original"] == true, is_same, "{name}: {}", made["aim"]);
        }
    }
    let views = ["--views", "16", "--size", "64x64", "--size", "1GB"];
    compressed(&model, &folder.path().join("b.ply"), &views).with(0, &["its own bytes were written"]);
}

#[test]
fn views_that_are_too_few_to_choose_a_file_by_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let (model, out) = (saved(folder.path(), &ball()), folder.path().join("a.sog"));
    for (views, size, are_few) in [("2", "3kB", true), ("16", "7kB", false)] {
        let made = compressed(&model, &out, &["--views", views, "--size", "64x64", "--size", size]).with(0, &[]);
        assert_eq!(made.said.contains("few views"), are_few, "{views}: {}", made.said);
    }
}

/// Photos with exposures of their own: a run, the packing of its model, `compress` and `eval` score alike.
#[test]
fn exposures_are_fitted_wherever_photos_score() {
    let folder = tempfile::tempdir().unwrap();
    let [scene, trained, small] = ["scene", "trained", "small.ply"].map(|name| folder.path().join(name));
    let (model, config) = (trained.join("model.ply"), trained.join("config.toml"));
    let mut synth = qirf(["synth".as_ref(), scene.as_os_str()]);
    works(synth.args(["--views", "24", "--size", "48x36", "--points", "400", "--effects", "exposure"]));
    let mut run = qirf(["run".as_ref(), scene.as_os_str(), "-o".as_ref(), trained.as_os_str()]);
    run.args(["--no-prune", "--iterations", "100", "--sh-degree", "0", "--effect", "exposure=on", "--size", "20kB"]);
    // No file records this dilation, so only the run's configuration tells it.
    run.args(["--antialias", "--dilation", "0.3"]);
    let run = works(run.args(["--no-report", "--json"])).json();
    let psnr = |scores: &Value| scores["psnr"].as_f64().unwrap_or_else(|| panic!("{scores}"));
    let (test, unfitted) = (psnr(&run["test"]), run["test_unfitted_psnr"].as_f64().unwrap());
    assert!(test - unfitted > 1.0, "exposures matter: {test} {unfitted}");
    let packed = &run["packed"];
    assert!((psnr(&packed["test"]["written"]) - test).abs() < 0.3, "{test}: {}", packed["test"]);
    assert_eq!(run["protocol"]["exposure"], packed["protocol"]["exposure"]);

    let eval = |arguments: [&OsStr; 3]| psnr(&works(qirf(["eval", "--json"]).args(arguments)).json()["test"]);
    let by_photos = eval([model.as_ref(), scene.as_ref(), "--quiet".as_ref()]);
    assert!((by_photos - test).abs() < 0.01, "a run's model has the run's scores: {by_photos} {test}");
    let given = ["--json", "--scene", scene.to_str().unwrap()];
    let made = compressed(&model, &small, &[&given[..], &["--keep", "0.5", "--fine-tune", "50"]].concat());
    let made =
        made.with(0, &["drawn with --dilation 0.3, as config.toml beside the model", "an exposure is fitted"]).json();
    let by_config = eval([small.as_ref(), "--config".as_ref(), config.as_ref()]);
    let [before, written] = ["before", "written"].map(|stage| psnr(&made["test"][stage]));
    assert!((before - test).abs() < 0.01 && (written - by_config).abs() < 0.01, "{test} {by_config} {}", made["test"]);
    let lone = folder.path().join("lone");
    std::fs::create_dir(&lone).unwrap();
    for file in [&config, &small] {
        std::fs::copy(file, lone.join(file.file_name().unwrap())).unwrap();
    }
    let beside = |last: &str| eval([lone.join("small.ply").as_ref(), scene.as_ref(), last.as_ref()]);
    assert!((beside("--quiet") - by_config).abs() < 0.01, "a config.toml counts without the run's model");
    assert!(beside("--exposure=off") < by_config - 1.0);
    // Without exposures, no file is as good as this.
    let wanted = format!("{:.1}", test - 0.5);
    let found = compressed(&model, &small, &[&given[..], &["--psnr", wanted.as_str()]].concat()).with(0, &[]).json();
    let [chosen, written] = [&found["aim"]["chosen"], &found["test"]["written"]].map(psnr);
    assert!(chosen >= test - 0.55 && (chosen - written).abs() < 0.01, "{wanted}: {}", found["aim"]);
    let off = compressed(&model, &small, &[&given[..], &["--exposure=off"]].concat()).with(0, &[]).json();
    assert!((psnr(&off["test"]["before"]) - unfitted).abs() < 0.01, "{}", off["test"]);
}

/// A model whose file lacks nothing can only lose by fine-tuning.
#[test]
fn fine_tuning_that_makes_a_file_worse_is_left_out() {
    let folder = tempfile::tempdir().unwrap();
    let model = saved(folder.path(), &ball().select(&(0..20).collect::<Vec<usize>>()));
    let [plain, tuned] = ["plain.ply", "tuned.ply"].map(|name| folder.path().join(name));
    let views = ["--views", "16", "--size", "64x64", "--json", "--size", "1MB"];
    compressed(&model, &plain, &views).with(0, &[]);
    let made = compressed(&model, &tuned, &[&views[..], &["--fine-tune", "40"]].concat());
    let made = made.with(0, &["dB, equal pictures without), so it was left out"]).json();
    assert!(std::fs::read(&plain).unwrap() == std::fs::read(&tuned).unwrap(), "the file is that without tuning");
    assert_eq!(made["aim"]["fine_tuning"]["written"], false, "{}", made["aim"]);
    assert_eq!(made["aim"]["written"]["bytes"], made["output"]["bytes"]);
    assert!(made["test"]["written"]["psnr"].is_null() && made["test"]["fine_tuned"]["psnr"].is_number());
    // Without an aim it is written, and a note says that it is worse.
    let all = ["--views", "16", "--size", "64x64", "--keep", "1", "--fine-tune", "40"];
    compressed(&model, &tuned, &all).with(0, &["fine-tuning made the model worse", "leave out --fine-tune"]);
}

/// Bands without effect take no room where there is too little.
#[test]
fn a_size_is_met_by_fewer_bands_where_these_show_nothing() {
    let folder = tempfile::tempdir().unwrap();
    let mut model = ball();
    model.sh.truncate(1);
    let whole = folder.path().join("whole.ply");
    formats::write(&whole, &model, formats::RenderMode::Plain).unwrap();
    let bytes = std::fs::metadata(&whole).unwrap().len();
    let n = model.len();
    model.sh.extend((1..=3).map(|l| vec![0.0; n * Gaussians::band_width(l)]));
    let model = saved(folder.path(), &model);
    let made = small(&model, &folder.path().join("a.ply"), &["--size", &format!("{bytes}B")]);
    // Some Gaussians lie within the ball.
    assert!(made["output"]["sh_degree"] == 0 && count(&made, "output") > 570, "{}", made["aim"]);
    assert!(made["test"]["written"]["psnr"].as_f64().is_none_or(|psnr| psnr > 60.0), "{}", made["test"]);
    assert_eq!(made["aim"]["precision"]["degree"], 0);
}

#[test]
fn pages_have_the_size_that_was_asked_for_and_copies_say_what_they_cost() {
    let folder = tempfile::tempdir().unwrap();
    let model = saved(folder.path(), &ball());
    let convert = |name: &str, more: &[&str]| {
        let out = folder.path().join(name);
        let Ended { code, said, .. } = end(qirf(["convert".as_ref(), &*model, &out]).args(more));
        (code, said, std::fs::metadata(&out).map_or(0, |m| m.len()))
    };
    let (code, said, bytes) = convert("a.html", &["--size", "39kB"]);
    assert!(code == Some(0) && (37_050..=39_000).contains(&bytes) && said.contains(" of 39 kB, "), "{bytes}: {said}");
    convert("b.html", &[]);
    let page = std::fs::read_to_string(folder.path().join("b.html")).unwrap();
    assert!(page.contains("id=\"poster\" src=\"data:image/"), "the page begins with a picture");
    let (_, said, coarse) = convert("a.spz", &["--sh-bits", "1"]);
    assert!(said.contains(" dB against the original"), "{said}");
    assert!(said.contains("is a poor copy"), "{said}");
    let (_, said, fine) = convert("a.spz", &["--sh-bits", "8,8"]);
    assert!(fine > coarse && !said.contains("poor"), "{said}");
    assert!(!convert("a.glb", &[]).1.contains(" dB"), "floats cost nothing");
    for (name, more) in [("a.sog", ["--sh-bits", "5"]), ("a.sog", ["--size", "9kB"]), ("a.sog", ["--lod", "2"])] {
        assert_eq!(convert(name, &more).0, Some(2), "{more:?}");
    }
    assert_eq!(convert("a.html", &["--size", "9kB"]).0, Some(2), "script and style alone take more");
    let (code, said, bytes) = convert("lod/lod-meta.json", &["--lod", "3"]);
    assert!(code == Some(0) && bytes > 0 && said.contains("level 2: 67 Gaussians"), "{said}");
    // The folder and its description are one model to every command.
    for place in ["lod", "lod/lod-meta.json"] {
        let seen = end(qirf(["inspect", "--json"]).arg(folder.path().join(place))).with(0, &[]).json();
        assert_eq!((&seen["kind"], &seen["format"], &seen["gaussians"]), (&"model".into(), &"SOG".into(), &600.into()));
        assert!(seen["bytes"].as_u64().unwrap() > bytes, "the textures lie in folders of levels: {seen}");
    }
}

#[test]
fn a_curve_has_files_of_six_sizes_with_their_bytes_by_attribute() {
    let folder = tempfile::tempdir().unwrap();
    let model = saved(folder.path(), &ball());
    let out = folder.path().join("curve");
    let more = ["--curve", "sog,spz,ply", "--peer", "none", "--views", "16", "--size", "64x64", "--json"];
    let curve = compressed(&model, &out, &more).with(0, &[]).json();
    let files = curve["files"].as_array().unwrap();
    assert!(files.len() > 7, "{curve}");
    for file in files {
        let number = |key: &str| file[key].as_u64().unwrap_or_else(|| panic!("{key}: {file}"));
        assert!(number("bytes") <= number("wanted"), "{file}");
        let parts = file["parts"].as_array().unwrap();
        let all: u64 = parts.iter().map(|part| part[1].as_u64().unwrap()).sum();
        assert!(if file["format"] == "ply" { parts.is_empty() } else { all == number("bytes") }, "{file}");
    }
    let losses = curve["attributes"].as_array().unwrap();
    assert_eq!(losses.iter().filter(|loss| loss["format"] == "spz").count(), 6, "{losses:?}");
    let csv = std::fs::read_to_string(out.join("curve.csv")).unwrap();
    assert_eq!(csv.lines().count(), files.len() + 1);
    let html = parse(&std::fs::read_to_string(out.join("curve.html")).unwrap()).unwrap();
    assert_eq!(html.select("#plot polyline").len(), 3);
    compressed(&model, &out, &["--curve", "sog", "--size", "9kB"]).with(2, &[]);
    compressed(&model, &out, &["--curve", "docx"]).with(2, &[]);
    // Without held-out photos there is nothing to measure.
    let scene = super::run::scene(folder.path());
    let more = ["--curve", "spz", "--scene", scene.to_str().unwrap(), "--eval-every", "0", "--pole-mask", "9"];
    compressed(&model, &out, &more).with(2, &["held-out photos", "there are no panoramas"]);
}

#[test]
fn files_have_the_psnr_that_was_asked_for_or_say_why_not() {
    let folder = tempfile::tempdir().unwrap();
    let model = saved(folder.path(), &ball());
    let out = folder.path().join("a.sog");
    let made = small(&model, &out, &["--psnr", "28"]);
    let reached = made["aim"]["chosen"]["psnr"].as_f64().unwrap();
    assert!((28.0..28.5).contains(&reached), "{}", made["aim"]);
    let whole = ["--views", "16", "--size", "64x64", "--size", "1GB"];
    compressed(&model, &out, &whole).with(0, &["no larger file, up to 1 GB, is better"]);
    assert_eq!(formats::read(&out).unwrap().gaussians.len(), SITES * CLONES);
    std::fs::remove_file(&out).unwrap();
    let refused = |code: i32, words: &str, more: &[&str]| {
        compressed(&model, &out, more).with(code, &[words]);
        assert!(!out.exists(), "{more:?}");
    };
    let tiny = ["--views", "16", "--size", "64x64", "--size", "100B"];
    refused(2, "the smallest SOG file", &tiny);
    let empty = folder.path().join("empty.ply");
    formats::write(&empty, &Gaussians::zeroed(0, 1), formats::RenderMode::Plain).unwrap();
    compressed(&empty, &out, &tiny).with(2, &["this model is empty, and its SOG file has"]);
    let packed = folder.path().join("a.compressed.ply");
    compressed(&model, &packed, &tiny).with(2, &["the smallest compressed PLY file"]);
    for bad in ["5", "0", "-1MB", "1XB", "MB", "nanMB"] {
        refused(2, "--size", &[&format!("--size={bad}")]);
    }
    refused(2, "--psnr", &["--psnr", "nan"]);
    refused(2, "--keep", &["--size", "9kB", "--keep", "0.5"]);
    refused(2, "--target-count", &["--psnr", "30", "--target-count", "5"]);
    refused(2, "one of them", &["--size", "9kB", "--psnr", "30"]);
    refused(2, "--selector pairs", &["--views", "16", "--size", "64x64", "--size", "9kB", "--selector", "css"]);
}

type Change = fn(&mut Gaussians);

/// Balls of several kinds in several formats, whose PSNR jumps: the smallest file tried that has the PSNR.
#[test]
fn every_format_reaches_a_psnr() {
    let folder = tempfile::tempdir().unwrap();
    let coloured: Change = |_| {};
    let plain: Change = |model| model.sh.truncate(1);
    let uneven: Change = |model| (0..model.len()).for_each(|i| model.log_scales[i] = [-1.2 - 0.003 * i as f32; 3]);
    for (name, change, format, wanted) in [
        ("coloured", coloured, "spz", 25.0),
        ("coloured", coloured, "sog", 33.0),
        ("plain", plain, "ply", 30.0),
        ("uneven", uneven, "compressed.ply", 27.0),
        ("uneven", uneven, "sog", 33.0),
    ] {
        let mut model = ball();
        change(&mut model);
        let model = saved(folder.path(), &model);
        let out = folder.path().join(format!("a.{format}"));
        let aim = small(&model, &out, &["--psnr", &wanted.to_string()])["aim"].clone();
        let tried = aim["tried"].as_array().unwrap();
        let reaches = |file: &&Value| file["psnr"].is_null() || file["psnr"].as_f64() >= Some(wanted);
        assert!(reaches(&&aim["chosen"]), "{name}, {format}: {aim:#}");
        let fewest = tried.iter().filter(reaches).map(|file| file["bytes"].as_u64().unwrap()).min();
        assert_eq!(fewest, aim["chosen"]["bytes"].as_u64(), "{name}, {format}: {aim:#}");
        // Few Gaussians get nine more files, and a PSNR that is still far off four.
        assert!(tried.len() <= 22, "{name}, {format}: {aim:#}");
    }
}

#[test]
fn a_format_that_ruins_a_model_is_named_and_a_report_lists_the_search() {
    let folder = tempfile::tempdir().unwrap();
    let mut bright = ball();
    bright.sh[0].iter_mut().for_each(|c| *c *= 8.0);
    let model = saved(folder.path(), &bright);
    let views = ["--views", "16", "--size", "64x64"];
    let say = |name: &str, more: &[&str]| compressed(&model, &folder.path().join(name), &[&views, more].concat()).said;
    assert!(say("a.spz", &["--keep", "0.9"]).contains("a.spz is a poor copy"), "SPZ cuts colours off");
    let said = say("a.sog", &["--keep", "0.9"]);
    assert!(!said.contains("poor copy"), "SOG stores them: {said}");
    let page = folder.path().join("page.html");
    let model = saved(folder.path(), &ball());
    let more = ["--size", "1GB", "--json", "--report", page.to_str().unwrap()];
    let said = compressed(&model, &folder.path().join("a.sog"), &[&views, &more[..]].concat()).with(0, &[]).said;
    assert!(said.contains("no larger file, up to 1 GB, is better"), "{said}");
    let html = parse(&std::fs::read_to_string(&page).unwrap()).unwrap();
    assert!(!html.select("#search tbody tr").is_empty());
    // A format whose header alone exceeds the sizes.
    let few = saved(folder.path(), &ball().select(&[0, 4, 8]));
    let more = ["--curve", "sog,spz", "--peer", "none"];
    let said = compressed(&few, &folder.path().join("curve"), &[&views, &more[..]].concat()).with(0, &[]).said;
    assert!(said.contains("sog: 6 of 6 sizes are too small for a single Gaussian"), "{said}");
}
