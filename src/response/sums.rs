//! Sums of responses and scores over chunks of views: in float32 within a chunk, as the device adds them; in float64
//! over chunks, on the host.

use super::{CHANNELS, Responses, Score, Wanted};
use rayon::prelude::*;

/// Numbers per score.
const SCORES: usize = size_of::<Score>() / size_of::<f32>();
const PEAK: usize = std::mem::offset_of!(Score, peak) / size_of::<f32>();

/// Responses and scores of a chunk, n each; empty if not wanted.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Rows {
    pub channels: Vec<[f32; CHANNELS]>,
    pub scores: Vec<Score>,
}

impl Rows {
    pub fn zeros(gaussians: usize, wanted: Wanted) -> Self {
        Self {
            channels: vec![[0.0; CHANNELS]; if wanted.channels { gaussians } else { 0 }],
            scores: vec![Score::default(); if wanted.scores { gaussians } else { 0 }],
        }
    }

    /// The rows of `members`.
    pub fn of(&self, members: &[u32]) -> Self {
        fn pick<T: Copy>(values: &[T], members: &[u32]) -> Vec<T> {
            if values.is_empty() { Vec::new() } else { members.iter().map(|i| values[*i as usize]).collect() }
        }
        Self { channels: pick(&self.channels, members), scores: pick(&self.scores, members) }
    }

    /// Replaces the rows of `members`.
    pub fn set(&mut self, members: &[u32], rows: &Self) {
        fn put<T: Copy>(values: &mut [T], members: &[u32], rows: &[T]) {
            members.iter().zip(rows).for_each(|(i, row)| values[*i as usize] = *row);
        }
        put(&mut self.channels, members, &rows.channels);
        put(&mut self.scores, members, &rows.scores);
    }
}

/// Sums over chunks, n each.
pub(super) struct Sums {
    channels: Vec<[f64; CHANNELS]>,
    scores: Vec<[f64; SCORES]>,
}

impl Sums {
    pub fn zeros(gaussians: usize, wanted: Wanted) -> Self {
        Self {
            channels: vec![[0.0; CHANNELS]; if wanted.channels { gaussians } else { 0 }],
            scores: vec![[0.0; SCORES]; if wanted.scores { gaussians } else { 0 }],
        }
    }

    /// Adds the values of a chunk.
    pub fn add(&mut self, chunk: &Rows) {
        self.channels.par_iter_mut().zip(&chunk.channels).for_each(|(sum, row)| {
            sum.iter_mut().zip(row).for_each(|(sum, x)| *sum += f64::from(*x));
        });
        self.scores.par_iter_mut().zip(&chunk.scores).for_each(|(sum, score)| {
            let row: &[f32; SCORES] = bytemuck::cast_ref(score);
            for (k, (sum, x)) in sum.iter_mut().zip(row).enumerate() {
                let x = f64::from(*x);
                *sum = if k == PEAK { sum.max(x) } else { *sum + x };
            }
        });
    }

    /// The sums, rounded once.
    pub fn rounded(self) -> Rows {
        let score = |row: [f64; SCORES]| -> Score { bytemuck::cast(row.map(|x| x as f32)) };
        Rows {
            channels: self.channels.into_par_iter().map(|row| row.map(|x| x as f32)).collect(),
            scores: self.scores.into_par_iter().map(score).collect(),
        }
    }
}

impl Responses {
    /// The responses to the first `n` Gaussians.
    #[must_use]
    pub fn of_first(&self, n: usize) -> Self {
        let mut first = self.clone();
        first.channels.truncate(n);
        first.scores.truncate(n);
        first
    }

    /// The responses of a whole pass over `n` Gaussians from those of its chunks, in their order: the same bits as from
    /// one pass.
    pub fn sum<E>(n: usize, wanted: Wanted, chunks: impl Iterator<Item = Result<Self, E>>) -> Result<Self, E> {
        let mut sums = Sums::zeros(n, wanted);
        let mut seen = Self::default();
        for chunk in chunks {
            let Self { channels, scores, cameras, dilation, .. } = chunk?;
            sums.add(&Rows { channels, scores });
            (seen.cameras, seen.dilation) = (cameras, dilation);
        }
        let Rows { channels, scores } = sums.rounded();
        Ok(Self { channels, scores, ..seen })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn chunk(contribution: f32, peak: f32) -> Rows {
        let score = Score { contribution, peak, change: 2.0 * contribution, ..Score::default() };
        Rows { channels: vec![[contribution; CHANNELS]; 2], scores: vec![score; 2] }
    }

    /// Float32 would lose the small ones in almost any order.
    #[test]
    fn chunks_add_up_in_float64() {
        let mut sums = Sums::zeros(2, Wanted::BOTH);
        sums.add(&chunk(16_777_216.0, 0.25));
        (0..3).for_each(|_| sums.add(&chunk(1.0, 0.75)));
        sums.add(&chunk(1.0, 0.5));
        let rows = sums.rounded();
        assert_eq!(rows.channels[1], [16_777_220.0; CHANNELS]);
        let Score { contribution, peak, change, hits, .. } = rows.scores[0];
        assert_eq!((contribution, peak, change, hits), (16_777_220.0, 0.75, 33_554_440.0, 0.0));
    }

    #[test]
    fn rows_of_members_are_picked_and_replaced() {
        let mut rows = Rows::zeros(4, Wanted::SCORES);
        rows.set(&[1, 3], &Rows { scores: chunk(5.0, 1.0).scores, channels: Vec::new() });
        assert_eq!(rows.of(&[3, 0]).scores.iter().map(|s| s.contribution).collect::<Vec<_>>(), [5.0, 0.0]);
        assert!(rows.channels.is_empty() && rows.of(&[1]).channels.is_empty());
    }
}
