//! `qirf-vk run SCENE`.

use super::choices::{Choices, checked};
use super::compress::outcome;
use super::console::Console;
use super::diagnostics::{self, Recorder};
use super::pose::{Posing, warn};
use super::resources::Resources;
use super::show::Show;
use super::training::Training;
use super::view::{self, Watched};
use super::{Global, check_file, check_folder, tell_of_missing, viewer};
use crate::gaussians::formats;
use crate::job::output::{bytes_on_disk, check_run_folder, same_place};
use crate::job::records::{Aim, CompressRecord, RunRecord, ViewScores};
use crate::job::{Earlier, Error, Init, Output, RunConfig, Session, Silent, earlier};
use crate::pipeline::compress::fit::Target;
use crate::pipeline::compress::remarks::remarks;
use crate::pipeline::compress::{CompressConfig, Input, ViewSource, compress_to};
use crate::pipeline::run;
use crate::pose::{is_video, pose};
use crate::report;
use crate::scene::{self, OpenOptions, Scene};
use crate::wording::{counted, file_size};
use serde::Serialize;
use std::path::{Path, PathBuf};
use std::time::Instant;

const EXAMPLES: &str = "Examples:
  qirf-vk run capture -o trained --preset quick --resolution 256
  qirf-vk run photos -o first --preset quick --resolution 256
  qirf-vk run capture -o trained --preset quick --resolution 256 --resume
  qirf-vk run capture -o smaller --keep 0.2 --selector css --schedule gradual
  qirf-vk run capture -o watched --view                # watch it in a browser
  qirf-vk run capture -o dense --no-prune
  qirf-vk run capture -o small --size 5MB              # and model.sog of at most 5 MB
  qirf-vk run --config trained/config.toml -o again

The folder holds model.ply, report.html, metrics.json, log.jsonl, renders/ and config.toml, which reproduces the run.

For photos without poses and for videos, `run` first estimates poses as `qirf-vk pose` does, and writes the scene to the folder's scene/.

`qirf-vk train` is another name for `qirf-vk run`.";

#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
#[expect(clippy::struct_excessive_bools, reason = "options, each on its own")]
pub(super) struct Arguments {
    /// Scene: a COLMAP, Blender, instant-ngp or nerfstudio folder, a folder of photos, or a video
    #[arg(required_unless_present = "config", conflicts_with = "config")]
    scene: Option<PathBuf>,
    /// Folder for the results; created if absent
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// Train a dense model, and do not prune it
    #[arg(long, conflicts_with_all = ["Choices", "schedule"])]
    no_prune: bool,
    /// Continue from the folder's checkpoint, if there is one
    #[arg(long)]
    resume: bool,
    /// Replace the finished run in the folder
    #[arg(long, conflicts_with = "resume")]
    overwrite: bool,
    /// Configuration of an earlier run, its config.toml, in place of the scene and all other options of the run. Its learning
    /// rates depend on its number of iterations: change both together
    #[arg(long, value_name = "FILE", conflicts_with_all = ["Training", "Choices", "Posing", "no_prune"])]
    config: Option<PathBuf>,
    #[command(flatten)]
    training: Training,
    #[command(flatten)]
    posing: Posing,
    #[command(flatten)]
    resources: Resources,
    #[command(flatten)]
    watched: Watched,
    /// Write the decision, score and block of each Gaussian at the last prune to this .safetensors file, and the model before
    /// that prune to a .ply beside it, for `qirf-vk view`
    #[arg(long, value_name = "FILE", conflicts_with = "no_prune", value_parser = diagnostics::file)]
    diagnostics: Option<PathBuf>,
    /// Remove floaters at the end, before the scores and the report: Gaussians in empty space, and those that the photos disagree
    /// with
    #[arg(long, conflicts_with = "config")]
    clean: bool,
    /// Also write model.sog, the file of at most this size, such as 5MB, with the highest PSNR against the photos. It is made
    /// from the pruned model: for a large size, use a larger --keep
    #[arg(long, value_name = "BYTES", allow_hyphen_values = true, value_parser = file_size)]
    size: Option<u64>,
    /// Embed a viewer with the model in report.html; the page grows by 4/3 of the size of the SPZ
    #[arg(long)]
    with_model: bool,
    /// Write no report.html
    #[arg(long, conflicts_with = "with_model")]
    no_report: bool,
    /// Print the figures as JSON on standard output
    #[arg(long)]
    json: bool,
    /// Print progress as lines of JSON on standard output, the same as in the folder's log.jsonl, and nothing else
    #[arg(long, conflicts_with = "json")]
    json_progress: bool,
    // Behind options without a heading: its own would hold for them.
    #[command(flatten)]
    choices: Choices,
}

