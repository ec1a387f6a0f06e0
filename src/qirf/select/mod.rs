//! Selection: from scores to ranks, and from ranks to a keep mask.
//!
//! Scores are compared after rounding to 12 bits of mantissa, then by index, so that the last bits never decide.

pub mod budget;
pub mod css;
pub mod detail;
pub mod merge;
mod selector;

use rayon::prelude::*;

pub use selector::{Selector, Statistics};

use super::partition::Blocks;

/// The order of a block or of the scene by one selector, n each.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Ranking {
    /// Rank of each Gaussian in its block; 0 is the first to keep.
    pub rank: Vec<u32>,
    /// Value of each Gaussian, comparable across blocks.
    pub gain: Vec<f64>,
}

impl Ranking {
    /// The order by one score per Gaussian (n), within blocks and across them.
    pub fn by_score(blocks: &Blocks, score: &[f64]) -> Self {
        let mut ranks = vec![0; score.len()];
        let of_block = |members: &[u32]| rank(&members.iter().map(|&i| score[i as usize]).collect::<Vec<_>>());
        let by_block: Vec<Vec<u32>> = (0..blocks.len()).into_par_iter().map(|b| of_block(blocks.block(b))).collect();
        for (members, block) in blocks.iter().zip(by_block) {
            members.iter().zip(block).for_each(|(&i, r)| ranks[i as usize] = r);
        }
        Self { rank: ranks, gain: score.to_vec() }
    }
}

/// A score rounded to 12 bits of mantissa; NaN is the lowest.
pub fn rounded(score: f64) -> f64 {
    const DROPPED: u32 = 52 - 12;
    if score.is_nan() {
        return f64::NEG_INFINITY;
    }
    if score == 0.0 || score.is_infinite() {
        return score + 0.0; // -0 is 0
    }
    f64::from_bits((score.to_bits() + (1 << (DROPPED - 1))) & !((1 << DROPPED) - 1))
}

/// The rank of each score in descending order, equal ones by index.
pub fn rank(scores: &[f64]) -> Vec<u32> {
    let keys: Vec<f64> = scores.iter().map(|&s| rounded(s)).collect();
    let mut order: Vec<u32> = (0..scores.len() as u32).collect();
    order.sort_by(|&a, &b| keys[b as usize].total_cmp(&keys[a as usize]));
    let mut rank = vec![0; scores.len()];
    order.iter().zip(0..).for_each(|(&i, place)| rank[i as usize] = place);
    rank
}
