//! Pictures that tell how a model is drawn, and what a prune did with it.

use super::session::{Viewer, request};
use super::{beside, scene};
use crate::program::ended::{Ended, copy, end, qirf};
use crate::support::{device, finish};
use qirf_vk::gaussians::resident::Resident;
use qirf_vk::gaussians::{Gaussians, formats};
use qirf_vk::job::diagnostics::{CANONICAL, DETAIL, Diagnostics, KEPT, MERGED, NO_BLOCK, REPAIRED, UNSEEN};
use qirf_vk::pipeline::evaluate::pictures::write_png;
use qirf_vk::qirf::select::Selector;
use qirf_vk::render::{Image, Renderer, Settings};
use qirf_vk::scene::{OpenOptions, Scene};
use qirf_vk::view::paint;
use qirf_vk::view::protocol::{Figure, Picture};
use serde_json::Value;
use std::fs;
use std::path::Path;

fn program(arguments: &[&str]) -> Ended {
    end(&mut qirf(arguments))
}

/// A compression of the scene's model by few, small views: its figures.
fn compressed(out: &Path, more: &[&str]) -> Value {
    let (model, out) = (beside("model.ply"), out.display().to_string());
    let small = ["compress", &model, "-o", &out, "--views", "16", "--size", "64x64", "--json"];
    program(&[&small[..], more].concat()).with(0, &[]).json()
}

fn flagged(facts: &Diagnostics, flag: u8) -> u64 {
    facts.flags.iter().filter(|f| **f & flag != 0).count() as u64
}

