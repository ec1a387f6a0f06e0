//! A run in blocks as tasks: a coarse model, its division, the blocks up to the prune, evidence by chunks of photos,
//! one choice, the blocks to a second and a third meeting and to their end, the joined model, and its scores by parts
//! of the photos.

use super::files::Files;
use super::task::{Listed, Scores, Stage, Task};
use crate::gaussians::Gaussians;
use crate::job::records::PruneRecord;
use crate::job::sealed::value;
use crate::job::{Error, Output, Session};
use crate::pipeline::evaluate::Assessment;
use crate::response::CHUNK;
use crate::shard::blocks::{BlockRun, BlockState, Layout, Leg, Meeting, copies, joined};
use crate::train::checkpoint::Snapshot;
use serde::{Deserialize, Serialize};
use serde_json::json;
use std::path::Path;

/// Photos per scoring task.
const SCORED: usize = 48;
const COARSE: Task = Task::whole(Stage::Coarse);
const ASSIGN: Task = Task::whole(Stage::Assign);
const FIRST: Task = Task::part(Stage::Collect, 0);
const SECOND: Task = Task::part(Stage::Collect, 1);
const THIRD: Task = Task::part(Stage::Collect, 2);
const CHOOSE: Task = Task::whole(Stage::Choose);
const JOIN: Task = Task::whole(Stage::Join);
const REPORT: Task = Task::whole(Stage::Report);

/// Notes beside the collected blocks of a meeting.
#[derive(Serialize, Deserialize)]
struct Collected {
    /// The first row of each block.
    starts: Vec<usize>,
    /// Number of all rows.
    gaussians: usize,
}

/// The choice among all Gaussians.
#[derive(Serialize, Deserialize)]
struct Chosen {
    prune: PruneRecord,
    /// Gaussians that each block keeps.
    quotas: Vec<usize>,
}

/// Notes beside a block from the second meeting on; those of all blocks are stored beside the joined model.
#[derive(Clone, Serialize, Deserialize)]
struct Ended {
    /// Number of its own Gaussians; after the second meeting, copies of its neighbours' follow them.
    gaussians: usize,
    prune: Option<PruneRecord>,
    skipped_rows: u64,
}

impl Ended {
    fn of(block: &BlockState) -> Self {
        let BlockState { state, copies, prune } = block;
        Self { gaussians: state.model.len() - copies, prune: prune.clone(), skipped_rows: state.skipped_rows }
    }
}

/// Notes beside the joined model.
#[derive(Serialize, Deserialize)]
struct Joined {
    blocks: Vec<Ended>,
}

/// The meeting whose Gaussians the task `collect` wrote.
fn meeting(files: &Files, collect: Task) -> Result<Meeting, Error> {
    let (collected, Collected { starts, .. }) = files.model(collect)?;
    Ok(Meeting { collected, starts })
}

impl BlockRun {
    fn blocks_of(&self, stage: Stage) -> impl Iterator<Item = Task> + use<> {
        Task::parts(stage, self.blocks)
    }

    fn scores(&self) -> Scores {
        Scores { views: self.held_out.len() + self.photos.len(), each: SCORED }
    }

    fn chunks_of_evidence(&self) -> impl Iterator<Item = Task> {
        Task::parts(Stage::Evidence, self.chunks())
    }

    /// All tasks; each comes after those that it needs. `output` is the name of the model's file.
    pub(super) fn tasks(&self, output: &str) -> Vec<Listed> {
        let prunes = self.config.prune.is_some();
        let iterations = self.config.schedule.iterations as usize;
        let each = iterations / 2 / self.blocks.max(1);
        let stored = |task: Task| format!("{task}.safetensors");
        let beside = |task: Task| format!("{task}.json");
        let model = |task: Task| [format!("{task}.ply"), beside(task)];
        let dense = |task: Task| Listed::new(task, [COARSE, ASSIGN], [stored(task)], each);
        let evidence = |task: Task| Listed::new(task, [ASSIGN, FIRST], [stored(task)], CHUNK);
        let choose = Listed::new(CHOOSE, [FIRST].into_iter().chain(self.chunks_of_evidence()), ["choose.json"], CHUNK);
        let tune = |task: Task| {
            // Without a prune it also trains its neighbours' Gaussians, and therefore reads their files, too.
            let own = Task { stage: Stage::Dense, ..task };
            let came: Vec<Task> = if prunes { vec![CHOOSE, own] } else { self.blocks_of(Stage::Dense).collect() };
            Listed::new(task, [ASSIGN, FIRST].into_iter().chain(came), [stored(task), beside(task)], each / 2)
        };
        let settle = |task: Task| {
            let needs = [ASSIGN, SECOND].into_iter().chain(self.blocks_of(Stage::Tune));
            Listed::new(task, needs, [stored(task), beside(task)], each / 4)
        };
        let finish = |task: Task| {
            let own = Task { stage: Stage::Settle, ..task };
            Listed::new(task, [ASSIGN, SECOND, THIRD, own], model(task), each / 4)
        };
        let collect = |task: Task, needs: Vec<Task>| Listed::new(task, needs, model(task), 0);
        let mut tasks = vec![
            Listed::new(COARSE, [], ["coarse.safetensors"], iterations / 32),
            Listed::new(ASSIGN, [COARSE], ["assign.json"], 2 * self.photos.len()),
        ];
        tasks.extend(self.blocks_of(Stage::Dense).map(dense));
        tasks.push(collect(FIRST, self.blocks_of(Stage::Dense).collect()));
        tasks.extend(self.chunks_of_evidence().map(evidence));
        tasks.extend(prunes.then_some(choose));
        tasks.extend(self.blocks_of(Stage::Tune).map(tune));
        tasks.push(collect(SECOND, self.blocks_of(Stage::Tune).collect()));
        tasks.extend(self.blocks_of(Stage::Settle).map(settle));
        tasks.push(collect(THIRD, [ASSIGN, SECOND].into_iter().chain(self.blocks_of(Stage::Settle)).collect()));
        tasks.extend(self.blocks_of(Stage::Finish).map(finish));
        let needs = [ASSIGN, SECOND].into_iter().chain(self.blocks_of(Stage::Finish));
        tasks.push(Listed::new(JOIN, needs, [output, "join.json"], 0));
        tasks.extend(self.scores().listed(JOIN));
        let needs = [ASSIGN, JOIN].into_iter().chain(prunes.then_some(CHOOSE)).chain(self.scores().tasks());
        tasks.push(Listed::new(REPORT, needs, ["metrics.json"], 0));
        tasks
    }