impl Arguments {
    pub fn run(&self, console: &Console, global: &Global) -> Result<(), Error> {
        check_folder(&self.output)?;
        check_run_folder(&self.output)?;
        self.watched.check()?;
        let mut config = self.configuration(console)?;
        if global.tuning.is_some() {
            config.tuning = None;
        }
        let input = Self::without_poses(&config, console)?;
        let recorder = self.recorder(&config)?;
        let output = Output::for_run(&self.output, &config.init)?;
        if self.size.is_some() {
            check_file(&output.packed())?;
        }
        let found = Earlier::of(&output);
        if found == Earlier::Interrupted && !self.resume {
            return Err(Error::Unfinished(output.checkpoint()));
        }
        if found == Earlier::Finished && !self.resume && !self.overwrite {
            return Err(Error::Finished(self.output.clone()));
        }
        let mut watcher = Show::new(console);
        watcher.record(recorder);
        watcher.print_log(self.json_progress);
        if input.is_none() && self.posing.asked() {
            console.note("the scene has poses: options of pose estimation have no effect");
        }
        if let Some(input) = input {
            config = self.posed(config, &input, &output, &watcher, console)?;
        }
        if self.resume && found != Earlier::Nothing {
            earlier::check(&output, &config)?;
        }
        if self.resume && found == Earlier::Finished {
            watcher.rest();
            return self.report_finished(console, global, (&config, &output));
        }
        let networks = self.resources.networks()?;
        let device = self.resources.device(global)?;
        let session = self.resources.session((&device, &networks), &watcher);
        let subject = self.watched.view.then(|| view::of_run(&config, &self.output, console)).transpose()?;
        let mut record = self
            .watched
            .during(&session, console, subject, |session| run::run(session, &config, &output, self.resume))?;
        let decided = config.decided(&record.effects);
        if !self.no_report {
            self.write_report(&session, [&config, &decided], &mut record, &output)?;
        }
        watcher.rest();
        tell_of_missing(&networks, console);
        self.tell_of_diagnostics(&record, console);
        let packed = self.size.map(|size| pack(&session, [&config, &decided], (&output, size), console)).transpose()?;
        output.complete();
        watcher.printed()?;
        self.report(console, &record, (packed.as_ref(), &output))
    }

    /// Writes the report of a run, drawn as the run has `decided`, and adds its time to the figures.
    fn write_report(
        &self,
        session: &Session<'_>,
        [config, decided]: [&RunConfig; 2],
        record: &mut RunRecord,
        output: &Output,
    ) -> Result<(), Error> {
        let begun = Instant::now();
        let title = self.output.file_name().unwrap_or_default().to_string_lossy();
        let drawn = decided.style.over(record.protocol.background);
        let viewer = || viewer::of_run(session, &output.model(), &title, drawn, &config.selection());
        let viewer = self.with_model.then(viewer).transpose()?;
        let pictures = report::pictures(record, output);
        record.time.add_report(begun.elapsed());
        report::write(record, &pictures, output, viewer.as_deref())?;
        Output::json(&output.metrics(), "metrics.json", &*record)
    }

