//! Blending of blocks that also trained each other's margins: near a border each Gaussian is a mean of its copies.

use super::layout::{GROWN, Layout};
use super::meeting::Meeting;
use crate::gaussians::{Attributes, Gaussians};

/// The row of each of a block's Gaussians in the scene, and its weight there.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Copies {
    /// By Gaussian of the block: its row in the scene.
    pub rows: Vec<usize>,
    /// By Gaussian of the block: weight of this copy in the mean, 0..=1; the weights of a row's copies add up to 1.
    shares: Vec<f32>,
}

/// The copies of each block after it has trained its own Gaussians and its margin from a meeting on. A copy's weight is
/// the depth of its Gaussian in the block's grown cell: half at a border, zero where the margin ends.
pub fn copies(layout: &Layout, meeting: &Meeting) -> Vec<Copies> {
    let means = &meeting.collected.means;
    let trained = |b: usize| -> Vec<(usize, f64)> {
        let grown = layout.cells.grown(b, GROWN);
        meeting.trained_by(layout, b).into_iter().map(|row| (row, grown.depth(means[row]))).collect()
    };
    let blocks: Vec<Vec<(usize, f64)>> = (0..meeting.starts.len()).map(trained).collect();
    let mut sums = vec![0.0; means.len()];
    for (row, depth) in blocks.iter().flatten() {
        sums[*row] += depth;
    }
    let of_block = |(b, copies): (usize, Vec<(usize, f64)>)| {
        let own = meeting.rows(b);
        // A Gaussian outside all grown cells belongs to its own block.
        let share = |(row, depth): (usize, f64)| {
            let share = if sums[row] > 0.0 { depth / sums[row] } else { f64::from(own.contains(&row)) };
            (row, share as f32)
        };
        let (rows, shares) = copies.into_iter().map(share).unzip();
        Copies { rows, shares }
    };
    blocks.into_iter().enumerate().map(of_block).collect()
}

impl Copies {
    /// Adds the block's share to a scene that begins with zeros. Parameters are averaged in their stored form: the
    /// copies of a Gaussian are only a part of a run apart, and their quaternions have the same sign. A Gaussian with
    /// one copy equals that copy, to the bit.
    ///
    /// # Panics
    /// If the block does not have one Gaussian per row.
    pub fn add_to(&self, scene: &mut Gaussians, block: &Gaussians) {
        assert_eq!(block.len(), self.rows.len(), "one Gaussian a row");
        let widths = Attributes::widths(scene.degree());
        scene.attributes_mut().zip(block.attributes()).zip(widths).map(|((sums, values), width)| {
            // A band that one of the two lacks adds nothing.
            let (values, copies) = (values.chunks_exact(width.max(1)), self.rows.iter().zip(&self.shares));
            for ((row, share), values) in copies.zip(values).filter(|((_, share), _)| **share > 0.0) {
                let sums = &mut sums[row * width..(row + 1) * width];
                sums.iter_mut().zip(values).for_each(|(sum, value)| *sum += share * value);
            }
        });
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Random;
    use crate::shard::blocks::{Block, Crop};
    use crate::shard::kd_tree::{Cells, Contraction};
    use glam::DVec3;

    /// A scene of 300 Gaussians in two blocks; those of the first come first.
    fn scene() -> (Gaussians, Layout, [usize; 2]) {
        let mut r = Random(8);
        let mut model = Gaussians::zeroed(300, 1);
        for mean in &mut model.means {
            *mean = [r.within(-1.0, 1.0) as f32, r.within(-0.1, 0.1) as f32, 0.0];
        }
        for value in model.opacity_logits.iter_mut().chain(&mut model.sh[1]) {
            *value = r.within(-1.0, 1.0) as f32;
        }
        let around = Contraction::around([DVec3::splat(-1.0), DVec3::splat(1.0)]);
        let cells = Cells::new(around, &model.means, &[1.0; 300], 2);
        let (first, second): (Vec<usize>, Vec<usize>) = (0..300).partition(|i| cells.owner(model.means[*i]) == 0);
        let block = || Block { crops: vec![Crop { view: 0, corner: [0, 0], size: [8, 8] }], painted: 0.5 };
        let layout = Layout { cells, blocks: vec![block(), block()], omega: 1.0, exposures: Vec::new() };
        (model.select(&[&first[..], &second[..]].concat()), layout, [0, first.len()])
    }

    fn blended(of: &[Copies], blocks: &[Gaussians], n: usize) -> Gaussians {
        let mut scene = Gaussians::zeroed(n, 1);
        for (copies, block) in of.iter().zip(blocks) {
            copies.add_to(&mut scene, block);
        }
        scene
    }

    #[test]
    fn copies_near_a_border_are_averaged_and_others_stay() {
        let (model, layout, starts) = scene();
        let of = copies(&layout, &Meeting { collected: model.clone(), starts: starts.to_vec() });
        assert!(of.iter().all(|copies| (160..220).contains(&copies.rows.len())), "own rows and margins");
        let same: Vec<Gaussians> = of.iter().map(|copies| model.select(&copies.rows)).collect();
        let back = blended(&of, &same, 300);
        let off = |a: f32, b: f32| (a - b).abs() < 1e-6;
        assert!(back.sh[1].iter().zip(&model.sh[1]).all(|(a, b)| off(*a, *b)), "equal copies give the scene");
        // The second block has moved everything that it trains by one.
        let mut moved = same;
        for logit in &mut moved[1].opacity_logits {
            *logit += 1.0;
        }
        let scene = blended(&of, &moved, 300);
        let shift = |row: usize| scene.opacity_logits[row] - model.opacity_logits[row];
        let depth = |row: usize| layout.cells.grown(1, GROWN).depth(model.means[row]);
        let near = (0..300).filter(|row| (0.01..0.99).contains(&depth(*row))).collect::<Vec<_>>();
        assert!(near.len() > 30 && near.iter().all(|row| (0.0..1.0).contains(&shift(*row))));
        let deep = |row: &usize| layout.cells.grown(0, GROWN).depth(model.means[*row]) == 1.0 && depth(*row) == 0.0;
        assert!(
            (0..300).filter(deep).all(|row| scene.opacity_logits[row].to_bits() == model.opacity_logits[row].to_bits())
        );
        assert!((0..300).filter(|row| depth(*row) == 1.0).all(|row| shift(row) > 0.5));
        assert!((0..300).all(|row| off(scene.means[row][0], model.means[row][0])));
    }

    #[test]
    fn a_block_that_trains_nothing_has_its_own_rows_alone() {
        let (model, mut layout, starts) = scene();
        layout.blocks[1].crops.clear();
        let of = copies(&layout, &Meeting { collected: model.clone(), starts: starts.to_vec() });
        assert_eq!(of[1].rows, (starts[1]..300).collect::<Vec<_>>());
        let blocks: Vec<Gaussians> = of.iter().map(|copies| model.select(&copies.rows)).collect();
        let back = blended(&of, &blocks, 300);
        assert!(back.opacity_logits.iter().zip(&model.opacity_logits).all(|(a, b)| (a - b).abs() < 1e-6));
    }
}
