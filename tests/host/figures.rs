//! `make figures`: the generator on small recorded measurements.

#[path = "../../tools/figures/mod.rs"]
mod generator;

use generator::{Bench, Origin, RENDERS, Sweep, fill, made, renders, results};
use image::{Rgb, RgbImage};
use std::path::{Path, PathBuf};

fn fixture() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/host/figures")
}

fn read(path: &Path) -> String {
    std::fs::read_to_string(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()))
}

/// Criterion's folder as left by the benchmarks.
fn unfolded(recorded: &serde_json::Value) -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let write = |path: PathBuf, value: &serde_json::Value| {
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        std::fs::write(path, value.to_string()).unwrap();
    };
    write(folder.path().join("device.json"), &recorded["device"]);
    for (k, one) in recorded["benchmarks"].as_array().unwrap().iter().enumerate() {
        let id = one["id"].as_str().unwrap();
        let own = folder.path().join(id.replace(|c: char| !c.is_alphanumeric() && c != '/', "_"));
        for age in ["base", "new"] {
            write(own.join(age).join("benchmark.json"), &serde_json::json!({ "full_id": id, "group_id": "unused" }));
        }
        write(own.join("new/sample.json"), &serde_json::json!({ "iters": one["iters"], "times": one["times"] }));
        let fact = serde_json::json!({ "id": id, "numbers": one["numbers"] });
        write(folder.path().join(format!("facts/{k}.json")), &fact);
    }
    folder
}

fn recorded() -> serde_json::Value {
    serde_json::from_str(&read(&fixture().join("criterion.json"))).expect("JSON")
}

fn origin() -> Origin {
    Origin { commit: "0123abc".into(), command: "make figures".into() }
}

fn all_of(recorded: &serde_json::Value) -> Result<[generator::Parts; 3], String> {
    let folder = unfolded(recorded);
    made(&Bench::read(folder.path())?, &Sweep::read(&fixture().join("sweep.json"))?, &origin())
}

fn part<'a>(parts: &'a generator::Parts, name: &str) -> &'a str {
    &parts.iter().find(|(n, _)| *n == name).unwrap_or_else(|| panic!("no {name}")).1
}

#[test]
fn the_pages_here_take_their_figures() {
    let [page, exactness, plots] = all_of(&recorded()).expect("figures");
    for (file, parts) in [("docs/performance.md", &page), ("docs/sweep.md", &exactness)] {
        let text = read(&Path::new(env!("CARGO_MANIFEST_DIR")).join(file));
        let filled = fill(file, &text, parts).expect("markers");
        assert_eq!(fill(file, &filled, parts).unwrap(), filled, "{file}: filling twice changes nothing");
        for (name, body) in parts {
            assert!(filled.contains(body.trim_end()), "{file}: {name}");
        }
        // Every plot that a page shows is generated.
        for shown in filled.split("figures/").skip(1).filter_map(|rest| rest.split_once(".svg)")) {
            assert!(plots.iter().any(|(name, _)| *name == format!("{}.svg", shown.0)), "{file}: {}", shown.0);
        }
    }
    for (name, text) in &plots {
        let wild = ["=\"NaN", "=\"inf", "=\"-inf", ",NaN", ",inf", ",-inf"];
        assert!(text.starts_with("<svg ") && !wild.iter().any(|w| text.contains(w)), "{name}");
    }
}

