//! Training a scene in blocks, stage by stage: a coarse model of the whole, its division, each block up to the prune, one choice
//! among all Gaussians, and each block from one meeting to the next and to its end.

use super::derived::{check, coarse, meetings, of_block};
use super::layout::{Block, GROWN, Layout};
use super::meeting::{Came, Meeting};
use super::members::{Members, beginning, own, owned, with_tail};
use super::seen::seen;
use crate::effects::{Choice, Effect};
use crate::error::Error;
use crate::gaussians::Gaussians;
use crate::gaussians::cells::{Cells, Contraction};
use crate::gaussians::resident::Resident;
use crate::pipeline::active_run::ActiveRun;
use crate::pipeline::checkpoint::{Checkpoint, Notes};
use crate::pipeline::compress::{CompressConfig, ViewSource, stages};
use crate::pipeline::config::{Init, Pruning, RunConfig};
use crate::pipeline::eval::{Evaluation, eval};
use crate::pipeline::output::{absolute, from_root};
use crate::pipeline::prepare::{Opened, Prepared, all_there, open};
use crate::pipeline::prune::PrunePlan;
use crate::pipeline::records::{PruneRecord, RunRecord};
use crate::pipeline::session::Session;
use crate::pipeline::setup::Setup;
use crate::pipeline::start::Start;
use crate::pipeline::{Output, budget, effects, virtual_views};
use crate::qirf::select::budget::Keep;
use crate::render::visible;
use crate::response::{CHUNK, Responses, Wanted};
use crate::scene::Photo;
use crate::scene::camera::Camera;
use crate::train::Exposures;
use crate::train::checkpoint::Snapshot;
use crate::train::exposure;
use serde::{Deserialize, Serialize};
use std::path::Path;
use std::time::Instant;

/// Largest sides of photos from which the coarse model takes them at half and at a quarter of their size.
const LARGE: [u32; 2] = [256, 1024];

/// What the sides of photos are divided by for the coarse model.
fn divisor(largest: [u32; 2]) -> u32 {
    1 << LARGE.iter().filter(|least| largest.iter().max() >= Some(*least)).count()
}

/// A run in blocks: all that its results depend on.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BlockRun {
    /// The run, with the decisions on its effects and the number of Gaussians that it plans to grow to.
    pub config: RunConfig,
    /// Number of blocks.
    pub blocks: usize,
    /// Names of the photos that are trained on.
    pub photos: Vec<String>,
}

/// A block after a meeting.
pub struct Tuned {
    /// Its Gaussians with their moments; at the end its copies of its neighbours' follow.
    pub state: Snapshot,
    /// Number of these copies.
    pub copies: usize,
    /// Its prune; absent without one. Times are left out: they differ from process to process.
    pub prune: Option<PruneRecord>,
}

/// What a block does after a meeting.
#[derive(Clone, Copy, Debug)]
pub enum Half<'a> {
    /// It goes on to the second meeting; with the number of Gaussians to keep, if it prunes.
    First(Option<usize>),
    /// It goes on to the end, after what it did as its prune.
    Second(Option<&'a PruneRecord>),
}

impl BlockRun {
    /// Plans a run in blocks: reads the scene, decides on its effects, and fixes all that tasks must agree on. Without a number of
    /// blocks there are as many as make each fit the device.
    ///
    /// # Errors
    /// Those of reading a scene; no photo to train on; [`Error::Usage`] for a run that cannot be divided.
    pub fn plan(session: &Session<'_>, config: &RunConfig, blocks: Option<usize>) -> Result<Self, Error> {
        check(config)?;
        let mut config = config.clone();
        from_root(&mut config.scene, &mut config.images)?;
        if let Init::Model(path) = &mut config.init {
            *path = absolute(path)?;
        }
        let opened = open(&config.selection())?;
        let pixels = opened.train_pixels().iter().sum();
        let initial =
            Start::of(&config, opened.scene.points.len(), opened.train_pixels().into_iter().max().unwrap_or(0))?.len();
        let prepared = opened.load_to_train(session.photo_memory(&std::env::temp_dir()), session.watcher)?;
        let (decisions, _) = effects::decide(&prepared, &config)?;
        session.watcher.note(&effects::summary(&decisions));
        let mut config = RunConfig { background: Some(prepared.background), ..config.decided(&decisions) };
        for decision in &decisions {
            if [Effect::ViewDependence, Effect::Exposure, Effect::Antialias, Effect::DepthOrder]
                .contains(&decision.name)
            {
                config.effects.set(decision.name, if decision.on { Choice::On } else { Choice::Off });
            }
        }
        let schedule = &mut config.schedule;
        schedule.growth = schedule.growth.map(|plan| plan.for_photos(pixels, schedule.iterations));
        let photos = prepared.names_to_train();
        let blocks = match blocks {
            Some(blocks) => blocks,
            None => budget::blocks(session.device, &config, &prepared, initial)?,
        };
        Ok(Self { config, blocks, photos })
    }

