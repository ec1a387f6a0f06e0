//! Jobs divided into tasks: pure functions from files to files, which any workflow engine may run in any order that
//! respects their dependencies, on one device in turn or on many at once. The results have the bytes of the undivided
//! job (docs/cluster.md).

pub mod blocks;
mod compression;
mod files;
pub mod kd_tree;
mod part;
mod plan;
mod sealed;
mod task;
mod training;

pub use compression::CompressPlan;
pub use plan::{Job, Plan};
pub use task::{Listed, Stage, Task};

use crate::gaussians::formats::{self, crc32};
use crate::job::{Error, Session, Watcher};
use crate::lock::{Attempt, attempt};
use crate::wording::mebibytes;
use files::Files;
use std::fs::{File, OpenOptions};
use std::io;
use std::path::{Path, PathBuf};
use std::time::{Duration, Instant};

/// A folder with a plan and the files of its tasks.
pub struct Shard {
    plan: Plan,
    files: Files,
    /// Name of the folder with this device's temporary files of a task.
    device: String,
}

/// The name of a folder for a device with this fingerprint.
fn folder_of(fingerprint: &str) -> String {
    format!("{:08x}", crc32([fingerprint.as_bytes()]))
}

/// Removes a folder with its contents, if it exists.
fn remove(folder: &Path) -> Result<(), Error> {
    match std::fs::remove_dir_all(folder) {
        Err(source) if source.kind() != io::ErrorKind::NotFound => {
            Err(Error::Write { path: folder.to_owned(), source })
        }
        _ => Ok(()),
    }
}

/// True if the system refuses to write, and may still read.
fn is_read_only(cause: &io::Error) -> bool {
    matches!(cause.kind(), io::ErrorKind::PermissionDenied | io::ErrorKind::ReadOnlyFilesystem)
}

/// State of a task.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum State {
    /// Its files are present and intact.
    Done,
    /// Another process is running it.
    Running,
    /// Its files are missing.
    Missing,
    /// One of its files is damaged or not its own.
    Damaged(String),
}

impl Shard {
    /// Writes plan, task list and Snakefile into `folder`.
    ///
    /// # Errors
    /// [`Error::Write`]; [`Error::Encode`]; [`Error::Usage`] if the folder holds anything but this plan.
    pub fn create(plan: &Plan, folder: &Path) -> Result<Self, Error> {
        plan.write(folder)?;
        Self::open(folder)
    }

    /// Opens a folder with a plan, for a device like the plan's.
    ///
    /// # Errors
    /// [`Error::Read`]; [`Error::Part`] for a file that is not a plan of this version.
    pub fn open(folder: &Path) -> Result<Self, Error> {
        let plan = Plan::read(folder)?;
        let (files, device) = (plan.files(folder), folder_of(&plan.fingerprint));
        Ok(Self { plan, files, device })
    }

    /// The plan.
    pub fn plan(&self) -> &Plan {
        &self.plan
    }

    /// All tasks; each comes after those that it needs.
    pub fn tasks(&self) -> impl ExactSizeIterator<Item = Task> {
        self.files.listed.iter().map(|listed| listed.task)
    }

    /// The same plan on a device with this fingerprint. It does not continue from checkpoints of other devices.
    ///
    /// # Errors
    /// [`Error::OtherDevice`] if its results are not bit-identical to those of the plan's device, unless `mixed` is true.
    pub fn on_device(self, fingerprint: &str, mixed: bool) -> Result<Self, Error> {
        if mixed || fingerprint == self.plan.fingerprint {
            return Ok(Self { device: folder_of(fingerprint), ..self });
        }
        Err(Error::OtherDevice { planned: self.plan.fingerprint, here: fingerprint.to_owned() })
    }

    /// Runs a task, unless it is done, and reports its cost to the watcher. Waits while another process runs it.
    ///
    /// # Errors
    /// [`Error::Usage`] for a task that the plan does not have; [`Error::Part`] for parts that are damaged or of
    /// another plan; errors of the work itself.
    pub fn run(&self, session: &Session<'_>, task: Task) -> Result<(), Error> {
        self.has(task)?;
        let _lock = self.lock(session.watcher, task)?;
        if self.state_of_files(task) == State::Done {
            return Ok(());
        }
        let Session { device, watcher, .. } = *session;
        let (begun, scratch) = (Instant::now(), self.files.scratch(task));
        device.forget_peak();
        for (path, bytes) in self.work(session, task, &scratch.join(&self.device))? {
            let folder = path.parent().unwrap_or(&self.files.folder);
            std::fs::create_dir_all(folder).map_err(|source| Error::Write { path: folder.to_owned(), source })?;
            formats::remove_leftovers(&path);
            formats::write_atomically(&path, |out| out.write_all(&bytes)).map_err(Error::writing)?;
        }
        let _ = remove(&scratch);
        let (seconds, most) = (begun.elapsed().as_secs_f64(), device.memory_used().1);
        let memory =
            if most == 0 { String::new() } else { format!(" and at most {} of device memory", mebibytes(most)) };
        watcher.note(&format!("{task} took {seconds:.1} s{memory}"));
        Ok(())
    }

