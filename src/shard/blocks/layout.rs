//! The layout of a scene in blocks: their cells, and the parts of photos that each trains on.

use super::members::inside;
use super::seen::{BlockVisibility, Seen};
use crate::gaussians::Gaussians;
use crate::scene::camera::Camera;
use crate::shard::kd_tree::Cells;
use serde::{Deserialize, Serialize};

/// Share of its sides by which a cell is grown for training.
pub const GROWN: f64 = 0.2;

/// A part of a photo.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Crop {
    /// The photo's number among the training photos.
    pub view: usize,
    /// Upper left corner in pixels.
    pub corner: [u32; 2],
    /// Width and height in pixels.
    pub size: [u32; 2],
}

/// A block of a scene.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Block {
    /// The parts of photos that it trains on, in the order of the photos.
    pub crops: Vec<Crop>,
    /// Contribution of the Gaussians in its grown cell, as a share of that of all Gaussians in the photos: 0..=1.
    pub painted: f64,
}

/// A scene's blocks.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Layout {
    /// The cells, which divide all of space.
    pub cells: Cells,
    /// One block for each cell.
    pub blocks: Vec<Block>,
    /// Pixels of all crops divided by those of all photos: the cost of the division.
    pub omega: f64,
    /// Exposures of the photos, twelve numbers each; empty if there are none.
    pub exposures: Vec<f32>,
}

impl Layout {
    /// The blocks of these cells, according to what the photos' cameras see of a model that fills them; without
    /// exposures. `weights` is the contribution of each of its Gaussians.
    ///
    /// # Panics
    /// If there is not one weight per Gaussian, or not one row of `seen` per camera.
    pub fn new(cells: Cells, model: &Gaussians, weights: &[f32], cameras: &[Camera], seen: &Seen) -> Self {
        assert_eq!(
            (model.len(), cameras.len()),
            (weights.len(), seen.len()),
            "one weight a Gaussian, one row a camera"
        );
        let sum = |rows: &mut dyn Iterator<Item = usize>| rows.map(|i| f64::from(weights[i].max(0.0))).sum::<f64>();
        let all = sum(&mut (0..model.len()));
        let block = |cell: usize| {
            let rows = inside(&cells, cell, GROWN, model);
            let painted = if all > 0.0 { sum(&mut rows.into_iter()) / all } else { 0.0 };
            Block { crops: crops(&cells, cell, cameras, seen), painted }
        };
        let blocks: Vec<Block> = (0..cells.count()).map(block).collect();
        let pixels = |[width, height]: [u32; 2]| f64::from(width) * f64::from(height);
        let of_crops: f64 = blocks.iter().flat_map(|b| &b.crops).map(|crop| pixels(crop.size)).sum();
        let of_photos: f64 = cameras.iter().map(|c| pixels([c.width, c.height])).sum();
        let omega = if of_photos > 0.0 { of_crops / of_photos } else { 0.0 };
        Self { cells, blocks, omega, exposures: Vec::new() }
    }

    /// A block's share of the light that no Gaussian contributes: the same for all blocks.
    pub(super) fn of_nothing(&self) -> f32 {
        1.0 / self.blocks.len().max(1) as f32
    }
}

/// The parts of photos that train the block of a cell.
fn crops(cells: &Cells, cell: usize, cameras: &[Camera], seen: &Seen) -> Vec<Crop> {
    let grown = cells.grown(cell, GROWN);
    let crop = |(view, (camera, shown)): (usize, (&Camera, &Vec<BlockVisibility>))| {
        let centre = camera.centre().as_vec3().to_array();
        let shown = shown[cell];
        let (corner, size) = shown.part?;
        shown.trains(grown.contains(centre)).then_some(Crop { view, corner, size })
    };
    cameras.iter().zip(seen).enumerate().filter_map(crop).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::shard::kd_tree::Contraction;
    use glam::DVec3;

    #[test]
    fn blocks_take_what_shows_them() {
        let mut model = Gaussians::zeroed(4, 0);
        for (i, mean) in model.means.iter_mut().enumerate() {
            *mean = [i as f32 - 1.5, 0.0, 0.0];
        }
        let around = Contraction::around([DVec3::splat(-2.0), DVec3::splat(2.0)]);
        let cells = Cells::new(around, &model.means, &[1.0; 4], 2);
        let camera = Camera::look_at(DVec3::new(0.0, 0.0, -9.0), DVec3::ZERO, DVec3::NEG_Y, 1.0, 64, 32);
        let shows = |share| BlockVisibility { share, part: Some(([16, 0], [32, 16])) };
        let none = BlockVisibility::default();
        let seen = vec![vec![shows(0.5), none], vec![shows(0.3), shows(0.4)], vec![none, shows(0.001)]];
        let cameras = [camera.clone(), camera.clone(), camera];
        let mut layout = Layout::new(cells, &model, &[1.0, 3.0, 2.0, 2.0], &cameras, &seen);
        layout.exposures = vec![1.0 / 3.0, 16_777_217.0, f32::MIN_POSITIVE / 3.0, -0.0];
        let views = |b: usize| layout.blocks[b].crops.iter().map(|crop| crop.view).collect::<Vec<_>>();
        assert_eq!((views(0), views(1)), (vec![0, 1], vec![1]));
        // The cut lies at the third Gaussian, which the grown first cell therefore contains.
        assert_eq!([layout.blocks[0].painted, layout.blocks[1].painted], [0.75, 0.5]);
        assert_eq!(layout.omega, 3.0 * 512.0 / (3.0 * 2048.0));
        let text = serde_json::to_string(&layout).unwrap();
        assert_eq!(serde_json::from_str::<Layout>(&text).unwrap(), layout);
    }
}
