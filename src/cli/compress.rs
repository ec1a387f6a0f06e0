//! `qirf-vk compress MODEL -o OUT`.

use super::compression::CompressArgs;
use super::console::Console;
use super::diagnostics::{self, Recorder};
use super::scratch::Scratch;
use super::show::Show;
use super::values;
use super::view::{self, Watched};
use super::{Global, check_file, check_folder, check_model, tell_of_missing};
use crate::extension::has_extension;
use crate::gaussians::formats::{self, Precision, SpzPrecision};
use crate::job::records::{CompressRecord, StageScores, Truth};
use crate::job::{Error, Output};
use crate::lab::curve::peer::Peer;
use crate::lab::curve::{CurvePlan, SIZES, curve};
use crate::metrics::{Networks, Scores};
use crate::pipeline::compress::fit::{self, Target};
use crate::pipeline::compress::remarks::remarks;
use crate::pipeline::compress::{self, Input};
use crate::qirf::pairs::PairCounts;
use crate::report;
use crate::wording::counted;
use std::path::PathBuf;
use std::time::Instant;

const EXAMPLES: &str = "Examples:
  qirf-vk compress flowers.ply -o small.spz
  qirf-vk compress flowers.ply -o small.ply --target-count 20000 --fine-tune 500
  qirf-vk compress flowers.ply -o small.sog --size 500kB
  qirf-vk compress flowers.ply -o small.sog --psnr 35
  qirf-vk compress flowers.ply -o curve --curve sog,spz
  qirf-vk compress model.ply -o small.ply --scene capture --resolution /4 --fine-tune 3000
  qirf-vk compress model.ply -o small.ply --selector importance --budget global --json

Without photos, the result is compared with pictures of the model from all around it. If you have the capture, use --scene, which gives better results. Rooms and landscapes, which surround their cameras, need it.";

