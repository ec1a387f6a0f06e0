//! `edit`: operations in order, what they leave, what they refuse.

use super::cli::{Sandbox, model};
use super::ended::Ended;
use crate::support::documented;
use qirf_vk::gaussians::formats::{self, RenderMode};
use qirf_vk::gaussians::{Gaussians, sh};
use qirf_vk::glam::DVec3;
use std::fs;

fn read(sandbox: &Sandbox, name: &str) -> Gaussians {
    formats::read(&sandbox.path(name)).unwrap().gaussians
}

fn write(sandbox: &Sandbox, name: &str, model: &Gaussians, mode: RenderMode) {
    formats::write(&sandbox.path(name), model, mode).unwrap();
}

#[test]
fn operations_apply_in_the_order_of_the_command_line() {
    let sandbox = Sandbox::new();
    // Twenty Gaussians on a circle of radius 1: half of them have x above 0.
    let half = ["--crop-box", "0,-9,-9,9,9,9"];
    let first = sandbox.works(&[&["edit", "model.ply", "-o", "a.ply"][..], &half, &["--translate", "5,0,0"]].concat());
    let last = sandbox.works(&[&["edit", "model.ply", "-o", "b.ply", "--translate", "5,0,0"][..], &half].concat());
    assert!(first.out.contains("left") && first.out.contains("removed"), "{}", first.out);
    let (a, b) = (read(&sandbox, "a.ply"), read(&sandbox, "b.ply"));
    assert_eq!((a.len(), b.len()), (model(20).means.iter().filter(|m| m[0] >= 0.0).count(), 20));
    assert!(a.means.iter().all(|m| m[0] >= 5.0), "{:?}", a.means);
    assert_eq!(last.out.lines().count(), 2, "{}", last.out);
    let outside =
        sandbox.works(&[&["edit", "model.ply", "--count-only", "--json"][..], &half, &["--outside"]].concat());
    let document = outside.json();
    documented("edit", &document);
    assert_eq!(document["steps"][0]["after"], 20 - a.len());
    assert_eq!(document["steps"][0]["why"], "centres inside the box");
    assert_eq!(document["output"]["path"], serde_json::Value::Null);
    // Nothing but the order of operations: no operation is the model itself.
    sandbox.works(&["edit", "model.ply", "-o", "same.ply", "--order", "none"]);
    assert_eq!(read(&sandbox, "same.ply"), model(20));
}

#[test]
fn successive_moves_are_applied_as_one() {
    let sandbox = Sandbox::new();
    let away = ["edit", "model.ply", "-o", "back.ply", "--translate", "1e6,-2e6,3e5"];
    let back = ["--rotate", "z:30", "--rotate", "z:-30", "--translate=-1e6,2e6,-3e5"];
    let off = || {
        let (moved, model) = (read(&sandbox, "back.ply").means, model(20).means);
        let apart = moved.as_flattened().iter().zip(model.as_flattened()).map(|(a, b)| (a - b).abs());
        apart.fold(0.0, f32::max)
    };
    let ran = sandbox.works(&[&away[..], &back].concat());
    assert!(off() < 1e-7 && !ran.said.contains("rounded"), "{}: {}", off(), ran.said);
    assert_eq!(ran.out.matches(": 20 Gaussians of SH degree 1").count(), 4, "{}", ran.out);
    // What lies between two moves needs positions in between.
    let ran = sandbox.works(&[&away[..], &["--crop-box", "0,-9e6,-9e6,9e6,9e6,9e6"], &back].concat());
    assert!(off() > 1e-3 && ran.said.contains("far from its origin at --crop-box 0,-9e6"), "{}: {}", off(), ran.said);
    // In any steps all the way round.
    let round = ["--rotate", "z:10"].repeat(36);
    sandbox.works(&[&["edit", "model.ply", "-o", "back.ply"][..], &round[..]].concat());
    assert!(off() < 1e-7, "{}", off());
}

