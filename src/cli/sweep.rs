//! `qirf-vk sweep SCENE|MODEL`.

use super::choices::{Choices, checked, first};
use super::console::Console;
use super::inspect::{is_scene, read_model};
use super::resources::Resources;
use super::show::Show;
use super::training::Training;
use super::values;
use super::{Global, check_file, check_no_run, tell_of_missing};
use crate::gaussians::formats::Loaded;
use crate::job::config::Pruning;
use crate::job::{Error, Output, Preset, RunConfig, Session};
use crate::lab::sweep::records::figure;
use crate::lab::sweep::{self, Asked, AxisRecord, Context, Described, Subject, SweepRecord, heavy, subject};
use crate::metrics::Networks;
use crate::pipeline::virtual_views::VirtualCameras;
use crate::scene::orbit::UP;
use glam::DVec3;
use std::cell::Cell;
use std::path::{Path, PathBuf};
use std::time::Instant;

const EXAMPLES: &str = "Examples:
  qirf-vk sweep capture -o swept
  qirf-vk sweep flowers.ply -o swept --axis culling --axis stop=0,1e-4,1e-3
  qirf-vk sweep capture -o swept --model trained/model.ply
  qirf-vk sweep capture -o swept --axis keep=0.1,0.28,0.5 --axis selector --preset quick

Light axes: solver, overlap, epsilon, culling, stop, gradients. They measure one model: the one that --model names, or a \
dense model of the scene that is trained briefly (--train). For a model without a scene, virtual cameras stand in for photos.

Heavy axes: keep, selector, iterations, effects. They need a scene. Each rung is a training, as long as --preset or --iterations say; \
keep and selector continue from one checkpoint. The options under Compression, --iterations, --grow-to and --checkpoint-every are for \
heavy axes; a model's axes read only --background of the options under Training, Effects and Photos.

The folder holds sweep.html, sweep.csv and sweep.json, which are written anew after each axis.";

#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub(super) struct Arguments {
    /// Scene (a COLMAP, Blender, instant-ngp or nerfstudio folder) or model file
    path: PathBuf,
    /// Folder for the results; created if absent
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// Axis to measure, with all of its rungs or the named ones; repeat it for more axes [default: every light axis]
    #[arg(long, value_name = "NAME[=RUNG,...]", value_parser = Asked::parse)]
    axis: Vec<Asked>,
    /// Model for the light axes, seen from the scene's cameras [default: one that is trained briefly]
    #[arg(long, value_name = "MODEL")]
    model: Option<PathBuf>,
    /// Number of iterations of the short training whose model the light axes measure
    #[arg(long, value_name = "N", default_value_t = 600, conflicts_with = "model", value_parser = clap::value_parser!(u32).range(1..=1_000_000))]
    train: u32,
    /// Time for each light axis, in seconds; a warm-up and three rounds are always run
    #[arg(long, value_name = "S", default_value_t = 10.0, value_parser = values::not_negative)]
    budget_per_axis: f64,
    /// Picture size of virtual cameras around a model [default: 400x400]
    #[arg(long, value_name = "WxH", value_parser = values::size)]
    size: Option<(u32, u32)>,
    /// Up direction of a model: x, y, z, -x, -y, -z, or auto (as in captures: -y) [default: auto]
    #[arg(long, value_name = "AXIS", value_parser = values::up, allow_hyphen_values = true)]
    up: Option<DVec3>,
    #[command(flatten)]
    training: Training,
    #[command(flatten)]
    resources: Resources,
    /// Print the figures as JSON on standard output
    #[arg(long)]
    json: bool,
    // Behind options without a heading: its own would hold for them.
    #[command(flatten)]
    choices: Choices,
    // True as soon as the folder has figures of this sweep.
    #[arg(skip)]
    measured: Cell<bool>,
}

/// A sweep in progress.
struct Progress<'a> {
    swept: SweepRecord,
    asked: &'a [Asked],
    folder: &'a Path,
    measured: &'a Cell<bool>,
    begun: Instant,
}