/// Pixels that a mask hides do not count, as in `eval`; a photo that is hidden as a whole has no figure.
#[test]
fn an_errors_psnr_is_that_of_eval_under_masks() {
    let folder = tempfile::tempdir().unwrap();
    copy(scene(), folder.path());
    fs::create_dir(folder.path().join("masks")).unwrap();
    for (photo, seen_from) in [("view_0001.png", 24), ("view_0002.png", 64)] {
        let mask = image::GrayImage::from_fn(64, 48, |x, _| image::Luma([if x < seen_from { 0 } else { 255 }]));
        mask.save(folder.path().join("masks").join(photo)).unwrap();
    }
    let (model, capture) = (beside("model.ply"), folder.path().display().to_string());
    let scores = program(&["eval", &model, &capture, "--eval-every", "1", "--json"]).with(0, &[]).json();
    let viewer = Viewer::start(&["view", &model, "--scene", &capture]);
    let description = viewer.json("/scene.json");
    let cameras = description["cameras"].as_array().unwrap();
    let mut socket = viewer.socket();
    for view in scores["views"].as_array().unwrap() {
        let photo = cameras.iter().position(|camera| camera["name"] == view["name"]).unwrap();
        let wish = request(1, &format!(r#"{{"photo":{photo}}}"#), r#""picture":"error","still":true"#);
        match (socket.picture(&wish).0.figure, view["psnr"].as_f64()) {
            (Figure::Psnr(shown), Some(scored)) => assert!((f64::from(shown) - scored).abs() < 1e-3, "{shown}: {view}"),
            (Figure::None, None) => assert_eq!(view["name"], "view_0002.png"),
            (shown, _) => panic!("{shown:?}: {view}"),
        }
    }
}

#[test]
fn a_compression_tells_what_became_of_each_gaussian() {
    let folder = tempfile::tempdir().unwrap();
    let (out, plain, file) =
        (folder.path().join("a.ply"), folder.path().join("b.ply"), folder.path().join("a.safetensors"));
    let name = file.display().to_string();
    let model = formats::read(Path::new(&beside("model.ply"))).unwrap().gaussians;
    for selector in ["pairs", "css", "importance"] {
        let figures = compressed(&out, &["--selector", selector, "--diagnostics", &name]);
        if selector == "pairs" {
            compressed(&plain, &["--selector", selector]);
            assert!(fs::read(&out).unwrap() == fs::read(&plain).unwrap(), "the same model with and without the file");
        }
        let facts = Diagnostics::read(&file, &model).unwrap();
        assert_eq!((facts.selector.to_string().as_str(), facts.score.len()), (selector, model.len()));
        let kept = figures["output"]["gaussians"].as_u64().unwrap();
        assert_eq!(flagged(&facts, KEPT), kept, "{selector}");
        let merged = figures["prune"]["pairs"]["merged"].as_u64();
        assert_eq!(flagged(&facts, MERGED), merged.unwrap_or(0), "{selector}");
        assert!(selector != "pairs" || merged > Some(0), "{selector}: {merged:?}");
        if selector == "pairs" {
            // Each that was merged shares its cluster with exactly one that was kept.
            for (i, flags) in facts.flags.iter().enumerate().filter(|(_, f)| **f & MERGED != 0) {
                let same = |k: &usize| facts.block[*k] == facts.block[i] && facts.flags[*k] & KEPT != 0;
                assert_eq!((0..model.len()).filter(same).count(), 1, "Gaussian {i}, {flags}");
            }
        } else {
            let blocks = facts.block.iter().max().unwrap() + 1;
            assert_eq!(Some(u64::from(blocks)), figures["prune"]["blocks"].as_u64(), "{selector}");
            assert_eq!(Some(flagged(&facts, DETAIL)), figures["prune"]["detail"].as_u64(), "{selector}");
        }
    }
    // A kept Gaussian scores no less than a dropped one of its block, where the score alone decides.
    compressed(&out, &["--selector", "importance", "--budget", "per-block", "--diagnostics", &name]);
    let facts = Diagnostics::read(&file, &model).unwrap();
    let mut compared = 0;
    for (i, k) in (0..model.len()).flat_map(|i| (0..model.len()).map(move |k| (i, k))) {
        let by_rank = facts.flags[i] & (KEPT | DETAIL) == KEPT && facts.flags[k] & KEPT == 0;
        if by_rank && facts.block[i] == facts.block[k] {
            // Ranks compare scores to 12 bits.
            assert!(facts.score[i] >= facts.score[k] * (1.0 - 1e-3), "{i} and {k}");
            compared += 1;
        }
    }
    assert!(compared > 1000, "{compared}");
}

#[test]
fn pictures_of_counts_and_of_a_prune_are_what_their_functions_draw() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("prune.safetensors");
    let name = file.display().to_string();
    compressed(&folder.path().join("small.ply"), &["--selector", "css", "--diagnostics", &name]);
    let viewer = super::viewer(&["--diagnostics", &name]);
    assert_eq!(viewer.json("/scene.json")["models"][0]["pruned_by"], "css");
    let mut socket = viewer.socket();

    let model = formats::read(Path::new(&beside("model.ply"))).unwrap().gaussians;
    let facts = Diagnostics::read(&file, &model).unwrap();
    let views = Scene::open(scene(), &OpenOptions::default()).unwrap().views;
    let device = device();
    let mut shown = model.clone();
    shown.sh.truncate(model.degree_in_effect() + 1);
    let resident = Resident::upload(&device, &shown).unwrap();
    let mut renderer = Renderer::new(&device, Settings::default(), model.len(), 64, 48).unwrap();
    let mut seen = Vec::new();
    for (n, kind) in ["count", "blocks", "kept", "score", "guards"].into_iter().enumerate() {
        for still in [true, false] {
            let more = format!(r#""picture":"{kind}","still":{still}"#);
            let (header, bytes) = socket.picture(&request(n as u32, r#"{"photo":1}"#, &more));
            let camera = views[1].camera.clone();
            let (image, figure) = if kind == "count" {
                let counts = renderer.count_blended(&resident, &camera).unwrap();
                let (image, mean) = paint::count_picture([64, 48], &counts);
                assert!(mean > 0.5 && mean < model.len() as f32, "{mean}");
                (image, Figure::Blended(mean))
            } else {
                let picture: Picture = serde_json::from_str(&format!("{kind:?}")).unwrap();
                let colours = paint::told(picture, &facts).unwrap();
                let painted = paint::painted(&device, &resident, &colours).unwrap();
                (renderer.render(&painted, &camera).unwrap(), Figure::None)
            };
            assert_eq!((png(&image), figure), (bytes.clone(), header.figure), "{kind}, still: {still}");
            if still {
                let pixels = image::load_from_memory(&bytes).unwrap().into_rgb8();
                assert!(
                    kind == "guards" || pixels.pixels().any(|p| p != pixels.get_pixel(0, 0)),
                    "{kind} is one colour"
                );
                assert!(!seen.contains(&bytes), "{kind} looks like another");
                seen.push(bytes);
            }
        }
    }
    // Blocks without the file are those of the default partition, and the others are refused.
    let viewer = super::viewer(&[]);
    let mut socket = viewer.socket();
    let blocks = socket.picture(&request(1, r#"{"photo":1}"#, r#""picture":"blocks","still":true"#)).1;
    assert_eq!(blocks, seen[1], "css chose from the default partition");
    for kind in ["kept", "score", "guards"] {
        let said =
            socket.frame_or_refusal(&request(2, r#"{"photo":1}"#, &format!(r#""picture":"{kind}""#))).unwrap_err();
        assert!(said.contains("--diagnostics FILE"), "{said}");
    }
    drop((resident, renderer));
    finish(&device);
}

fn png(image: &Image) -> Vec<u8> {
    let mut bytes = Vec::new();
    write_png(&mut bytes, image, false).unwrap();
    bytes
}

/// Six opaque Gaussians side by side: each pixel picture shows the colour that its record means.
#[test]
fn colours_mean_what_the_page_says() {
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("row.ply");
    let means = (0..6_u8).map(|i| [f32::from(i) - 2.5, 0.0, 0.0]).collect();
    let model = Gaussians::balls(means, 0.12_f32.ln(), 6.0, 0);
    formats::write(&path, &model, formats::RenderMode::Plain).unwrap();
    let model = formats::read(&path).unwrap().gaussians;
    let facts = Diagnostics {
        selector: Selector::Css,
        block: vec![0, 0, 1, 1, NO_BLOCK, 2],
        score: vec![0.0, 1.0, 2.0, 3.0, 4.0, 100.0],
        flags: vec![KEPT | DETAIL, MERGED, UNSEEN, KEPT | CANONICAL, REPAIRED, KEPT],
        participation: vec![0.5, 0.4, 0.3, 0.2, 0.1, 0.0],
    };
    let file = folder.path().join("row.safetensors");
    facts.write(&file, &model).unwrap();
    let viewer = Viewer::start(&["view", path.to_str().unwrap(), "--diagnostics", file.to_str().unwrap()]);
    let mut socket = viewer.socket();
    let mut colours = |kind: &str| -> Vec<[f64; 3]> {
        let camera = r#"{"pose":{"position":[0,0,-6],"rotation":[1,0,0,0],"fov":0.9}}"#;
        let more = format!(r#""picture":"{kind}","still":true"#);
        let bytes = socket.picture(&request(1, camera, &more).replace("[64,48]", "[320,240]")).1;
        let picture = image::load_from_memory(&bytes).unwrap().into_rgb8();
        let focal = 120.0 / 0.45_f64.tan();
        let x = |i: usize| (160.0 + focal * f64::from(model.means[i][0]) / 6.0) as u32;
        (0..6).map(|i| picture.get_pixel(x(i), 120).0.map(|c| f64::from(c) / 255.0)).collect()
    };
    let near = |a: [f64; 3], b: [f64; 3]| a.iter().zip(b).all(|(a, b)| (a - b).abs() < 0.03);
    let (green, yellow, red) = ([0.20, 0.75, 0.30], [0.95, 0.80, 0.20], [0.85, 0.15, 0.12]);
    let kept = colours("kept");
    for (got, wanted) in kept.iter().zip([green, yellow, red, green, red, green]) {
        assert!(near(*got, wanted), "{kept:?}");
    }
    let guards = colours("guards");
    let (pink, orange, blue, cyan, grey) =
        ([0.90, 0.20, 0.75], [0.95, 0.60, 0.15], [0.20, 0.45, 0.95], [0.30, 0.85, 0.85], [0.35, 0.37, 0.40]);
    for (got, wanted) in guards.iter().zip([cyan, grey, blue, orange, pink, grey]) {
        assert!(near(*got, wanted), "{guards:?}");
    }
    let blocks = colours("blocks");
    assert!(near(blocks[0], blocks[1]) && near(blocks[2], blocks[3]) && near(blocks[4], grey), "{blocks:?}");
    assert!(!near(blocks[0], blocks[2]) && !near(blocks[2], blocks[5]), "{blocks:?}");
    // By rank, whatever the scores' distances: dark blue, and red for 100 after 4.
    let score = colours("score");
    assert!(near(score[0], [0.09, 0.07, 0.35]) && near(score[5], [0.80, 0.12, 0.10]), "{score:?}");
    assert!(near(colours("count")[0], [0.105, 0.26, 0.60]), "one Gaussian: {:?}", colours("count"));
}

#[test]
fn files_of_other_models_and_damaged_files_are_refused_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let file = folder.path().join("prune.safetensors");
    let name = file.display().to_string();
    compressed(&folder.path().join("small.ply"), &["--diagnostics", &name]);
    let refused = |model: &str, file: &str, words: &[&str]| {
        let said = program(&["view", model, "--diagnostics", file]).with(3, words).said;
        assert_eq!(said.trim_end().lines().count(), 1, "{said}");
    };
    let (model, other) = (beside("model.ply"), beside("other.ply"));
    refused(&other, &name, &["prune.safetensors", "another model", "before the prune"]);
    refused(folder.path().join("small.ply").to_str().unwrap(), &name, &["another model", "Gaussians, this one "]);
    refused(&model, folder.path().join("none.safetensors").to_str().unwrap(), &["none.safetensors", "check the path"]);
    refused(&model, &model, &["model.ply", "not a complete safetensors file"]);
    let bytes = fs::read(&file).unwrap();
    let damaged = folder.path().join("damaged.safetensors");
    let damage = |bytes: &[u8], words: &[&str]| {
        fs::write(&damaged, bytes).unwrap();
        refused(&model, damaged.to_str().unwrap(), &[&["damaged.safetensors"], words].concat());
    };
    damage(&bytes[..bytes.len() / 2], &["not a complete safetensors file"]);
    let mut flipped = bytes.clone();
    *flipped.last_mut().unwrap() ^= 4;
    damage(&flipped, &["checksum"]);
    let at = bytes.windows(8).position(|w| w == b"\"score\":").unwrap();
    damage(&[&bytes[..at], b"\"scare\":", &bytes[at + 8..]].concat(), &["record score is missing"]);

    // Where a file is written, it replaces nothing else.
    let out = folder.path().join("x.ply").display().to_string();
    for (arguments, word) in [
        (vec!["--diagnostics", "facts.txt"], ".safetensors"),
        (vec!["--diagnostics", "none/facts.safetensors"], "create its folder"),
        (vec!["--diagnostics", &name, "--report", &name], "different files"),
    ] {
        let Ended { code, said, .. } = program(&[&["compress", &model, "-o", &out], &arguments[..]].concat());
        assert!(matches!(code, Some(2 | 5)) && said.contains(word), "{said}");
    }
}

#[test]
fn a_run_writes_its_last_prune_and_the_model_before_it() {
    let folder = tempfile::tempdir().unwrap();
    let out = folder.path().join("out");
    let (out_name, file) = (out.display().to_string(), out.join("prune.safetensors"));
    let name = file.display().to_string();
    let scene = scene().display().to_string();
    let run = ["run", &scene, "-o", &out_name, "--iterations", "60", "--grow-to", "400", "--schedule", "one-shot"];
    let refused = |more: &[&str], word: &str| {
        program(&[&run[..], more].concat()).with(2, &[word]);
        assert!(!out.exists(), "{word}");
    };
    for taken in ["model", "checkpoint"] {
        let taken = out.join(taken).with_extension("safetensors").display().to_string();
        refused(&["--diagnostics", &taken], "already used for another output");
    }
    refused(&["--diagnostics", &name, "--no-prune"], "--no-prune");
    let ended = program(&[&run[..], &["--diagnostics", &name]].concat());
    let before = out.join("prune.ply");
    ended.with(0, &[&format!("qirf-vk view {} --diagnostics {name}", before.display())]);
    let model = formats::read(&before).unwrap().gaussians;
    let facts = Diagnostics::read(&file, &model).unwrap();
    let figures: Value = serde_json::from_slice(&fs::read(out.join("metrics.json")).unwrap()).unwrap();
    let prune = figures["prunes"].as_array().unwrap().last().unwrap();
    assert_eq!(prune["before"].as_u64(), Some(model.len() as u64));
    assert_eq!(prune["after"].as_u64(), Some(flagged(&facts, KEPT)));
    // The same model without the file.
    let again = folder.path().join("again");
    program(&[&["run", &scene, "-o", again.to_str().unwrap()], &run[4..]].concat()).with(0, &[]);
    assert_eq!(fs::read(out.join("model.ply")).unwrap(), fs::read(again.join("model.ply")).unwrap());
}

/// Among the faces' names, `front` is not the first.
#[test]
fn a_photo_that_is_cut_into_faces_is_shown_from_its_front_first() {
    let folder = tempfile::tempdir().unwrap();
    copy(scene(), folder.path());
    fs::write(folder.path().join("sparse/0/cameras.txt"), "1 OPENCV_FISHEYE 64 48 15 15 32 24 0 0 0 0\n").unwrap();
    let viewer = Viewer::start(&["view", &beside("model.ply"), "--scene", &folder.path().display().to_string()]);
    let description = viewer.json("/scene.json");
    let cameras = description["cameras"].as_array().unwrap();
    let is_start = |c: &&Value| ["position", "rotation"].iter().all(|key| c[key] == description["start"][key]);
    let first = cameras.iter().find(is_start).unwrap();
    assert!(first["held_out"] == true && first["name"].as_str().unwrap().contains(".front."), "{first}");
}
