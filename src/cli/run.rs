//! `qirf-vk run SCENE`.

use super::Global;
use super::choices::Choices;
use super::console::Console;
use super::show::Show;
use super::values;
use crate::effects::{Choice, Effect, Overrides};
use crate::error::Error;
use crate::metrics::Networks;
use crate::pipeline::compression::Pruning;
use crate::pipeline::results::Results;
use crate::pipeline::{Init, Output, Preset, RunConfig};
use crate::pipeline::{budget, run};
use std::path::PathBuf;

const EXAMPLES: &str = "Examples:
  qirf-vk run capture -o trained --no-prune --preset quick --resolution 256
  qirf-vk run capture -o trained --no-prune --iterations 7000 --checkpoint-every 1000
  qirf-vk run capture -o trained --no-prune --iterations 7000 --resume
  qirf-vk run --config trained/config.toml -o again --no-prune

The folder holds model.ply, metrics.json, renders/ and config.toml, which reproduces the run.";

/// Train a scene: photos with poses to a 3DGS model, its pictures and its figures.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub(super) struct Arguments {
    /// Scene: a COLMAP, Blender, instant-ngp or nerfstudio folder
    #[arg(required_unless_present = "config", conflicts_with = "config")]
    scene: Option<PathBuf>,
    /// Folder for the results; made where it is absent
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// Train a dense model only
    #[arg(long)]
    no_prune: bool,
    /// Prune once, or in steps
    #[arg(long, value_name = "one-shot|gradual", default_value = "one-shot", help_heading = "Compression")]
    schedule: Steps,
    #[command(flatten)]
    choices: Choices,
    /// Go on from the folder's checkpoint, if there is one
    #[arg(long)]
    resume: bool,
    /// Take every option from this file: an earlier run's config.toml
    #[arg(long, value_name = "FILE")]
    config: Option<PathBuf>,
    /// Named schedule
    #[arg(long, default_value = "standard", help_heading = "Training")]
    preset: Preset,
    /// Length of the run; the schedule's milestones scale with it
    #[arg(long, value_name = "N", help_heading = "Training", value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    iterations: Option<u32>,
    /// Degree of the spherical harmonics [default: as the scene calls for, up to 3]
    #[arg(long, value_name = "L", help_heading = "Effects", value_parser = clap::value_parser!(u8).range(0..=3))]
    sh_degree: Option<u8>,
    /// Key of all random numbers: the same seed on the same device gives the same bytes
    #[arg(long, value_name = "N", default_value_t = 1, help_heading = "Training")]
    seed: u32,
    /// Begin on: points (the scene's own, else random), random, or a model file
    #[arg(long, value_name = "points|random|MODEL", default_value = "points", help_heading = "Training")]
    init: String,
    /// Number of random points [default: by picture size]
    #[arg(long, value_name = "N", help_heading = "Training", value_parser = clap::value_parser!(u32).range(1..))]
    init_count: Option<u32>,
    /// Never more Gaussians than this
    #[arg(long, value_name = "N", default_value_t = 4_000_000, help_heading = "Training")]
    max_gaussians: usize,
    /// Device memory that the run may use, such as 2G or 800M, and the most that decoded photos take of the host's
    /// [default: the device's, and a quarter of the host's]
    #[arg(long, value_name = "BYTES", value_parser = values::bytes, help_heading = "Training")]
    memory_budget: Option<u64>,
    /// Keep each Gaussian's energy where it is smaller than a pixel
    #[arg(long, help_heading = "Effects")]
    antialias: bool,
    /// Simulate an effect or not, whatever the scene calls for: view_dependence, exposure, antialias, distortion,
    /// transparency or masks; repeat it for others (`qirf-vk inspect SCENE` tells what a scene calls for)
    #[arg(long, value_name = "NAME=on|off|auto", value_parser = Overrides::parse, help_heading = "Effects")]
    effect: Vec<(Effect, Choice)>,
    /// Colour behind the Gaussians [default: white for photos with alpha, else black]
    #[arg(long, value_name = "R,G,B", value_parser = values::colour, help_heading = "Training")]
    background: Option<[f32; 3]>,
    /// Iterations between checkpoints; 0 for none but on Ctrl-C
    #[arg(long, value_name = "N", default_value_t = 5000, help_heading = "Training")]
    checkpoint_every: u32,
    /// Photo folder (such as images_4)
    #[arg(long, value_name = "DIR", help_heading = "Photos")]
    images: Option<PathBuf>,
    /// Picture size as width, or as a divisor of the photos' size
    #[arg(long, value_name = "W|/K", help_heading = "Photos", value_parser = values::resolution_text)]
    resolution: Option<String>,
    /// Hold every N-th photo out for the scores; 0 holds none out
    #[arg(long, value_name = "N", default_value_t = 8, help_heading = "Photos")]
    eval_every: usize,
    /// LPIPS weights: a file, or a folder of them (tools/lpips-weights makes them)
    #[arg(long, value_name = "PATH", help_heading = "Photos")]
    lpips_weights: Option<PathBuf>,
    /// Print the figures as JSON on standard output
    #[arg(long)]
    json: bool,
}

