//! Anti-aliased models are drawn as their files say, unless an option says otherwise.

use super::{Sandbox, model};
use crate::program::ended::Ended;
use crate::support::golden::Case;
use crate::support::runs::config;
use crate::support::source;
use qirf_vk::gaussians::formats::{self, RenderMode};
use qirf_vk::job::RunConfig;
use qirf_vk::render::Style;
use std::fs;
use std::io::BufReader;

/// Small Gaussians, of which anti-aliasing leaves less: far from the cameras of `scene`.
fn sandbox() -> Sandbox {
    let sandbox = Sandbox::new();
    let mut small = model(20);
    small.log_scales.iter_mut().flatten().for_each(|s| *s -= 3.0);
    for (name, mode) in [("plain.ply", RenderMode::Plain), ("smooth.ply", RenderMode::AntiAliased)] {
        formats::write(&sandbox.path(name), &small, mode).unwrap();
    }
    sandbox
}

impl Sandbox {
    /// The picture of a model from the scene's first camera.
    fn picture(&self, model: &str, options: &[&str]) -> (Vec<u8>, Ended) {
        let ran = self.works(&[&["render", model, "--scene", "scene", "-o", "out"], options].concat());
        (fs::read(self.path("out/one.png")).unwrap(), ran)
    }
}

#[test]
fn files_say_how_they_are_drawn_and_options_override_them() {
    let sandbox = sandbox();
    let (plain, ran) = sandbox.picture("plain.ply", &[]);
    assert!(!ran.said.contains("drawn"), "{}", ran.said);
    let (smooth, ran) = sandbox.picture("smooth.ply", &[]);
    assert!(smooth != plain && !ran.said.contains("drawn"), "{}", ran.said);

    for option in ["--antialias", "--antialias=on"] {
        let (forced, ran) = sandbox.picture("plain.ply", &[option]);
        assert!(
            forced == smooth
                && ran.said.contains("drawn anti-aliased, as --antialias says; its file is tagged as plain")
        );
        assert!(!sandbox.picture("smooth.ply", &[option]).1.said.contains("drawn"), "nothing is overridden");
    }
    let (forced, ran) = sandbox.picture("smooth.ply", &["--antialias=off"]);
    assert!(forced == plain && ran.said.contains("smooth.ply: drawn plain"), "{}", ran.said);

    // The widths: each style's own, and the other one.
    assert!(sandbox.picture("smooth.ply", &["--dilation", "0.1"]).0 == smooth);
    assert!(sandbox.picture("plain.ply", &["--dilation", "0.3"]).0 == plain);
    let wide = sandbox.picture("smooth.ply", &["--dilation", "0.3"]).0;
    assert!(wide != smooth && wide != plain);
    sandbox.fails(2, &["render", "plain.ply", "--orbit", "1", "-o", "out", "--dilation", "0.2"], &["write 0.1 or 0.3"]);
}

