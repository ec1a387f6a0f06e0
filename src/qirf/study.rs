//! The study of a model: its blocks, and the order of its Gaussians by each selector. The device assembles one batch of
//! blocks while LAPACK solves the previous batch on all cores.

use super::assemble::{Assembly, Options, unpack_symmetric};
use super::batch::{Block, Collected, Modes, Solved, Solver, by_opacity, self_overlap};
use super::overlap::Metric;
use super::participation::{Eigensolver, device};
use super::partition::{Blocks, Partition, Partitioned};
use super::rrdm::Density;
use super::select::budget::{self, Budget, Choice, Keep, Safeguard};
use super::select::detail::{self, Exponents, Inputs};
use super::select::merge::{Functions, merge};
use super::select::{BlockSelector, Ranking, Selector, Statistics, rank};
use super::{CHANNELS, normalise};
use crate::gaussians::resident::Resident;
use crate::gaussians::{Gaussians, MAX_SH_DEGREE};
use crate::gpu::{self, Device, Timings};
use crate::response::{CHANNEL_NAMES, Responses, Wanted};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use std::time::Instant;

/// Reason why a model cannot be studied.
#[derive(Debug, thiserror::Error)]
pub enum Error {
    /// The device floor.
    #[error(transparent)]
    Device(#[from] gpu::Error),
    /// A response that is not a finite number.
    #[error("Gaussian {gaussian} has a response of {value} in channel {channel} ({}): responses must be finite", CHANNEL_NAMES[*channel])]
    Response {
        /// Its Gaussian.
        gaussian: usize,
        /// Its channel, 0 to 7.
        channel: usize,
        /// NaN or infinite.
        value: f32,
    },
}

/// Result of a study.
pub type Result<T> = std::result::Result<T, Error>;

/// Bytes of overlaps per batch, of which two are in flight: enough to keep every core busy, little besides a model.
const BATCH_BYTES: usize = 16 << 20;

/// Peak device memory of a study of `n` Gaussians by `solver`, and of the pass before it, which gathers `wanted`; in bytes.
pub fn bytes(n: usize, wanted: Wanted, solver: Eigensolver) -> u64 {
    let density = Density { full: solver == Eigensolver::Dsygvd, ..Density::default() };
    let batches = Options { batch_bytes: BATCH_BYTES, density: Some(density), ..Options::default() };
    Assembly::bytes(n, &batches).max(wanted.bytes(n))
}

/// The overlaps used as the metric.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Overlap {
    /// N: overlaps of functions of unit norm.
    #[default]
    Normalised,
    /// S, as in the literal text of the paper; epsilon dominates it.
    Raw,
}

/// Options for making and solving blocks: the inputs of an order besides the model and its responses.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct Basis {
    /// Rule that makes blocks.
    pub partition: Partition,
    /// The overlaps used as the metric.
    pub overlap: Overlap,
    /// Standard deviation added to every axis for the overlaps, as a multiple of the median largest scale; 0 for none.
    pub dilate: f64,
    /// Solver of the eigenproblem.
    pub solver: Eigensolver,
    /// Added to the metric's diagonal, and to traces.
    pub epsilon: f64,
    /// Share of the energy that the leading eigenvalues reach.
    pub tau: f64,
    /// Weight of the rendering channels; those of optimisation have the rest.
    pub eta: f64,
}

impl Default for Basis {
    fn default() -> Self {
        let Solver { eigensolver, epsilon, tau, .. } = Solver::default();
        Self {
            partition: Partition::ADAPTIVE,
            overlap: Overlap::default(),
            dilate: 0.0,
            solver: eigensolver,
            epsilon,
            tau,
            eta: 0.75,
        }
    }
}

/// Seconds of a study.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Seconds {
    /// Rows of H, and the partition.
    pub partition: f64,
    /// Device: N.
    pub overlap: f64,
    /// Device: W and P.
    pub rrdm: f64,
    /// Device: eigenproblems.
    pub participation: f64,
    /// Host: eigenproblems and column subsets.
    pub solve: f64,
    /// Elapsed time of all of these, which run concurrently.
    pub wall: f64,
}

/// A model's blocks, and its order by each selector asked for.
pub struct Study {
    /// Blocks, and statistics of the partition.
    pub partitioned: Partitioned,
    /// Each selector's order.
    pub rankings: Vec<(Selector, Ranking)>,
    /// The solver of the blocks; none if no selector needs them.
    pub solver: Option<Eigensolver>,
    /// Results of the solved blocks; their rankings have moved to `rankings`.
    pub collected: Collected,
    /// Detail scores, n.
    pub detail: Vec<f64>,
    /// Times of the parts.
    pub seconds: Seconds,
    /// Bytes of matrices and solutions that came back from the device.
    pub read_back: u64,
    dilation: f32,
}

