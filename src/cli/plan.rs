//! `qirf-vk shard plan`: the tasks of a compression, or of a run in blocks.

use super::choices::{Choices, checked};
use super::compression::CompressArgs;
use super::console::Console;
use super::remedy::quoted;
use super::show::Show;
use super::training::Training;
use super::values;
use super::{Global, check_folder};
use crate::extension::has_extension;
use crate::gaussians::formats;
use crate::gpu::Device;
use crate::job::{Error, RunConfig, Session, host_bytes};
use crate::metrics::Networks;
use crate::selftest;
use crate::shard::blocks::BlockRun;
use crate::shard::{CompressPlan, Job, Plan, Shard};
use crate::wording::counted;
use clap::Arg;
use std::path::{Path, PathBuf};

#[derive(Debug, clap::Subcommand)]
pub(super) enum Planned {
    /// Plan the compression of a model, with the options of `qirf-vk compress`
    Compress(Box<OfModel>),
    /// Plan the training of a scene in blocks, with the options of `qirf-vk run`
    Run(Box<OfScene>),
}

// A plan has no aim for the file.
#[derive(Debug, clap::Args)]
#[command(mut_arg("psnr", |arg| arg.hide(true)), mut_arg("size", of_pictures), mut_arg("name", of_one_precision))]
pub(super) struct OfModel {
    /// Model: a .ply, .spz, .splat, .ksplat, .sog, .glb, .gltf, .usda or .usdz file, or a SOG folder
    model: PathBuf,
    #[command(flatten)]
    place: Place,
    #[command(flatten)]
    options: CompressArgs,
}

// Blocks prune at most once, and by the responses of one moment.
#[derive(Debug, clap::Args)]
#[command(mut_arg("schedule", of_one_prune), mut_arg("preset", of_one_moment))]
pub(super) struct OfScene {
    /// Scene: a COLMAP, Blender, instant-ngp or nerfstudio folder
    scene: PathBuf,
    #[command(flatten)]
    place: Place,
    /// Number of blocks [default: the smallest number whose blocks fit on the device one at a time]
    #[arg(long, value_name = "N", value_parser = clap::value_parser!(u16).range(1..=1024))]
    blocks: Option<u16>,
    /// Train a dense model, and do not prune it
    #[arg(long, conflicts_with_all = ["Choices", "schedule"])]
    no_prune: bool,
    #[command(flatten)]
    choices: Choices,
    #[command(flatten)]
    training: Training,
}

/// `--size` of a plan.
fn of_pictures(size: Arg) -> Arg {
    let size = size.value_name("WxH").help_heading("Without photos");
    size.help("Picture size of virtual cameras [default: 400x400]")
}

/// `--name` of a compressed model.
fn of_one_precision(name: Arg) -> Arg {
    name.help("Name of the model's file in that folder: .ply or .compressed.ply")
}

/// `--schedule` of a run in blocks.
fn of_one_prune(schedule: Arg) -> Arg {
    schedule.value_name("attrition|one-shot").hide_possible_values(true).help(
        "When and how the model is pruned: by growing pressure on opacities from half the run on, with a cut to the number to keep at 3/4 of \
         the run at the latest (attrition), or once, at half the run (one-shot) [default: attrition]",
    )
}

/// `--preset` of a run in blocks.
fn of_one_moment(preset: Arg) -> Arg {
    preset.value_name("standard|quick|paper").hide_possible_values(true).help(
        "Preset of the schedule: that of the 3DGS reference, 30,000 iterations (standard); a short one, 2,000 iterations (quick); or, with \
         --no-prune, that of the QIRF paper, which also sets its effects (paper)",
    )
}

/// Folder of a plan, and memory limit of its tasks.
#[derive(Debug, clap::Args)]
struct Place {
    /// Folder for the plan and the files of its tasks
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// Name of the model's file in that folder: .ply or .spz
    #[arg(long, value_name = "NAME", default_value = "model.ply")]
    name: String,
    /// Limit on device memory, such as 2G or 800M [default: the device's]
    #[arg(long, value_name = "BYTES", value_parser = values::bytes)]
    memory_budget: Option<u64>,
}

