//! Beginning of a block's run: its parts of photos, and its checkpoint.

use super::layout::Block;
use super::members::with_tail;
use super::run::BlockRun;
use crate::gaussians::Gaussians;
use crate::job::records::PruneRecord;
use crate::job::{Error, Init, Output, RunConfig, Session, Silent};
use crate::pipeline::budget;
use crate::pipeline::checkpoint::{Checkpoint, RunNotes};
use crate::pipeline::prepare::{Prepared, open_to_train};
use crate::pipeline::setup::Setup;
use crate::pipeline::start::Start;
use crate::render::visible;
use crate::scene::Photo;
use crate::train::checkpoint::Snapshot;
use crate::train::{self, Exposures, exposure};
use std::collections::HashSet;
use std::time::Instant;

impl BlockRun {
    /// The setup of a block's run on the parts of photos that show it.
    pub(super) fn setup<'a>(
        &self,
        session: &Session<'a>,
        config: RunConfig,
        block: &Block,
        exposures: &[f32],
        output: &Output,
    ) -> Result<Setup<'a>, Error> {
        let begun = Instant::now();
        let opened = match self.config.init {
            // Without near copies, as the plan counts them.
            Init::Points => open_to_train(&self.selection())?.only(&self.photos)?,
            Init::Random | Init::Model(_) => self.opened()?,
        };
        let every: Vec<usize> = (0..opened.scene.views.len()).collect();
        let (extent, centre) = (opened.scene.extent(&every), opened.scene.centre(&every));
        let names: Vec<String> = block.crops.iter().map(|crop| self.photos[crop.view].clone()).collect();
        let mut prepared = opened
            .only(&names)?
            .with_depths(&Silent)
            .load_to_train(session.photo_memory(output.folder()), session.watcher)?
            .in_usual_unit();
        let crops = prepared.train.iter().zip(&block.crops).map(|(photo, crop)| photo.part(crop.corner, crop.size));
        prepared.train = crops.collect::<std::io::Result<Vec<Photo>>>().map_err(train::Error::Photos)?;
        prepared.extent = extent / self.unit;
        let maps = block.crops.iter().filter_map(|crop| exposures.chunks_exact(exposure::SIZE).nth(crop.view));
        Ok(Setup {
            session: *session,
            prepared: Prepared { test: Vec::new(), ..prepared },
            estimated_bytes: 0,
            trial: None,
            decisions: Vec::new(),
            exposures: Exposures::Known(maps.flatten().copied().collect()),
            cameras: Some((centre / self.unit).as_vec3().to_array()),
            begun,
            earlier_s: 0.0,
            load_s: begun.elapsed().as_secs_f64(),
            start_s: 0.0,
            config,
        })
    }
}

impl Setup<'_> {
    /// The Gaussians among `rows` that the photos may show.
    pub(super) fn shown(&self, model: &Gaussians, rows: &[usize]) -> Vec<usize> {
        let settings = self.prepared.settings(self.config.style);
        let rows: Vec<u32> = rows.iter().map(|i| *i as u32).collect();
        let mut shown = vec![false; model.len()];
        for photo in &self.prepared.train {
            for i in visible(model, &rows, &photo.camera, &settings) {
                shown[i as usize] = true;
            }
        }
        (0..model.len()).filter(|i| shown[*i]).collect()
    }

    /// The checkpoint in `output`, if there is one. Otherwise the state that `before` gives for these rows of the scene,
    /// with the other rows frozen, after this prune if there was one.
    pub(super) fn start(
        &mut self,
        scene: &Gaussians,
        rows: &[usize],
        before: impl FnOnce(&Self) -> Result<Snapshot, Error>,
        prune: Option<PruneRecord>,
        output: &Output,
    ) -> Result<Start, Error> {
        let Session { device, watcher, .. } = self.session;
        let checkpoint = if output.checkpoint().exists() {
            let checkpoint = Checkpoint::read(&output.checkpoint())?;
            watcher.note(&format!("resuming after iteration {}", checkpoint.snapshot.iteration));
            checkpoint
        } else {
            let trained: HashSet<usize> = rows.iter().copied().collect();
            let others: Vec<usize> = (0..scene.len()).filter(|i| !trained.contains(i)).collect();
            let snapshot = with_tail(&before(self)?, &scene.select(&self.shown(scene, &others)));
            let initial = snapshot.model.len() - snapshot.tail;
            let prunes = prune.into_iter().collect();
            let notes = RunNotes { config: self.config.written()?, initial, prunes, ..RunNotes::default() };
            Checkpoint { snapshot, notes }
        };
        self.estimated_bytes = budget::for_block(device, &self.config, &self.prepared, &checkpoint.snapshot)?;
        Ok(Start::Resumed(Box::new(checkpoint)))
    }
}