    /// Chunks of photos that responses are taken from; none without a prune.
    pub fn chunks(&self) -> usize {
        if self.config.prune.is_some() { self.photos.len().div_ceil(CHUNK) } else { 0 }
    }

    /// The scene with its training photos alone, not decoded.
    fn opened(&self) -> Result<Opened, Error> {
        open(&self.config.selection())?.only(&self.photos)
    }

    /// A coarse model of the whole scene, by a short run on small pictures. It continues from the checkpoint in `output`, if there
    /// is one.
    ///
    /// # Errors
    /// As of a run; photos other than the plan's.
    pub fn coarse(&self, session: &Session<'_>, output: &Output) -> Result<Snapshot, Error> {
        let config = coarse(&self.config, divisor(self.opened()?.size()));
        let (setup, start) = Setup::load(session, &config, output, output.checkpoint().exists())?;
        all_there(&setup.prepared.scene, &self.photos)?;
        let mut run = ActiveRun::start(&setup, &setup.config, output, start)?;
        run.train(setup.config.schedule.iterations)?;
        Ok(run.checkpoint()?.snapshot)
    }

    /// The blocks of the scene that a coarse model shows in pictures of the size that it was trained on.
    ///
    /// # Errors
    /// Device memory; device errors; [`Error::Interrupted`].
    pub fn assign(&self, session: &Session<'_>, coarse: &Snapshot) -> Result<Layout, Error> {
        let Snapshot { model: coarse, exposures: (exposures, _), .. } = coarse;
        let opened = self.opened()?;
        let (cameras, divisor) = (opened.cameras(), divisor(opened.size()));
        let smaller = |c: &Camera| c.resized((c.width / divisor).max(1), (c.height / divisor).max(1));
        let small: Vec<Camera> = cameras.iter().map(smaller).collect();
        let settings = self.config.style.over(self.config.background.unwrap_or_default());
        let resident = Resident::upload(session.device, coarse)?;
        let scores = virtual_views::responses(session, &resident, (&small, None), settings, Wanted::SCORES)?.scores;
        drop(resident);
        let weights: Vec<f32> = scores.iter().map(|score| score.contribution).collect();
        let around = Contraction::around(cameras.iter().map(Camera::centre));
        let cells = Cells::new(around, &coarse.means, &weights, self.blocks);
        let owners = cells.owners(&coarse.means);
        let seen = seen(session, coarse, (&owners, cells.count()), (&cameras, &small), settings)?;
        Ok(Layout { exposures: exposures.clone(), ..Layout::new(cells, coarse, &weights, &cameras, &seen) })
    }