/// Blocks that were merged.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Merging {
    /// Blocks whose kept Gaussians now also represent the dropped ones.
    pub accepted: usize,
    /// Blocks left unchanged, because merging would not have lowered the error.
    pub refused: usize,
}

fn channel(rows: &[[f32; CHANNELS]], c: usize) -> Vec<f32> {
    rows.iter().map(|row| row[c]).collect()
}

/// A model, on the device and on the host, and the responses of its Gaussians.
#[derive(Clone, Copy)]
pub struct Observed<'a> {
    /// The model on the device.
    pub resident: &'a Resident,
    /// The same model on the host.
    pub model: &'a Gaussians,
    /// Responses of its Gaussians, n.
    pub responses: &'a Responses,
}

impl Seconds {
    fn add(&mut self, timings: &Timings) {
        self.overlap += timings.seconds("overlap");
        self.rrdm += timings.seconds("rrdm");
        self.participation += timings.seconds("participation");
    }
}

/// What the solution of blocks reads.
struct Job<'a> {
    device: &'a Device,
    observed: Observed<'a>,
    basis: &'a Basis,
    /// Rows of H, n.
    rows: &'a [[f32; CHANNELS]],
}

impl<'a> Job<'a> {
    /// The assembly of N, W and, for `dsygvd`, P.
    fn assembly(&self, blocks: &Blocks, dilation: f32) -> gpu::Result<Assembly<'a>> {
        let Basis { eta, epsilon, solver, .. } = *self.basis;
        let density = Density { eta: eta as f32, epsilon: epsilon as f32, full: solver == Eigensolver::Dsygvd };
        let metric = Metric { dilation, ..Metric::default() };
        let options = Options { metric, density: Some(density), batch_bytes: BATCH_BYTES };
        let Blocks { members, starts } = blocks;
        Assembly::new(self.device, self.observed.resident, members, starts, self.rows, options)
    }

    fn opacity(&self, members: &[u32]) -> Vec<f32> {
        members.iter().map(|i| self.observed.model.opacity_logits[*i as usize]).collect()
    }
}

impl Study {
    /// Studies a model. If one of the selectors reads blocks, the paper's eigenproblem is solved for every block.
    ///
    /// # Errors
    /// [`Error::Response`] for a response that is not finite; device memory; device errors.
    ///
    /// # Panics
    /// If there is not one response per Gaussian, or a selector needs scores that are missing.
    pub fn new(
        device: &Device,
        observed: Observed<'_>,
        basis: &Basis,
        selectors: &[Selector],
        seed: u32,
    ) -> Result<Self> {
        let Observed { model, responses, .. } = observed;
        assert_eq!(responses.channels.len(), model.len(), "one response a Gaussian");
        if let Some((gaussian, channel, value)) = normalise::not_finite(&responses.channels) {
            return Err(Error::Response { gaussian, channel, value });
        }
        let begun = Instant::now();
        let rows = normalise::rows(&responses.channels, basis.eta);
        let partitioned = basis.partition.of(&model.means);
        let dilation = dilation(model, basis.dilate);
        let seconds = Seconds { partition: begun.elapsed().as_secs_f64(), ..Seconds::default() };
        let of_blocks: Vec<BlockSelector> = selectors.iter().filter_map(|s| s.of_blocks()).collect();
        let mut study = Self {
            detail: detail_scores(model, responses),
            dilation,
            rankings: Vec::new(),
            solver: (!of_blocks.is_empty()).then_some(basis.solver),
            collected: Collected::new(&partitioned.blocks, &of_blocks),
            partitioned,
            seconds,
            read_back: 0,
        };
        if !of_blocks.is_empty() {
            study.solve(device, observed, basis, of_blocks, &rows)?;
        }
        study.rank(observed, selectors, &rows, seed);
        Ok(study)
    }

