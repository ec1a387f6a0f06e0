//! The benefit of effects on synthetic scenes: held-out PSNR with each effect off and on, in scenes that call for it
//! and in others. `make effects` prints the table of docs/effects.md.

use crate::support::plain;
use crate::support::runs::config;
use qirf_vk::effects::{Choice, Effect};
use qirf_vk::gaussians::formats;
use qirf_vk::job::{Output, RunConfig, Selection, Session};
use qirf_vk::metrics::Networks;
use qirf_vk::pipeline::eval::{Evaluation, eval};
use qirf_vk::pipeline::run;
use qirf_vk::synth::{self, SynthOptions, write};
use std::path::Path;
use synth::Effect as Made;

/// 48 photos; every fourth is held out.
#[derive(Clone, Copy)]
struct Case {
    /// Effects that the scene was made with.
    made: &'static [Made],
    /// The effect under test: switched on, against `off`.
    effect: Effect,
    off: Choice,
    /// Width of the pictures that are trained on.
    width: u32,
    /// Largest number of Gaussians.
    most: usize,
    iterations: u32,
    /// Resolution of the training photos, and of the scored ones; none means their own.
    resolutions: [Option<&'static str>; 2],
}

const EXPOSURE: Case = Case {
    made: &[Made::Exposure],
    effect: Effect::Exposure,
    off: Choice::Off,
    width: 64,
    most: 3000,
    iterations: 1000,
    resolutions: [None; 2],
};
const GLOSSY: Case = Case { made: &[Made::Glossy], effect: Effect::ViewDependence, ..EXPOSURE };
const SCALES: Case = Case { made: &[Made::Scales], effect: Effect::Antialias, ..EXPOSURE };
const DISTORTION: Case = Case { made: &[Made::Distortion], effect: Effect::Distortion, ..EXPOSURE };

impl Case {
    /// The shortest run that still shows the effect's benefit.
    fn short(self) -> Self {
        Self { most: 2000, iterations: 250, ..self }
    }

    /// PSNR in dB, off and on, means over `seeds`. Both are scored alike: with fitted exposures if the effect is
    /// exposure, by undistorted photos if it is distortion.
    fn psnr(self, seeds: u64) -> [f64; 2] {
        let device = plain();
        let mut sums = [0.0; 2];
        for seed in 1..=seeds {
            let folder = tempfile::tempdir().unwrap();
            let scene = folder.path().join("scene");
            let large = if self.resolutions[0].is_some() { 2 } else { 1 };
            let (views, width, height) = (48, self.width * large, self.width * 3 / 4 * large);
            let effects = self.made.to_vec();
            let options =
                SynthOptions { views, width, height, points: 30 * views, effects, seed, ..SynthOptions::default() };
            write(&scene, &options, &|_| ()).expect("a synthetic scene");
            for (sum, choice) in sums.iter_mut().zip([self.off, Choice::On]) {
                let mut config = config(&scene, self.iterations);
                config.eval_every = 4;
                config.max_gaussians = self.most;
                config.resolution = self.resolutions[0].map(str::to_owned);
                config.sh_degree = if self.effect == Effect::ViewDependence { 3 } else { 1 };
                config.effects.set(self.effect, choice);
                let output = Output::new(&folder.path().join(format!("{choice:?}"))).unwrap();
                let networks = Networks::default();
                let results = run::run(&Session::new(&device, &networks), &config, &output, false).unwrap();
                let decision = results.effects.iter().find(|d| d.name == self.effect).unwrap();
                assert_eq!(decision.forced, choice != Choice::Auto);
                assert!(choice == Choice::Auto || decision.on == (choice == Choice::On));
                assert_eq!(decision.seconds.is_some(), decision.on && self.effect.scope().is_some());
                let written = std::fs::read_to_string(output.folder().join("config.toml")).unwrap();
                let again: RunConfig = toml::from_str(&written).unwrap();
                assert_eq!(again.effects, config.effects);
                *sum += self.score(&device, &output.folder().join("model.ply"), &again) / seeds as f64;
            }
        }
        println!("{}", self.row(sums));
        sums
    }

    fn score(&self, device: &qirf_vk::gpu::Device, path: &Path, run: &RunConfig) -> f64 {
        let model = formats::read(path).unwrap().gaussians;
        let mut selection = Selection { resolution: self.resolutions[1].map(str::to_owned), ..run.selection() };
        if self.effect == Effect::Distortion {
            selection.effects.set(Effect::Distortion, Choice::Auto);
        }
        let exposure = self.effect == Effect::Exposure;
        let evaluation = Evaluation { selection, style: run.style, exposure };
        let networks = Networks::default();
        let scored = eval(&Session::new(device, &networks), path, &model, &evaluation, None).unwrap();
        scored.test.unwrap().psnr.unwrap()
    }

    /// A row of the table.
    fn row(&self, [off, on]: [f64; 2]) -> String {
        let made: Vec<String> = self.made.iter().map(|made| format!("`{made}`")).collect();
        let made = if made.is_empty() { "plain".to_owned() } else { made.join(", ") };
        let (effect, iterations) = (self.effect.name(), self.iterations);
        let effect =
            if self.off == Choice::Auto { format!("{effect}, beside what the scene calls for") } else { effect.into() };
        let width = self.width;
        let [trained, scored] = self.resolutions.map(|r| r.unwrap_or("/1"));
        format!(
            "| {made} | {effect} | {width} | {iterations} | {trained} | {scored} | {off:.2} | {on:.2} | {:+.2} |",
            on - off
        )
    }
}

/// If cameras are near and far, a model keeps its quality at a resolution that it was not trained at.
#[test]
fn antialias_helps_at_a_second_resolution() {
    let [off, on] = Case { resolutions: [None, Some("/4")], ..SCALES }.short().psnr(1);
    assert!(on > off + 0.5, "{off} {on}");
}

#[test]
#[ignore = "minutes: make effects"]
fn table() {
    let plain = |case: Case| Case { made: &[], ..case };
    println!(
        "| scene | effect | width | iterations | trained at | scored at | off, dB | on, dB | gain |\n|---|---|---:|---:|---|---|---:|---:|---:|"
    );
    for (case, least) in [(EXPOSURE, 0.5), (GLOSSY, 0.5), (DISTORTION, 0.25)] {
        let [off, on] = case.psnr(3);
        assert!(on > off + least, "{}: {off} {on}", case.effect.name());
    }
    for case in [
        Case { iterations: 400, ..EXPOSURE },
        plain(EXPOSURE),
        Case { made: &[Made::Matte], off: Choice::Auto, width: 120, most: 100_000, iterations: 2000, ..GLOSSY },
        SCALES,
        Case { resolutions: [None, Some("/2")], ..SCALES },
        Case { resolutions: [None, Some("/4")], ..SCALES },
        Case { resolutions: [Some("/2"), None], ..SCALES },
        plain(SCALES),
        Case { resolutions: [None, Some("/4")], ..plain(SCALES) },
        Case { effect: Effect::DepthOrder, ..plain(EXPOSURE) },
    ] {
        case.psnr(3);
    }
}