impl Progress<'_> {
    /// Adds an axis, and writes the files anew: an interruption loses no axis that was measured.
    fn add(&mut self, axis: AxisRecord) -> Result<(), Error> {
        let asked = self.asked;
        let place = |axis: &AxisRecord| asked.iter().position(|a| a.axis.name == axis.axis.name);
        self.swept.axes.push(axis);
        self.swept.axes.sort_by_key(place);
        self.swept.seconds = self.begun.elapsed().as_secs_f64();
        sweep::write(&self.swept, self.folder)?;
        self.measured.set(true);
        Ok(())
    }
}

impl Arguments {
    /// A sentence on what an interrupted sweep has left behind.
    pub fn kept(&self) -> String {
        if self.measured.get() {
            let figures = self.output.join("sweep.json");
            format!("{} has the axes measured so far; the same command measures all of them again", figures.display())
        } else {
            "no axis was measured".to_owned()
        }
    }

    pub fn run(&self, console: &Console, global: &Global) -> Result<(), Error> {
        let begun = Instant::now();
        let asked = if self.axis.is_empty() { Asked::light() } else { self.axis.clone() };
        if let Some(twice) = (1..asked.len()).find(|i| asked[..*i].iter().any(|a| a.axis.name == asked[*i].axis.name)) {
            return Err(Error::Usage(format!("--axis {} is given twice", asked[twice].axis.name)));
        }
        let scene = is_scene(&self.path);
        if let Some(heavy) = asked.iter().find(|a| a.axis.heavy() && !scene) {
            return Err(Error::Usage(format!(
                "axis {} trains, but {} is not a scene: name a folder of photos with poses",
                heavy.axis.name,
                self.path.display()
            )));
        }
        if !scene && self.model.is_some() {
            return Err(Error::Usage("--model needs a scene, whose cameras show it".to_owned()));
        }
        if scene && (self.size.is_some() || self.up.is_some()) {
            return Err(Error::Usage(
                "--size and --up apply to virtual cameras around a model; a scene has cameras, and --resolution sets their size"
                    .to_owned(),
            ));
        }
        let config = self.training.configuration(self.path.clone(), console)?;
        let pruning = self.training.pruning(&self.choices)?;
        self.check_read(&asked, &config, &pruning)?;
        checked(config.clone().pruned(pruning.clone()))?;
        check_no_run(&self.output)?;
        let _claimed = Output::claim(&self.output)?;
        check_file(&self.output.join("sweep.json"))?;
        let device = self.resources.device(global)?;
        let watcher = Show::new(console);
        let networks = Networks::default();
        let session = self.resources.session((&device, &networks), &watcher);
        let swept = SweepRecord {
            schema: 1,
            version: env!("CARGO_PKG_VERSION"),
            device: device.tuned(),
            host_threads: rayon::current_num_threads(),
            subject: Described::default(),
            axes: Vec::new(),
            seconds: 0.0,
        };
        let mut progress = Progress { swept, asked: &asked, folder: &self.output, measured: &self.measured, begun };
        self.light(&session, console, &config, &mut progress)?;
        if asked.iter().any(|a| a.axis.heavy()) {
            let networks = self.resources.networks()?;
            let session = Session { networks: &networks, ..session };
            self.heavy(session, (&config, &pruning), &mut progress)?;
            tell_of_missing(&networks, console);
        }
        watcher.rest();
        if self.json { console.json(&progress.swept) } else { self.report(console, &progress.swept) }
    }

