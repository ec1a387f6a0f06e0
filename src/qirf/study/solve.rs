//! The solution of all blocks: the device assembles one batch while the host solves the previous one, or solves it
//! itself.

use super::{BATCH_BYTES, Basis, Observed, Overlap, Result, Seconds, Study, self_overlaps};
use crate::gpu::{self, Device, Timings};
use crate::qirf::CHANNELS;
use crate::qirf::assemble::{Assembly, Options};
use crate::qirf::batch::{Block, Modes, Solved, Solver, by_opacity};
use crate::qirf::overlap::Metric;
use crate::qirf::participation::{Eigensolver, device};
use crate::qirf::partition::Blocks;
use crate::qirf::rrdm::Density;
use crate::qirf::select::{Ranking, Selector, rank};
use rayon::prelude::*;
use std::time::Instant;

impl Seconds {
    fn add(&mut self, timings: &Timings) {
        self.overlap += timings.seconds("overlap");
        self.rrdm += timings.seconds("rrdm");
        self.participation += timings.seconds("participation");
    }
}

/// Inputs of the solution of blocks.
struct Job<'a> {
    device: &'a Device,
    observed: Observed<'a>,
    basis: &'a Basis,
    /// Rows of H, n.
    rows: &'a [[f32; CHANNELS]],
}

impl<'a> Job<'a> {
    /// The assembly of N, W and, for `dsygvd`, P.
    fn assembly(&self, blocks: &Blocks, metric: Metric) -> gpu::Result<Assembly<'a>> {
        let Basis { eta, epsilon, solver, .. } = *self.basis;
        let density = Density { eta: eta as f32, epsilon: epsilon as f32, full: solver == Eigensolver::Dsygvd };
        let options = Options { metric, density: Some(density), batch_bytes: BATCH_BYTES };
        let Blocks { members, starts } = blocks;
        Assembly::new(self.device, self.observed.resident, members, starts, self.rows, options)
    }

    fn opacity(&self, members: &[u32]) -> Vec<f32> {
        members.iter().map(|i| self.observed.model.opacity_logits[*i as usize]).collect()
    }
}

impl Study {
    /// Assembles the matrices of all blocks, and solves the blocks for each of these selectors.
    pub(super) fn solve(
        &mut self,
        device: &Device,
        observed: Observed<'_>,
        basis: &Basis,
        selectors: Vec<Selector>,
        rows: &[[f32; CHANNELS]],
    ) -> Result<()> {
        let began = Instant::now();
        let mut solver = Solver { eigensolver: basis.solver, epsilon: basis.epsilon, tau: basis.tau, selectors };
        let job = Job { device, observed, basis, rows };
        if basis.solver == Eigensolver::Device {
            let failed = self.solve_on_device(&job)?;
            let again = Solver { eigensolver: Eigensolver::LowRank, selectors: vec![Selector::Gnso], ..solver.clone() };
            self.solve_on_host(&job, &again, &failed)?;
            solver.selectors.retain(|s| *s != Selector::Gnso);
        }
        if basis.solver != Eigensolver::Device || !solver.selectors.is_empty() {
            let all: Vec<usize> = (0..self.partitioned.blocks.len()).collect();
            self.solve_on_host(&job, &solver, &all)?;
        }
        self.seconds.wall = began.elapsed().as_secs_f64();
        Ok(())
    }

    /// Solves blocks on the device. Returns those that are too large for it, and those that it cannot factorise in float32.
    fn solve_on_device(&mut self, job: &Job<'_>) -> Result<Vec<usize>> {
        let all = &self.partitioned.blocks;
        let (chosen, mut failed): (Vec<usize>, Vec<usize>) =
            (0..all.len()).partition(|b| all.block(*b).len() <= device::LARGEST_BLOCK);
        let blocks = Blocks::of(chosen.iter().map(|b| all.block(*b)));
        let assembly = job.assembly(&blocks, self.metric)?;
        let problem = device::Problem { epsilon: job.basis.epsilon as f32, tau: job.basis.tau as f32 };
        let collected = &mut self.collected;
        let timings = assembly.solve_each(problem, |k, solution| -> Result<()> {
            let (b, members) = (chosen[k], blocks.block(k));
            let wide = |values: &[f32]| values.iter().map(|x| f64::from(*x)).collect::<Vec<_>>();
            let unseen = members.iter().all(|i| job.rows[*i as usize] == [0.0; CHANNELS]);
            if solution.failed && !unseen {
                failed.push(b);
                return Ok(());
            }
            let participation = wide(solution.q);
            let ranking = if unseen {
                by_opacity(&job.opacity(members))
            } else {
                Ranking { rank: rank(&participation), gain: wide(solution.gain) }
            };
            let spectrum = solution.lambda.map(f64::from);
            let modes = Modes { spectrum, r: solution.r.max(1) as u32, participation, unseen, ..Modes::default() };
            let solved = Solved { ranked: vec![(Selector::Gnso, ranking)], modes: Some(modes), repaired: 0 };
            collected.take(all, b, &solved);
            Ok(())
        })?;
        self.seconds.add(&timings);
        self.collected.fallbacks += failed.len();
        Ok(failed)
    }

    /// Assembles `chosen` blocks on the device and solves them on the host.
    fn solve_on_host(&mut self, job: &Job<'_>, solver: &Solver, chosen: &[usize]) -> Result<()> {
        if chosen.is_empty() {
            return Ok(());
        }
        let all = &self.partitioned.blocks;
        let blocks = Blocks::of(chosen.iter().map(|b| all.block(*b)));
        let own = (job.basis.overlap == Overlap::Raw).then(|| self_overlaps(job.observed.model, self.metric));
        let collected = &mut self.collected;
        let mut solve_s = 0.0;
        let assembly = job.assembly(&blocks, self.metric)?;
        let timings = assembly.for_each(|batch| -> Result<()> {
            let started = Instant::now();
            let batch: Vec<_> = batch.iter().collect();
            let solved = batch.par_iter().with_max_len(1).map(|&(k, matrices)| {
                let members = blocks.block(k);
                let own = own.as_ref().map(|own| members.iter().map(|i| own[*i as usize]).collect::<Vec<_>>());
                let opacity = job.opacity(members);
                solver.solve_one(&Block { matrices, opacity: &opacity, self_overlaps: own.as_deref() })
            });
            let solved: Vec<_> = solved.collect();
            for ((k, _), solved) in batch.iter().zip(&solved) {
                collected.take(all, chosen[*k], solved);
            }
            solve_s += started.elapsed().as_secs_f64();
            Ok(())
        })?;
        self.seconds.add(&timings);
        self.seconds.solve += solve_s;
        Ok(())
    }
}