/// Models are drawn as their run drew them, on the background that its photos had, unless options say otherwise.
#[test]
fn the_style_and_background_of_a_run_are_those_of_its_model() {
    let sandbox = sandbox();
    let plain = sandbox.picture("plain.ply", &[]).0;
    let run = config(&sandbox.path("scene"), 10);
    let run = RunConfig { style: Style { depth_order: true, ..run.style }, ..run };
    fs::write(sandbox.path("config.toml"), run.written().unwrap()).unwrap();
    fs::write(sandbox.path("metrics.json"), r#"{"protocol":{"background":[1,1,1]}}"#).unwrap();
    let (white, ran) = sandbox.picture("plain.ply", &[]);
    assert!(
        ran.said.contains("with --depth-order") && ran.said.contains("--background 1.000,1.000,1.000"),
        "{}",
        ran.said
    );
    let picture = image::load_from_memory(&white).unwrap().into_rgb8();
    assert!(picture.pixels().any(|p| p.0 == [255; 3]));
    let (black, ran) = sandbox.picture("plain.ply", &["--background", "black", "--depth-order=off"]);
    assert!(black == plain && !ran.said.contains("drawn"), "{}", ran.said);
    assert!(sandbox.works(&["convert", "plain.ply", "page.html"]).said.contains("--background 1.000,1.000,1.000"));
}

#[test]
fn convert_and_compress_keep_the_tag_and_inspect_names_it() {
    let sandbox = sandbox();
    let mode = |name: &str| {
        let said = sandbox.works(&["inspect", name, "--json"]).json()["render_mode"].clone();
        let shown = sandbox.works(&["inspect", name]).out;
        assert!(shown.lines().any(|l| l.starts_with("render mode") && l.ends_with(said.as_str().unwrap())), "{shown}");
        said
    };
    for (from, to) in [("smooth.ply", "a.spz"), ("a.spz", "b.sog"), ("b.sog", "c.ply")] {
        sandbox.converts(&["plain.ply", to]);
        assert_eq!(mode(to), "plain", "{to}");
        let ran = sandbox.converts(&[from, to]);
        assert!(ran.said.contains("20 anti-aliased Gaussians"), "{}", ran.said);
        assert_eq!(mode(to), "anti-aliased", "{to}");
    }
    let compress = ["--views", "8", "--size", "48x48", "--json"];
    for (from, to, options, expected) in [
        ("smooth.ply", "d.spz", &[][..], true),
        ("a.spz", "d.sog", &[], true),
        ("plain.ply", "d.ply", &[], false),
        ("plain.ply", "d.ply", &["--antialias"], true),
        ("smooth.ply", "d.ply", &["--antialias=off"], false),
    ] {
        let ran = sandbox.validated(&[&["compress", from, "-o", to], &compress[..], options].concat());
        assert_eq!(ran.json()["protocol"]["antialias"], expected);
        assert_eq!(mode(to) == "anti-aliased", expected, "{from} {options:?}");
    }
}

#[test]
fn edit_convert_and_compress_keep_the_place_in_the_world() {
    let sandbox = Sandbox::new();
    let place = [500_000.0, 4_100_000.0, 30.0];
    formats::write_at(&sandbox.path("far.ply"), &model(20), RenderMode::Plain, place).unwrap();
    let compress = ["compress", "far.ply", "--views", "4", "--size", "48x48", "-o"];
    for (how, to) in [
        (&["convert", "far.ply"][..], "a.ply"),
        (&["edit", "far.ply", "--min-opacity", "0", "-o"], "b.ply"),
        (&compress, "c.ply"),
        (&compress, "d.spz"),
        (&["compress", "far.ply", "--views", "4", "--size", "48x48", "--size", "9kB", "-o"], "e.ply"),
        (&["convert", "far.ply"], "f.glb"),
    ] {
        let beside = sandbox.path("georeference.json");
        let _ = fs::remove_file(&beside);
        sandbox.works(&[how, &[to]].concat());
        let written: serde_json::Value = serde_json::from_slice(&fs::read(beside).unwrap()).unwrap();
        assert_eq!(written["origin"], serde_json::json!(place), "{to}");
        assert_eq!(formats::read(&sandbox.path(to)).unwrap().origin, place, "{to}");
    }
}

#[test]
fn damaged_tags_are_warnings() {
    let sandbox = sandbox();
    let ply = fs::read(sandbox.path("smooth.ply")).unwrap();
    let at = ply.windows(3).position(|w| w == b"mip").unwrap();
    fs::write(sandbox.path("hurt.ply"), [&ply[..at], b"m\x1b\xff", &ply[at + 3..]].concat()).unwrap();
    let (picture, ran) = sandbox.picture("hurt.ply", &[]);
    assert!(
        ran.said.contains("warning") && ran.said.contains("hurt.ply: the tag `comment SplatRenderMode: m"),
        "{}",
        ran.said
    );
    assert!(picture == sandbox.picture("plain.ply", &[]).0);
    let seen = sandbox.works(&["inspect", "hurt.ply"]);
    assert!(seen.said.contains("hurt.ply: the tag"), "{}", seen.said);
}

#[test]
fn models_are_compared_each_in_its_own_mode() {
    let sandbox = sandbox();
    let scores = |model: &str, original: &str, options: &[&str]| {
        let ran = sandbox.works(&[&["eval", model, "--against", original, "--json"], options].concat());
        (ran.json()["test"]["psnr"].as_f64(), ran.said)
    };
    let (equal, said) = scores("smooth.ply", "smooth.ply", &[]);
    assert!(equal.is_none() && !said.contains("their files tag"), "{equal:?} {said}");
    let (differing, said) = scores("plain.ply", "smooth.ply", &[]);
    assert!(differing.is_some() && said.contains("their files tag this model as plain"), "{differing:?} {said}");
    let (equal, said) = scores("plain.ply", "smooth.ply", &["--antialias=off"]);
    assert!(equal.is_none() && !said.contains("their files tag"), "{equal:?} {said}");
}

/// The golden anti-aliased case has a filter of 0.3 square pixels, as gsplat and PlayCanvas have.
#[test]
fn golden_pictures_come_out_of_the_command_line() {
    let sandbox = Sandbox::new();
    for case in Case::here() {
        let name = case.name.as_str();
        let from = source("tests/golden").join(name);
        let scene = sandbox.path(name).join("sparse/0");
        fs::create_dir_all(&scene).unwrap();
        for file in ["cameras.txt", "images.txt"] {
            fs::copy(from.join("sparse/0").join(file), scene.join(file)).unwrap();
        }
        fs::write(scene.join("points3D.txt"), "").unwrap();
        let tagged = sandbox.path(&format!("{name}.ply"));
        formats::write(&tagged, &case.model, RenderMode::of(case.settings.antialias)).unwrap();
        let untagged = from.join("model.ply");
        let background = case.settings.background.map(|v| v.to_string()).join(",");

        let error = |model: &std::path::Path, options: &[&str]| {
            let out = ["--scene", name, "-o", "out", "--format", "npy", "--background", &background];
            sandbox.works(&[&["render", model.to_str().unwrap()], &out[..], options].concat());
            let mut sum = 0.0;
            for v in 0..case.views.len() {
                let file = fs::File::open(sandbox.path(&format!("out/view{v}.npy"))).unwrap();
                let pixels: Vec<f32> = npyz::NpyFile::new(BufReader::new(file)).unwrap().into_vec().unwrap();
                let (colours, alphas) = (case.expected_view("images", v), case.expected_view("alphas", v));
                assert_eq!(pixels.len(), 4 * alphas.len());
                for (p, (rgb, alpha)) in pixels.chunks_exact(4).zip(colours.chunks_exact(3).zip(&alphas)) {
                    let differences = [rgb[0], rgb[1], rgb[2], *alpha];
                    sum += (0..4).map(|c| (f64::from(p[c]) - differences[c]).abs()).sum::<f64>() / pixels.len() as f64;
                }
            }
            sum / case.views.len() as f64
        };
        let wide = ["--dilation", "0.3"];
        let right = error(&tagged, &wide);
        assert!(right < 1e-5, "{name}: {right:.1e}");
        let narrow = error(&tagged, &["--dilation", "0.1"]);
        assert!(narrow > 1e-3, "{name}: 0.1 square pixels are not what is expected: {narrow:.1e}");
        if case.settings.antialias {
            assert_eq!(error(&untagged, &[&wide[..], &["--antialias"]].concat()), right);
            assert!(error(&untagged, &wide) > 1e-3, "{name}: without its tag");
            assert!(error(&tagged, &[]) > 1e-3, "{name}: with the width of our own models");
        } else {
            assert_eq!(error(&untagged, &[]), right);
        }
    }
}
