//! The plan of a divided job: all that its results depend on, and the list of its tasks.

use super::task::Task;
use crate::error::Error;
use crate::gaussians::formats::crc32;
use crate::pipeline::Output;
use crate::pipeline::compress::CompressConfig;
use crate::pipeline::records::CompressProtocol;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use std::fs::File;
use std::io::Read;
use std::path::{Path, PathBuf};

/// What makes a plan this program's.
const MADE_BY: &str = "qirf-vk shard";
/// Views held out that a task scores.
const SCORED: usize = 16;

/// The plan of a compression in tasks. How many processes do them appears nowhere: the results do not depend on it.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Plan {
    /// `qirf-vk shard`.
    pub made_by: String,
    /// Version of the program.
    pub version: String,
    /// The model.
    pub model: PathBuf,
    /// CRC-32 of its bytes; 0 for a folder.
    pub model_crc32: u32,
    /// Its number of Gaussians.
    pub gaussians: usize,
    /// Name of the compressed model's file.
    pub output: String,
    /// The compression.
    pub config: CompressConfig,
    /// Chunks of views that responses are taken from.
    pub chunks: usize,
    /// Views held out.
    pub test_views: usize,
    /// Fingerprint of the device that made the plan: what its kernels compute.
    pub fingerprint: String,
    /// Conditions of the measurement, for the report.
    pub protocol: Value,
}

/// The inputs of a plan.
pub struct Planned<'a> {
    /// The model's file.
    pub model: &'a Path,
    /// Its number of Gaussians.
    pub gaussians: usize,
    /// Name of the compressed model's file.
    pub output: &'a str,
    /// The compression.
    pub config: CompressConfig,
    /// Fingerprint of this device.
    pub fingerprint: String,
}

impl Plan {
    /// The plan of a compression with these numbers of views.
    ///
    /// # Errors
    /// A model that cannot be read again; [`Error::Encode`].
    pub fn new(
        planned: Planned<'_>,
        chunks: usize,
        test_views: usize,
        protocol: &CompressProtocol,
    ) -> Result<Self, Error> {
        let Planned { model, gaussians, output, config, fingerprint } = planned;
        let model = std::path::absolute(model).map_err(|source| Error::Read { path: model.to_owned(), source })?;
        Ok(Self {
            made_by: MADE_BY.to_owned(),
            version: env!("CARGO_PKG_VERSION").to_owned(),
            model_crc32: crc32_of_file(&model)?,
            model,
            gaussians,
            output: output.to_owned(),
            config,
            chunks,
            test_views,
            fingerprint,
            protocol: serde_json::to_value(protocol).map_err(|e| Error::encoding("the plan", e))?,
        })
    }

    /// Reads the plan of a folder.
    ///
    /// # Errors
    /// [`Error::Read`]; [`Error::Part`] for a file that is no plan of this version.
    pub fn read(folder: &Path) -> Result<Self, Error> {
        let path = file(folder);
        let bytes = std::fs::read(&path).map_err(|source| Error::Read { path: path.clone(), source })?;
        let plan: Result<Self, _> = serde_json::from_slice(&bytes);
        let wrong = |what: String| Error::Part { path: path.clone(), what, task: "plan".to_owned() };
        let plan = plan.map_err(|e| wrong(format!("it is no plan: {e}")))?;
        match (plan.made_by == MADE_BY, plan.version == env!("CARGO_PKG_VERSION")) {
            (true, true) => Ok(plan),
            (true, false) => Err(wrong(format!("it was made by version {}", plan.version))),
            _ => Err(wrong("it was made by another program".to_owned())),
        }
    }

    /// Writes plan, task list and Snakefile.
    ///
    /// # Errors
    /// [`Error::Write`]; [`Error::Encode`]; [`Error::Usage`] if the folder holds another plan.
    pub fn write(&self, folder: &Path) -> Result<(), Error> {
        if let Ok(there) = Self::read(folder)
            && there != *self
        {
            return Err(Error::Usage(format!("{} holds another plan; name an empty or new folder", folder.display())));
        }
        std::fs::create_dir_all(folder).map_err(|source| Error::Write { path: folder.to_owned(), source })?;
        let tasks: Vec<Value> = self.tasks().iter().map(|task| self.listed(*task)).collect();
        Output::text(&folder.join("Snakefile"), include_str!("Snakefile"))?;
        Output::json(&folder.join("tasks.json"), "tasks.json", &json!({ "plan": self.hash(), "tasks": tasks }))?;
        Output::json(&file(folder), "plan.json", self)
    }

    /// A task as in `tasks.json`.
    fn listed(&self, task: Task) -> Value {
        let needs: Vec<String> = task.needs(self).iter().flat_map(|t| t.outputs(self)).collect();
        let name = task.to_string();
        json!({ "id": name, "needs": needs, "outputs": task.outputs(self), "work": task.work(self) })
    }

    /// All tasks; each comes after those that it needs.
    pub fn tasks(&self) -> Vec<Task> {
        let evidence = (0..self.chunks).map(Task::Evidence);
        let scores = (0..self.test_views.div_ceil(SCORED)).map(Task::Score);
        evidence.chain([Task::Choose]).chain(scores).chain([Task::Report]).collect()
    }

    /// The views held out that task number `n` of the scores has.
    pub fn scored(&self, n: usize) -> std::ops::Range<usize> {
        n * SCORED..((n + 1) * SCORED).min(self.test_views)
    }

    /// A number that parts carry, to tell the plans apart.
    pub fn hash(&self) -> String {
        format!("{:08x}", crc32([serde_json::to_string(self).unwrap_or_default().as_bytes()]))
    }
}

/// The plan's file in its folder.
pub fn file(folder: &Path) -> PathBuf {
    folder.join("plan.json")
}

/// CRC-32 of a file; 0 for a folder.
///
/// # Errors
/// [`Error::Read`].
pub fn crc32_of_file(path: &Path) -> Result<u32, Error> {
    if path.is_dir() {
        return Ok(0);
    }
    let failed = |source| Error::Read { path: path.to_owned(), source };
    let mut file = File::open(path).map_err(failed)?;
    let (mut crc, mut buffer) = (flate2::Crc::new(), vec![0; 1 << 20]);
    loop {
        let read = file.read(&mut buffer).map_err(failed)?;
        if read == 0 {
            return Ok(crc.sum());
        }
        crc.update(&buffer[..read]);
    }
}