#[test]
fn a_turned_model_shows_turned_colours() {
    let sandbox = Sandbox::new();
    sandbox.works(&["edit", "model.ply", "-o", "turned.ply", "--rotate", "1,2,3:40", "--scale", "2", "--up", "y"]);
    fs::write(sandbox.path("m.json"), "[[0,-1,0,1],[1,0,0,2],[0,0,1,3],[0,0,0,1]]").unwrap();
    let orders = ["--matrix", "m.json", "--order", "morton", "--order", "none"];
    sandbox.works(&[&["edit", "model.ply", "-o", "quarter.ply"][..], &orders].concat());
    let (before, after) = (model(20), read(&sandbox, "turned.ply"));
    let size = |m: &[f32; 3]| m.iter().map(|x| f64::from(*x).powi(2)).sum::<f64>().sqrt();
    for i in 0..20 {
        assert!((size(&after.means[i]) - 2.0 * size(&before.means[i])).abs() < 1e-5);
        assert!((after.log_scales[i][1] + 2.0 - 2_f32.ln()).abs() < 1e-6);
    }
    // Along a Gaussian's own direction from the origin, colours are the same before and after.
    let colour = |model: &Gaussians, i: usize, c: usize| -> f64 {
        let basis = sh::basis(DVec3::from_array(model.means[i].map(f64::from)).normalize());
        (0..3).map(|m| basis[1 + m] * f64::from(model.sh[1][i * 9 + 3 * m + c])).sum()
    };
    assert!((0..20).all(|i| (0..3).all(|c| (colour(&before, i, c) - colour(&after, i, c)).abs() < 1e-6)));
    let quarter = read(&sandbox, "quarter.ply");
    let expected = |m: &[f32; 3]| [1.0 - m[1], 2.0 + m[0], 3.0 + m[2]];
    let near = |a: [f32; 3], b: &[f32; 3]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 1e-6);
    assert!(before.means.iter().all(|m| quarter.means.iter().any(|q| near(expected(m), q))));
}

#[test]
fn sizes_that_the_format_cuts_off_are_told() {
    let sandbox = Sandbox::new();
    let mut thin = model(20);
    thin.log_scales[3] = [-9.0; 3];
    write(&sandbox, "thin.ply", &thin, RenderMode::Plain);
    let ran = sandbox.works(&["edit", "thin.ply", "-o", "thin.spz", "--scale", "0.1"]);
    assert!(ran.said.contains("thin.spz: 1 Gaussian is smaller or larger than"), "{}", ran.said);
}

#[test]
fn what_goes_is_counted_with_its_reason() {
    let sandbox = Sandbox::new();
    let mut strange = model(20);
    strange.means[2][1] = f32::NAN;
    strange.opacity_logits[3] = -9.0;
    strange.log_scales[4] = [3.0, -4.0, -4.0];
    strange.log_scales[5] = [f32::NEG_INFINITY, -1.0, -1.0]; // a scale of 0
    write(&sandbox, "strange.ply", &strange, RenderMode::Plain);
    let line =
        ["edit", "strange.ply", "-o", "out.ply", "--remove", "invisible", "--remove", "needles", "--max-size", "1e3"];
    let ran = sandbox.works(&[&line[..], &["--min-opacity", "0.1", "--sh-degree", "0", "--json"]].concat());
    assert!(ran.said.contains("1 Gaussian removed for NaN") && ran.said.contains("zero scales"), "{}", ran.said);
    let document = ran.json();
    documented("edit", &document);
    let removed =
        |step: usize| (document["steps"][step]["removed"].as_u64(), document["steps"][step]["ranges"].to_string());
    assert_eq!(removed(0), (Some(1), "[[3,3]]".to_owned()));
    assert_eq!(removed(1), (Some(1), "[[4,4]]".to_owned()));
    assert_eq!(removed(2), (Some(0), "[]".to_owned()));
    assert_eq!(document["output"]["gaussians"], 17);
    // Those of a second model follow, with every row of its file.
    let both =
        sandbox.works(&["edit", "strange.ply", "strange.ply", "--count-only", "--json", "--remove", "invisible"]);
    assert_eq!(both.json()["steps"][0]["ranges"].to_string(), "[[3,3],[23,23]]");
    assert_eq!((read(&sandbox, "out.ply").degree(), document["output"]["sh_degree"].as_u64()), (0, Some(0)));
}