    /// Path of the diagnostics, which must differ from the run's own files and its initial model.
    fn recorder(&self, config: &RunConfig) -> Result<Option<Recorder>, Error> {
        let Some(file) = &self.diagnostics else { return Ok(None) };
        if config.prune.is_none() {
            return Err(Error::Usage("--diagnostics describes a prune, but this run does not prune".to_owned()));
        }
        let [model, checkpoint] = ["model.ply", "checkpoint.safetensors"].map(|name| self.output.join(name));
        let mut taken: Vec<&Path> = vec![&model, &checkpoint];
        if let Init::Model(initial) = &config.init {
            taken.push(initial);
        }
        Recorder::of_run(file, &taken, &self.output).map(Some)
    }

    /// Tells why there are no diagnostics, where they were asked for.
    fn tell_of_diagnostics(&self, record: &RunRecord, console: &Console) {
        let Some(file) = &self.diagnostics else { return };
        let cause = match (record.prunes.is_empty(), file.exists()) {
            (true, _) => "the model was not pruned",
            (false, false) => "the model was pruned in an earlier part of the run",
            (false, true) => return,
        };
        console.note(format_args!("{} is not written: {cause}", file.display()));
    }

    fn configuration(&self, console: &Console) -> Result<RunConfig, Error> {
        if let Some(path) = &self.config {
            return RunConfig::read(path);
        }
        let config = self.training.configuration(self.scene.clone().unwrap_or_default(), console)?;
        let config = RunConfig { clean: self.clean, ..config };
        checked(if self.no_prune { config } else { config.pruned(self.training.pruning(&self.choices)?) })
    }

    /// The photos without poses, or the video, that the run begins with; `None` for a scene.
    fn without_poses(config: &RunConfig, console: &Console) -> Result<Option<PathBuf>, Error> {
        if is_video(&config.scene) {
            return Ok(Some(config.scene.clone()));
        }
        let options = OpenOptions { images: config.images.clone(), ..OpenOptions::default() };
        match Scene::find(&config.scene, &options) {
            Err(scene::Error::NoPoses { images, beside, .. }) => {
                if !beside.is_empty() {
                    let photos = config.scene.display();
                    console.warn(format_args!(
                        "{photos}: poses are estimated, although there are some: {}",
                        beside.trim_start_matches("; ")
                    ));
                }
                Ok(Some(images))
            }
            found => Ok(found.map(|()| None)?),
        }
    }

    /// The same run on a scene with poses, which `input` gets.
    fn posed(
        &self,
        config: RunConfig,
        input: &Path,
        output: &Output,
        watcher: &Show,
        console: &Console,
    ) -> Result<RunConfig, Error> {
        if same_place(input, output.folder()) {
            return Err(Error::AmongPhotos(output.model()));
        }
        let posed = pose(input, &output.scene(), &self.posing.options(), watcher)?;
        warn(&posed, console);
        console.note(posed.summary());
        Ok(RunConfig { scene: output.scene(), images: None, ..config })
    }

    /// Tells of a run that was finished before, and packs its model if that was not done.
    fn report_finished(
        &self,
        console: &Console,
        global: &Global,
        (config, output): (&RunConfig, &Output),
    ) -> Result<(), Error> {
        let missing = self.size.filter(|size| !(size - size / 20..=*size).contains(&bytes_on_disk(&output.packed())));
        let to_do = match (missing, output.packed().exists()) {
            (None, _) => "nothing to do",
            (Some(_), true) => "model.sog is packed again, for this size",
            (Some(_), false) => "only model.sog is missing",
        };
        console.note(format_args!("{}: this run is finished; {to_do}", output.folder().display()));
        if let Some(size) = missing {
            let (networks, watcher) = (self.resources.networks()?, Silent);
            let device = self.resources.device(global)?;
            let decided = RunConfig::read(&output.config())?;
            let session = self.resources.session((&device, &networks), &watcher);
            let packed = pack(&session, [config, &decided], (output, size), console)?;
            console.tell(remarks(&packed));
            console.note(format_args!("packed {}", outcome(&packed)));
        }
        if !output.report().exists() && !self.no_report {
            console.note("it has no report.html: only the run itself can write one");
        } else if self.with_model {
            console.note("--with-model has no effect: its report.html is written");
        }
        if self.diagnostics.is_some() {
            console.note("--diagnostics has no effect: only the run itself can write them");
        }
        if self.json {
            let path = output.metrics();
            let text = std::fs::read_to_string(&path).map_err(|source| Error::Read { path, source })?;
            return console.print(text.trim_end());
        }
        if self.json_progress {
            return Ok(());
        }
        console.print(format_args!("model  {}", output.model().display()))?;
        if output.packed().exists() {
            console.print(format_args!("packed {}", output.packed().display()))?;
        }
        if output.report().exists() {
            console.print(format_args!("report {}", output.report().display()))?;
        }
        Ok(())
    }