    /// Block number `b` up to the prune, behind what the coarse model has of the others: its own Gaussians with their moments. It
    /// continues from the checkpoint in `output`, if there is one.
    ///
    /// # Errors
    /// As of a run; photos other than the plan's.
    pub fn dense(
        &self,
        session: &Session<'_>,
        (layout, b): (&Layout, usize),
        coarse: &Gaussians,
        output: &Output,
    ) -> Result<Snapshot, Error> {
        let Some(block) = layout.blocks.get(b) else { return Ok(beginning(Gaussians::default(), 0)) };
        let members = Members::of(&layout.cells, b, GROWN, coarse);
        let of_coarse = || beginning(coarse.select(&members.trained), 0);
        if members.trained.is_empty() || block.crops.is_empty() {
            return Ok(owned(&of_coarse(), &layout.cells, b));
        }
        let config = of_block(&self.config, (block, b), self.photos.len());
        let mut setup = self.setup(session, config, (block, &layout.exposures), output)?;
        let seen = |setup: &Setup<'_>| coarse.select(&setup.shown(coarse, &members.seen));
        let start = setup.start(output, (|setup: &Setup<'_>| Ok(with_tail(&of_coarse(), &seen(setup))), &[]))?;
        let mut run = ActiveRun::start(&setup, &setup.config, output, start)?;
        run.train(meetings(&setup.config)[0])?;
        Ok(owned(&run.checkpoint()?.snapshot, &layout.cells, b))
    }

    /// Responses of a chunk of photos to the Gaussians of all blocks.
    ///
    /// # Errors
    /// As of a compression.
    pub fn evidence(
        &self,
        session: &Session<'_>,
        collected: &Gaussians,
        layout: &Layout,
        chunk: usize,
    ) -> Result<Responses, Error> {
        let (config, _) = self.choice()?;
        let exposures = self.config.exposure.then(|| Exposures::Known(layout.exposures.clone()));
        stages::evidence(session, collected, &config, (chunk, &self.photos, exposures))
    }

    /// How many Gaussians of each block a choice among all of them keeps, by the responses of all chunks in their order.
    ///
    /// # Errors
    /// As of a compression; those of the chunks.
    pub fn choose(
        &self,
        session: &Session<'_>,
        meeting: &Meeting<'_>,
        chunks: impl Iterator<Item = Result<Responses, Error>>,
    ) -> Result<(PruneRecord, Vec<usize>), Error> {
        let (config, _) = self.choice()?;
        let PrunePlan { record, keep, .. } =
            stages::choose(session, meeting.collected, (&config, &self.photos), chunks)?;
        let quota = |b: usize| keep[meeting.rows(b)].iter().filter(|kept| **kept).count();
        Ok((record.timeless(), (0..meeting.starts.len()).map(quota).collect()))
    }

    /// Block number `b` from a meeting to the next or to the end, behind the Gaussians of the others. While none is pruned, those of
    /// them that lie in the grown cell are trained along: what one block does at a border, the other expects. At the end they are
    /// handed on behind its own, as copies for [`copies`](super::copies). It continues from the checkpoint in `output`, if there is one.
    ///
    /// # Errors
    /// As of a run; photos other than the plan's.
    pub fn tune(
        &self,
        session: &Session<'_>,
        (layout, b, half): (&Layout, usize, Half<'_>),
        (meeting, came): (&Meeting<'_>, Came<'_>),
        output: &Output,
    ) -> Result<Tuned, Error> {
        let (quota, prune) = match half {
            Half::First(quota) => (quota, None),
            Half::Second(prune) => (None, prune.cloned()),
        };
        let collected = meeting.collected;
        let Some(block) = meeting.trains(layout, b) else {
            return Ok(Tuned { state: came(b)?, copies: 0, prune });
        };
        let mut config = of_block(&self.config, (block, b), self.photos.len());
        let until = match half {
            Half::First(_) => meetings(&config)[1],
            Half::Second(_) => config.schedule.iterations,
        };
        if let (Some(pruning), Some(quota)) = (&mut config.prune, quota) {
            pruning.compression.keep = Keep::Count(quota.max(1));
        }
        let (mut margin, mut others) = meeting.margin(layout, b);
        if quota.is_some() {
            others.append(&mut margin);
            others.sort_unstable();
        }
        let mut setup = self.setup(session, config, (block, &layout.exposures), output)?;
        let begin = |setup: &Setup<'_>| {
            let before = meeting.with(came, b, &margin)?;
            Ok(with_tail(&before, &collected.select(&setup.shown(collected, &others))))
        };
        let start = setup.start(output, (begin, prune.as_slice()))?;
        let mut run = ActiveRun::start(&setup, &setup.config, output, start)?;
        run.train(until)?;
        let Checkpoint { snapshot, notes } = run.checkpoint()?;
        let prune = notes.prunes.into_iter().next().map(PruneRecord::timeless);
        let copies = if matches!(half, Half::Second(_)) { margin.len() } else { 0 };
        Ok(Tuned { state: own(&snapshot, margin.len() - copies), copies, prune })
    }

    /// Figures of the joined model: those of `qirf-vk eval`.
    ///
    /// # Errors
    /// As of an evaluation.
    pub fn evaluate(&self, session: &Session<'_>, path: &Path, model: &Gaussians) -> Result<RunRecord, Error> {
        let RunConfig { style, exposure, .. } = self.config;
        let evaluation = Evaluation { selection: self.config.selection(), style, exposure };
        let mut record = eval(session, path, model, &evaluation, None)?;
        record.protocol.iterations = Some(self.config.schedule.iterations);
        record.protocol.seed = Some(self.config.seed);
        Ok(record)
    }

    /// The choice as a compression of the joined blocks by the run's photos.
    fn choice(&self) -> Result<(CompressConfig, &Pruning), Error> {
        let RunConfig { prune, style, seed, .. } = &self.config;
        let pruning = prune.as_ref().ok_or_else(|| Error::Usage("this run does not prune".to_owned()))?;
        let views = ViewSource::Photos(self.config.selection());
        let compression = pruning.compression.clone();
        Ok((CompressConfig { compression, views, style: *style, fine_tune: 0, seed: *seed }, pruning))
    }

    /// The setup of a block's run on the parts of photos that show it.
    fn setup<'a>(
        &self,
        session: &Session<'a>,
        config: RunConfig,
        (block, exposures): (&Block, &[f32]),
        output: &Output,
    ) -> Result<Setup<'a>, Error> {
        let begun = Instant::now();
        let opened = self.opened()?;
        let every: Vec<usize> = (0..opened.scene.views.len()).collect();
        let (extent, centre) = (opened.scene.extent(&every), opened.scene.centre(&every));
        let names: Vec<String> = block.crops.iter().map(|crop| self.photos[crop.view].clone()).collect();
        let mut prepared =
            opened.only(&names)?.load_to_train(session.photo_memory(output.folder()), session.watcher)?;
        let crops = prepared.train.iter().zip(&block.crops).map(|(photo, crop)| photo.part(crop.corner, crop.size));
        prepared.train = crops.collect::<std::io::Result<Vec<Photo>>>().map_err(crate::train::Error::Photos)?;
        prepared.extent = extent;
        let maps = block.crops.iter().filter_map(|crop| exposures.chunks_exact(exposure::SIZE).nth(crop.view));
        Ok(Setup {
            session: *session,
            prepared: Prepared { test: Vec::new(), ..prepared },
            estimated_bytes: 0,
            decisions: Vec::new(),
            exposures: Exposures::Known(maps.flatten().copied().collect()),
            cameras: Some(centre.as_vec3().to_array()),
            begun,
            load_s: begun.elapsed().as_secs_f64(),
            config,
        })
    }
}

