//! Jobs divided into tasks: pure functions from files to files, which any engine may run in any order that their needs allow,
//! on one device in turn or on many at once. The results have the bytes of the undivided job (docs/cluster.md).

mod part;
mod plan;
mod sealed;
mod task;

pub use plan::{Plan, Planned};
pub use task::Task;

use super::compress::stages;
use super::output::bytes_on_disk;
use super::records::{ModelFile, PruneRecord, PruneSeconds, StageScores, ViewStages};
use super::session::Session;
use crate::error::Error;
use crate::gaussians::{Gaussians, formats};
use fs4::FileExt;
use part::{Part, Stored};
use serde::{Deserialize, Serialize};
use serde_json::json;
use std::fs::{File, OpenOptions};
use std::io;
use std::path::{Path, PathBuf};

/// A folder with a plan and the files of its tasks.
pub struct Shard {
    folder: PathBuf,
    plan: Plan,
    hash: String,
}

/// How far a task is.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum State {
    /// Its files are there and whole.
    Done,
    /// A process is at it.
    Running,
    /// Its files are not there.
    Missing,
    /// A file is there that is not its own, or is damaged.
    Damaged(String),
}

/// What the choice leaves besides the model.
#[derive(Debug, Serialize, Deserialize)]
struct Chosen {
    /// CRC-32 of the model's file.
    model_crc32: u32,
    prune: PruneRecord,
}

impl Shard {
    /// Plans the compression of a model, and writes plan, task list and Snakefile into `folder`.
    ///
    /// # Errors
    /// What the compression itself would refuse; [`Error::Usage`] if the folder holds another plan, or for fine-tuning.
    pub fn create(
        session: &Session<'_>,
        model: &Gaussians,
        planned: Planned<'_>,
        folder: &Path,
    ) -> Result<Self, Error> {
        if planned.config.fine_tune > 0 {
            return Err(Error::Usage("a divided compression has no fine-tuning".to_owned()));
        }
        let census = stages::census(session, model, &planned.config)?;
        let plan = Plan::new(planned, census.chunks, census.test_views, &census.protocol)?;
        plan.write(folder)?;
        Self::open(folder)
    }

    /// Opens a folder with a plan.
    ///
    /// # Errors
    /// Those of [`Plan::read`].
    pub fn open(folder: &Path) -> Result<Self, Error> {
        let plan = Plan::read(folder)?;
        let hash = plan.hash();
        Ok(Self { folder: folder.to_owned(), plan, hash })
    }

    /// The plan.
    pub fn plan(&self) -> &Plan {
        &self.plan
    }

    /// Refuses a device that computes other bits than the one that made the plan; `mixed` lets it pass.
    ///
    /// # Errors
    /// [`Error::OtherDevice`].
    pub fn check_device(&self, fingerprint: &str, mixed: bool) -> Result<(), Error> {
        if mixed || fingerprint == self.plan.fingerprint {
            return Ok(());
        }
        Err(Error::OtherDevice { planned: self.plan.fingerprint.clone(), here: fingerprint.to_owned() })
    }

    /// Does a task, unless it is done. Waits while another process does it.
    ///
    /// # Errors
    /// [`Error::Usage`] for a task that the plan does not have; [`Error::Part`] for parts that are damaged or of another plan;
    /// those of the work itself.
    pub fn run(&self, session: &Session<'_>, task: Task) -> Result<(), Error> {
        self.has(task)?;
        let _lock = self.lock(task)?;
        if self.state_of_files(task) == State::Done {
            return Ok(());
        }
        for (path, bytes) in self.work(session, task)? {
            let folder = path.parent().unwrap_or(&self.folder);
            std::fs::create_dir_all(folder).map_err(|source| Error::Write { path: folder.to_owned(), source })?;
            formats::remove_leftovers(&path);
            formats::write_atomically(&path, |out| out.write_all(&bytes)).map_err(Error::writing)?;
        }
        Ok(())
    }