// Only photos are filed. Clap drops a requirement where another option excludes what is required: those exclude it, too.
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
#[command(mut_arg("scratch", |arg| arg.requires("scene").conflicts_with_all(["views", "up"])))]
pub(super) struct Arguments {
    /// Model: a .ply, .spz, .splat, .ksplat, .sog, .glb, .gltf, .usda or .usdz file, or a SOG folder
    model: PathBuf,
    /// Model to write: .ply, .compressed.ply, .spz, .sog, .glb, .gltf, .usda or .usdz
    #[arg(short, long, value_name = "OUT")]
    output: PathBuf,
    /// Measure PSNR against bytes instead: the best files of these formats, such as sog,spz, at six sizes, with the bytes and
    /// the loss of each attribute. OUT is a folder for curve.json, curve.csv and curve.html
    #[arg(long, value_name = "FORMATS", value_delimiter = ',', value_parser = format, conflicts_with_all = ["psnr", "fine_tune", "report", "diagnostics", "sh_bits", "keep", "target_count", "view", "port", "host"])]
    pub(super) curve: Option<Vec<String>>,
    /// Command of splat-transform, with its options, for comparison in the curve; none omits it
    #[arg(long, value_name = "COMMAND", default_value = "splat-transform", requires = "curve")]
    peer: String,
    /// LPIPS weights of the curve: a file, or a folder of them, as the script lpips-weights writes them [default: $QIRF_LPIPS, else
    /// the folder qirf-vk in the user's data folder]
    #[arg(long, value_name = "PATH", requires = "curve")]
    lpips_weights: Option<PathBuf>,
    /// Iterations of training after the prune, on the photos or on the original's pictures; with --size or --psnr, the better file is kept
    #[arg(long, value_name = "N", default_value_t = 0, value_parser = clap::value_parser!(u32).range(0..=1_000_000))]
    fine_tune: u32,
    /// Write the figures to this file: as JSON, or as a web page if its name ends in .html
    #[arg(long, value_name = "FILE")]
    report: Option<PathBuf>,
    /// Write the decision, score and block of each Gaussian to this .safetensors file, for `qirf-vk view MODEL --diagnostics
    /// FILE`
    #[arg(long, value_name = "FILE", value_parser = diagnostics::file)]
    diagnostics: Option<PathBuf>,
    /// Print the figures as JSON on standard output
    #[arg(long)]
    json: bool,
    /// Bits of SH coefficients in an SPZ, 1 to 8: of band 1, and of the others if they differ [default: as many as pictures
    /// need]
    #[arg(long, value_name = "N[,N]", value_parser = values::sh_bits)]
    sh_bits: Option<SpzPrecision>,
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

/// The extension of a format that is written.
fn format(text: &str) -> Result<String, String> {
    let name = text.trim_start_matches('.').to_ascii_lowercase();
    if formats::check_output(&PathBuf::from(format!("model.{name}"))).is_err() {
        return Err(format!("'{text}' is not an output format; choose, for example, sog, spz, ply or compressed.ply"));
    }
    Ok(name)
}

impl Arguments {
    pub fn run(&self, console: &Console, global: &Global) -> Result<(), Error> {
        if let Some(formats) = &self.curve {
            return self.measure(formats, console, global);
        }
        self.check_outputs()?;
        self.watched.check()?;
        if self.watched.view && self.fine_tune == 0 {
            return Err(Error::Usage("--view shows the training after the prune; add --fine-tune N".to_owned()));
        }
        let aim = self.options.aim()?;
        let reading = Instant::now();
        let (loaded, beside) = self.options.read(&self.model, console)?;
        let read_s = reading.elapsed().as_secs_f64();
        let device = global.open_with(self.memory_budget)?;
        let input = Input { path: &self.model, model: loaded.gaussians, read_s };
        let networks = Networks::default();
        let mut watcher = Show::new(console);
        watcher.record(self.diagnostics.as_deref().map(Recorder::of_file));
        let session = self.scratch.session(self.memory_budget, (&device, &networks), &watcher);
        let config = self.options.configuration(&beside, self.fine_tune, console)?;
        let precision = self.sh_bits.map(Precision::Spz);
        let target = Target { precision, origin: loaded.origin, ..Target::new(&self.output) };
        let subject = || view::of_compression(&config, &input.model, &self.output, console);
        let subject = self.watched.view.then(subject).transpose()?;
        let figures = self.watched.during(&session, console, subject, |session| {
            compress::compress_to(session, input, &config, aim, &target)
        })?;
        match &self.report {
            Some(page) if has_extension(page, &["html"]) => Output::text(page, &report::compression::page(&figures))?,
            Some(file) => Output::json(file, "the report", &figures)?,
            None => {}
        }
        watcher.rest();
        console.tell(remarks(&figures));
        if self.json { console.json(&figures) } else { report(console, &figures) }
    }

    /// Writes the curve of these formats.
    fn measure(&self, formats: &[String], console: &Console, global: &Global) -> Result<(), Error> {
        if self.options.aim()?.is_some() {
            return Err(Error::Usage("--curve chooses the sizes itself; omit --size of the file".to_owned()));
        }
        check_folder(&self.output)?;
        let output = Output::claim(&self.output)?;
        check_file(&output.folder().join("curve.json"))?;
        let peer = Peer::find(&self.peer, output.folder());
        let (loaded, beside) = self.options.read(&self.model, console)?;
        let networks = Networks::find(self.lpips_weights.as_deref())?;
        let device = global.open_with(self.memory_budget)?;
        let watcher = Show::new(console);
        let session = self.scratch.session(self.memory_budget, (&device, &networks), &watcher);
        let config = self.options.configuration(&beside, 0, console)?;
        let input = Input { path: &self.model, model: loaded.gaussians, read_s: 0.0 };
        let plan = CurvePlan { formats, peer: peer.as_ref() };
        let record = curve(&session, input, &config, &plan)?;
        if peer.is_none() && self.peer != "none" {
            console.note(format_args!("{} could not be started, so the curve has no files from it", self.peer));
        }
        for format in formats {
            let files = record.files.iter().filter(|file| file.wanted.is_some() && file.format == *format).count();
            if files < SIZES as usize {
                let small = SIZES as usize - files;
                let are = if small == 1 { "is" } else { "are" };
                console.note(format_args!("{format}: {small} of {SIZES} sizes {are} too small for a single Gaussian"));
            }
        }
        tell_of_missing(&networks, console);
        let at = |name: &str| output.folder().join(name);
        Output::json(&at("curve.json"), "the curve", &record)?;
        Output::text(&at("curve.csv"), &record.csv())?;
        Output::text(&at("curve.html"), &report::curve::page(&record))?;
        watcher.rest();
        if self.json { console.json(&record) } else { console.print(record.csv().trim_end()) }
    }

