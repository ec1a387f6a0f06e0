//! The files of a plan's tasks: their paths, and readers of their contents.

use super::part::{self, Stored};
use super::sealed;
use super::task::{Listed, Task};
use crate::gaussians::formats::{self, RenderMode, SpzVersion};
use crate::gaussians::{self, Gaussians, formats::crc32};
use crate::job::Error;
use crate::pipeline::prepare::crc32_of_file;
use crate::response::Responses;
use crate::train::checkpoint::Snapshot;
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::io;
use std::path::PathBuf;

/// Notes of a training state that name its plan and its task.
const NOTES: [&str; 2] = ["plan", "task"];

/// The files of a plan in its folder.
pub(super) struct Files {
    pub folder: PathBuf,
    /// The plan's hash.
    pub hash: String,
    pub listed: Vec<Listed>,
}

/// The error of reading a file of a task. Without the file, the task is not done.
fn unread(error: impl Into<Error>, task: Task) -> Error {
    match error.into() {
        Error::Read { path, source } if source.kind() == io::ErrorKind::NotFound => {
            Error::Part { path, what: format!("task {task} is not done"), task: task.to_string() }
        }
        other => other,
    }
}

/// Notes beside a model's file.
#[derive(Serialize, Deserialize)]
struct Beside<T> {
    /// CRC-32 of that file.
    model_crc32: u32,
    #[serde(flatten)]
    content: T,
}

impl Files {
    /// A task as the plan lists it.
    pub fn listed(&self, task: Task) -> Option<&Listed> {
        self.listed.iter().find(|listed| listed.task == task)
    }

    /// The paths of a task's files; empty for a task that the plan does not have.
    pub fn outputs(&self, task: Task) -> Vec<PathBuf> {
        self.listed(task).map_or(Vec::new(), |l| l.outputs.iter().map(|name| self.folder.join(name)).collect())
    }

    fn first(&self, task: Task) -> PathBuf {
        self.outputs(task).into_iter().next().unwrap_or_default()
    }

    fn last(&self, task: Task) -> PathBuf {
        self.outputs(task).pop().unwrap_or_default()
    }

    /// Folder for a task's temporary files, with a folder for each device, removed when the task is done.
    pub fn scratch(&self, task: Task) -> PathBuf {
        self.folder.join("work").join(format!("{}-{}", self.hash, task.to_string().replace('/', "-")))
    }

    /// A file that a task wrote, by a parser that is given its bytes, the plan's hash and the task's name.
    ///
    /// # Errors
    /// [`Error::Read`]; [`Error::Part`] if it is missing or damaged, or belongs to another plan or task.
    fn read<T>(
        &self,
        path: PathBuf,
        task: Task,
        parse: impl Fn(&[u8], &str, &str) -> Result<T, String>,
    ) -> Result<T, Error> {
        match std::fs::read(&path) {
            Ok(bytes) => {
                let task = task.to_string();
                parse(&bytes, &self.hash, &task).map_err(|what| Error::Part { path, what, task })
            }
            Err(source) => Err(unread(Error::Read { path, source }, task)),
        }
    }

    /// The responses that a task wrote, for `n` Gaussians.
    pub fn part(&self, task: Task, n: usize) -> Result<Stored, Error> {
        self.read(self.first(task), task, |bytes, plan, task| part::parse(bytes, n, plan, task))
    }

    pub fn part_bytes(&self, task: Task, responses: &Responses) -> Result<Vec<u8>, Error> {
        part::bytes(&self.hash, &task.to_string(), responses)
    }

    /// The figures that a task wrote.
    pub fn sealed<T: DeserializeOwned>(&self, task: Task) -> Result<T, Error> {
        self.read(self.last(task), task, sealed::parse)
    }

    /// The bytes of a task's figures.
    pub fn seal(&self, task: Task, content: &impl Serialize) -> Result<Vec<u8>, Error> {
        sealed::bytes(&self.hash, &task.to_string(), content)
    }