#[test]
fn tables_say_what_was_measured() {
    let [page, readme, _] = all_of(&recorded()).expect("figures");
    for (name, there) in [
        ("device", &["| commit | 0123abc |", "GFLOP/s", "2 x 128 MiB"][..]),
        ("sort", &["| sort | 2^20 |", "| scan | 2^22 |", "bytes"]),
        ("frame", &["| 10,000 (58,699 pairs) | project |", "rasterise", "operations"]),
        ("cost", &["R²", "| pixels, × ", "| pairs, × ", "| all points | "]),
        ("culling", &["| exact: fewer than 3-sigma by | 32.5 % | 46.3 % |"]),
        ("effects", &["| all off, again |", "| 1.310 | 1.300 to 1.330 |\n| exposure |"]),
        ("iteration", &["**19,159 pairs per image**", "50 ms or less", "| adam |"]),
        ("kernels", &["| participation | m = 48 | 64 blocks |", "| loss | 144x256 | 36,864 pixels |"]),
        ("sweep", &["**exact**", "| determinant |", "* gradients: "]),
    ] {
        for text in there {
            assert!(part(&page, name).contains(text), "{name}: {text}\n{}", part(&page, name));
        }
    }
    let lines = part(&readme, "exactness");
    assert_eq!(lines.lines().filter(|l| l.starts_with("| ")).count(), 1 + 4, "{lines}");
}

#[test]
fn the_same_measurements_give_the_same_bytes() {
    assert!(all_of(&recorded()).unwrap() == all_of(&recorded()).unwrap());
}

/// Times of 2 ms + 3 ms per million pixels + 5 ms per million pairs, and a copy rate of 1 byte per nanosecond.
#[test]
fn bounds_and_straight_lines_are_what_they_should() {
    let mut recorded = recorded();
    for one in recorded["benchmarks"].as_array_mut().unwrap() {
        let id = one["id"].as_str().unwrap().to_owned();
        let number = |name: &str| one["numbers"][name].as_f64().unwrap_or(0.0);
        let time = match id.split('/').next().unwrap() {
            "cost" => 2e6 + 3.0 * number("pixels") + 5.0 * number("pairs"),
            "device" if id.contains("copy") => number("bytes"),
            "scan" => 3.0 * number("bytes"),
            _ => continue,
        };
        one["iters"] = [1.0, 2.0].into();
        one["times"] = [time, 2.0 * time].into();
    }
    let [page, _, _] = all_of(&recorded).expect("figures");
    let cost = part(&page, "cost");
    assert!(cost.contains("| all points | 2.00 | 3.00 | 5.00 | 1.0000 | 0 % off |"), "{cost}");
    // 2^20 words of 12 bytes each at 1 GB/s; the measured time is three times that.
    let row = "| scan | 2^20 | 27.8 | 37.7 [37.7..37.7] | 12.6 | bytes | 3.0 |";
    assert!(part(&page, "sort").contains(row), "{}", part(&page, "sort"));
}

#[test]
fn what_is_missing_is_said() {
    let parts = [("sort", "new".to_owned())];
    let (begin, end) = ("<!-- figures: begin sort -->", "<!-- figures: end sort -->");
    assert_eq!(
        fill("p.md", &format!("a\n{begin}\nold\n{end}\nb\n"), &parts).unwrap(),
        format!("a\n{begin}\nnew\n{end}\nb\n")
    );
    for (page, said) in [
        ("no marks\n".to_owned(), "no line '<!-- figures: begin sort -->'"),
        (format!("{begin}\n"), "no line '<!-- figures: end sort -->'"),
        (format!("{begin}{end}{begin}"), "occurs 2 times"),
        (format!("{end}\n{begin}"), "comes before its beginning"),
        (format!("{begin}{end}<!-- figures: begin sortt -->"), "there are no figures 'sortt'; there are device, sort"),
    ] {
        let error = fill("p.md", &page, &parts).unwrap_err();
        assert!(error.starts_with("p.md: ") && error.contains(said), "{error}");
    }

    let mut recorded = recorded();
    recorded["benchmarks"].as_array_mut().unwrap().retain(|b| !b["id"].as_str().unwrap().starts_with("culling/"));
    assert!(part(&all_of(&recorded).unwrap()[0], "culling").contains("Not measured"));
    for group in ["device/multiply-add", "scan/", "frame/", "cost/pairs", "effects/", "iteration/whole", "rrdm/"] {
        let mut less = recorded.clone();
        less["benchmarks"].as_array_mut().unwrap().retain(|b| !b["id"].as_str().unwrap().starts_with(group));
        let error = all_of(&less).map(|_| ()).expect_err(group);
        assert!(error.contains("make figures") && error.contains(group.split('/').next().unwrap()), "{group}: {error}");
    }

    let folder = tempfile::tempdir().unwrap();
    let refused = |result: Result<(), String>, said: &str| {
        let error = result.expect_err(said);
        assert!(error.contains(said), "{error}");
    };
    refused(Bench::read(folder.path()).map(|_| ()), "device.json");
    let path = folder.path().join("sweep.json");
    for (text, said) in
        [("{", "sweep.json"), ("{\"schema\": 2}", "schema 2"), ("{\"schema\": 1, \"axes\": []}", "no axes")]
    {
        std::fs::write(&path, text).unwrap();
        refused(Sweep::read(&path).map(|_| ()), said);
    }
    let folder = unfolded(&recorded);
    std::fs::write(folder.path().join("facts/0.json"), "{}").unwrap();
    refused(Bench::read(folder.path()).map(|_| ()), "0.json: no 'id'");
}