#[test]
fn cameras_crop_what_they_see() {
    let sandbox = Sandbox::new();
    sandbox.scene("low", "1 PINHOLE 40 8 35 35 20 4", &["one.png", "two.png"]);
    let crop = ["edit", "model.ply", "-o", "seen.ply", "--crop-views", "low"];
    sandbox.works(&crop);
    let seen = read(&sandbox, "seen.ply").len();
    sandbox.works(&["edit", "model.ply", "-o", "rest.ply", "--crop-views", "low", "--outside"]);
    assert!(seen > 0 && seen + read(&sandbox, "rest.ply").len() == 20);
    sandbox.fails(2, &[&crop[..], &["--least-views", "3"]].concat(), &["3 photos", "2 photos", "--least-views"]);
    // The faces of a photo are one photo, whose rim may lie within them.
    sandbox.scene("wide", "1 OPENCV_FISHEYE 96 72 22 22 48 36 0 0 0 0", &["one.png"]);
    let beyond = Gaussians { means: vec![[0.0; 3], [1.9, 0.0, -4.14]], ..model(2) };
    write(&sandbox, "beyond.ply", &beyond, RenderMode::Plain);
    let wide = ["edit", "beyond.ply", "-o", "seen.ply", "--crop-views", "wide"];
    sandbox.works(&wide);
    assert_eq!(read(&sandbox, "seen.ply").means, [[0.0; 3]]);
    sandbox.fails(2, &[&wide[..], &["--least-views", "2"]].concat(), &["at least 2 photos", "wide has 1 photo;"]);
    sandbox.fails(3, &["edit", "model.ply", "-o", "o.ply", "--crop-views", "absent"], &["absent"]);
}

/// The crop moves no coordinates of the model, wherever the capture lies.
#[test]
fn a_far_capture_tells_nothing_about_the_model() {
    let sandbox = Sandbox::new();
    let folder = sandbox.scene("far", "1 PINHOLE 40 30 35 35 20 15", &["one.png"]).join("sparse/0");
    let poses = "1 1 0 0 0 -1000000 0 4 1 one.png\n\n2 1 0 0 0 -1000001 0 4 1 two.png\n\n";
    fs::write(folder.join("images.txt"), poses).unwrap();
    fs::write(folder.join("points3D.txt"), "1 1000000 0 0 10 20 30 0.5 1 0\n").unwrap();
    let ran = sandbox.works(&["edit", "model.ply", "--count-only", "--crop-views", "far"]);
    assert!(ran.said.contains("far from its world's origin") && !ran.said.contains("of the model"), "{}", ran.said);
}

#[test]
fn models_are_merged_if_they_are_drawn_alike() {
    let sandbox = Sandbox::new();
    let mut flat = model(3);
    flat.sh.truncate(1);
    write(&sandbox, "flat.ply", &flat, RenderMode::Plain);
    write(&sandbox, "smooth.ply", &flat, RenderMode::AntiAliased);
    sandbox.works(&["edit", "model.ply", "flat.ply", "-o", "both.ply"]);
    let both = read(&sandbox, "both.ply");
    assert_eq!((both.len(), both.degree()), (23, 1));
    assert!(both.sh[1][20 * 9..].iter().all(|x| *x == 0.0));
    let clash = ["edit", "flat.ply", "smooth.ply", "-o", "no.ply"];
    sandbox.fails(3, &clash, &["flat.ply is plain", "smooth.ply is anti-aliased", "--antialias"]);
    assert!(!sandbox.path("no.ply").exists());
    sandbox.works(&[&clash[..], &["--antialias=on"]].concat());
    assert_eq!(formats::read(&sandbox.path("no.ply")).unwrap().mode, RenderMode::AntiAliased);
}