/// How often to prune.
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Steps {
    /// Once, at half the run
    OneShot,
    /// Four times, from 13/30 to 20/30 of the run
    Gradual,
}

fn init(text: &str) -> Init {
    match text {
        "points" => Init::Points,
        "random" => Init::Random,
        path => Init::Model(PathBuf::from(path)),
    }
}

impl Arguments {
    pub fn run(&self, console: &Console, global: &Global) -> Result<(), Error> {
        if self.output.exists() && !self.output.is_dir() {
            return Err(Error::Usage(format!("-o {} is a file; name a folder", self.output.display())));
        }
        let config = self.configuration()?;
        let networks = Networks::find(self.lpips_weights.as_deref())?;
        if let Some(note) = networks.note() {
            console.note(note);
        }
        let device = global.open_with(self.memory_budget)?;
        let show = Show::new(console);
        let output = Output::new(&self.output)?;
        let results =
            run::run(&device, &config, &output, &networks, budget::host(self.memory_budget), self.resume, &show)?;
        self.report(console, &results)
    }

    fn configuration(&self) -> Result<RunConfig, Error> {
        if let Some(path) = &self.config {
            return values::run_config(path);
        }
        Ok(RunConfig {
            scene: self.scene.clone().unwrap_or_default(),
            images: self.images.clone(),
            resolution: self.resolution.clone(),
            seed: self.seed,
            eval_every: self.eval_every,
            sh_degree: usize::from(self.sh_degree.unwrap_or(3)),
            init: init(&self.init),
            init_count: self.init_count.map(|n| n as usize),
            background: self.background,
            antialias: false,
            exposure: false,
            max_gaussians: self.max_gaussians,
            checkpoint_every: self.checkpoint_every,
            schedule: self.preset.schedule(self.iterations),
            prune: (!self.no_prune).then(|| self.pruning()),
            effects: self.overrides(),
        })
    }

    fn overrides(&self) -> Overrides {
        let mut out = self.preset.effects();
        if self.antialias {
            out.set(Effect::Antialias, Choice::On);
        }
        if let Some(degree) = self.sh_degree {
            out.set(Effect::ViewDependence, if degree > 0 { Choice::On } else { Choice::Off });
        }
        for (effect, choice) in &self.effect {
            out.set(*effect, *choice);
        }
        out
    }

    fn pruning(&self) -> Pruning {
        let mut pruning = self.preset.pruning();
        if self.schedule == Steps::Gradual {
            pruning.at = Pruning::GRADUAL.to_vec();
        }
        pruning.compression = self.choices.over(pruning.compression);
        pruning
    }

    fn report(&self, console: &Console, results: &Results) -> Result<(), Error> {
        if self.json {
            return console.json(&serde_json::to_value(results).unwrap_or_default());
        }
        let score = |v: Option<f64>, unit: &str| v.map_or_else(|| "-".to_owned(), |v| format!("{v:.3}{unit}"));
        if let Some(test) = &results.test {
            console.print(format_args!(
                "test   PSNR {}  SSIM {:.4}  LPIPS {}  ({} views)",
                score(test.psnr, " dB"),
                test.ssim,
                score(test.lpips_vgg, ""),
                results.protocol.test_views,
            ))?;
        }
        console.print(format_args!("train  PSNR {}", score(results.train.psnr, " dB")))?;
        console.print(format_args!(
            "model  {} Gaussians, {:.1} MB, {:.0} frames a second",
            results.gaussians.last,
            results.model_bytes as f64 / 1e6,
            results.frames_per_second.unwrap_or(0.0),
        ))?;
        console.print(format_args!(
            "time   {:.1} s: photos {:.1}, training {:.1}, evaluation {:.1}; device memory {:.0} MB",
            results.time.total_s,
            results.time.load_s,
            results.time.train_s,
            results.time.evaluate_s,
            results.memory.peak_bytes as f64 / 1e6,
        ))?;
        console.print(format_args!("        {}", self.output.join("model.ply").display()))
    }
}