impl Setup<'_> {
    /// The Gaussians among `rows` that the photos may show.
    fn shown(&self, model: &Gaussians, rows: &[usize]) -> Vec<usize> {
        let settings = self.config.style.over(self.prepared.background);
        let rows: Vec<u32> = rows.iter().map(|i| *i as u32).collect();
        let mut shown = vec![false; model.len()];
        for photo in &self.prepared.train {
            for i in visible(model, &rows, &photo.camera, &settings) {
                shown[i as usize] = true;
            }
        }
        (0..model.len()).filter(|i| shown[*i]).collect()
    }

    /// The checkpoint in `output`, if it is of this run; else what `begin` says, after these prunes.
    ///
    /// # Errors
    /// [`Error::Memory`] if the device has too little; a checkpoint that cannot be read; those of `begin`.
    fn start(
        &mut self,
        output: &Output,
        (begin, prunes): (impl FnOnce(&Self) -> Result<Snapshot, Error>, &[PruneRecord]),
    ) -> Result<Start, Error> {
        let Session { device, watcher, .. } = self.session;
        let checkpoint = if output.checkpoint().exists() {
            let checkpoint = Checkpoint::read(&output.checkpoint())?;
            watcher.note(&format!("resuming after iteration {}", checkpoint.snapshot.iteration));
            checkpoint
        } else {
            let snapshot = begin(self)?;
            let initial = snapshot.model.len() - snapshot.tail;
            let notes = Notes { config: self.config.written()?, initial, prunes: prunes.to_vec(), ..Notes::default() };
            Checkpoint { snapshot, notes }
        };
        self.estimated_bytes = budget::for_block(device, &self.config, &self.prepared, &checkpoint.snapshot)?;
        Ok(Start::Resumed(Box::new(checkpoint)))
    }
}
