//! `qirf-vk shard`: a compression divided into tasks, for one device after the other or for a cluster.

use super::Global;
use super::compression::Options;
use super::console::Console;
use super::inspect::read_model;
use super::show::Show;
use super::values;
use crate::error::Error;
use crate::gaussians::formats;
use crate::metrics::Networks;
use crate::pipeline::shard::{Plan, Planned, Shard, State, Task};
use crate::pipeline::{Session, host_bytes};
use crate::random;
use crate::selftest;
use serde_json::json;
use std::path::{Path, PathBuf};

const EXAMPLES: &str = "Examples:
  qirf-vk shard plan city.ply -o big --scene capture --resolution /4 --keep 0.28
  qirf-vk shard all big                 on this device, one task after the other
  snakemake -d big --cores 2            with an engine: docs/cluster.md
  qirf-vk shard status big
  qirf-vk shard verify big --share 0.1

The compressed model is big/model.ply. It has the bytes that `qirf-vk compress` would have written, however many processes did the
tasks, in whatever order, and however often they were interrupted.";

/// Divide a compression into tasks, and do them: on one device in turn, or on many at once
#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub(super) struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, clap::Subcommand)]
enum Command {
    /// Write plan.json, tasks.json and a Snakefile
    Plan(Box<PlanArguments>),
    /// Do all tasks that are missing, one after the other
    All(Work),
    /// Do one task: what an engine calls
    Task(TaskArguments),
    /// Show which tasks are done, running, missing or damaged
    Status(StatusArguments),
    /// Do some tasks again and compare the bytes: finds a bad device, disk or driver
    Verify(VerifyArguments),
}

#[derive(Debug, clap::Args)]
struct PlanArguments {
    /// Model: a .ply, .spz, .splat, .ksplat or .sog file, or a SOG folder
    model: PathBuf,
    /// Folder of the plan and of its tasks' files
    #[arg(short, long, value_name = "DIR")]
    output: PathBuf,
    /// Name of the compressed model's file in that folder: .ply or .spz
    #[arg(long, value_name = "NAME", default_value = "model.ply")]
    name: String,
    #[command(flatten)]
    options: Options,
    /// Limit on device memory, such as 2G or 800M [default: the device's]
    #[arg(long, value_name = "BYTES", value_parser = values::bytes, help_heading = "Rendering")]
    memory_budget: Option<u64>,
}

#[derive(Debug, clap::Args)]
struct Work {
    /// Folder of the plan
    folder: PathBuf,
    /// Limit on device memory, such as 2G or 800M: changes no byte of the results [default: the device's]
    #[arg(long, value_name = "BYTES", value_parser = values::bytes)]
    memory_budget: Option<u64>,
    /// Accept a device that computes other bits than the plan's: the results may then differ from those of one device
    #[arg(long)]
    mixed: bool,
}

#[derive(Debug, clap::Args)]
struct TaskArguments {
    #[command(flatten)]
    work: Work,
    /// The task, as tasks.json names it, such as evidence/0003
    #[arg(value_name = "TASK")]
    task: Task,
}

#[derive(Debug, clap::Args)]
struct StatusArguments {
    /// Folder of the plan
    folder: PathBuf,
    /// Print the states as JSON
    #[arg(long)]
    json: bool,
}

#[derive(Debug, clap::Args)]
struct VerifyArguments {
    #[command(flatten)]
    work: Work,
    /// Share of the tasks, in (0, 1]
    #[arg(long, value_name = "X", default_value_t = 0.1, value_parser = values::share)]
    share: f64,
    /// Which of them: another number, another choice
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u32,
}

impl Arguments {
    pub fn run(&self, console: &Console, global: &Global) -> Result<(), Error> {
        match &self.command {
            Command::Plan(a) => a.run(console, global),
            Command::All(work) => work.with(console, global, |shard, session| {
                let total = shard.plan().tasks().len();
                let mut begun = 0;
                shard.all(session, |task| {
                    begun += 1;
                    console.note(format_args!("task {begun} of at most {total}: {task}"));
                })?;
                done(console, shard, &work.folder)
            }),
            Command::Task(a) => a.work.with(console, global, |shard, session| shard.run(session, a.task)),
            Command::Status(a) => a.run(console),
            Command::Verify(a) => a.run(console, global),
        }
    }
}

/// Where the results are.
fn done(console: &Console, shard: &Shard, folder: &Path) -> Result<(), Error> {
    console.print(format_args!("model      {}", folder.join(&shard.plan().output).display()))?;
    console.print(format_args!("figures    {}", folder.join("metrics.json").display()))
}