/// In map coordinates float32 has steps of half a metre.
#[test]
fn merged_models_use_the_origin_that_is_near_them() {
    let sandbox = Sandbox::new();
    let utm = [500_000.0, 4_000_000.0, 300.0];
    let world = |m: [f32; 3]| std::array::from_fn::<f32, 3, _>(|i| (f64::from(m[i]) + utm[i]) as f32);
    let far = Gaussians { means: model(20).means.into_iter().map(world).collect(), ..model(20) };
    write(&sandbox, "world.ply", &far, RenderMode::Plain);
    formats::write_at(&sandbox.path("local.ply"), &model(20), RenderMode::Plain, utm).unwrap();
    let merged = |first: &str, second: &str| {
        let said = sandbox.works(&["edit", first, second, "-o", "both.ply"]).said;
        let loaded = formats::read(&sandbox.path("both.ply")).unwrap();
        let warned = said.lines().any(|line| line.contains("rounded to about") && !line.contains("world.ply: "));
        (loaded.gaussians.means, loaded.origin, warned)
    };
    let (means, origin, warned) = merged("world.ply", "local.ply");
    assert!(means[20..] == model(20).means && origin == utm && !warned, "{origin:?}");
    let (means, origin, warned) = merged("local.ply", "model.ply");
    assert!(means[..20] == model(20).means && origin == utm && warned, "{origin:?}");
    let (means, origin, warned) = merged("model.ply", "local.ply");
    assert!(means[..20] == model(20).means && origin == [0.0; 3] && warned, "{origin:?}");
}

#[test]
fn bad_requests_write_nothing_and_say_why() {
    let sandbox = Sandbox::new();
    for (name, text) in [
        ("stretch.txt", "1 0 0 0\n0 1 0 0\n0 0 2 0"),
        ("words.txt", "one two"),
        ("short.txt", "1 2 3"),
        ("zero.txt", "0 0 0 0 0 0 0 0 0 0 0 0"),
    ] {
        fs::write(sandbox.path(name), text).unwrap();
    }
    fs::write(sandbox.path("bytes.txt"), [0xff, 0xfe]).unwrap();
    let before = sandbox.content();
    let fails = |code: i32, options: &[&str], says: &[&str]| {
        sandbox.fails(code, &[&["edit", "model.ply", "-o", "out.ply"], options].concat(), says);
    };
    fails(2, &["--scale", "0"], &["--scale 0", "above 0"]);
    fails(2, &["--scale", "nan"], &["above 0"]);
    fails(2, &["--scale", "1e39"], &["float32"]);
    fails(2, &["--translate", "0,0"], &["x,y,z"]);
    fails(2, &["--crop-box", "1,1,1,0,0,0"], &["--crop-box", "box is empty"]);
    fails(2, &["--crop-sphere", "50,0,0,1"], &["leaves no Gaussian", "from -1.0", "nothing was written"]);
    fails(2, &["--outside"], &["--crop-box"]);
    fails(2, &["--scene", "scene"], &["--remove floaters"]);
    fails(2, &["--least-views", "2"], &["--crop-views"]);
    fails(2, &["--remove", "dirt"], &["needles"]);
    fails(2, &["--sh-degree", "4"], &["0 to 3"]);
    fails(2, &["--min-opacity", "2"], &["0 to 1"]);
    fails(2, &["--max-size", "-1"], &["above 0"]);
    fails(2, &["--order", "random"], &["morton"]);
    fails(2, &["--rotate", "y"], &["degrees"]);
    fails(2, &["--rotate", "0,0,0,0"], &["a quaternion", "not all of them 0"]);
    fails(3, &["--matrix", "stretch.txt"], &["stretch.txt", "2.0", "a uniform scale"]);
    fails(3, &["--matrix", "zero.txt"], &["zero.txt"]);
    fails(3, &["--matrix", "words.txt"], &["words.txt", "'one'"]);
    fails(3, &["--matrix", "short.txt"], &["short.txt", "12 or 16"]);
    fails(3, &["--matrix", "bytes.txt"], &["bytes.txt"]);
    fails(3, &["--matrix", "absent.txt"], &["absent.txt"]);
    sandbox.fails(2, &["edit", "model.ply", "--scale", "2"], &["--output"]);
    sandbox.fails(2, &["edit", "-o", "out.ply"], &["IN"]);
    sandbox.fails(2, &["edit", "model.ply", "-o", "model.ply"], &["another name"]);
    sandbox.fails(2, &["edit", "model.ply", "-o", "out.obj"], &["out.obj"]);
    sandbox.fails(2, &["edit", "model.ply", "-o", "scene"], &["scene"]);
    for name in ["page.html", "lod/lod-meta.json"] {
        sandbox.fails(2, &["edit", "model.ply", "-o", name], &[name, "`qirf-vk convert`"]);
        sandbox.fails(2, &["compress", "model.ply", "-o", name], &[name, "`qirf-vk convert`"]);
    }
    sandbox.fails(5, &["edit", "model.ply", "-o", "absent/out.ply"], &["absent"]);
    sandbox.fails(3, &["edit", "absent.ply", "-o", "out.ply"], &["absent.ply"]);
    assert_eq!(sandbox.content(), before, "nothing was written or changed");
    // Only counting, nothing may be left.
    sandbox.works(&["edit", "model.ply", "--count-only", "--crop-sphere", "50,0,0,1"]);
}

