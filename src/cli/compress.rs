//! `qirf-vk compress MODEL -o OUT`.

use super::Global;
use super::choices::Choices;
use super::console::Console;
use super::inspect::read_model;
use super::scratch::Scratch;
use super::show::Show;
use super::style;
use super::values::{self, Up};
use crate::effects::Overrides;
use crate::error::Error;
use crate::gaussians::formats;
use crate::metrics::{Networks, Scores};
use crate::pipeline::compress::{self, CompressConfig, Input, ViewSource};
use crate::pipeline::config::Compression;
use crate::pipeline::records::{CompressRecord, Truth};
use crate::pipeline::virtual_views::VirtualCameras;
use crate::pipeline::{Output, Selection, Session, host_bytes};
use crate::qirf::pairs::PairCounts;
use crate::qirf::select::Selector;
use crate::qirf::select::budget::Budget;
use crate::render::Style;
use std::path::{Path, PathBuf};
use std::time::Instant;

const EXAMPLES: &str = "Examples:
  qirf-vk compress flowers.ply -o small.spz
  qirf-vk compress flowers.ply -o small.ply --target-count 20000 --fine-tune 500
  qirf-vk compress model.ply -o small.ply --scene capture --resolution /4 --fine-tune 3000
  qirf-vk compress model.ply -o small.ply --selector importance --budget global --json

Without photos, pictures of the model itself, from all around it, tell which Gaussians they need. If you have the capture,
--scene is the better choice; for rooms and landscapes, which surround their cameras, it is the only good one.";

/// Prune an existing model: keep the Gaussians that its pictures need.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub(super) struct Arguments {
    /// Model: a .ply, .spz, .splat, .ksplat or .sog file, or a SOG folder
    model: PathBuf,
    /// Model to write: .ply, .spz or .sog
    #[arg(short, long, value_name = "OUT")]
    output: PathBuf,
    /// Iterations of training after the prune, on the photos or on the original's pictures
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = clap::value_parser!(u32).range(0..=1_000_000))]
    fine_tune: u32,
    /// Write the figures as JSON to this file
    #[arg(long, value_name = "FILE")]
    report: Option<PathBuf>,
    /// Print the figures as JSON on standard output
    #[arg(long)]
    json: bool,
    /// Preset: standard, or paper with every value as published
    #[arg(long, value_name = "standard|paper", default_value = "standard", help_heading = "Compression")]
    preset: Preset,
    #[command(flatten)]
    choices: Choices,
    /// Random seed: the same seed on the same device gives the same bytes
    #[arg(long, value_name = "N", default_value_t = 1, help_heading = "Compression")]
    seed: u32,
    /// Virtual cameras around the model; every eighth is held out for the scores [default: 48]
    #[arg(long, value_name = "N", help_heading = "Without photos", conflicts_with = "scene", value_parser = clap::value_parser!(u32).range(2..=10_000))]
    views: Option<u32>,
    /// Picture size of virtual cameras [default: 400x400]
    #[arg(long, value_name = "WxH", help_heading = "Without photos", conflicts_with = "scene", value_parser = values::size)]
    size: Option<(u32, u32)>,
    /// Up direction: x, y, z, -x, -y, -z, or auto (as in captures: -y) [default: auto]
    #[arg(long, value_name = "AXIS", help_heading = "Without photos", conflicts_with = "scene", value_parser = values::up, allow_hyphen_values = true)]
    up: Option<Up>,
    /// Scene whose photos are used to score the model: a COLMAP, Blender, instant-ngp or nerfstudio folder
    #[arg(long, value_name = "SCENE", help_heading = "Photos")]
    scene: Option<PathBuf>,
    /// Photo folder (such as images_4)
    #[arg(long, value_name = "DIR", help_heading = "Photos", requires = "scene")]
    images: Option<PathBuf>,
    /// Picture size as width, or as a divisor of the photos' size
    #[arg(long, value_name = "W|/K", help_heading = "Photos", requires = "scene", value_parser = values::resolution_text)]
    resolution: Option<String>,
    /// Hold out every N-th photo for the scores; 0 holds out none [default: 8]
    #[arg(long, value_name = "N", help_heading = "Photos", requires = "scene")]
    eval_every: Option<usize>,
    #[command(flatten)]
    rendering: style::Rendering,
    /// Colour behind the Gaussians [default: white for photos with alpha, else black]
    #[arg(long, value_name = "R,G,B", value_parser = values::colour, help_heading = "Rendering")]
    background: Option<[f32; 3]>,
    /// Limit on device memory, such as 2G or 800M [default: the device's]
    #[arg(long, value_name = "BYTES", value_parser = values::bytes, help_heading = "Rendering")]
    memory_budget: Option<u64>,
    #[command(flatten)]
    scratch: Scratch,
}

/// A preset of all options under "Compression".
#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Preset {
    /// Chosen by measurements
    Standard,
    /// The values of the QIRF paper
    Paper,
}