    /// Does all tasks that are not done, one after the other; `follow` hears of each before it begins.
    ///
    /// # Errors
    /// As [`Shard::run`]; [`Error::Interrupted`].
    pub fn all(&self, session: &Session<'_>, mut follow: impl FnMut(Task)) -> Result<(), Error> {
        for task in self.plan.tasks() {
            if self.state_of_files(task) != State::Done {
                session.watcher.unless_stopped()?;
                follow(task);
                self.run(session, task)?;
            }
        }
        Ok(())
    }

    /// The state of each task.
    pub fn status(&self) -> Vec<(Task, State)> {
        let state = |task: Task| match self.state_of_files(task) {
            State::Done => State::Done,
            _ if self.is_locked(task) => State::Running,
            other => other,
        };
        self.plan.tasks().into_iter().map(|task| (task, state(task))).collect()
    }

    /// Does a task again and compares the bytes with those of its files. Returns the files that differ.
    ///
    /// # Errors
    /// As [`Shard::run`]; files that cannot be read.
    pub fn verify(&self, session: &Session<'_>, task: Task) -> Result<Vec<PathBuf>, Error> {
        self.has(task)?;
        let mut wrong = Vec::new();
        for (path, bytes) in self.work(session, task)? {
            let there = std::fs::read(&path).map_err(|source| Error::Read { path: path.clone(), source })?;
            if there != bytes {
                wrong.push(path);
            }
        }
        Ok(wrong)
    }

    fn has(&self, task: Task) -> Result<(), Error> {
        if self.plan.tasks().contains(&task) {
            return Ok(());
        }
        Err(Error::Usage(format!("the plan in {} has no task {task}", self.folder.display())))
    }

    fn lock_file(&self, task: Task) -> PathBuf {
        self.folder.join("locks").join(task.to_string().replace('/', "-"))
    }

    /// The lock of a task, which goes with the process, however that ends. Where the file system has no locks there is none: a task
    /// that two processes do has the same result.
    fn lock(&self, task: Task) -> Result<Option<File>, Error> {
        let path = self.lock_file(task);
        let failed = |source| Error::Write { path: path.clone(), source };
        std::fs::create_dir_all(path.parent().unwrap_or(&self.folder)).map_err(failed)?;
        let file = OpenOptions::new().write(true).create(true).truncate(false).open(&path).map_err(failed)?;
        match FileExt::lock(&file) {
            Ok(()) => Ok(Some(file)),
            Err(error) if error.kind() == io::ErrorKind::Unsupported => Ok(None),
            Err(error) => Err(failed(error)),
        }
    }

    fn is_locked(&self, task: Task) -> bool {
        let Ok(file) = File::open(self.lock_file(task)) else { return false };
        matches!(FileExt::try_lock(&file), Err(fs4::TryLockError::WouldBlock))
    }

    fn outputs(&self, task: Task) -> Vec<PathBuf> {
        task.outputs(&self.plan).iter().map(|name| self.folder.join(name)).collect()
    }

    fn state_of_files(&self, task: Task) -> State {
        if self.outputs(task).iter().any(|path| !path.exists()) {
            return State::Missing;
        }
        let whole = match task {
            Task::Evidence(_) => self.part(task).map(drop),
            Task::Choose => self.chosen().map(drop),
            Task::Score(_) => self.sealed::<Vec<ViewStages>>(task).map(drop),
            Task::Report => Ok(()),
        };
        whole.map_or_else(|error| State::Damaged(error.to_string()), |()| State::Done)
    }

    fn part(&self, task: Task) -> Result<Stored, Error> {
        let path = &self.outputs(task)[0];
        Part::read(path, self.plan.gaussians, &self.hash, &task.to_string())
    }

    fn sealed<T: serde::de::DeserializeOwned>(&self, task: Task) -> Result<T, Error> {
        let outputs = self.outputs(task);
        sealed::read(&outputs[outputs.len() - 1], &self.hash, &task.to_string())
    }

    fn seal(&self, task: Task, content: &impl Serialize) -> Result<Vec<u8>, Error> {
        sealed::bytes(&self.hash, &task.to_string(), content)
    }

