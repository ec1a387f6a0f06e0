//! Training a scene in blocks, stage by stage: a coarse model of the whole scene, its division, each block up to the
//! prune, one choice among all Gaussians, and each block from one meeting to the next and to its end.

use super::derived::{check, coarse, ends, of_block};
use super::first::first;
use super::layout::{GROWN, Layout};
use super::meeting::{Came, Meeting};
use super::members::{beginning, inside, own, owned};
use super::seen::seen;
use crate::effects::{Choice, Effect, Told};
use crate::gaussians::Gaussians;
use crate::gaussians::resident::Resident;
use crate::job::config::Pruning;
use crate::job::output::absolute;
use crate::job::records::PruneRecord;
use crate::job::{Error, Init, Output, RunConfig, Selection, Session};
use crate::pipeline::active_run::ActiveRun;
use crate::pipeline::checkpoint::Checkpoint;
use crate::pipeline::compress::{CompressConfig, ViewSource, stages};
use crate::pipeline::prepare::{Opened, all_there, contents, open, open_to_train, unchanged};
use crate::pipeline::prune::PrunePlan;
use crate::pipeline::setup::Setup;
use crate::pipeline::start::Start;
use crate::pipeline::{budget, effects, virtual_views};
use crate::qirf::select::budget::Keep;
use crate::response::{CHUNK, Responses, Wanted};
use crate::scene::camera::{self, Camera};
use crate::scene::{AlphaRole, Skipped};
use crate::shard::kd_tree::{Cells, Contraction};
use crate::train::Exposures;
use crate::train::checkpoint::Snapshot;
use crate::train::growth::Growth;
use serde::{Deserialize, Serialize};
use std::collections::BTreeMap;

/// Largest sides of photos beyond which the coarse model uses them at half and at a quarter of their size.
const LARGE: [u32; 2] = [256, 1024];

/// Factor by which the sides of photos are divided for the coarse model.
fn divisor(largest: [u32; 2]) -> u32 {
    1 << LARGE.iter().filter(|least| largest.iter().max() >= Some(*least)).count()
}

/// A run in blocks: everything that its results depend on.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct BlockRun {
    /// The run, with the decisions on its effects and the planned number of Gaussians.
    pub config: RunConfig,
    /// Number of blocks.
    pub blocks: usize,
    /// Names of the training photos.
    pub photos: Vec<String>,
    /// Names of the photos held out.
    pub held_out: Vec<String>,
    /// CRC-32 of each photo's files and camera, by name.
    pub contents: BTreeMap<String, u32>,
    /// Largest width and height among these photos.
    pub image_size: [u32; 2],
    /// Parts of the scene that its readers left out.
    pub skipped: Skipped,
    /// Local origin of the scene's coordinates.
    pub origin: [f64; 3],
    /// Unit of length of training and of the models before the joined one, in units of the scene.
    pub unit: f64,
}

/// A block after a meeting.
pub struct BlockState {
    /// Its Gaussians with their moments; after the second meeting followed by its copies of its neighbours' Gaussians.
    pub state: Snapshot,
    /// Number of these copies.
    pub copies: usize,
    /// Its prune, if it had one. Times are left out: they differ between processes.
    pub prune: Option<PruneRecord>,
}

/// A leg of a block's training, from one meeting to the next or to the end.
pub struct Leg<'a> {
    /// All blocks.
    pub layout: &'a Layout,
    /// The block's number.
    pub b: usize,
    /// The meeting whose Gaussians it trains: the first in the first leg, the second in the others.
    pub meeting: &'a Meeting,
    /// The leg's number: 1 from the first meeting to the second, 2 to the third, 3 to the end.
    pub(in crate::shard) number: usize,
    /// Number of Gaussians that it prunes to; only the first leg prunes.
    pub quota: Option<usize>,
    /// The block's prune in an earlier leg.
    pub prune: Option<PruneRecord>,
    /// Returns a block's state before the leg.
    pub came: Came<'a>,
    /// The scene of the blocks' blended copies, if the leg begins with it in place of the meeting's Gaussians.
    pub blended: Option<&'a Gaussians>,
}

