//! The Gaussians of a block: those that it trains, those that it only sees, and those that it passes on.

use crate::gaussians::{Attributes, Gaussians};
use crate::shard::kd_tree::Cells;
use crate::train::checkpoint::Snapshot;
use std::ops::Range;

/// The rows of `model` in a cell that is grown by `share` of its sides, rising: those that the cell's block trains.
pub(super) fn inside(cells: &Cells, cell: usize, share: f64, model: &Gaussians) -> Vec<usize> {
    let grown = cells.grown(cell, share);
    (0..model.len()).filter(|i| grown.contains(model.means[*i])).collect()
}

/// A state before any iteration; the last `tail` Gaussians never change.
pub(super) fn beginning(model: Gaussians, tail: usize) -> Snapshot {
    let moments = Attributes::widths(model.degree()).map(|width| vec![0.0; 2 * width * (model.len() - tail)]);
    Snapshot { tail, moments, growth: vec![0.0; 2 * model.len()], model, ..Snapshot::default() }
}

/// The rows before the tail.
fn trained(snapshot: &Snapshot) -> Range<usize> {
    0..snapshot.model.len() - snapshot.tail
}

/// Selects these rows of a state with their moments. The tail, exposures and a method's arrays are dropped; growth and
/// averaged responses restart.
///
/// # Panics
/// If a row belongs to the tail.
pub(super) fn select(snapshot: &Snapshot, rows: &[usize]) -> Snapshot {
    let widths = Attributes::widths(snapshot.model.degree());
    let moments = widths.zip(snapshot.moments.each_ref()).map(|(width, moments)| {
        rows.iter().flat_map(|i| &moments[2 * width * i..2 * width * (i + 1)]).copied().collect()
    });
    Snapshot {
        iteration: snapshot.iteration,
        skipped_rows: snapshot.skipped_rows,
        model: snapshot.model.select(rows),
        moments,
        growth: vec![0.0; 2 * rows.len()],
        state: snapshot.state,
        notes: snapshot.notes.clone(),
        ..Snapshot::default()
    }
}

/// The rows that a block passes on before the first meeting: the trained ones that its cell owns, in their order. A row
/// in a neighbour's cell is passed on by that neighbour.
pub fn owned(snapshot: &Snapshot, cells: &Cells, cell: usize) -> Snapshot {
    let rows: Vec<usize> = trained(snapshot).filter(|i| cells.owner(snapshot.model.means[*i]) == cell).collect();
    select(snapshot, &rows)
}

/// The rows that a block passes on after a meeting: its trained ones except the last `margin`, wherever they lie.
pub(super) fn own(snapshot: &Snapshot, margin: usize) -> Snapshot {
    select(snapshot, &(0..trained(snapshot).end - margin).collect::<Vec<_>>())
}

/// A block without a tail, with rows of a neighbour behind its own, all of them trained.
pub(super) fn with_margin(mut block: Snapshot, margin: &Snapshot) -> Snapshot {
    block.model.append(&margin.model);
    block.moments = block.moments.zip(margin.moments.each_ref()).map(|(own, more)| [&own[..], more].concat());
    block.growth.extend(&margin.growth);
    block
}

/// The state with which a block resumes, with these neighbours as its tail.
///
/// # Panics
/// If the neighbours have more bands than the block's model.
pub fn with_tail(block: &Snapshot, neighbours: &Gaussians) -> Snapshot {
    assert!(neighbours.sh.len() <= block.model.sh.len(), "bands that the block lacks");
    let mut alone = own(block, 0);
    alone.model.append(neighbours);
    alone.growth = vec![0.0; 2 * alone.model.len()];
    Snapshot { tail: neighbours.len(), exposures: block.exposures.clone(), ..alone }
}