impl Arguments {
    pub fn run(&self, console: &Console, global: &Global) -> Result<(), Error> {
        self.check_outputs()?;
        let reading = Instant::now();
        let loaded = read_model(&self.model, console)?;
        let read_s = reading.elapsed().as_secs_f64();
        let device = global.open_with(self.memory_budget)?;
        let style = self.rendering.style(&self.model, &loaded, None, console);
        let input = Input { path: &self.model, model: loaded.gaussians, read_s };
        let watcher = Show::new(console);
        let (host_bytes, scratch) = (host_bytes(self.memory_budget), self.scratch.folder());
        let session =
            Session { device: &device, networks: &Networks::default(), host_bytes, scratch, watcher: &watcher };
        let figures = compress::compress(&session, input, &self.configuration(style)?, &self.output)?;
        let json = serde_json::to_value(&figures).map_err(|e| Error::encoding("the report", e))?;
        if let Some(path) = &self.report {
            Output::text(path, &format!("{json:#}\n"))?;
        }
        if self.json { console.json(&json) } else { report(console, &figures) }
    }

    /// Refuses outputs that cannot be written or would overwrite the input, before any work.
    fn check_outputs(&self) -> Result<(), Error> {
        formats::check_output(&self.output).map_err(Error::writing)?;
        for path in [Some(&self.output), self.report.as_ref()].into_iter().flatten() {
            formats::refuse_overwrite(&self.model, path).map_err(Error::writing)?;
            if path.is_dir() {
                return Err(Error::Usage(format!("{} is a folder; name a file", path.display())));
            }
            let folder = path.parent().filter(|f| !f.as_os_str().is_empty()).unwrap_or(Path::new("."));
            std::fs::metadata(folder).map_err(|source| Error::Write { path: path.clone(), source })?;
        }
        if self.report.as_ref() == Some(&self.output) {
            return Err(Error::Usage(format!("{} cannot hold model and report", self.output.display())));
        }
        Ok(())
    }

    fn configuration(&self, style: Style) -> Result<CompressConfig, Error> {
        let preset = match self.preset {
            Preset::Standard => {
                let selector = self.choices.selector.unwrap_or(Selector::Pairs);
                // Without training afterwards, what each block loses stays lost: every block keeps its share.
                let budget = if self.fine_tune == 0 { Budget::PerBlock } else { Budget::default() };
                Compression { selector, budget, ..Compression::default() }
            }
            Preset::Paper => Compression::paper(),
        };
        let default = VirtualCameras::default();
        let views = match &self.scene {
            Some(scene) => ViewSource::Photos(Selection {
                scene: scene.clone(),
                images: self.images.clone(),
                resolution: self.resolution.clone(),
                eval_every: self.eval_every.unwrap_or(8),
                background: self.background,
                effects: Overrides::default(),
            }),
            None => ViewSource::OwnPictures {
                cameras: VirtualCameras {
                    views: self.views.unwrap_or(default.views),
                    size: self.size.unwrap_or(default.size),
                    up: self.up.unwrap_or(Up::Auto).direction(),
                },
                background: self.background.unwrap_or([0.0; 3]),
            },
        };
        Ok(CompressConfig {
            compression: self.choices.over(preset)?,
            views,
            style,
            fine_tune: self.fine_tune,
            seed: self.seed,
        })
    }
}

fn report(console: &Console, figures: &CompressRecord) -> Result<(), Error> {
    let CompressRecord { input, output, time, test, protocol, prune, .. } = figures;
    let how = match &prune.pairs {
        Some(PairCounts { clusters, merged, dropped }) => {
            format!("{merged} merged into {clusters}, {dropped} dropped")
        }
        None => format!("{} in {} blocks", prune.selector, prune.blocks),
    };
    console.print(format_args!("Gaussians  {} of {} kept ({how})", output.gaussians, input.gaussians))?;
    // The output may be larger in another format: 28 % of a SOG model's Gaussians written as PLY.
    let [before, after] = [input.bytes, output.bytes].map(|bytes| bytes.max(1) as f64);
    let (ratio, what) = if after <= before { (before / after, "smaller") } else { (after / before, "larger") };
    console.print(format_args!(
        "file       {:.2} MB of {:.2} MB, {ratio:.1} times {what}",
        after / 1e6,
        before / 1e6
    ))?;
    let truth = match protocol.truth {
        Truth::Photos => "photos",
        Truth::OwnPictures => "the original's pictures",
    };
    let score = |name: &str, scores: &Option<Scores>| match scores {
        Some(s) => {
            // Equal pictures have no PSNR.
            let psnr = s.psnr.map_or_else(|| "equal".to_owned(), |v| format!("{v:.2} dB"));
            console.print(format_args!("{name:<10} PSNR {psnr}, SSIM {:.4}", s.ssim))
        }
        None => Ok(()),
    };
    score("before", &test.before)?;
    score("pruned", &test.pruned)?;
    score("fine-tuned", &test.fine_tuned)?;
    if test.pruned.is_some() {
        console.note(format_args!("scores are of {} held-out views against {truth}", protocol.test_views));
    }
    console.print(format_args!(
        "time       {:.1} s: responses {:.1}, choice and merging {:.2}, fine-tuning {:.1}",
        time.total_s,
        time.responses_s,
        time.keep_mask_s + time.merge_s,
        time.fine_tune_s
    ))?;
    console.print(format_args!("           {}", output.path.display()))
}