impl Planned {
    pub fn run(&self, console: &Console, global: &Global) -> Result<(), Error> {
        match self {
            Self::Compress(a) => {
                formats::refuse_overwrite(&a.model, &a.output()?).map_err(Error::writing)?;
                a.place.plan(console, global, |session| a.job(session, console))
            }
            Self::Run(a) => {
                a.place.model(&["ply", "spz"])?;
                let config = a.configuration(console)?;
                a.place.plan(console, global, |session| a.job(session, &config, console))
            }
        }
    }
}

impl OfModel {
    /// The path of the compressed model. Tasks compare no pictures, by which `compress` chooses the precision of some formats.
    fn output(&self) -> Result<PathBuf, Error> {
        if formats::ladder(Path::new(&self.place.name), 0).steps.len() > 1 {
            return Err(Error::Usage(format!(
                "--name {}: `qirf-vk compress` chooses the precision of this format by pictures, and a divided compression compares \
                 none; name a .ply file, and pack it with `qirf-vk convert`",
                self.place.name
            )));
        }
        self.place.model(&["ply"])
    }

    fn job(&self, session: &Session<'_>, console: &Console) -> Result<Job, Error> {
        let (loaded, beside) = self.options.read(&self.model, console)?;
        if self.options.aim()?.is_some() {
            let what = "--size of a file and --psnr are for `qirf-vk compress`; a plan has --keep or --target-count";
            return Err(Error::Usage(what.to_owned()));
        }
        let config = self.options.configuration(&beside, 0, console)?;
        let job = CompressPlan::plan(session, &self.model, &loaded.gaussians, loaded.origin, config)?;
        Ok(Job::Compression(Box::new(job)))
    }
}

impl OfScene {
    fn configuration(&self, console: &Console) -> Result<RunConfig, Error> {
        let config = self.training.configuration(self.scene.clone(), console)?;
        checked(if self.no_prune { config } else { config.pruned(self.training.pruning(&self.choices)?) })
    }

    fn job(&self, session: &Session<'_>, config: &RunConfig, console: &Console) -> Result<Job, Error> {
        let run = BlockRun::plan(session, config, self.blocks.map(usize::from))?;
        if run.blocks == 1 {
            console.note("one block: `qirf-vk run` needs no more memory, and less work");
        }
        Ok(Job::Run(Box::new(run)))
    }
}

impl Place {
    /// The path of the model, whose name has one of these extensions.
    fn model(&self, extensions: &[&str]) -> Result<PathBuf, Error> {
        let model = self.output.join(&self.name);
        if self.name.contains(['/', '\\']) || !has_extension(&model, extensions) {
            let known = extensions.join(" or .");
            return Err(Error::Usage(format!("'{}' is not the name of a .{known} file", self.name)));
        }
        Ok(model)
    }

    /// Plans a job on the device that is asked for, and says what is to be done next.
    fn plan(
        &self,
        console: &Console,
        global: &Global,
        job: impl FnOnce(&Session<'_>) -> Result<Job, Error>,
    ) -> Result<(), Error> {
        check_folder(&self.output)?;
        let device = global.open_with(self.memory_budget)?;
        let job = session(&device, self.memory_budget, console, job)?;
        let shard = Shard::create(&Plan::new(job, &self.name, selftest::fingerprint(&device)?), &self.output)?;
        console.print(format_args!("{} in {}", counted(shard.tasks().len(), "task"), self.output.display()))?;
        let [folder, snakefile] = [&self.output, &self.output.join("Snakefile")].map(|path| quoted(path));
        // Snakemake looks for its file in the current folder, whatever -d names.
        console
            .note(format_args!("next: qirf-vk shard all {folder}, or snakemake -d {folder} -s {snakefile} --cores 2"));
        Ok(())
    }
}

/// Works in a session that shows its progress.
pub(super) fn session<T>(
    device: &Device,
    memory_budget: Option<u64>,
    console: &Console,
    body: impl FnOnce(&Session<'_>) -> Result<T, Error>,
) -> Result<T, Error> {
    let (watcher, networks, host_bytes) = (Show::new(console), Networks::default(), host_bytes(memory_budget));
    body(&Session { host_bytes, watcher: &watcher, ..Session::new(device, &networks) })
}
