//! A compression in tasks: evidence by chunks of views, one choice, scores by held-out views.

use super::files::Files;
use super::task::{Listed, Scores, Stage, Task};
use crate::gaussians::{Gaussians, formats};
use crate::job::output::{absolute, respell};
use crate::job::records::{ModelFile, PruneRecord, StageScores, ViewStages};
use crate::job::sealed::value;
use crate::job::{Error, Selection, Session};
use crate::pipeline::compress::{CompressConfig, ViewSource, stages};
use crate::pipeline::prepare::{contents, crc32_of_file, open};
use crate::response::CHUNK;
use glam::DVec3;
use serde::{Deserialize, Serialize};
use serde_json::{Value, json};
use std::path::{Path, PathBuf};

/// Number of held-out views per scoring task.
const SCORED: usize = 16;
const CHOOSE: Task = Task::whole(Stage::Choose);
const REPORT: Task = Task::whole(Stage::Report);

/// Everything that the results of a compression depend on.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct CompressPlan {
    /// The model.
    pub model: PathBuf,
    /// Local origin of the compressed model.
    pub origin: [f64; 3],
    /// CRC-32 of its bytes; 0 for a folder.
    pub model_crc32: u32,
    /// Its number of Gaussians.
    pub gaussians: usize,
    /// The compression.
    pub config: CompressConfig,
    /// Number of chunks of views for responses.
    pub chunks: usize,
    /// Number of held-out views.
    pub test_views: usize,
    /// Names of the training photos and of the held-out photos; empty if the model's own pictures are used.
    pub photos: [Vec<String>; 2],
    /// Conditions of the measurement, for the report.
    pub protocol: Value,
}

/// Notes beside the chosen model.
#[derive(Debug, Serialize, Deserialize)]
struct Chosen {
    prune: PruneRecord,
}

impl CompressPlan {
    /// Plans the compression of the model in `path`, which was moved to this local origin.
    ///
    /// # Errors
    /// Errors of the compression itself; [`Error::Usage`] for fine-tuning; a model that cannot be read again.
    pub fn plan(
        session: &Session<'_>,
        path: &Path,
        model: &Gaussians,
        origin: [f64; 3],
        config: CompressConfig,
    ) -> Result<Self, Error> {
        if config.fine_tune > 0 {
            return Err(Error::Usage("a divided compression has no fine-tuning".to_owned()));
        }
        let mut config = config;
        if let ViewSource::Photos(selection) = &mut config.views {
            let Selection { scene, images, depth, .. } = selection;
            respell(scene, [images, depth], absolute);
        }
        let stages::Census { chunks, test_views, photos, background, alpha_role, protocol } =
            stages::census(session, model, &config)?;
        if let ViewSource::Photos(selection) = &mut config.views {
            selection.contents = contents(&open(selection)?.only(&photos.concat())?.scene)?;
            // Tasks decode only a few photos, but background and alpha depend on all of them.
            selection.background = Some(background);
            selection.effects.keep_alpha(alpha_role);
        }
        let path = absolute(path);
        Ok(Self {
            model_crc32: crc32_of_file(&path)?,
            model: path,
            origin,
            gaussians: model.len(),
            config,
            chunks,
            test_views,
            photos,
            protocol: value(&protocol).map_err(|e| Error::encoding("the plan", e))?,
        })
    }

    /// The scene of the photos, if there is one.
    pub(super) fn scene(&self) -> Option<&PathBuf> {
        match &self.config.views {
            ViewSource::Photos(selection) => Some(&selection.scene),
            ViewSource::OwnPictures { .. } => None,
        }
    }

    fn evidence(&self) -> impl Iterator<Item = Task> {
        Task::parts(Stage::Evidence, self.chunks)
    }

    fn scores(&self) -> Scores {
        Scores { views: self.test_views, each: SCORED }
    }

