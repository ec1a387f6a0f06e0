//! Comparisons by the real binary: equal counts, one dense model, seeds.

use super::ended::{end, qirf, works};
use super::run::scene;
use std::path::Path;
use std::process::Command;

fn command(scene: &Path, out: &Path, iterations: &str, more: &[&str]) -> Command {
    let mut command = qirf(["compare".as_ref(), scene, "-o".as_ref(), out]);
    command.args(["--iterations", iterations, "--json"]).args(more);
    command
}

/// A comparison's figures.
fn compared(scene: &Path, out: &Path, iterations: &str, more: &[&str]) -> serde_json::Value {
    works(&mut command(scene, out, iterations, more)).json()
}

/// Methods by name end at the same count: by two cuts, by pressure, and from the beginning by relocation and by learnt masks.
#[test]
fn methods_end_at_equal_counts() {
    let folder = tempfile::tempdir().unwrap();
    let scene = scene(folder.path());
    let more = ["--arms", "pop,gns,mcmc,compact3dgs,maskgaussian", "--keep", "0.3"];
    let out = folder.path().join("compared");
    let record = compared(&scene, &out, "120", &more);
    let kept = (record["gaussians"].as_u64().unwrap() * 3 + 5) / 10;
    let arms = record["arms"].as_array().unwrap();
    assert!(
        arms.iter().all(|a| a["gaussians"].as_u64() == Some(kept) && a["psnr"].as_f64().is_some()),
        "{kept}: {arms:?}"
    );
    let selectors = |arm: usize| -> Vec<(&str, u64)> {
        let prunes = arms[arm]["prunes"].as_array().unwrap().iter();
        prunes.map(|p| (p["selector"].as_str().unwrap(), p["iteration"].as_u64().unwrap())).collect()
    };
    assert_eq!(selectors(0), [("change", 60), ("change", 80)]);
    assert!(selectors(1).len() == 1 && selectors(1)[0].0 == "opacity" && (2..5).all(|arm| selectors(arm).is_empty()));
    for arm in &arms[3..] {
        let cut = &arm["cut"];
        let number = |field: &str| cut[field].as_u64().unwrap();
        assert_eq!((number("iteration"), number("after")), (90, kept), "{arm}");
        assert!(number("before") >= number("after") && number("shown") <= number("before"), "{cut}");
    }
    assert!(arms[..3].iter().all(|arm| arm.get("cut").is_none()));
    let page = std::fs::read_to_string(out.join("compare.html")).unwrap();
    assert_eq!(page.matches("the method would have kept").count(), 2);

    // An arm's configuration reproduces it, also where nothing, or only later, is pruned.
    for arm in ["pop", "mcmc", "maskgaussian"] {
        let (own, again) = (out.join("arms").join(arm), folder.path().join(arm));
        works(qirf(["run", "--config"]).arg(own.join("config.toml")).arg("-o").arg(&again));
        let model = |folder: &Path| std::fs::read(folder.join("model.ply")).unwrap();
        assert!(model(&again) == model(&own), "{arm}");
        let memory = &super::run::metrics(&again)["memory"];
        let [estimated, peak] = ["estimated_bytes", "peak_bytes"].map(|field| memory[field].as_u64().unwrap());
        assert!(peak <= estimated, "{arm}: {memory}");
    }
}

