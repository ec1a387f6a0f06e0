//! The plan of a divided job: everything that its results depend on, and the list of its tasks.

use super::compression::CompressPlan;
use super::files::Files;
use super::task::{Listed, Task};
use crate::gaussians::formats::crc32;
use crate::job::{Error, Exit, Output, Session};
use crate::shard::blocks::BlockRun;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};

/// The format and version that mark a plan as this program's.
const MADE_BY: &str = "qirf-vk shard";

/// The list of tasks and the workflow, which are written before the plan.
const TASKS: &str = "tasks.json";
const SNAKEFILE: &str = "Snakefile";

/// The plan of a job in tasks. It does not contain the number of processes: the results do not depend on it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Plan {
    /// `qirf-vk shard`.
    made_by: String,
    version: String,
    /// Fingerprint of the results of the device that made the plan.
    pub fingerprint: String,
    /// Name of the resulting model's file.
    pub output: String,
    /// The job.
    pub job: Job,
}

/// A divided job.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Job {
    /// The compression of a model.
    Compression(Box<CompressPlan>),
    /// A run in blocks.
    Run(Box<BlockRun>),
}

impl Job {
    pub(super) fn tasks(&self, output: &str) -> Vec<Listed> {
        match self {
            Self::Compression(job) => job.tasks(output),
            Self::Run(job) => job.tasks(output),
        }
    }

    pub(super) fn check(&self, files: &Files, task: Task) -> Result<(), Error> {
        match self {
            Self::Compression(job) => job.check(files, task),
            Self::Run(_) => BlockRun::check(files, task),
        }
    }

    pub(super) fn work(
        &self,
        session: &Session<'_>,
        files: &Files,
        task: Task,
        scratch: &Path,
    ) -> Result<Vec<Vec<u8>>, Error> {
        let made = match self {
            Self::Compression(job) => job.work(session, files, task),
            Self::Run(job) => job.work(session, files, task, scratch),
        };
        made.map_err(|error| match (Exit::of(&error), self.lost()) {
            (Exit::BadInput, Some(path)) if !matches!(error, Error::Part { .. }) => {
                let what = "the plan names this input, which is no longer there".to_owned();
                Error::Part { path: path.to_owned(), what, task: "plan".to_owned() }
            }
            _ => error,
        })
    }

    /// The model or scene that the plan names, if it is not there any more.
    fn lost(&self) -> Option<&Path> {
        let [model, scene] = match self {
            Self::Compression(job) => [Some(&job.model), job.scene()],
            Self::Run(job) => [None, Some(&job.config.scene)],
        };
        model.into_iter().chain(scene).find(|path| !path.exists()).map(PathBuf::as_path)
    }
}

impl Plan {
    /// The plan of a job on a device with this fingerprint; `output` is the file name of the resulting model.
    pub fn new(job: Job, output: &str, fingerprint: String) -> Self {
        let version = env!("CARGO_PKG_VERSION").to_owned();
        Self { made_by: MADE_BY.to_owned(), version, fingerprint, output: output.to_owned(), job }
    }

    /// Reads the plan of a folder.
    ///
    /// # Errors
    /// [`Error::Read`]; [`Error::Part`] for a file that is not a plan of this version.
    pub fn read(folder: &Path) -> Result<Self, Error> {
        let path = file(folder);
        let bytes = std::fs::read(&path).map_err(|source| Error::Read { path: path.clone(), source })?;
        let plan: Result<Self, _> = serde_json::from_slice(&bytes);
        let wrong = |what: String| Error::Part { path: path.clone(), what, task: "plan".to_owned() };
        let plan = plan.map_err(|e| wrong(format!("it is not a plan: {e}")))?;
        match (plan.made_by == MADE_BY, plan.version == env!("CARGO_PKG_VERSION")) {
            (true, true) if listed_hash(folder).is_some_and(|hash| hash != plan.hash()) => {
                Err(wrong(format!("it is not the plan that {TASKS} beside it lists: one of them was changed")))
            }
            (true, true) => Ok(plan),
            (true, false) => Err(wrong(format!("it was made by version {}", plan.version))),
            _ => Err(wrong("it was made by another program".to_owned())),
        }
    }

    /// Writes plan, task list and Snakefile.
    ///
    /// # Errors
    /// [`Error::Write`]; [`Error::Encode`]; [`Error::Usage`] if the folder holds anything but this plan.
    pub fn write(&self, folder: &Path) -> Result<(), Error> {
        let what = match Self::read(folder) {
            Ok(there) if there == *self => None,
            Ok(_) => Some("holds another plan"),
            // A failed attempt may have left the files that are written before the plan.
            Err(_) => {
                let begun = |entry: &std::fs::DirEntry| {
                    let name = entry.file_name();
                    name == SNAKEFILE || name == TASKS || name.to_string_lossy().ends_with(".tmp")
                };
                let alien = |entry: std::io::Result<std::fs::DirEntry>| entry.map_or(true, |entry| !begun(&entry));
                let foreign = |mut entries: std::fs::ReadDir| file(folder).exists() || entries.any(alien);
                std::fs::read_dir(folder).is_ok_and(foreign).then_some("is not empty")
            }
        };
        if let Some(what) = what {
            return Err(Error::Usage(format!("{} {what}; name an empty or new folder", folder.display())));
        }
        std::fs::create_dir_all(folder).map_err(|source| Error::Write { path: folder.to_owned(), source })?;
        let files = self.files(folder);
        let tasks: Vec<Value> = files.listed.iter().map(|listed| entry(&files, listed)).collect();
        Output::text(&folder.join(SNAKEFILE), include_str!("Snakefile"))?;
        Output::json(&folder.join(TASKS), TASKS, &json!({ "plan": files.hash, "tasks": tasks }))?;
        Output::json(&file(folder), "plan.json", self)
    }

    fn hash(&self) -> String {
        format!("{:08x}", crc32([serde_json::to_string(self).unwrap_or_default().as_bytes()]))
    }

    /// The files of its tasks in `folder`. Their hash, which parts contain, identifies the plan.
    pub(super) fn files(&self, folder: &Path) -> Files {
        Files { folder: folder.to_owned(), hash: self.hash(), listed: self.job.tasks(&self.output) }
    }
}

/// The hash of the plan that a folder's list of tasks names.
fn listed_hash(folder: &Path) -> Option<String> {
    let list: Value = serde_json::from_slice(&std::fs::read(folder.join(TASKS)).ok()?).ok()?;
    list["plan"].as_str().map(str::to_owned)
}

/// A task as in `tasks.json`.
fn entry(files: &Files, listed: &Listed) -> Value {
    let outputs = |task: &Task| files.listed(*task).map_or(&[][..], |l| &l.outputs);
    let needs: Vec<&String> = listed.needs.iter().flat_map(outputs).collect();
    json!({ "id": listed.task.to_string(), "needs": needs, "outputs": listed.outputs, "work": listed.work })
}

/// The plan's file in its folder.
fn file(folder: &Path) -> PathBuf {
    folder.join("plan.json")
}