    /// Checks the figures for readers that a task wrote.
    pub fn check_figures(&self, task: Task) -> Result<(), Error> {
        self.read(self.first(task), task, |bytes, plan, _| sealed::check_stamped(bytes, plan))
    }

    /// The bytes of figures for readers.
    pub fn figures(&self, figures: Value) -> Vec<u8> {
        sealed::stamped(figures, &self.hash)
    }

    /// The training state that a task wrote.
    pub fn state(&self, task: Task) -> Result<Snapshot, Error> {
        let path = self.first(task);
        let mut snapshot = Snapshot::read(&path).map_err(|error| match error {
            gaussians::Error::Malformed { path, record, what } => {
                // The remedy for a checkpoint is not that for a task's file.
                let why = what.split("; delete").next().unwrap_or_default();
                Error::Part { path, what: format!("{record}: {why}"), task: task.to_string() }
            }
            other => unread(other, task),
        })?;
        let notes = NOTES.map(|name| snapshot.notes.remove(name).unwrap_or_default());
        let task = task.to_string();
        match sealed::check(notes.each_ref().map(String::as_str), [&self.hash, &task]) {
            Ok(()) => Ok(snapshot),
            Err(what) => Err(Error::Part { path, what, task }),
        }
    }

    pub fn state_bytes(&self, task: Task, mut snapshot: Snapshot) -> Result<Vec<u8>, Error> {
        snapshot.notes = NOTES.map(str::to_owned).into_iter().zip([self.hash.clone(), task.to_string()]).collect();
        snapshot.bytes().map_err(Error::writing)
    }

    /// Reads the notes beside a task's model, and refuses a damaged model.
    pub fn beside<T: DeserializeOwned>(&self, task: Task) -> Result<T, Error> {
        let (path, Beside { model_crc32, content }) = (self.first(task), self.sealed(task)?);
        if crc32_of_file(&path).map_err(|error| unread(error, task))? != model_crc32 {
            let what = "its checksum does not match the model that was written: it is damaged".to_owned();
            return Err(Error::Part { path, what, task: task.to_string() });
        }
        Ok(content)
    }

    /// The model that a task wrote, with the notes beside it.
    pub fn model<T: DeserializeOwned>(&self, task: Task) -> Result<(Gaussians, T), Error> {
        let content = self.beside(task)?;
        Ok((formats::read(&self.first(task))?.gaussians, content))
    }

    /// The bytes of a model's file, with its mode and local origin, and of the notes beside it.
    pub fn with_model(
        &self,
        task: Task,
        model: &Gaussians,
        mode: RenderMode,
        origin: [f64; 3],
        content: impl Serialize,
    ) -> Result<Vec<Vec<u8>>, Error> {
        let path = self.first(task);
        let how = (formats::usual(&path, model), SpzVersion::default());
        let bytes = formats::encode(&path, model, (mode, origin), how).map_err(Error::writing)?;
        let model_crc32 = crc32([bytes.as_slice()]);
        let sealed = self.seal(task, &Beside { model_crc32, content })?;
        Ok(vec![bytes, sealed])
    }
}

#[cfg(test)]
mod tests {
    use super::super::task::Stage;
    use super::*;

    #[test]
    fn a_damaged_state_is_its_tasks_and_no_checkpoint() {
        let folder = tempfile::tempdir().unwrap();
        let (task, name) = (Task::part(Stage::Settle, 0), "settle.safetensors");
        std::fs::write(folder.path().join(name), [0_u8; 64]).unwrap();
        let listed = vec![Listed::new(task, [], [name], 1)];
        let files = Files { folder: folder.path().to_owned(), hash: String::new(), listed };
        match files.state(task) {
            Err(Error::Part { path, what, task }) => {
                assert_eq!((path, task.as_str()), (folder.path().join(name), "settle/0000"));
                assert!(what.starts_with("header: ") && !what.contains("delete"), "{what}");
            }
            other => panic!("{:?}", other.map(drop)),
        }
    }
}