/// Arms start from one checkpoint: equal counts, one dense model, and finished arms are reused.
#[test]
fn arms_are_compared_at_equal_counts() {
    let folder = tempfile::tempdir().unwrap();
    let scene = scene(folder.path());
    let out = folder.path().join("compared");
    let compare = |more: &[&str]| compared(&scene, &out, "160", more);
    let first = compare(&["--arms", "default,importance,random:global,dense,radsplat:global+twice", "--keep", "0.3"]);
    let arms = first["arms"].as_array().unwrap();
    let names: Vec<_> = arms.iter().map(|a| a["name"].as_str().unwrap()).collect();
    assert_eq!(names, ["default", "importance", "random:global", "dense", "radsplat:global+twice"]);
    let n = first["gaussians"].as_u64().unwrap();
    let kept = (n * 3 + 5) / 10;
    let counts: Vec<_> = arms.iter().map(|a| a["gaussians"].as_u64().unwrap()).collect();
    assert_eq!(counts, [kept, kept, kept, n, kept]);
    let iterations: Vec<_> = arms[4]["prunes"].as_array().unwrap().iter().map(|p| p["iteration"].clone()).collect();
    assert_eq!(iterations, [85, 128]);
    assert!(arms.iter().all(|a| a["psnr"].as_f64().is_some() && a["fps"].as_f64().unwrap() > 0.0));
    let page = std::fs::read_to_string(out.join("compare.html")).unwrap();
    assert!(
        page.contains("random:global") && page.matches("<img").count() == 2 * 2 * 6,
        "photo and arms, whole and cut"
    );
    assert!(page.contains("another seed may differ") && !page.contains("deviation / dB"), "there is one seed");
    #[cfg(unix)]
    super::report::works_in_a_browser(&out.join("compare.html"));
    let table = std::fs::read_to_string(out.join("compare.csv")).unwrap();
    assert_eq!(table.lines().count(), 6);
    let ends: Vec<&str> = table.lines().filter_map(|line| line.rsplit(',').next()).collect();
    assert!(ends[..2] == ["tie", ""] && ends[2..].iter().all(|tie| ["true", "false"].contains(tie)), "{table}");

    let model = |name: &str| std::fs::metadata(out.join("arms").join(name).join("model.ply")).unwrap().modified();
    let before = model("importance").unwrap();
    let again = compare(&["--arms", "importance,dense", "--keep", "0.3", "--resume"]);
    assert_eq!(again["arms"][0]["psnr"], first["arms"][1]["psnr"]);
    assert_eq!(model("importance").unwrap(), before, "not trained again");
    // A record about another model counts for nothing.
    let file = |name: &str| out.join("arms").join(name).join("model.ply");
    let trained = std::fs::read(file("importance")).unwrap();
    std::fs::copy(file("dense"), file("importance")).unwrap();
    let mended = compare(&["--arms", "importance", "--keep", "0.3", "--resume"]);
    assert_eq!(mended["arms"][0]["psnr"], first["arms"][1]["psnr"]);
    assert!(std::fs::read(file("importance")).unwrap() == trained);
}

/// With several seeds each has its folder, figures are means, and finished seeds are reused. Arms may grow on their own.
#[test]
fn arms_are_compared_over_seeds() {
    let folder = tempfile::tempdir().unwrap();
    let scene = scene(folder.path());
    let out = folder.path().join("compared");
    let compare = |more: &[&str]| compared(&scene, &out, "100", more);
    let first = compare(&["--arms", "default,grown,dense+thresholds", "--seeds", "1", "--seed", "5"]);
    assert_eq!(
        (&first["seeds"], &first["arms"][0]["psnr_spread"]),
        (&serde_json::json!([5]), &serde_json::Value::Null)
    );
    let model = out.join("seed-5/arms/grown/model.ply");
    let written = || std::fs::metadata(&model).unwrap().modified().unwrap();
    let before = written();
    let both = compare(&["--arms", "default,grown,dense+thresholds", "--seeds", "2", "--seed", "5", "--resume"]);
    assert_eq!((&both["seeds"], before), (&serde_json::json!([5, 6]), written()));
    for (arm, once) in both["arms"].as_array().unwrap().iter().zip(first["arms"].as_array().unwrap()) {
        let seeds: Vec<f64> = arm["psnr_by_seed"].as_array().unwrap().iter().map(|v| v.as_f64().unwrap()).collect();
        assert!(seeds.len() == 2 && seeds[0] == once["psnr"].as_f64().unwrap(), "{seeds:?}");
        let (mean, spread) = (arm["psnr"].as_f64().unwrap(), arm["psnr_spread"].as_f64().unwrap());
        assert!((mean - f64::midpoint(seeds[0], seeds[1])).abs() < 1e-9);
        assert!((spread - (seeds[0] - seeds[1]).abs() / 2.0_f64.sqrt()).abs() < 1e-9, "{arm}");
    }
    let [once, twice] = [&first, &both].map(|compared| &compared["arms"][1]["paired"]);
    assert!(once["over_seeds"].is_null() && once["over_views"]["n"].as_u64() > Some(1), "{once}");
    assert_eq!((twice["over_seeds"]["n"].as_u64(), twice["over_seeds"]["t"].as_f64()), (Some(2), Some(12.706205)));
    let [kept, grown] = [0, 1].map(|k| both["arms"][k]["gaussians"].as_f64().unwrap());
    assert!(grown <= kept && grown > 0.9 * kept, "{grown} of {kept}");
    let page = std::fs::read_to_string(out.join("compare.html")).unwrap();
    assert!(page.contains("<img") && page.contains("deviation / dB") && !page.contains("another seed may differ"));
}