/// A ball of 400 Gaussians, and a scene of nine cameras all round it whose photos are its own pictures.
fn ball(sandbox: &Sandbox) -> Gaussians {
    let mean = |i: usize| {
        let (z, turn) = (1.0 - (i as f32 + 0.5) / 200.0, i as f32 * 2.399_963);
        let side = (1.0 - z * z).sqrt();
        [side * turn.cos(), z, side * turn.sin()]
    };
    let colour = |k: usize| (k / 3 * (7 + k % 3) % 10) as f32 / 5.0 - 1.0;
    let sh = vec![(0..3 * 400).map(colour).collect()];
    let ball = Gaussians { sh, ..Gaussians::balls((0..400).map(mean).collect(), -2.3, 3.0, 0) };
    write(sandbox, "ball.ply", &ball, RenderMode::Plain);
    let names: Vec<String> = (0..9).map(|i| format!("v{i}.png")).collect();
    let round = sandbox.scene("round", "1 PINHOLE 64 48 60 60 32 24", &["v0.png"]);
    let line = |i: usize| {
        let half = std::f64::consts::PI * i as f64 / 9.0;
        format!("{} {} 0 {} 0 0 0 4 1 {}\n\n", i + 1, half.cos(), half.sin(), names[i])
    };
    fs::write(round.join("sparse/0/images.txt"), (0..9).map(line).collect::<String>()).unwrap();
    sandbox.works(&["render", "ball.ply", "--scene", "round", "-o", "shots"]);
    fs::create_dir(round.join("images")).unwrap();
    for name in &names {
        fs::copy(sandbox.path("shots").join(name), round.join("images").join(name)).unwrap();
    }
    ball
}

