//! The generalized eigenproblem on the device: the low-rank solver in float32, a batch of blocks at a time, so that
//! only participations are read back.

use crate::gpu::{Error, Groups, Readback, Recording, Timings};
use crate::kernels::constants::participation;
use crate::kernels::qirf::{Participation as Kernel, ParticipationPush, ParticipationSpec};
use crate::qirf::CHANNELS;
use crate::qirf::assemble::Assembly;
use crate::qirf::plan::Batch;

/// The most members of a block for one subgroup, whose time grows with their third power: about a second for 1024 of
/// them, by estimate, and minutes for 4096, where systems reset a busy device after 2 to 10 seconds.
pub const LARGEST_BLOCK: usize = 512;

/// Numbers in a block's solution besides those per member.
const EXTRA: usize = participation::EXTRA as usize;

/// Parameters of the eigenproblem, besides its matrices.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Problem {
    /// Added to the diagonal of N.
    pub epsilon: f32,
    /// Share of the eigenvalues' sum that the leading ones reach.
    pub tau: f32,
}

impl Default for Problem {
    fn default() -> Self {
        Self { epsilon: 1e-4, tau: 0.95 }
    }
}

/// One block's solution.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Solution<'a> {
    /// Participation of each member, by W; zero if the solver failed.
    pub q: &'a [f32],
    /// The same by H, which makes members of different blocks comparable.
    pub gain: &'a [f32],
    /// Eigenvalues, descending; negative ones from rounding are set to 0.
    pub lambda: [f32; CHANNELS],
    /// The fewest eigenvalues that reach tau.
    pub r: usize,
    /// True if N + epsilon I was not positive definite in float32: the host must solve this block.
    pub failed: bool,
}

/// Floats of a batch's solutions.
fn floats(batch: &Batch) -> usize {
    2 * batch.members.len() + EXTRA * batch.blocks.len()
}

impl Assembly<'_> {
    /// Assembles and solves every batch on the device, and calls `body` with the number and the solution of each block,
    /// in order, while the device works on the next batch. Returns the device times.
    ///
    /// # Panics
    /// If W was not requested of the assembly.
    pub fn solve_each<E: From<Error>>(
        &self,
        problem: Problem,
        mut body: impl FnMut(usize, Solution<'_>) -> Result<(), E>,
    ) -> Result<Timings, E> {
        assert!(self.options.density.is_some(), "the eigenproblem needs W");
        let most = self.batches().iter().map(floats).max().unwrap_or(0);
        let solutions = self.device.buffer("solutions", most)?;
        let modes = self.device.buffer("modes of blocks", self.arrays.factors.len())?;
        let submit = |batch: &Batch, readback: &mut Readback<f32>| {
            let mut recording = Recording::new();
            self.record(&mut recording, batch);
            let kernel = Kernel {
                blocks: &self.arrays.blocks,
                overlaps: &self.arrays.overlaps,
                factors: &self.arrays.factors,
                divisors: &self.arrays.divisors,
                modes: &modes,
                solutions: &solutions,
                push: ParticipationPush {
                    first_block: batch.blocks.start as u32,
                    count: batch.blocks.len() as u32,
                    first_member: batch.members.start as u32,
                    epsilon: problem.epsilon,
                    tau: problem.tau,
                },
                spec: ParticipationSpec { workgroup: self.arrays.rows },
            };
            recording.scope("participation", |r| r.dispatch(&kernel, Groups::Count(batch.blocks.len() as u32)));
            readback.submit(&self.device, recording, &[(&solutions, floats(batch))])
        };
        let readback = || self.device.readback("solutions", most);
        self.overlapped([readback()?, readback()?], submit, |batch, values| {
            let mut rest = values;
            for b in batch.blocks.clone() {
                let m = (self.starts[b + 1] - self.starts[b]) as usize;
                let (own, others) = rest.split_at(2 * m + EXTRA);
                rest = others;
                let (q, own) = own.split_at(m);
                let (gain, extra) = own.split_at(m);
                let lambda = std::array::from_fn(|k| extra[k]);
                let (r, failed) = (extra[CHANNELS] as usize, extra[CHANNELS + 1] != 0.0);
                let solution = Solution { q, gain, lambda, r, failed };
                body(b, solution)?;
            }
            Ok(())
        })
    }
}