impl BlockRun {
    /// Plans a run in blocks: reads the scene, decides on its effects, and fixes everything that tasks must agree on.
    /// Without a number of blocks, uses as many as are needed for each to fit the device.
    ///
    /// # Errors
    /// Errors of reading a scene; no photo to train on; [`Error::Usage`] for a run that cannot be divided.
    pub fn plan(session: &Session<'_>, config: &RunConfig, blocks: Option<usize>) -> Result<Self, Error> {
        check(config)?;
        let mut config = config.clone();
        // Blocks would each move the cameras that they share.
        config.effects.set(Effect::Poses, Choice::Off);
        // Blocks start from a coarse model, which would have a sky, and from the points of their own cells, which have none.
        config.effects.set(Effect::Sky, Choice::Off);
        // A block's length and photos say nothing of the whole run's.
        if config.effects.forced(Effect::Dropout).is_none() {
            config.effects.set(Effect::Dropout, Choice::Off);
        }
        config.respell(absolute);
        let opened = open_to_train(&config.selection())?.with_depths(session.watcher);
        let pixels = opened.train_pixels();
        let start = Start::of(&config, &opened.scene, pixels.iter().copied().max().unwrap_or(0), session.watcher)?;
        let (initial, degree) = (start.len(), start.degree());
        if let (Init::Points, Some(note)) = (&config.init, opened.scene.lacks_points()) {
            session.watcher.lost(&note);
            config.init = Init::Random;
        }
        drop(start);
        let mut prepared = opened.load_to_train(session.photo_memory(&std::env::temp_dir()), session.watcher)?;
        let (Told { mut decisions, .. }, advice) = effects::decide(&prepared, &config)?;
        prepared.note(advice, session.watcher);
        effects::keep_bands(&mut decisions, degree);
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
        schedule.growth = schedule.growth.map(|plan| {
            let plan = plan.for_photos(&pixels, schedule.iterations);
            // A scene of more points than the plan asks for keeps them.
            Growth { gaussians: plan.gaussians.map(|n| n.max(initial)), ..plan }
        });
        let photos = prepared.names_to_train();
        let held_out = prepared.test.iter().map(|(name, _)| name.clone()).collect();
        let blocks = match blocks {
            Some(blocks) => blocks,
            None => budget::blocks(session.device, &config, &prepared, initial)?,
        };
        let image_size = camera::largest(prepared.views().map(|view| &view.camera));
        config.effects.keep_alpha(AlphaRole::of(prepared.views()));
        let contents = contents(&prepared.scene)?;
        let (origin, unit) = (prepared.scene.origin.to_array(), prepared.scene.use_usual_unit());
        let skipped = prepared.scene.skipped;
        Ok(Self { config, blocks, photos, held_out, contents, image_size, skipped, origin, unit })
    }

    /// Number of chunks of photos for responses; 0 without a prune.
    pub fn chunks(&self) -> usize {
        if self.config.prune.is_some() { self.photos.len().div_ceil(CHUNK) } else { 0 }
    }

    /// The scene with its training photos alone, not decoded.
    pub(super) fn opened(&self) -> Result<Opened, Error> {
        open(&self.selection())?.only(&self.photos)
    }

    /// The scene's pictures, of photos that have not changed.
    pub(super) fn selection(&self) -> Selection {
        Selection { contents: self.contents.clone(), ..self.config.selection() }
    }

    /// A coarse model of the whole scene, by a short run on small pictures. It continues from the checkpoint in
    /// `output`, if there is one.
    pub fn coarse(&self, session: &Session<'_>, output: &Output) -> Result<Snapshot, Error> {
        let opened = self.opened()?;
        unchanged(&opened.scene, &self.contents)?;
        let points = self.config.init == Init::Points;
        let config = coarse(&self.config, divisor(opened.size()), points);
        let (setup, start) = Setup::load(session, &config, output, output.checkpoint().exists())?;
        all_there(&setup.prepared.scene, &self.photos)?;
        Ok(train_until(&setup, start, setup.config.schedule.iterations, output)?.0)
    }