#[test]
fn floaters_go_by_what_photos_show() {
    let sandbox = Sandbox::new();
    let mut model = ball(&sandbox);
    let scene = ["--scene", "round"];
    let clean = |name: &str, options: &[&str]| {
        let line = ["edit", name, "-o", "clean.ply", "--remove", "floaters", "--json"];
        let line = [&line[..], options].concat();
        // The rest is done by the same kernels.
        let ended = if name == "dirty.ply" { sandbox.validated(&line) } else { sandbox.works(&line) };
        ended.json()
    };
    assert_eq!(clean("ball.ply", &scene)["steps"][0]["removed"], 0, "a model that agrees with its photos");
    // In empty space, before the second camera, far behind, and where no camera looks.
    let mut floaters = Gaussians::zeroed(4, 0);
    floaters.rotations.fill([1.0, 0.0, 0.0, 0.0]);
    floaters.opacity_logits.fill(1.0);
    floaters.log_scales = vec![[-2.5; 3], [-3.5; 3], [-1.0; 3], [-1.0; 3]];
    let (sin, cos) = (std::f32::consts::TAU / 9.0).sin_cos();
    let before = |depth: f32| [sin * (4.0 - depth), 0.0, -cos * (4.0 - depth)];
    floaters.means = vec![[0.0, 0.2, -2.0], before(0.5), [1.5, 0.0, 9.0], [0.0, 60.0, 0.0]];
    model.append(&floaters);
    write(&sandbox, "dirty.ply", &model, RenderMode::Plain);
    let document = clean("dirty.ply", &scene);
    documented("edit", &document);
    assert_eq!(document["steps"][0]["ranges"].to_string(), "[[400,403]]", "{document:#}");
    let by_rule = document["steps"][0]["rules"].as_object().unwrap().values();
    let listed =
        by_rule.flat_map(|ranges| ranges.as_array().unwrap()).map(|r| r[1].as_u64().unwrap() - r[0].as_u64().unwrap());
    assert_eq!(listed.map(|more| more + 1).sum::<u64>(), 4, "{document:#}");
    assert_eq!(read(&sandbox, "clean.ply").len(), 400);
    // Pictures of the model agree with it: they tell what is alone.
    let alone = clean("dirty.ply", &[]);
    let removed = alone["steps"][0]["removed"].as_u64().unwrap();
    assert!((1..=4).contains(&removed), "{alone:#}");
    let Ended { out, said, .. } = sandbox.works(&["edit", "dirty.ply", "--count-only", "--remove", "floaters"]);
    assert!(out.contains("close to a single camera") && !out.contains("photo"), "{out}");
    assert!(said.contains("--scene finds them"), "{said}");
    sandbox.fails(3, &["edit", "ball.ply", "-o", "o.ply", "--remove", "floaters", "--scene", "absent"], &["absent"]);
    // No Gaussian is to blame for the photos' exposures.
    for (i, gain) in [0.7, 1.2].into_iter().cycle().take(9).enumerate() {
        let photo = sandbox.path("round/images").join(format!("v{i}.png"));
        let mut picture = image::open(&photo).unwrap().into_rgb8();
        picture.iter_mut().for_each(|value| *value = (f32::from(*value) * gain).round() as u8);
        picture.save(&photo).unwrap();
    }
    assert_eq!(clean("ball.ply", &scene)["steps"][0]["removed"], 0, "a model that agrees but for exposures");
    assert_eq!(clean("dirty.ply", &scene)["steps"][0]["ranges"].to_string(), "[[400,403]]");
}

#[test]
fn runs_may_end_clean() {
    let sandbox = Sandbox::new();
    ball(&sandbox);
    let line = ["run", "round", "-o", "trained", "--init", "ball.ply", "--iterations", "20", "--no-prune", "--json"];
    let plain = sandbox.works(&line).json();
    assert!(plain["floaters"].is_null());
    let line = [&line[..3], &["cleaned"], &line[4..], &["--clean"]].concat();
    let cleaned = sandbox.works(&line).json();
    documented("metrics.json", &serde_json::json!({ "floaters": cleaned["floaters"] }));
    let gone: u64 = ["disagree", "near_one", "alone"].iter().filter_map(|k| cleaned["floaters"][k].as_u64()).sum();
    assert_eq!(cleaned["gaussians"]["final"].as_u64().map(|n| n + gone), plain["gaussians"]["final"].as_u64());
    let config = fs::read_to_string(sandbox.path("cleaned/config.toml")).unwrap();
    assert!(config.contains("\nclean = true\n"), "{config}");
}