/// The folder of a comparison: three held-out views, whose pruned renders are off by 8, 32 and 16 of 255.
fn comparison() -> tempfile::TempDir {
    let folder = tempfile::tempdir().unwrap();
    let arms = folder.path().join("arms");
    let save = |path: PathBuf, value: u8| {
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        RgbImage::from_pixel(40, 30, Rgb([value; 3])).save(path).unwrap();
    };
    for (name, error) in [("a.png", 8), ("b.png", 32), ("c.png", 16)] {
        save(arms.join("default/renders/photos").join(name), 100);
        save(arms.join("dense/renders").join(name), 104);
        save(arms.join("default/renders").join(name), 100 + error);
    }
    let told = serde_json::json!({ "arms": [
        { "name": "dense", "gaussians": 5000 },
        { "name": "default", "gaussians": 1400 },
    ] });
    std::fs::write(folder.path().join("compare.json"), told.to_string()).unwrap();
    folder
}

#[test]
fn renders_are_one_view_side_by_side() {
    let folder = comparison();
    let (jpeg, readme) = renders(folder.path()).expect("renders");
    let picture = image::load_from_memory(&jpeg).unwrap().to_rgb8();
    assert_eq!(picture.dimensions(), (3 * 40 + 2 * 6, 30));
    // The middle of each picture: photo, dense, and the pruned render of median quality.
    for (x, expected) in [(20, 100_u8), (66, 104), (112, 116)] {
        assert!(picture.get_pixel(x, 15).0.iter().all(|v| v.abs_diff(expected) <= 3), "{x}");
    }
    // 20 lg (255 / 4) and 20 lg (255 / 16).
    let caption = part(&readme, "renders");
    for told in ["5,000 Gaussians, 36.1 dB", "28 % of them, 1,400 Gaussians, 24.0 dB", RENDERS] {
        assert!(caption.contains(told), "{told}: {caption}");
    }
    assert!(renders(folder.path()).unwrap().0 == jpeg, "the same files give the same bytes");

    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let page = read(&root.join("README.md"));
    assert!(fill("README.md", &page, &readme).expect("markers").contains(caption.trim_end()));
    assert!(!page.contains(RENDERS) || root.join(RENDERS).is_file(), "README shows {RENDERS}");
}

#[test]
fn a_comparison_without_pictures_is_refused() {
    for (missing, said) in [
        ("compare.json", "compare.json"),
        ("arms/dense/renders/b.png", "b.png"),
        ("arms/default/renders/c.png", "c.png"),
        ("arms/default/renders/photos", "--arms dense,default"),
    ] {
        let folder = comparison();
        let path = folder.path().join(missing);
        if path.is_dir() { std::fs::remove_dir_all(&path) } else { std::fs::remove_file(&path) }.unwrap();
        let error = renders(folder.path()).map(|_| ()).expect_err(missing);
        assert!(error.contains(said), "{missing}: {error}");
    }
    let folder = comparison();
    std::fs::write(folder.path().join("compare.json"), "{\"arms\": []}").unwrap();
    assert!(renders(folder.path()).map(|_| ()).unwrap_err().contains("no arm 'dense'"));
    let folder = comparison();
    RgbImage::new(4, 3).save(folder.path().join("arms/dense/renders/a.png")).unwrap();
    assert!(renders(folder.path()).map(|_| ()).unwrap_err().contains("a.png"), "sizes differ");
}

