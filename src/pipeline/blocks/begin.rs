//! The beginning of a block's run: its parts of photos and its first Gaussians.

use super::layout::Block;
use super::run::BlockRun;
use crate::error::Error;
use crate::gaussians::Gaussians;
use crate::gaussians::cells::Grown;
use crate::pipeline::checkpoint::{Checkpoint, Notes};
use crate::pipeline::config::RunConfig;
use crate::pipeline::prepare::Prepared;
use crate::pipeline::records::PruneRecord;
use crate::pipeline::session::Session;
use crate::pipeline::setup::Setup;
use crate::pipeline::start::{self, Start};
use crate::pipeline::{Output, budget};
use crate::render::visible;
use crate::scene::{Photo, Point};
use crate::train::checkpoint::Snapshot;
use crate::train::exposure;
use crate::train::initialise::{self, Seed};
use crate::train::{self, Exposures};
use std::time::Instant;

/// A cell begins with the coarse model if that has more than so many Gaussians in it for each point.
const FEW: usize = 10;

/// The Gaussians that a block's training begins with, of those in its grown cell: the capture's points, at most `most` of them; `coarse`,
/// those of the coarse model, where there are few points. Points lead to better test photos (docs/decisions.md).
pub(super) fn first(points: &[Point], grown: &Grown<'_>, coarse: Gaussians, most: usize) -> Gaussians {
    let seeds: Vec<Seed> = points.iter().map(Seed::from).collect();
    let inside = |i: &usize| grown.contains(seeds[*i].position.as_vec3().to_array());
    let rows: Vec<usize> = (0..seeds.len()).filter(inside).collect();
    if rows.len() * FEW < coarse.len() {
        return coarse;
    }
    // A Gaussian's size follows from its nearest points, which may lie outside the cell.
    let on_points = initialise::from_points(&seeds).select(&start::evenly(&rows, most));
    // In all bands at once, as the coarse model is.
    let mut model = Gaussians::zeroed(0, coarse.degree());
    model.append(&on_points);
    model
}

impl BlockRun {
    /// The setup of a block's run on the parts of photos that show it.
    pub(super) fn setup<'a>(
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
        prepared.train = crops.collect::<std::io::Result<Vec<Photo>>>().map_err(train::Error::Photos)?;
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
    pub(super) fn shown(&self, model: &Gaussians, rows: &[usize]) -> Vec<usize> {
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
    pub(super) fn start(
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::gaussians::cells::{Cells, Contraction};
    use glam::DVec3;

    #[test]
    fn blocks_begin_with_points_where_there_are_enough() {
        let point = |i: usize| Point {
            position: DVec3::new(i as f64 - 50.0, 0.0, 0.0),
            colour: [9; 3],
            error: 0.0,
            track: Vec::new(),
        };
        let points: Vec<Point> = (0..100).map(point).collect();
        let mut coarse = Gaussians::zeroed(100, 2);
        for (mean, point) in coarse.means.iter_mut().zip(&points) {
            *mean = point.position.as_vec3().to_array();
        }
        let around = Contraction::around([DVec3::splat(-50.0), DVec3::splat(50.0)]);
        let cells = Cells::new(around, &coarse.means, &[1.0; 100], 2);
        let grown = cells.grown(0, 0.2);
        let inside = |points: &[Point]| {
            points
                .iter()
                .map(|p| p.position.as_vec3().to_array())
                .filter(|mean| grown.contains(*mean))
                .collect::<Vec<_>>()
        };
        let model = first(&points, &grown, coarse.clone(), usize::MAX);
        assert!(model.len() > 50 && model.means == inside(&points), "{}", model.len());
        assert!(model.degree() == 2 && model.validate().is_ok());
        // Points beyond the cell are neighbours, too: all have the same distance to the nearest.
        let all_equal = model.log_scales[1..].iter().all(|scale| scale == &model.log_scales[1]);
        assert!(all_equal, "{:?}", model.log_scales);
        assert_eq!(first(&points, &grown, coarse.clone(), 20).len(), 20);

        let few = &points[..inside(&points).len() / 11];
        assert!(first(few, &grown, coarse.select(&[3, 4]), usize::MAX).len() == few.len());
        let coarse = coarse.select(&(0..99).collect::<Vec<_>>());
        assert!(first(few, &grown, coarse.clone(), usize::MAX) == coarse);
    }
}