    /// Refuses options that no requested axis reads.
    fn check_read(&self, asked: &[Asked], config: &RunConfig, pruning: &Pruning) -> Result<(), Error> {
        if asked.iter().any(|a| a.axis.heavy()) {
            return Ok(());
        }
        let usual = RunConfig::of(self.path.clone(), self.training.preset);
        let of_runs = [
            ("--schedule", *pruning != self.training.preset.pruning()),
            ("--iterations", config.schedule.iterations != usual.schedule.iterations),
            ("--grow-to", config.schedule.growth != usual.schedule.growth),
            ("--checkpoint-every", config.checkpoint_every != usual.checkpoint_every),
        ];
        if let Some(option) = self.choices.given().or_else(|| first(of_runs)) {
            let heavy = if is_scene(&self.path) { ", or add an axis that trains, such as --axis selector" } else { "" };
            return Err(Error::Usage(format!("{option} has no effect on light axes; leave it out{heavy}")));
        }
        let usual = RunConfig { background: config.background, ..usual };
        if !is_scene(&self.path) && *config != usual {
            let what = "of the options of training, effects and photos, the axes of a model read only --background; leave out the others";
            return Err(Error::Usage(what.to_owned()));
        }
        Ok(())
    }

    /// Measures the requested light axes.
    fn light(
        &self,
        session: &Session<'_>,
        console: &Console,
        config: &RunConfig,
        progress: &mut Progress<'_>,
    ) -> Result<(), Error> {
        if progress.asked.iter().all(|a| a.axis.heavy()) {
            let path = self.path.display().to_string();
            let origin = "every rung is a training of its own".to_owned();
            progress.swept.subject = Described { path, origin, ..Described::default() };
            return Ok(());
        }
        let own_pictures = !is_scene(&self.path);
        let subject =
            if own_pictures { self.of_model(session, console)? } else { self.of_scene(session, config, console)? };
        let context = Context { session: *session, subject: &subject, own_pictures, seconds: self.budget_per_axis };
        progress.swept.subject = subject.described.clone();
        for asked in progress.asked {
            if let Some(axis) = sweep::light(&context, asked)? {
                progress.add(axis)?;
            }
        }
        Ok(())
    }

    fn of_scene(&self, session: &Session<'_>, config: &RunConfig, console: &Console) -> Result<Subject, Error> {
        let config = match &self.model {
            Some(model) => self.training.obey(config.clone(), model, console)?,
            None => config.clone(),
        };
        let schedule = Preset::Quick.schedule(Some(self.train));
        let config = RunConfig { schedule, checkpoint_every: 0, ..config };
        subject::of_scene(session, &self.output, &config, self.model.as_deref())
    }

    fn of_model(&self, session: &Session<'_>, console: &Console) -> Result<Subject, Error> {
        let Loaded { gaussians: model, mode, .. } = read_model(&self.path, console)?;
        let default = VirtualCameras::default();
        let (size, up) = (self.size.unwrap_or(default.size), self.up.unwrap_or(UP));
        let background = self.training.background.unwrap_or([0.0; 3]);
        subject::of_model(session, &self.path, (model, mode), VirtualCameras { size, up, ..default }, background)
    }

    /// Measures the requested heavy axes.
    fn heavy(
        &self,
        session: Session<'_>,
        (config, pruning): (&RunConfig, &Pruning),
        progress: &mut Progress<'_>,
    ) -> Result<(), Error> {
        let (folder, preset) = (self.output.as_path(), self.training.preset);
        let training = heavy::Training { session, folder, config, preset, pruning };
        sweep::heavy(&training, progress.asked, |axis| progress.add(axis))
    }

    fn report(&self, console: &Console, swept: &SweepRecord) -> Result<(), Error> {
        for record in &swept.axes {
            let axis = record.axis;
            console.print(format_args!("{}: {} ({})", axis.name, axis.accuracy, axis.time))?;
            for r in &record.rungs {
                let time = r.time.map_or_else(|| "-".to_owned(), |t| figure(t.median));
                let row = format!("  {:<22} {:>10} {:>10}  {}", r.name, record.shown(r), time, r.mark());
                console.print(row.trim_end())?;
            }
        }
        console.print(format_args!("report {}", self.output.join("sweep.html").display()))
    }
}