    /// Refuses outputs that cannot be written or would overwrite the input, before any work.
    fn check_outputs(&self) -> Result<(), Error> {
        check_model(&self.output)?;
        for path in [Some(&self.output), self.report.as_ref(), self.diagnostics.as_ref()].into_iter().flatten() {
            formats::refuse_overwrite(&self.model, path).map_err(Error::writing)?;
            check_file(path)?;
        }
        if self.sh_bits.is_some() && !has_extension(&self.output, &["spz"]) {
            return Err(Error::Usage("--sh-bits applies only to SPZ: name an .spz file".to_owned()));
        }
        if self.report.as_ref().is_some_and(|report| diagnostics::same_file(report, &self.output)) {
            return Err(Error::Usage(format!("{} cannot hold model and report", self.output.display())));
        }
        if self.report.is_some() && self.report == self.diagnostics {
            return Err(Error::Usage("--report and --diagnostics need different files".to_owned()));
        }
        Ok(())
    }
}

/// The choice for an aim, as a line.
pub(super) fn outcome(figures: &CompressRecord) -> String {
    let CompressRecord { aim, output, test, .. } = figures;
    let Some(aim) = aim else { return String::new() };
    let psnr = test.written.as_ref().map_or(aim.chosen.psnr, |scores| scores.psnr);
    fit::line(aim, output.bytes, output.gaussians, psnr)
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
        "file       {} of {}, {ratio:.1} times {what}",
        fit::megabytes(after, 2),
        fit::megabytes(before, 2)
    ))?;
    if figures.aim.is_some() {
        console.print(format_args!("           {}", outcome(figures)))?;
    }
    let truth = match protocol.truth {
        Truth::Photos => "photos",
        Truth::OwnPictures => "the original's pictures",
    };
    let exact = formats::is_exact(&output.path);
    let score = |name: &str, stage: fn(&StageScores) -> &Option<Scores>, more: &str| match stage(test) {
        Some(Scores { psnr, ssim, .. }) => {
            // Equal pictures have no PSNR.
            let psnr = psnr.map_or_else(|| "equal".to_owned(), |v| format!("{v:.2} dB"));
            let worst = views.iter().filter_map(|view| stage(&view.scores).as_ref()?.psnr).reduce(f64::min);
            let worst = worst.map_or_else(String::new, |v| format!(" (worst view {v:.2} dB)"));
            console.print(format_args!("{name:<10} PSNR {psnr}{worst}, SSIM {:.4}{more}", ssim.unwrap_or_default()))
        }
        None => Ok(()),
    };
    let unpacked = if exact { "" } else { ", before packing" };
    score("before", |stages| &stages.before, "")?;
    score("pruned", |stages| &stages.pruned, unpacked)?;
    score("fine-tuned", |stages| &stages.fine_tuned, unpacked)?;
    if !exact {
        score("file", |stages| &stages.written, "")?;
    }
    if test.pruned.is_some() {
        console.note(format_args!("scored {} against {truth}", counted(protocol.test_views, "held-out view")));
    }
    let parts = report::compression::parts(figures);
    let parts: Vec<String> = parts.iter().map(|(name, seconds)| format!("{name} {seconds:.1}")).collect();
    console.print(format_args!("time       {:.1} s: {}", time.total_s, parts.join(", ")))?;
    console.print(format_args!("           {}", output.path.display()))
}