    /// Reads the files of a task, to detect damaged ones.
    pub(super) fn check(files: &Files, task: Task) -> Result<(), Error> {
        match task.stage {
            Stage::Coarse | Stage::Dense => files.state(task).map(drop),
            Stage::Assign => files.sealed::<Layout>(task).map(drop),
            Stage::Collect if task == THIRD => files.beside::<Joined>(task).map(drop),
            Stage::Collect => files.beside::<Collected>(task).map(drop),
            Stage::Evidence => files.part(task, files.sealed::<Collected>(FIRST)?.gaussians).map(drop),
            Stage::Choose => files.sealed::<Chosen>(task).map(drop),
            Stage::Tune | Stage::Settle => files.state(task).and_then(|_| files.sealed::<Ended>(task)).map(drop),
            Stage::Finish => files.beside::<Ended>(task).map(drop),
            Stage::Join => files.beside::<Joined>(task).map(drop),
            Stage::Score => files.sealed::<Assessment>(task).map(drop),
            Stage::Report => files.check_figures(task),
        }
    }

    /// The contents of a task's files. Training continues from the checkpoint in the folder `scratch`, if there is one.
    pub(super) fn work(
        &self,
        session: &Session<'_>,
        files: &Files,
        task: Task,
        scratch: &Path,
    ) -> Result<Vec<Vec<u8>>, Error> {
        let part = task.part.unwrap_or_default();
        let output = || Output::new(scratch);
        match task.stage {
            Stage::Coarse => Ok(vec![files.state_bytes(task, self.coarse(session, &output()?)?)?]),
            Stage::Assign => Ok(vec![files.seal(task, &self.assign(session, &files.state(COARSE)?)?)?]),
            Stage::Dense => {
                let layout: Layout = files.sealed(ASSIGN)?;
                let state = self.dense(session, &layout, part, &files.state(COARSE)?.model, &output()?)?;
                Ok(vec![files.state_bytes(task, state)?])
            }
            Stage::Collect if task == THIRD => self.blended(files, task, self.blocks_of(Stage::Settle)),
            Stage::Collect => {
                let blocks = self.blocks_of(if task == FIRST { Stage::Dense } else { Stage::Tune });
                let blocks = blocks.map(|block| files.state(block)).collect::<Result<Vec<Snapshot>, _>>()?;
                let (model, starts) = joined(&blocks);
                let collected = Collected { starts, gaussians: model.len() };
                files.with_model(task, &model, self.config.style.mode(), self.origin, collected)
            }
            Stage::Evidence => {
                let (model, _) = files.model::<Collected>(FIRST)?;
                let responses = self.evidence(session, &model, &files.sealed(ASSIGN)?, part)?;
                Ok(vec![files.part_bytes(task, &responses)?])
            }
            Stage::Choose => {
                let meeting = meeting(files, FIRST)?;
                let n = meeting.collected.len();
                let chunks = self.chunks_of_evidence().map(|chunk| Ok(files.part(chunk, n)?.responses(n)));
                let (prune, quotas) = self.choose(session, &meeting, chunks)?;
                Ok(vec![files.seal(task, &Chosen { prune, quotas })?])
            }
            Stage::Tune | Stage::Settle | Stage::Finish => self.leg(session, files, task, scratch),
            Stage::Join => self.blended(files, task, self.blocks_of(Stage::Finish)),
            Stage::Score => {
                let (model, Joined { .. }) = files.model(JOIN)?;
                Ok(vec![files.seal(task, &self.score(session, &model, self.scores().part(part))?)?])
            }
            Stage::Report => Ok(vec![self.report(session, files)?]),
        }
    }