    /// The blocks of the scene, from pictures of a coarse model in the size that it was trained on.
    pub fn assign(&self, session: &Session<'_>, coarse: &Snapshot) -> Result<Layout, Error> {
        let Snapshot { model: coarse, exposures: (exposures, _), .. } = coarse;
        let mut opened = self.opened()?;
        opened.scene.use_usual_unit();
        let (cameras, divisor) = (opened.cameras(), divisor(opened.size()));
        let smaller = |c: &Camera| c.resized((c.width / divisor).max(1), (c.height / divisor).max(1));
        let small: Vec<Camera> = cameras.iter().map(smaller).collect();
        let settings = opened.settings(self.config.style, self.config.background);
        let resident = Resident::upload(session.device, coarse)?;
        let scores = virtual_views::responses(session, &resident, &small, None, settings, Wanted::SCORES)?.scores;
        drop(resident);
        let weights: Vec<f32> = scores.iter().map(|score| score.contribution).collect();
        let around = Contraction::around(cameras.iter().map(Camera::centre));
        let cells = Cells::new(around, &coarse.means, &weights, self.blocks);
        let seen = seen(session, coarse, &cells, &cameras, &small, settings)?;
        Ok(Layout { exposures: exposures.clone(), ..Layout::new(cells, coarse, &weights, &cameras, &seen) })
    }