    /// What the choice left, if it is of the model's file that is there.
    fn chosen(&self) -> Result<Chosen, Error> {
        let (task, path) = (Task::Choose, self.compressed());
        let chosen: Chosen = self.sealed(task)?;
        if plan::crc32_of_file(&path)? != chosen.model_crc32 {
            let what = "its checksum is not that of the model that was written: it is damaged".to_owned();
            return Err(Error::Part { path, what, task: task.to_string() });
        }
        Ok(chosen)
    }

    fn compressed(&self) -> PathBuf {
        self.folder.join(&self.plan.output)
    }

    /// The model, as it was when the plan was made.
    fn model(&self) -> Result<Gaussians, Error> {
        let path = &self.plan.model;
        if plan::crc32_of_file(path)? != self.plan.model_crc32 {
            let what = "it has changed since the plan was made".to_owned();
            return Err(Error::Part { path: path.clone(), what, task: "plan".to_owned() });
        }
        Ok(formats::read(path)?.gaussians)
    }

    /// The files of a task, in the order in which they are written.
    fn work(&self, session: &Session<'_>, task: Task) -> Result<Vec<(PathBuf, Vec<u8>)>, Error> {
        let config = &self.plan.config;
        let contents: Vec<Vec<u8>> = match task {
            Task::Evidence(chunk) => {
                let responses = stages::evidence(session, &self.model()?, config, chunk)?;
                vec![Part { plan: self.hash.clone(), task: task.to_string(), responses }.bytes()?]
            }
            Task::Choose => {
                let needs = task.needs(&self.plan).into_iter();
                let parts = needs.map(|evidence| Ok(self.part(evidence)?.responses(self.plan.gaussians)));
                let (prune, model) = stages::choose(session, self.model()?, config, parts)?;
                // Times would differ from process to process.
                let prune = PruneRecord { seconds: PruneSeconds::default(), ..prune };
                let bytes = self.encoded(&model)?;
                let model_crc32 = formats::crc32([bytes.as_slice()]);
                let chosen = self.seal(task, &Chosen { model_crc32, prune })?;
                vec![bytes, chosen]
            }
            Task::Score(n) => {
                self.chosen()?;
                let compressed = formats::read(&self.compressed())?.gaussians;
                let views = stages::score(session, &self.model()?, &compressed, config, self.plan.scored(n))?;
                vec![self.seal(task, &views)?]
            }
            Task::Report => vec![self.report(session)?],
        };
        Ok(self.outputs(task).into_iter().zip(contents).collect())
    }

    /// The bytes of a model's file.
    fn encoded(&self, model: &Gaussians) -> Result<Vec<u8>, Error> {
        let beside =
            tempfile::tempdir_in(&self.folder).map_err(|source| Error::Write { path: self.folder.clone(), source })?;
        let path = beside.path().join(&self.plan.output);
        formats::write(&path, model, self.plan.config.style.mode()).map_err(Error::writing)?;
        std::fs::read(&path).map_err(|source| Error::Read { path, source })
    }

    /// All figures, as `qirf-vk compress --json` prints them, without times and memory.
    fn report(&self, session: &Session<'_>) -> Result<Vec<u8>, Error> {
        let Chosen { prune, .. } = self.chosen()?;
        let mut views: Vec<ViewStages> = Vec::new();
        for task in Task::Report.needs(&self.plan) {
            if matches!(task, Task::Score(_)) {
                views.extend(self.sealed::<Vec<ViewStages>>(task)?);
            }
        }
        let file = |path: &Path| -> Result<ModelFile, Error> {
            let model = formats::read(path)?.gaussians;
            let (gaussians, sh_degree) = (model.len(), model.degree());
            Ok(ModelFile { path: path.to_owned(), bytes: bytes_on_disk(path), gaussians, sh_degree })
        };
        let record = json!({
            "schema": 1,
            "version": self.plan.version,
            "device": session.device.tuned(),
            "protocol": self.plan.protocol,
            "input": file(&self.plan.model)?,
            "output": ModelFile { path: self.plan.output.clone().into(), ..file(&self.compressed())? },
            "prune": prune,
            "test": StageScores::mean(&views),
            "views": views,
        });
        Ok(format!("{record:#}\n").into_bytes())
    }
}