    /// Runs all tasks that are not done, one after the other; calls `follow` before each.
    pub fn all(&self, session: &Session<'_>, mut follow: impl FnMut(Task)) -> Result<(), Error> {
        for task in self.tasks() {
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
        self.tasks().map(|task| (task, state(task))).collect()
    }

    /// Reads the files of a task.
    ///
    /// # Errors
    /// [`Error::Part`] if one is missing or damaged, or not its own; [`Error::Read`].
    pub fn check(&self, task: Task) -> Result<(), Error> {
        self.plan.job.check(&self.files, task)
    }

    /// Runs a task again from its beginning and compares the bytes with those of its files. Returns the files that differ.
    /// Waits while another process runs the task.
    ///
    /// # Errors
    /// As [`Shard::run`]; [`Error::Read`] for files that are not there.
    pub fn verify(&self, session: &Session<'_>, task: Task) -> Result<Vec<PathBuf>, Error> {
        self.has(task)?;
        let _lock = match self.lock(session.watcher, task) {
            // Who may only read the folder goes without a lock: results are replaced as a whole, if at all.
            Err(Error::Write { source, .. }) if is_read_only(&source) => None,
            lock => lock?,
        };
        // Not the task's own folder: checkpoints of one are not for the other.
        let scratch = self.files.scratch(task).with_extension("verify");
        remove(&scratch)?;
        let made = self.work(session, task, &scratch);
        let _ = remove(&scratch);
        let mut wrong = Vec::new();
        for (path, bytes) in made? {
            let there = std::fs::read(&path).map_err(|source| Error::Read { path: path.clone(), source })?;
            if there != bytes {
                wrong.push(path);
            }
        }
        Ok(wrong)
    }

    fn has(&self, task: Task) -> Result<(), Error> {
        if self.files.listed(task).is_some() {
            return Ok(());
        }
        Err(Error::Usage(format!("the plan in {} has no task {task}", self.files.folder.display())))
    }

    fn lock_file(&self, task: Task) -> PathBuf {
        self.files.folder.join("locks").join(task.to_string().replace('/', "-"))
    }

    /// The lock of a task, released when the process ends, however it ends. `None` on a file system without locks: two
    /// processes that run the same task produce the same result.
    fn lock(&self, watcher: &dyn Watcher, task: Task) -> Result<Option<File>, Error> {
        let path = self.lock_file(task);
        let failed = |source| Error::Write { path: path.clone(), source };
        std::fs::create_dir_all(path.parent().unwrap_or(&self.files.folder)).map_err(failed)?;
        let file = OpenOptions::new().write(true).create(true).truncate(false).open(&path).map_err(failed)?;
        let mut told = false;
        loop {
            match attempt(&file).map_err(failed)? {
                Attempt::Locked => return Ok(Some(file)),
                Attempt::WithoutLocks => return Ok(None),
                Attempt::Busy => watcher.unless_stopped()?,
            }
            if !told {
                watcher.note(&format!("{task}: waiting for another process that runs it"));
                told = true;
            }
            std::thread::sleep(Duration::from_millis(200));
        }
    }

    fn is_locked(&self, task: Task) -> bool {
        let path = self.lock_file(task);
        // A reader of the folder may not be allowed to write, and can still see the lock, except on NFS.
        let file = OpenOptions::new().write(true).open(&path).or_else(|_| File::open(&path));
        file.and_then(|file| attempt(&file)).is_ok_and(|attempt| attempt == Attempt::Busy)
    }

    fn state_of_files(&self, task: Task) -> State {
        if self.files.outputs(task).iter().any(|path| !path.exists()) {
            return State::Missing;
        }
        self.check(task).map_or_else(|error| State::Damaged(error.to_string()), |()| State::Done)
    }

    /// The files of a task with their contents, in the order of writing; `scratch` is a folder for temporary files.
    fn work(&self, session: &Session<'_>, task: Task, scratch: &Path) -> Result<Vec<(PathBuf, Vec<u8>)>, Error> {
        let contents = self.plan.job.work(session, &self.files, task, scratch)?;
        Ok(self.files.outputs(task).into_iter().zip(contents).collect())
    }
}