    /// Trains block number `b` up to the prune, with the coarse model in place of the other blocks, and returns its own
    /// Gaussians with their moments. It continues from the checkpoint in `output`, if there is one.
    pub fn dense(
        &self,
        session: &Session<'_>,
        layout: &Layout,
        b: usize,
        coarse: &Gaussians,
        output: &Output,
    ) -> Result<Snapshot, Error> {
        let Some(block) = layout.blocks.get(b) else { return Ok(beginning(Gaussians::default(), 0)) };
        // A short run of the coarse model ends before it has all bands.
        let mut full = Gaussians::zeroed(0, self.config.sh_degree);
        full.append(coarse);
        let coarse = &full;
        let rows = inside(&layout.cells, b, GROWN, coarse);
        if rows.is_empty() || block.crops.is_empty() {
            return Ok(owned(&beginning(coarse.select(&rows), 0), &layout.cells, b));
        }
        let config = of_block(&self.config, block, b, self.photos.len());
        let mut setup = self.setup(session, config, block, &layout.exposures, output)?;
        setup.take_share(coarse, &rows, layout.of_nothing())?;
        let before = |setup: &Setup<'_>| {
            let (points, grown) = (&setup.prepared.scene.points, layout.cells.grown(b, GROWN));
            let of_coarse = coarse.select(&rows);
            let first = match self.config.init {
                Init::Points => first(points, setup.prepared.unit(), &grown, of_coarse, setup.config.max_gaussians),
                Init::Random | Init::Model(_) => of_coarse,
            };
            Ok(beginning(first, 0))
        };
        let start = setup.start(coarse, &rows, before, None, output)?;
        let (snapshot, _) = train_until(&setup, start, ends(&setup.config)[0], output)?;
        Ok(owned(&snapshot, &layout.cells, b))
    }

    /// Responses of a chunk of photos to the Gaussians of all blocks.
    pub fn evidence(
        &self,
        session: &Session<'_>,
        collected: &Gaussians,
        layout: &Layout,
        chunk: usize,
    ) -> Result<Responses, Error> {
        let (config, _) = self.choice()?;
        let exposures = self.config.exposure.then(|| Exposures::Known(layout.exposures.clone()));
        stages::evidence(session, &collected.scaled(self.unit), &config, chunk, &self.photos, exposures)
    }

    /// The number of Gaussians of each block that a choice among all of them keeps, by the responses of all chunks in
    /// their order.
    pub fn choose(
        &self,
        session: &Session<'_>,
        meeting: &Meeting,
        chunks: impl Iterator<Item = Result<Responses, Error>>,
    ) -> Result<(PruneRecord, Vec<usize>), Error> {
        let (config, _) = self.choice()?;
        let PrunePlan { record, keep, .. } =
            stages::choose(session, &meeting.collected.scaled(self.unit), &config, &self.photos, chunks)?;
        let quota = |b: usize| keep[meeting.rows(b)].iter().filter(|kept| **kept).count();
        let record = PruneRecord { iteration: ends(&self.config)[0], ..record.timeless() };
        Ok((record, (0..meeting.starts.len()).map(quota).collect()))
    }

    /// Trains a block to the end of a leg, with the Gaussians of the others frozen. With a quota, the block prunes to
    /// that many Gaussians; without one, it also trains other blocks' Gaussians that lie in its grown cell, since each
    /// side of a border expects what the other does. From the second leg on it passes these on behind its own, as
    /// copies for [`copies`](super::copies). It continues from the checkpoint in `output`, if there is one.
    pub fn train(&self, session: &Session<'_>, leg: Leg<'_>, output: &Output) -> Result<BlockState, Error> {
        let Leg { layout, b, meeting, number, quota, prune, came, blended } = leg;
        let rows: Vec<usize> = if quota.is_some() { meeting.rows(b).collect() } else { meeting.trained_by(layout, b) };
        let before = || match blended {
            Some(blended) => came(b).map(|state| Snapshot { model: blended.select(&rows), ..state }),
            None => meeting.with(came, b, &rows),
        };
        let Some(block) = meeting.trains(layout, b) else {
            return Ok(BlockState { state: before()?, copies: 0, prune });
        };
        let mut config = of_block(&self.config, block, b, self.photos.len());
        if let (Some(pruning), Some(quota)) = (&mut config.prune, quota) {
            pruning.compression.keep = Keep::Count(quota.max(1));
        }
        let mut setup = self.setup(session, config, block, &layout.exposures, output)?;
        if number == 1 {
            setup.take_share(&meeting.collected, &rows, layout.of_nothing())?;
        }
        let scene = blended.unwrap_or(&meeting.collected);
        let start = setup.start(scene, &rows, |_| before(), prune, output)?;
        let (snapshot, prune) = train_until(&setup, start, ends(&setup.config)[number], output)?;
        let margin = rows.len() - meeting.rows(b).len();
        let (dropped, copies) = if number == 1 { (margin, 0) } else { (0, margin) };
        Ok(BlockState { state: own(&snapshot, dropped), copies, prune })
    }

    /// The number of Gaussians that the undivided run grows to, if it has a plan.
    fn planned(&self) -> Option<usize> {
        self.config.schedule.growth?.gaussians.map(|n| n.min(self.config.max_gaussians))
    }

    /// The choice as a compression of the joined blocks by the run's photos.
    fn choice(&self) -> Result<(CompressConfig, &Pruning), Error> {
        let RunConfig { prune, style, exposure, seed, .. } = &self.config;
        let pruning = prune.as_ref().ok_or_else(|| Error::Usage("this run does not prune".to_owned()))?;
        let views = ViewSource::Photos(self.config.selection());
        let mut compression = pruning.compression.clone();
        if let (Keep::Share(share), Some(planned)) = (compression.keep, self.planned()) {
            // Together, blocks may grow to slightly more or fewer Gaussians than the undivided run.
            compression.keep = Keep::Count((share * planned as f64).round().max(1.0) as usize);
        }
        let (style, exposure, seed) = (*style, *exposure, *seed);
        Ok((CompressConfig { compression, views, style, exposure, fine_tune: 0, seed }, pruning))
    }
}

/// Trains up to this iteration. Returns the state and the prune, if there has been one.
fn train_until(
    setup: &Setup<'_>,
    start: Start,
    until: u32,
    output: &Output,
) -> Result<(Snapshot, Option<PruneRecord>), Error> {
    let mut run = ActiveRun::start(setup, &setup.config, output, start)?;
    run.train(until)?;
    let Checkpoint { snapshot, notes } = run.checkpoint()?;
    Ok((snapshot, notes.prunes.into_iter().next().map(PruneRecord::timeless)))
}