    fn report(
        &self,
        console: &Console,
        record: &RunRecord,
        (packed, output): (Option<&CompressRecord>, &Output),
    ) -> Result<(), Error> {
        if self.json {
            return console.json(&Figures { record, packed });
        }
        if self.json_progress {
            return Ok(());
        }
        let score = |v: Option<f64>, unit: &str| match v {
            None => "-".to_owned(),
            // The PSNR of equal pictures is infinite.
            Some(v) if v.is_infinite() => "equal".to_owned(),
            Some(v) => format!("{v:.3}{unit}"),
        };
        if let Some(test) = &record.test {
            console.print(format_args!(
                "test   PSNR {}  SSIM {}  LPIPS {}  ({})",
                score(test.psnr.or(Some(f64::INFINITY)), " dB"),
                test.ssim.map_or_else(|| "-".to_owned(), |v| format!("{v:.4}")),
                score(test.lpips_vgg, ""),
                counted(ViewScores::counting(&record.views), "view"),
            ))?;
        }
        console.print(format_args!("train  PSNR {}", score(record.train.psnr, " dB")))?;
        console.print(format_args!(
            "model  {}, {:.1} MB, {:.0} frames per second",
            counted(record.gaussians.last, "Gaussian"),
            record.model_bytes as f64 / 1e6,
            record.frames_per_second.unwrap_or(0.0),
        ))?;
        console.print(format_args!(
            "time   {:.1} s: photos {:.1}, training {:.1}, evaluation {:.1}; device memory {:.0} MB",
            record.time.total_s,
            record.time.load_s,
            record.time.train_s,
            record.time.evaluate_s,
            record.memory.peak_bytes as f64 / 1e6,
        ))?;
        console.print(format_args!("       {}", output.model().display()))?;
        if let Some(packed) = packed {
            console.tell(remarks(packed));
            console.print(format_args!("packed {}", outcome(packed)))?;
            console.print(format_args!("       {}", output.packed().display()))?;
        }
        if self.no_report {
            return Ok(());
        }
        console.print(format_args!("report {}", output.report().display()))
    }
}

/// The figures of a run, and of its packed model if there is one.
#[derive(Serialize)]
struct Figures<'a> {
    #[serde(flatten)]
    record: &'a RunRecord,
    #[serde(skip_serializing_if = "Option::is_none")]
    packed: Option<&'a CompressRecord>,
}

/// Packs the trained model into a file of at most this many bytes, compared by the run's photos, and drawn as the run has `decided`.
fn pack(
    session: &Session<'_>,
    [config, decided]: [&RunConfig; 2],
    (output, size): (&Output, u64),
    console: &Console,
) -> Result<CompressRecord, Error> {
    // The run's own watcher records the prunes of the run.
    let watcher = Show::new(console);
    let session = &Session { watcher: &watcher, ..*session };
    let path = output.model();
    let loaded = formats::read(&path)?;
    let views = ViewSource::Photos(config.selection());
    let RunConfig { style, exposure, .. } = *decided;
    let config = CompressConfig { views, style, exposure, ..CompressConfig::default() };
    let input = Input { path: &path, model: loaded.gaussians, read_s: 0.0 };
    let packed = output.packed();
    let target = Target { origin: loaded.origin, ..Target::new(&packed) };
    compress_to(session, input, &config, Some(Aim::Bytes(size)), &target)
}
