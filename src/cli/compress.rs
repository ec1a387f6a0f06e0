//! `qirf-vk compress MODEL -o OUT`.

use super::Global;
use super::compression::CompressArgs;
use super::console::Console;
use super::diagnostics::{self, Recorder};
use super::inspect::read_model;
use super::scratch::Scratch;
use super::show::Show;
use super::values;
use super::view::{self, Watched};
use crate::gaussians::formats;
use crate::metrics::{Networks, Scores};
use crate::pipeline::Error;
use crate::pipeline::compress::aim::Aim;
use crate::pipeline::compress::{self, Input};
use crate::pipeline::config::no_methods;
use crate::pipeline::records::{AimRecord, CompressRecord, ModelFile, StageScores, Truth};
use crate::pipeline::{Output, Session, host_bytes};
use crate::qirf::pairs::PairCounts;
use crate::report::of_compression;
use std::path::{Path, PathBuf};
use std::time::Instant;

const EXAMPLES: &str = "Examples:
  qirf-vk compress flowers.ply -o small.spz
  qirf-vk compress flowers.ply -o small.ply --target-count 20000 --fine-tune 500
  qirf-vk compress flowers.ply -o small.sog --size 500kB
  qirf-vk compress flowers.ply -o small.sog --psnr 35
  qirf-vk compress model.ply -o small.ply --scene capture --resolution /4 --fine-tune 3000
  qirf-vk compress model.ply -o small.ply --selector importance --budget global --json

Without photos, pictures of the model itself, from all around it, tell which Gaussians they need. If you have the capture, --scene is the better choice; for rooms and landscapes, which surround their cameras, it is the only good one.";

/// Prune an existing model: keep the Gaussians that its pictures need.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub(super) struct Arguments {
    /// Model: a .ply, .spz, .splat, .ksplat, .sog, .glb, .gltf, .usda or .usdz file, or a SOG folder
    model: PathBuf,
    /// Model to write: .ply, .compressed.ply, .spz, .sog, .glb, .usda or .usdz
    #[arg(short, long, value_name = "OUT")]
    output: PathBuf,
    /// Iterations of training after the prune, on the photos or on the original's pictures
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = clap::value_parser!(u32).range(0..=1_000_000))]
    fine_tune: u32,
    /// Write the figures to this file: as JSON, or as a page if its name ends in .html
    #[arg(long, value_name = "FILE")]
    report: Option<PathBuf>,
    /// Write what became of each Gaussian, its score and its block to this file, for `qirf-vk view MODEL --diagnostics FILE`; its
    /// name ends in .safetensors
    #[arg(long, value_name = "FILE", value_parser = diagnostics::file)]
    diagnostics: Option<PathBuf>,
    /// Print the figures as JSON on standard output
    #[arg(long)]
    json: bool,
    #[command(flatten)]
    options: CompressArgs,
    /// Limit on device memory, such as 2G or 800M [default: the device's]
    #[arg(long, value_name = "BYTES", value_parser = values::bytes, help_heading = "Rendering")]
    memory_budget: Option<u64>,
    #[command(flatten)]
    scratch: Scratch,
    #[command(flatten)]
    watched: Watched,
}

impl Arguments {
    pub fn run(&self, console: &Console, global: &Global) -> Result<(), Error> {
        self.check_outputs()?;
        self.watched.check()?;
        if self.watched.view && self.fine_tune == 0 {
            return Err(Error::Usage("--view shows the training after the prune; add --fine-tune N".to_owned()));
        }
        let aim = self.options.aim()?;
        let reading = Instant::now();
        let loaded = read_model(&self.model, console)?;
        let read_s = reading.elapsed().as_secs_f64();
        let device = global.open_with(self.memory_budget)?;
        let style = self.options.rendering.style(&self.model, &loaded, None, console);
        let input = Input { path: &self.model, model: loaded.gaussians, read_s };
        let mut watcher = Show::new(console);
        watcher.record(self.diagnostics.as_deref().map(Recorder::of_file));
        let (host_bytes, scratch) = (host_bytes(self.memory_budget), self.scratch.folder());
        let session = Session {
            device: &device,
            networks: &Networks::default(),
            host_bytes,
            scratch,
            watcher: &watcher,
            methods: no_methods,
        };
        let config = self.options.configuration(style, self.fine_tune)?;
        let subject = || view::of_compression(&config, &input.model, &self.output, console);
        let subject = self.watched.view.then(subject).transpose()?;
        let figures = self.watched.during(&session, console, subject, |session| {
            compress::compress_to(session, input, (&config, aim), &self.output)
        })?;
        let json = serde_json::to_value(&figures).map_err(|e| Error::encoding("the report", e))?;
        if let Some(path) = &self.report {
            let page = path.extension().is_some_and(|e| e.eq_ignore_ascii_case("html"));
            let text = if page { of_compression(&figures) } else { format!("{json:#}\n") };
            Output::text(path, &text)?;
        }
        if self.json { console.json(&json) } else { report(console, &figures) }
    }

    /// Refuses outputs that cannot be written or would overwrite the input, before any work.
    fn check_outputs(&self) -> Result<(), Error> {
        formats::check_output(&self.output).map_err(Error::writing)?;
        for path in [Some(&self.output), self.report.as_ref(), self.diagnostics.as_ref()].into_iter().flatten() {
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
        if self.report.is_some() && self.report == self.diagnostics {
            return Err(Error::Usage("--report and --diagnostics are two files".to_owned()));
        }
        Ok(())
    }
}

/// Says where the model has less than was asked.
fn shortfall(console: &Console, aim: &AimRecord, output: &ModelFile) {
    match aim.aim {
        Aim::Bytes(size) if 20 * output.bytes < 19 * size => console.note(format_args!(
            "no file of this model in this format needs {size} bytes: the whole model, as finely as the format allows, has {}",
            output.bytes
        )),
        Aim::Psnr(wanted) if aim.chosen.psnr.is_some_and(|psnr| psnr < wanted - 0.1) => console.note(format_args!(
            "no file in this format reaches {wanted} dB: this one, of the whole model, is the finest"
        )),
        _ => {}
    }
}

fn report(console: &Console, figures: &CompressRecord) -> Result<(), Error> {
    let CompressRecord { input, output, time, test, views, protocol, prune, .. } = figures;
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
    if let Some(aim) = &figures.aim {
        console.print(compress::fit::line(aim, output.bytes, output.gaussians))?;
        shortfall(console, aim, output);
    }
    let truth = match protocol.truth {
        Truth::Photos => "photos",
        Truth::OwnPictures => "the original's pictures",
    };
    let score = |name: &str, stage: fn(&StageScores) -> &Option<Scores>| match stage(test) {
        Some(Scores { psnr, ssim, .. }) => {
            // Equal pictures have no PSNR.
            let psnr = psnr.map_or_else(|| "equal".to_owned(), |v| format!("{v:.2} dB"));
            let worst = views.iter().filter_map(|view| stage(&view.scores).as_ref()?.psnr).reduce(f64::min);
            let worst = worst.map_or_else(String::new, |v| format!(" (worst view {v:.2} dB)"));
            console.print(format_args!("{name:<10} PSNR {psnr}{worst}, SSIM {ssim:.4}"))
        }
        None => Ok(()),
    };
    score("before", |stages| &stages.before)?;
    score("pruned", |stages| &stages.pruned)?;
    score("fine-tuned", |stages| &stages.fine_tuned)?;
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