/// A comparison that begins anew in the folder of another can be resumed at any moment, and is not lost by a forgotten option.
#[test]
fn a_comparison_in_the_folder_of_another_is_resumed() {
    let folder = tempfile::tempdir().unwrap();
    let (scene, out) = (scene(folder.path()), folder.path().join("compared"));
    let command = |more: &[&str], fault: &str| {
        let mut command = command(&scene, &out, "160", &[&["--arms", "dense,random:global", "-v"], more].concat());
        command.env("QIRF_DEVICE_FAULT", fault);
        command
    };
    let (never, seed) = (format!("submit:{}:lost", 1_u64 << 40), ["--seed", "5"]);
    let again = [&seed[..], &["--resume"]].concat();
    let said = works(&mut command(&[], &never)).said;
    let counted = said.split("had not yet come after ").nth(1).and_then(|rest| rest.split(' ').next());
    let all: u64 = counted.and_then(|n| n.parse().ok()).unwrap_or_else(|| panic!("no count: {said}"));
    let there =
        || ["config.toml", "checkpoint.safetensors", "compare.json", "compare.csv"].map(|name| out.join(name).exists());
    assert_eq!(there(), [true; 4]);
    end(&mut command(&seed, &format!("submit:{}:lost", all / 6))).with(4, &[]);
    assert_eq!(there(), [true, false, false, false], "lost before its first checkpoint");
    let remains = ["no checkpoint yet", "the checkpoint of iteration ", "`run` and `compare` with --resume"];
    end(&mut command(&again, &format!("submit:{}:device-memory", all / 2))).with(5, &remains);
    assert_eq!(there(), [true, true, false, false], "without memory for an arm");
    end(&mut command(&seed, &never)).with(2, &["belongs to an interrupted run", "--resume"]);
    let refused = end(&mut command(&["--resume"], &never))
        .with(2, &["seed was 5, is 1", "use the original options and photos, or"]);
    assert!(!refused.said.contains("--config"), "{}", refused.said);
    let resumed = works(&mut command(&again, &never)).json();
    assert_eq!((&resumed["seeds"], there()), (&serde_json::json!([5]), [true; 4]));
}

/// An arm goes on from its own checkpoint, with the bytes of an undisturbed one.
#[cfg(unix)]
#[test]
fn an_interrupted_arm_goes_on() {
    let folder = tempfile::tempdir().unwrap();
    let (scene, out) = (scene(folder.path()), folder.path().join("compared"));
    let command = |more: &[&str]| command(&scene, &out, "240", &[&["--arms", "random:global"], more].concat());
    let mut child = super::faults::harness::start(&mut command(&[]));
    child.until(|| out.join("checkpoint.safetensors").exists());
    child.signal("TERM").with(130, &["continue with --resume"]);
    let own = out.join("arms/random-global");
    assert!(own.join("checkpoint.safetensors").exists());
    let resumed = works(&mut command(&["--resume"])).with(0, &["random:global resumes after iteration "]).json();
    assert!(resumed["arms"][0]["psnr_pruned"].is_number(), "{resumed}");
    assert!(!own.join("checkpoint.safetensors").exists());
    let again = folder.path().join("again");
    works(qirf(["run", "--config"]).arg(own.join("config.toml")).arg("-o").arg(&again));
    let model = |folder: &Path| std::fs::read(folder.join("model.ply")).unwrap();
    assert!(model(&again) == model(&own));
}