    /// Assembles the matrices of all blocks, and solves the blocks for each of these selectors.
    fn solve(
        &mut self,
        device: &Device,
        observed: Observed<'_>,
        basis: &Basis,
        selectors: Vec<BlockSelector>,
        rows: &[[f32; CHANNELS]],
    ) -> Result<()> {
        let began = Instant::now();
        let mut solver = Solver {
            eigensolver: basis.solver,
            epsilon: basis.epsilon,
            tau: basis.tau,
            selectors,
            ..Solver::default()
        };
        let job = Job { device, observed, basis, rows };
        if basis.solver == Eigensolver::Device {
            let failed = self.solve_on_device(&job)?;
            let again =
                Solver { eigensolver: Eigensolver::LowRank, selectors: vec![BlockSelector::Gnso], ..solver.clone() };
            self.solve_on_host(&job, &again, &failed)?;
            solver.selectors.retain(|s| *s != BlockSelector::Gnso);
        }
        if basis.solver != Eigensolver::Device || !solver.selectors.is_empty() {
            let all: Vec<usize> = (0..self.partitioned.blocks.len()).collect();
            self.solve_on_host(&job, &solver, &all)?;
        }
        self.seconds.wall = began.elapsed().as_secs_f64();
        Ok(())
    }

    /// Solves all blocks on the device. Returns those that it cannot factorise in float32.
    fn solve_on_device(&mut self, job: &Job<'_>) -> Result<Vec<usize>> {
        let blocks = &self.partitioned.blocks;
        let assembly = job.assembly(blocks, self.dilation)?;
        let problem = device::Problem { epsilon: job.basis.epsilon as f32, tau: job.basis.tau as f32 };
        let collected = &mut self.collected;
        let mut failed = Vec::new();
        let timings = assembly.solve_each(problem, |b, solution| -> Result<()> {
            let members = blocks.block(b);
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
            let solved = Solved { ranked: vec![(BlockSelector::Gnso, ranking)], modes: Some(modes), repaired: 0 };
            collected.take(blocks, b, &solved);
            Ok(())
        })?;
        self.seconds.add(&timings);
        self.read_back += assembly.solutions_read_back();
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
        let own = (job.basis.overlap == Overlap::Raw).then(|| self_overlaps(job.observed.model));
        let collected = &mut self.collected;
        let mut solve_s = 0.0;
        let assembly = job.assembly(&blocks, self.dilation)?;
        self.read_back += assembly.read_back();
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

    /// Computes each selector's order, from the solved blocks or from a score of each Gaussian alone.
    fn rank(&mut self, observed: Observed<'_>, selectors: &[Selector], rows: &[[f32; CHANNELS]], seed: u32) {
        let Observed { model, responses, .. } = observed;
        let mut solved = std::mem::take(&mut self.collected.rankings);
        let statistics = Statistics {
            rows,
            opacity: &model.opacity_logits,
            scores: &responses.scores,
            log_scales: &model.log_scales,
        };
        for &selector in selectors {
            let alone = selector.ranking(&self.partitioned.blocks, &statistics, u64::from(seed));
            let of_blocks = || {
                let at = solved.iter().position(|(s, _)| Some(*s) == selector.of_blocks())?;
                Some(solved.swap_remove(at).1)
            };
            if let Some(ranking) = alone.or_else(of_blocks) {
                self.rankings.push((selector, ranking));
            }
        }
    }

    /// Calls `body` with the packed lower triangles of N, batch by batch, while the device assembles the next batch.
    fn overlaps(
        &self,
        device: &Device,
        resident: &Resident,
        mut body: impl FnMut(&[(usize, &[f32])]),
    ) -> gpu::Result<Timings> {
        let Blocks { members, starts } = &self.partitioned.blocks;
        let metric = Metric { dilation: self.dilation, ..Metric::default() };
        let options = Options { metric, density: None, batch_bytes: BATCH_BYTES };
        let assembly = Assembly::new(device, resident, members, starts, &[], options)?;
        assembly.for_each(|assembled| {
            body(&assembled.iter().map(|(b, matrices)| (b, matrices.overlap)).collect::<Vec<_>>());
            Ok(())
        })
    }

    /// Chooses the Gaussians to keep by the order of `selector`; `detail` is the share of all Gaussians that the
    /// safeguard keeps.
    ///
    /// # Panics
    /// If the study was not asked for that selector.
    pub fn choose(&self, selector: Selector, budget: Budget, keep: Keep, detail: f64) -> Choice {
        let (_, ranking) = self.rankings.iter().find(|(s, _)| *s == selector).expect("a selector that was studied");
        let safeguard = (detail > 0.0).then_some(Safeguard { scores: &self.detail, share: detail });
        budget::choose(&self.partitioned.blocks, ranking, &self.collected.r, budget, keep, safeguard)
    }

    /// Merges dropped Gaussians of `model` into kept ones: opacities and colours of kept ones change if that lowers the error
    /// of their block. `model` is the one that was studied, and `resident` holds it.
    ///
    /// # Errors
    /// Device memory; device errors.
    pub fn merge(
        &self,
        device: &Device,
        resident: &Resident,
        model: &mut Gaussians,
        keep: &[bool],
    ) -> gpu::Result<Merging> {
        let own = self_overlaps(model);
        let blocks = &self.partitioned.blocks;
        let mut merging = Merging::default();
        self.overlaps(device, resident, |batch| {
            let before: &Gaussians = model;
            let merged: Vec<_> = batch
                .par_iter()
                .with_max_len(1)
                .map(|(b, overlap)| {
                    let members = blocks.block(*b);
                    let mut functions = functions(before, members, &own);
                    let kept: Vec<bool> = members.iter().map(|i| keep[*i as usize]).collect();
                    merge(&full(members.len(), overlap), &kept, &mut functions).map(|m| (m.accepted, kept, functions))
                })
                .collect();
            for ((b, _), merged) in batch.iter().zip(merged) {
                let Some((accepted, kept, functions)) = merged else { continue };
                merging.accepted += usize::from(accepted);
                merging.refused += usize::from(!accepted);
                if accepted {
                    store(model, blocks.block(*b), &kept, &functions);
                }
            }
        })?;
        Ok(merging)
    }
}

fn full(m: usize, packed: &[f32]) -> Vec<f32> {
    let mut matrix = vec![0.0; m * m];
    unpack_symmetric(m, packed, &mut matrix);
    matrix
}

fn self_overlaps(model: &Gaussians) -> Vec<f64> {
    model.log_scales.iter().map(|s| self_overlap(*s)).collect()
}

/// `share` of the median over the Gaussians of the largest scale, in world units.
pub fn dilation(model: &Gaussians, share: f64) -> f32 {
    let mut largest: Vec<f32> =
        model.log_scales.iter().map(|s| s[0].max(s[1]).max(s[2])).filter(|s| s.is_finite()).collect();
    if share <= 0.0 || largest.is_empty() {
        return 0.0;
    }
    let middle = largest.len() / 2;
    let median = *largest.select_nth_unstable_by(middle, f32::total_cmp).1;
    (share * f64::from(median).exp()) as f32
}

fn detail_scores(model: &Gaussians, responses: &Responses) -> Vec<f64> {
    let inputs = Inputs {
        gradient: &channel(&responses.channels, 4),
        visibility: &channel(&responses.channels, 0),
        log_scales: &model.log_scales,
        opacity_logits: &model.opacity_logits,
    };
    detail::scores(&inputs, Exponents::default())
}

/// Offsets of the bands in a row of all coefficients, and the width of the row.
fn layout(model: &Gaussians) -> (Vec<usize>, usize) {
    let mut width = 0;
    let mut starts = Vec::with_capacity(MAX_SH_DEGREE + 1);
    for l in 0..model.sh.len() {
        starts.push(width);
        width += Gaussians::band_width(l);
    }
    (starts, width)
}

fn functions(model: &Gaussians, members: &[u32], own: &[f64]) -> Functions {
    let (_, width) = layout(model);
    let mut sh = Vec::with_capacity(members.len() * width);
    for &i in members {
        for (l, band) in model.sh.iter().enumerate() {
            let w = Gaussians::band_width(l);
            sh.extend(band[i as usize * w..(i as usize + 1) * w].iter().map(|x| f64::from(*x)));
        }
    }
    let alpha = |i: &u32| 1.0 / (1.0 + (-f64::from(model.opacity_logits[*i as usize])).exp());
    Functions {
        alpha: members.iter().map(alpha).collect(),
        sh,
        width,
        self_overlaps: members.iter().map(|i| own[*i as usize]).collect(),
    }
}

fn store(model: &mut Gaussians, members: &[u32], kept: &[bool], functions: &Functions) {
    let (starts, width) = layout(model);
    for (row, &i) in members.iter().enumerate().filter(|(row, _)| kept[*row]) {
        let (i, alpha) = (i as usize, functions.alpha[row]);
        model.opacity_logits[i] = (alpha / (1.0 - alpha)).ln() as f32;
        for (l, start) in starts.iter().enumerate() {
            let w = Gaussians::band_width(l);
            let from = &functions.sh[row * width + start..][..w];
            model.sh[l][i * w..(i + 1) * w].iter_mut().zip(from).for_each(|(to, x)| *to = *x as f32);
        }
    }
}