impl PlanArguments {
    fn run(&self, console: &Console, global: &Global) -> Result<(), Error> {
        let output = self.output.join(&self.name);
        if self.name.contains(['/', '\\']) || output.extension().is_none_or(|e| e != "ply" && e != "spz") {
            return Err(Error::Usage(format!("'{}' is no name of a .ply or .spz file", self.name)));
        }
        formats::refuse_overwrite(&self.model, &output).map_err(Error::writing)?;
        let loaded = read_model(&self.model, console)?;
        let device = global.open_with(self.memory_budget)?;
        let style = self.options.rendering.style(&self.model, &loaded, None, console);
        let (watcher, networks, host_bytes) = (Show::new(console), Networks::default(), host_bytes(self.memory_budget));
        let session = Session { host_bytes, watcher: &watcher, ..Session::new(&device, &networks) };
        let planned = Planned {
            model: &self.model,
            gaussians: loaded.gaussians.len(),
            output: &self.name,
            config: self.options.configuration(style, 0)?,
            fingerprint: selftest::fingerprint(&device)?,
        };
        let shard = Shard::create(&session, &loaded.gaussians, planned, &self.output)?;
        let Plan { chunks, test_views, .. } = shard.plan();
        let (tasks, folder) = (shard.plan().tasks().len(), self.output.display());
        console
            .print(format_args!("{tasks} tasks in {folder}: {chunks} chunks of views, {test_views} views held out"))?;
        console.note(format_args!("next: qirf-vk shard all {folder}, or snakemake -d {folder} --cores 2"));
        Ok(())
    }
}

impl Work {
    /// Opens the plan and a device that computes as the plan's does, and works with them.
    fn with(
        &self,
        console: &Console,
        global: &Global,
        body: impl FnOnce(&Shard, &Session<'_>) -> Result<(), Error>,
    ) -> Result<(), Error> {
        let shard = Shard::open(&self.folder)?;
        let device = global.open_with(self.memory_budget)?;
        shard.check_device(&selftest::fingerprint(&device)?, self.mixed)?;
        let (watcher, networks, host_bytes) = (Show::new(console), Networks::default(), host_bytes(self.memory_budget));
        let session = Session { host_bytes, watcher: &watcher, ..Session::new(&device, &networks) };
        body(&shard, &session)
    }
}

impl StatusArguments {
    fn run(&self, console: &Console) -> Result<(), Error> {
        let states = Shard::open(&self.folder)?.status();
        let name = |state: &State| match state {
            State::Done => "done",
            State::Running => "running",
            State::Missing => "missing",
            State::Damaged(_) => "damaged",
        };
        if self.json {
            let listed = |(task, state): &(Task, State)| json!({ "id": task.to_string(), "state": name(state) });
            return console.json(&json!({ "tasks": states.iter().map(listed).collect::<Vec<_>>() }));
        }
        for wanted in ["done", "running", "missing", "damaged"] {
            let named: Vec<String> =
                states.iter().filter(|(_, s)| name(s) == wanted).map(|(task, _)| task.to_string()).collect();
            let shown = if wanted == "done" { String::new() } else { named.join(" ") };
            console.print(format_args!("{wanted:<9} {:>5}  {shown}", named.len()))?;
        }
        for (_, state) in &states {
            if let State::Damaged(what) = state {
                console.warn(format_args!("{what}"));
            }
        }
        Ok(())
    }
}

impl VerifyArguments {
    fn run(&self, console: &Console, global: &Global) -> Result<(), Error> {
        self.work.with(console, global, |shard, session| {
            let done = shard.status().into_iter().filter(|(_, state)| *state == State::Done).map(|(task, _)| task);
            let done: Vec<Task> = done.filter(|task| *task != Task::Report).collect();
            let number = ((self.share * done.len() as f64).ceil() as usize).min(done.len());
            let order = random::permutation(done.len(), &[u64::from(self.seed)]);
            let mut wrong = Vec::new();
            for at in order.into_iter().take(number) {
                console.note(format_args!("{} again", done[at]));
                wrong.extend(shard.verify(session, done[at])?.into_iter().map(|path| (done[at], path)));
            }
            if let Some((task, path)) = wrong.first() {
                let what = format!("{} of {number} tasks gave other bytes, {task} first", wrong.len());
                return Err(Error::Part { path: path.clone(), what, task: task.to_string() });
            }
            console.print(format_args!("{number} of {} tasks gave the same bytes again", done.len()))
        })
    }
}