/// The comparison of one scene, as left by `make results`.
fn compared(psnr: f64) -> serde_json::Value {
    let arm = |name: &str, psnr: f64, gaussians: usize| {
        serde_json::json!({ "name": name, "psnr": psnr, "psnr_spread": 0.126, "psnr_pruned": null, "ssim": 0.91234,
            "gaussians": gaussians, "ply_bytes": 1_500_000, "seconds": 61.0 })
    };
    let arms = [arm("dense", psnr, 100_000), arm("default", psnr - 0.25, 28_000)];
    serde_json::json!({ "device": { "name": "a device" }, "iterations": 7000, "prune_point": 3500, "gaussians": 100_000,
        "seeds": [1, 2, 3], "arms": arms })
}

#[test]
fn tables_of_results() {
    let folder = tempfile::tempdir().unwrap();
    assert!(results(folder.path(), &origin()).map(|_| ()).unwrap_err().contains("no comparison"));
    for (scene, psnr) in [("fox", 32.0), ("chair", 35.5)] {
        std::fs::create_dir(folder.path().join(scene)).unwrap();
        std::fs::write(folder.path().join(scene).join("compare.json"), compared(psnr).to_string()).unwrap();
    }
    let [page, readme] = results(folder.path(), &origin()).unwrap();
    let (page, readme) = (part(&page, "results"), part(&readme, "results"));
    for told in
        ["a device, commit 0123abc", "### chair", "seeds: 3.", "| default | 31.75 | 0.13 | – | 0.9123 | 28,000 | "]
    {
        assert!(page.contains(told), "{told}: {page}");
    }
    assert!(readme.contains("| chair | 35.50 dB, 100 k | 35.25 dB, 28 k |"), "{readme}");
    for (file, body) in [("docs/results.md", page), ("README.md", readme)] {
        let text = read(&Path::new(env!("CARGO_MANIFEST_DIR")).join(file));
        assert!(fill(file, &text, &[("results", body.to_owned())]).unwrap().contains(body.trim_end()));
    }
    std::fs::write(folder.path().join("fox/compare.json"), "{").unwrap();
    assert!(results(folder.path(), &origin()).map(|_| ()).unwrap_err().contains("fox"));
}

#[test]
fn curves_of_models_become_a_plot_and_a_table() {
    let folder = tempfile::tempdir().unwrap();
    let cup = folder.path().join("cup");
    std::fs::create_dir(&cup).unwrap();
    let files = [
        ("qirf-vk", "sog", 200, Some(30.0)),
        ("qirf-vk", "spz", 100, Some(20.0)),
        ("qirf-vk", "spz", 400, Some(24.0)),
        ("other 1.0", "sog", 150, Some(19.0)),
        ("other 1.0", "spz", 190, Some(18.0)),
        ("other 1.0", "sog", 900, None),
    ]
    .map(|(tool, format, bytes, psnr)| {
        serde_json::json!({ "tool": tool, "format": format, "bytes": bytes, "gaussians": 9,
            "scores": { "psnr": psnr }, "parts": [["means", bytes]] })
    });
    std::fs::write(cup.join("curve.json"), serde_json::json!({ "files": files }).to_string()).unwrap();
    let (plot, table) = generator::bytes(&[&cup], "Once.").unwrap();
    // SPZ: half of the way by the logarithm; the other tool: the best file that is small enough.
    assert!(table.contains("| cup | 0.000 | 30.0 | 22.0 | 19.0 |"), "{table}");
    assert_eq!((plot.matches("<polyline").count(), generator::BYTES), (4, "docs/figures/bytes.svg"));
    assert!(generator::bytes(&[folder.path()], "").is_err(), "there is no curve");
}