    /// All tasks; each comes after those that it needs. `output` is the name of the compressed model's file.
    pub(super) fn tasks(&self, output: &str) -> Vec<Listed> {
        let evidence = self.evidence().map(|task| Listed::new(task, [], [format!("{task}.safetensors")], CHUNK));
        let choose = Listed::new(CHOOSE, self.evidence(), [output, "prune.json"], self.chunks);
        let report = Listed::new(REPORT, [CHOOSE].into_iter().chain(self.scores().tasks()), ["metrics.json"], 0);
        evidence.chain([choose]).chain(self.scores().listed(CHOOSE)).chain([report]).collect()
    }

    /// Reads the files of a task, to detect damaged ones.
    pub(super) fn check(&self, files: &Files, task: Task) -> Result<(), Error> {
        match task.stage {
            Stage::Evidence => files.part(task, self.gaussians).map(drop),
            Stage::Choose => files.beside::<Chosen>(task).map(drop),
            Stage::Score => files.sealed::<Vec<ViewStages>>(task).map(drop),
            _ => files.check_figures(task),
        }
    }

    /// The contents of a task's files.
    pub(super) fn work(&self, session: &Session<'_>, files: &Files, task: Task) -> Result<Vec<Vec<u8>>, Error> {
        let config = &self.config;
        match (task.stage, task.part) {
            (Stage::Evidence, Some(chunk)) => {
                let responses = stages::evidence(session, &self.model()?, config, chunk, &self.photos[0], None)?;
                Ok(vec![files.part_bytes(task, &responses)?])
            }
            (Stage::Choose, _) => {
                let parts = self.evidence().map(|part| Ok(files.part(part, self.gaussians)?.responses(self.gaussians)));
                let model = self.model()?;
                let (prune, model) = stages::choose(session, &model, config, &self.photos[0], parts)?.apply(model);
                files.with_model(task, &model, config.style.mode(), self.origin, Chosen { prune: prune.timeless() })
            }
            (Stage::Score, Some(n)) => {
                let (compressed, _) = files.model::<Chosen>(CHOOSE)?;
                let (held_out, photos) = (self.scores().part(n), &self.photos[1]);
                let mut views = stages::score(session, &self.model()?, &compressed, config, held_out, photos)?;
                // The model was read from its file, which may have rounded its values.
                if !files.outputs(CHOOSE).iter().all(|file| formats::is_exact(file)) {
                    for view in &mut views {
                        view.scores.written = view.scores.pruned.take();
                    }
                }
                Ok(vec![files.seal(task, &views)?])
            }
            _ => Ok(vec![self.report(session, files)?]),
        }
    }

    /// The model, unchanged since the plan was made.
    fn model(&self) -> Result<Gaussians, Error> {
        let path = &self.model;
        if crc32_of_file(path)? != self.model_crc32 {
            let what = "it has changed since the plan was made".to_owned();
            return Err(Error::Part { path: path.clone(), what, task: "plan".to_owned() });
        }
        let mut loaded = formats::read(path)?;
        loaded.gaussians.shift(DVec3::from(loaded.origin) - DVec3::from(self.origin));
        Ok(loaded.gaussians)
    }

    /// All figures, as printed by `qirf-vk compress --json`, without times and memory.
    fn report(&self, session: &Session<'_>, files: &Files) -> Result<Vec<u8>, Error> {
        let Chosen { prune } = files.beside(CHOOSE)?;
        let mut views: Vec<ViewStages> = Vec::new();
        for task in self.scores().tasks() {
            views.extend(files.sealed::<Vec<ViewStages>>(task)?);
        }
        let file =
            |path: &Path| -> Result<ModelFile, Error> { Ok(ModelFile::of(path, &formats::read(path)?.gaussians)) };
        let written = files.outputs(CHOOSE).swap_remove(0);
        let record = json!({
            "schema": 1,
            "version": env!("CARGO_PKG_VERSION"),
            "device": session.device.tuned(),
            "protocol": self.protocol,
            "input": file(&self.model)?,
            "output": ModelFile { path: written.file_name().unwrap_or_default().into(), ..file(&written)? },
            "prune": prune,
            "test": StageScores::mean(&views),
            "views": views,
        });
        Ok(files.figures(record))
    }
}
