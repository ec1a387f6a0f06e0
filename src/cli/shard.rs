//! `qirf-vk shard`: a job divided into tasks, for one device in turn or for a cluster.

use super::Global;
use super::console::Console;
use super::plan::{Planned, session};
use super::remedy::quoted;
use super::values;
use crate::job::{Error, Session};
use crate::random;
use crate::selftest;
use crate::shard::{Shard, Stage, State, Task};
use crate::wording::counted;
use serde_json::json;
use std::path::{Path, PathBuf};

const EXAMPLES: &str = "Examples:
  qirf-vk shard plan compress city.ply -o big --scene capture --resolution /4 --keep 0.28
  qirf-vk shard plan run capture -o big --blocks 8
  qirf-vk shard all big                           on this device, one task after the other
  snakemake -d big -s big/Snakefile --cores 2     with an engine: docs/cluster.md
  qirf-vk shard status big
  qirf-vk shard verify big --share 0.1

The model is big/model.ply. It does not depend on the number of processes that did the tasks, on their order, or on interruptions. \
A compression gives the bytes that `qirf-vk compress` would have written.";

/// In place of a task's name in the error of a verification.
pub(super) const VERIFY: &str = "verify";

#[derive(Debug, clap::Args)]
#[command(after_help = EXAMPLES)]
pub(super) struct Arguments {
    #[command(subcommand)]
    command: Command,
}

#[derive(Debug, clap::Subcommand)]
enum Command {
    /// Plan a job: write plan.json, tasks.json and a Snakefile
    #[command(subcommand)]
    Plan(Planned),
    /// Run all missing tasks, one after the other
    All(Work),
    /// Run one task; a workflow engine such as Snakemake calls this
    Task(TaskArguments),
    /// Show which tasks are done, running, missing or damaged
    Status(StatusArguments),
    /// Repeat some tasks and compare the bytes, to find a faulty device, disk or driver
    Verify(VerifyArguments),
}

#[derive(Debug, clap::Args)]
struct Work {
    /// Folder of the plan
    folder: PathBuf,
    /// Limit on device memory, such as 2G or 800M; it changes no byte of the results [default: the device's]
    #[arg(long, value_name = "BYTES", value_parser = values::bytes)]
    memory_budget: Option<u64>,
    /// Accept a device whose results are not bit-identical to those of the one that planned; the results may then differ from those of one device
    #[arg(long)]
    mixed: bool,
}

#[derive(Debug, clap::Args)]
struct TaskArguments {
    #[command(flatten)]
    work: Work,
    /// Name of the task in tasks.json, such as evidence/0003
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
    /// Share of the tasks to repeat, above 0 and up to 1
    #[arg(long, value_name = "X", default_value_t = 0.1, value_parser = values::share)]
    share: f64,
    /// Random seed of the choice of tasks: another seed chooses others
    #[arg(long, value_name = "N", default_value_t = 1)]
    seed: u32,
}

impl Arguments {
    pub fn run(&self, console: &Console, global: &Global) -> Result<(), Error> {
        match &self.command {
            Command::Plan(planned) => planned.run(console, global),
            Command::All(work) => work.with(console, global, |shard, session| {
                let total = shard.tasks().len();
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

/// The folder of the results.
fn done(console: &Console, shard: &Shard, folder: &Path) -> Result<(), Error> {
    console.print(format_args!("model      {}", folder.join(&shard.plan().output).display()))?;
    console.print(format_args!("figures    {}", folder.join("metrics.json").display()))
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
        let shard = shard.on_device(&selftest::fingerprint(&device)?, self.mixed)?;
        session(&device, self.memory_budget, console, |session| body(&shard, session))
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
            console.print(format!("{wanted:<9} {:>5}  {shown}", named.len()).trim_end())?;
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
            let mut done: Vec<Task> = Vec::new();
            for (task, state) in shard.status() {
                match state {
                    State::Done if task.stage != Stage::Report => done.push(task),
                    State::Damaged(_) => shard.check(task)?,
                    _ => {}
                }
            }
            if done.is_empty() {
                let folder = quoted(&self.work.folder);
                let what = format!("no task is done that could be repeated; run `qirf-vk shard all {folder}` first");
                return Err(Error::Usage(what));
            }
            let number = ((self.share * done.len() as f64).ceil() as usize).min(done.len());
            let order = random::permutation(done.len(), &[u64::from(self.seed)]);
            let mut wrong: Vec<(Task, Vec<PathBuf>)> = Vec::new();
            for at in order.into_iter().take(number) {
                console.note(format_args!("repeating {}", done[at]));
                let files = shard.verify(session, done[at])?;
                if !files.is_empty() {
                    wrong.push((done[at], files));
                }
            }
            if let Some((task, files)) = wrong.first() {
                let files: Vec<String> = files.iter().map(|file| file.display().to_string()).collect();
                let (all, files) = (counted(number, "task"), files.join(", "));
                let what = format!("{} of {all} gave other bytes, {task} first: {files}", wrong.len());
                return Err(Error::Part { path: self.work.folder.clone(), what, task: VERIFY.to_owned() });
            }
            console.print(format_args!(
                "{number} of {} repeated: the bytes are the same (report is not repeated: its file names the device)",
                counted(done.len(), "task")
            ))
        })
    }
}