/// The scene of all blocks' own Gaussians, in the order of the blocks, and the first row of each block in it.
pub fn joined<'a>(blocks: impl IntoIterator<Item = &'a Snapshot>) -> (Gaussians, Vec<usize>) {
    let (mut scene, mut starts) = (Gaussians::default(), Vec::new());
    for block in blocks {
        starts.push(scene.len());
        scene.append(&block.model.select(&trained(block).collect::<Vec<_>>()));
    }
    (scene, starts)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::Random;
    use crate::shard::kd_tree::Contraction;
    use glam::DVec3;

    fn model(n: usize, degree: usize) -> Gaussians {
        let mut r = Random(5);
        let mut model = Gaussians::zeroed(n, degree);
        for (i, mean) in model.means.iter_mut().enumerate() {
            *mean = [r.within(-4.0, 4.0) as f32, r.within(-1.0, 1.0) as f32, 0.0];
            model.opacity_logits[i] = i as f32;
        }
        model.means[7] = [f32::NAN; 3];
        model
    }

    fn cells(model: &Gaussians) -> Cells {
        let around = Contraction::around([DVec3::splat(-4.0), DVec3::splat(4.0)]);
        Cells::new(around, &model.means, &vec![1.0; model.len()], 4)
    }

    fn snapshot(model: Gaussians, tail: usize) -> Snapshot {
        let (trained, widths) = (model.len() - tail, Attributes::widths(model.degree()));
        let rows = |width: usize| (0..trained).flat_map(|i| vec![i as f32; 2 * width]).collect();
        let growth = vec![1.0; 2 * model.len()];
        Snapshot { iteration: 9, moments: widths.map(rows), growth, ..beginning(model, tail) }
    }

    /// Whatever the blocks train in their margins, together they pass on every Gaussian once, with its own moments.
    #[test]
    fn blocks_hand_everything_on_once() {
        let whole = model(200, 1);
        let cells = cells(&whole);
        let (mut handed, mut blocks) = (Vec::new(), Vec::new());
        for cell in 0..cells.count() {
            let rows = inside(&cells, cell, 0.2, &whole);
            let others: Vec<usize> = (0..200).filter(|i| !rows.contains(i)).collect();
            let trained = rows.len();
            assert_eq!(trained + others.len(), 200);
            assert!(trained > 40 && trained < 120, "{trained}");
            let state = snapshot(whole.select(&[&rows[..], &others[..]].concat()), others.len());
            let kept = owned(&state, &cells, cell);
            assert!(kept.tail == 0 && kept.model.len() < trained && kept.iteration == 9);
            for (row, logit) in kept.model.opacity_logits.iter().enumerate() {
                let before = rows.iter().position(|i| *i as f32 == *logit).unwrap() as f32;
                let at = |width: usize, moments: &[f32]| moments[2 * width * row..2 * width * (row + 1)].to_vec();
                assert_eq!(at(3, &kept.moments.means), [before; 6]);
                assert_eq!(at(9, &kept.moments.sh[1]), [before; 18]);
            }
            handed.extend(kept.model.opacity_logits.iter().map(|logit| *logit as usize));
            blocks.push(kept);
        }
        let (scene, starts) = joined(&blocks);
        assert_eq!(scene.len(), 200);
        assert!(scene.opacity_logits.iter().map(|logit| *logit as usize).eq(handed.iter().copied()));
        assert!((0..4).all(|b| scene.means[starts[b]] == blocks[b].model.means[0]));
        handed.sort_unstable();
        assert_eq!(handed, (0..200).collect::<Vec<_>>());
    }

    /// A margin that is trained behind a block's rows has its own moments, and is not passed on.
    #[test]
    fn a_margin_comes_and_goes() {
        let (state, neighbour) = (snapshot(model(20, 1), 0), snapshot(model(30, 1), 0));
        let margin = select(&neighbour, &[3, 29]);
        let both = with_tail(&with_margin(state.clone(), &margin), &model(8, 0));
        assert_eq!((both.model.len(), both.tail, both.growth.len()), (30, 8, 60));
        assert_eq!(both.model.opacity_logits[19..23], [19.0, 3.0, 29.0, 0.0]);
        assert_eq!(both.moments.sh[1].len(), 22 * 18);
        assert_eq!(both.moments.rotations[160..], [[3.0; 8], [29.0; 8]].concat());
        let back = own(&both, 2);
        assert_eq!(back.moments, state.moments);
        assert_eq!((back.model.opacity_logits, back.tail), (state.model.opacity_logits, 0));
    }

    #[test]
    fn a_tail_takes_the_place_of_another() {
        let state = snapshot(model(20, 1), 5);
        let other = model(8, 0);
        let new = with_tail(&state, &other);
        assert_eq!((new.model.len(), new.tail, new.growth.len()), (23, 8, 46));
        assert!(new.model.validate().is_ok() && new.moments == state.moments);
        assert_eq!(new.model.opacity_logits[14..17], [14.0, 0.0, 1.0]);
        assert_eq!(new.model.sh[1].len(), 23 * 9);
    }
}