    /// The scene of the blocks' blended copies, and its notes.
    fn blended(&self, files: &Files, task: Task, blocks: impl Iterator<Item = Task>) -> Result<Vec<Vec<u8>>, Error> {
        let meeting = meeting(files, SECOND)?;
        let of = copies(&files.sealed(ASSIGN)?, &meeting);
        let all = &meeting.collected;
        let (mut model, mut notes) = (Gaussians::zeroed(all.len(), all.degree()), Vec::new());
        for (block, copies) in blocks.zip(&of) {
            let (of_block, ended) = match block.stage {
                Stage::Settle => (files.state(block)?.model, files.sealed::<Ended>(block)?),
                _ => files.model::<Ended>(block)?,
            };
            if of_block.len() != copies.rows.len() {
                let what = format!(
                    "it has {} Gaussians in place of {}: another version of qirf-vk wrote it",
                    of_block.len(),
                    copies.rows.len()
                );
                let path = files.outputs(block).swap_remove(0);
                return Err(Error::Part { path, what, task: block.to_string() });
            }
            copies.add_to(&mut model, &of_block);
            notes.push(ended);
        }
        // The joined model is in the scene's unit.
        let model = model.scaled(if task == JOIN { self.unit } else { 1.0 });
        files.with_model(task, &model, self.config.style.mode(), self.origin, Joined { blocks: notes })
    }

    /// The contents of the files of a task that trains a block from a meeting on.
    fn leg(&self, session: &Session<'_>, files: &Files, task: Task, scratch: &Path) -> Result<Vec<Vec<u8>>, Error> {
        let b = task.part.unwrap_or_default();
        let (number, collect, came) = match task.stage {
            Stage::Tune => (1, FIRST, Stage::Dense),
            Stage::Settle => (2, SECOND, Stage::Tune),
            _ => (3, SECOND, Stage::Settle),
        };
        let prunes = number == 1 && self.config.prune.is_some();
        let chosen: Option<Chosen> = prunes.then(|| files.sealed(CHOOSE)).transpose()?;
        let ended: Option<Ended> = (number > 1).then(|| files.sealed(Task::part(came, b))).transpose()?;
        let blended = (number == 3).then(|| files.model::<Joined>(THIRD)).transpose()?;
        let layout: Layout = files.sealed(ASSIGN)?;
        let meeting = meeting(files, collect)?;
        let leg = Leg {
            layout: &layout,
            b,
            meeting: &meeting,
            number,
            quota: chosen.map(|chosen| chosen.quotas[b]),
            prune: ended.and_then(|ended| ended.prune),
            came: &|b: usize| files.state(Task::part(came, b)),
            blended: blended.as_ref().map(|(blended, _)| blended),
        };
        let block = self.train(session, leg, &Output::new(scratch)?)?;
        let ended = Ended::of(&block);
        if number == 3 {
            return files.with_model(task, &block.state.model, self.config.style.mode(), self.origin, ended);
        }
        Ok(vec![files.state_bytes(task, block.state)?, files.seal(task, &ended)?])
    }

    /// All figures, as printed by `qirf-vk eval`, without times, memory and the frame rate; plus those of the blocks.
    fn report(&self, session: &Session<'_>, files: &Files) -> Result<Vec<u8>, Error> {
        let (model, Joined { blocks }) = files.model(JOIN)?;
        let layout: Layout = files.sealed(ASSIGN)?;
        let chosen = if self.config.prune.is_some() { Some(files.sealed::<Chosen>(CHOOSE)?) } else { None };
        let mut measured = Assessment::default();
        for task in self.scores().tasks() {
            measured.extend(files.sealed(task)?);
        }
        let record = self.record(session, &files.outputs(JOIN)[0], &model, measured);
        let of_block = |(b, ended): (usize, &Ended)| {
            let photos = layout.blocks.get(b).map_or(0, |block| block.crops.len());
            json!({ "photos": photos, "gaussians": ended.gaussians, "prune": ended.prune, "skipped_rows": ended.skipped_rows })
        };
        let record = json!({
            "schema": record.schema,
            "version": record.version,
            "device": record.device,
            "protocol": value(&record.protocol).map_err(|e| Error::encoding("the figures", e))?,
            "gaussians": record.gaussians,
            "test": record.test,
            "test_unfitted_psnr": record.unfitted_psnr,
            "train": record.train,
            "views": record.views,
            "ply_bytes": record.model_bytes,
            "guards": record.guards,
            "prune": chosen.map(|chosen| chosen.prune),
            "omega": layout.omega,
            "blocks": blocks.iter().enumerate().map(of_block).collect::<Vec<_>>(),
        });
        Ok(files.figures(record))
    }
}
