//! Blocks of a real model, with random responses: the solvers agree, and their times are printed.

use super::Made;
use crate::support::shared;
use std::time::{Duration, Instant};

use qirf_vk::gaussians::formats;
use qirf_vk::qirf::CHANNELS;
use qirf_vk::qirf::batch::{Block, Collected, Solver};
use qirf_vk::qirf::dense::LIBRARIES;
use qirf_vk::qirf::normalise::rows;
use qirf_vk::qirf::participation::Eigensolver;
use qirf_vk::qirf::partition::Partition;
use qirf_vk::qirf::select::budget::{Budget, Keep, choose};
use qirf_vk::qirf::select::{Selector, rank};
use qirf_vk::random::uniform;
use qirf_vk::reference::overlap::{Primitive, block as overlaps};
use rayon::prelude::*;

const ETA: f64 = 0.75;
/// Number of blocks that every solver solves.
const SOLVED: usize = 250;

/// Responses over four orders of magnitude, a tenth of them zero.
fn descriptors(n: usize) -> Vec<[f32; CHANNELS]> {
    let value = |i: u64, c: u64| {
        let size = 4.0 * uniform(&[1, i]) + uniform(&[2, i, c]) - 5.0;
        if uniform(&[3, i]) < 0.1 { 0.0 } else { 10_f64.powf(size) as f32 }
    };
    (0..n as u64).map(|i| std::array::from_fn(|c| value(i, c as u64))).collect()
}

#[test]
fn real_blocks_keep_the_same_sets() {
    let Some(model) = shared("models/flowers_lod2_93k_sh2.ply") else { return };
    let model = formats::read(&model).unwrap().gaussians;
    let start = Instant::now();
    let made = Partition::ADAPTIVE.of(&model.means);
    let blocks = &made.blocks;
    println!("{} blocks in {:?}, {} rebinned, {} split", blocks.len(), start.elapsed(), made.rebinned, made.split);
    assert!(blocks.len() >= 1000);
    let start = Instant::now();
    let h = rows(&descriptors(model.len()), ETA);
    println!("normalised in {:?}", start.elapsed());

    let primitive = |&i: &u32| {
        let i = i as usize;
        Primitive::of(model.means[i], model.log_scales[i], model.rotations[i])
    };
    let overlap = |b: usize| -> Vec<f32> {
        let primitives: Vec<Primitive> = blocks.block(b).iter().map(primitive).collect();
        overlaps(&primitives).into_iter().map(|x| x as f32).collect()
    };
    let all: Vec<Vec<f32>> = (0..blocks.len()).into_par_iter().map(overlap).collect();
    let gathered = |members: &[u32]| members.iter().map(|&i| h[i as usize]).collect::<Vec<_>>();
    let made: Vec<Made> = blocks.iter().zip(&all).map(|(members, n)| Made::new(n, &gathered(members))).collect();

    let differs = |b: usize| {
        let m = blocks.block(b).len();
        let [full, low, single] = Eigensolver::HOST.map(|solver| made[b].solved(solver, LIBRARIES[0]));
        for (x, y) in full.spectrum.iter().zip(&low.spectrum) {
            assert!((x - y).abs() <= 1e-4 * low.spectrum[0].max(f64::MIN_POSITIVE), "block {b}: {x} and {y}");
        }
        let k = (m * 28).div_ceil(100);
        let kept = |q: &[f64]| rank(q).iter().map(|&place| (place as usize) < k).collect::<Vec<_>>();
        assert!(!low.canonical && !single.canonical, "block {b}");
        // A block keeps the same set with every library.
        for library in &LIBRARIES[1..] {
            for (solver, first) in Eigensolver::HOST.into_iter().zip([&full, &low, &single]) {
                let other = made[b].solved(solver, *library);
                let exact = solver != Eigensolver::LowRankF32;
                assert!(!exact || kept(&other.q) == kept(&first.q), "block {b} by {library:?}, {solver}");
            }
        }
        [&full, &single].map(|other| usize::from(kept(&other.q) != kept(&low.q)))
    };
    let differing: Vec<[usize; 2]> = (0..SOLVED).into_par_iter().map(differs).collect();
    let [full, single] = [0, 1].map(|k| differing.iter().map(|d| d[k]).sum::<usize>());
    println!("of {SOLVED} blocks' sets, {full} differ with P in float32, {single} with the metric in float32");
    assert!(full <= 2 && single <= 12);

    let batch: Vec<Block> = made
        .iter()
        .zip(blocks.iter())
        .map(|(made, members)| Block {
            matrices: made.matrices(),
            opacity: &model.opacity_logits[..members.len()],
            self_overlaps: None,
        })
        .collect();
    for selector in [Selector::Gnso, Selector::Ordinary, Selector::Lowdin, Selector::Css] {
        let solver = Solver { selectors: vec![selector], ..Solver::default() };
        let start = Instant::now();
        let solved = solver.solve(&batch);
        let took: Duration = start.elapsed();
        let mut collected = Collected::new(blocks, &solver.selectors);
        solved.iter().enumerate().for_each(|(b, solved)| collected.take(blocks, b, solved));
        let start = Instant::now();
        let choice = choose(blocks, &collected.rankings[0].1, &collected.r, Budget::Hybrid, Keep::Share(0.28), None);
        println!("{selector:?}: solved in {took:?}, chosen in {:?}", start.elapsed());
        assert_eq!(choice.kept(), (0.28 * model.len() as f64).round() as usize);
    }
}
