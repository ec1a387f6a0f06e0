//! The axis of eigensolvers: on the subject's own blocks, and by block size.

use super::blocks::{self, Problem, jaccard};
use super::records::{AxisRecord, Table, figure};
use super::rung::{Rung, Solver};
use super::subject::Context;
use super::timing::{Sample, Timed, interleaved};
use crate::gaussians::resident::Resident;
use crate::job::Error;
use crate::qirf::assemble::{Assembly, Options, symmetric};
use crate::qirf::dense::serving;
use crate::qirf::overlap::Metric as Overlaps;
use crate::qirf::participation::{Eigensolver, Gram, device, solve as solve_block};
use crate::qirf::partition::Blocks;
use crate::qirf::rrdm::Density;
use crate::qirf::select::rank;
use crate::qirf::study::Basis;
use rayon::prelude::*;
use std::time::Instant;

/// Block sizes measured separately, with the number of blocks of each.
const SIZES: [(usize, usize); 4] = [(16, 8), (64, 8), (256, 3), (1024, 1)];
/// Share of a block that is kept in the compared sets: the paper's kappa.
const KAPPA: (usize, usize) = (22, 100);
/// The reference of the other solvers: float64 from W on. P reaches `dsygvd` in float32, as assembled by the device.
const EXACT: Eigensolver = Eigensolver::LowRank;
/// The solver whose time the others' times are compared with.
const SLOWEST: Eigensolver = Eigensolver::Dsygvd;

/// Eigenvalues and participation of one block.
#[derive(Clone)]
struct Solution {
    lambda: Vec<f64>,
    q: Vec<f64>,
    failed: bool,
}

fn solve(problem: &Problem, solver: Solver, basis: &Basis) -> Solution {
    let overlap = symmetric(problem.len(), &problem.overlap);
    let metric = Gram::new(problem.len(), &overlap, None, basis.epsilon).by(solver.library);
    let (p, _) = solve_block(&metric, &problem.rows, &problem.density, solver.eigensolver, basis.tau);
    Solution { lambda: p.spectrum.to_vec(), q: p.q, failed: p.canonical }
}

/// The set that a block keeps with these scores.
fn kept(q: &[f64]) -> Vec<bool> {
    let k = (KAPPA.0 * q.len()).div_ceil(KAPPA.1);
    rank(q).iter().map(|place| (*place as usize) < k).collect()
}

/// Distance of solutions from the reference.
struct Distance {
    lambda: f64,
    q: f64,
    jaccard: f64,
    failed: usize,
}

fn distance(found: &[Solution], truth: &[Solution]) -> Distance {
    let mut d = Distance { lambda: 0.0, q: 0.0, jaccard: 1.0, failed: 0 };
    let mut sets = [Vec::new(), Vec::new()];
    for (a, b) in found.iter().zip(truth) {
        // A block that failed on the device is solved by the host, and has the host's solution.
        d.failed += usize::from(a.failed);
        let a = if a.failed { b } else { a };
        let most = |v: &[f64]| v.iter().copied().fold(0.0, f64::max).max(f64::MIN_POSITIVE);
        let far = |x: &[f64], y: &[f64]| x.iter().zip(y).map(|(x, y)| (x - y).abs()).fold(0.0, f64::max) / most(y);
        d.lambda = d.lambda.max(far(&a.lambda, &b.lambda));
        d.q = d.q.max(far(&a.q, &b.q));
        sets[0].extend(kept(&a.q));
        sets[1].extend(kept(&b.q));
    }
    d.jaccard = jaccard(&sets[0], &sets[1]);
    d
}

/// Blocks with the device's own assembly.
struct Measured<'a> {
    problems: Vec<Problem>,
    assembly: Assembly<'a>,
    basis: Basis,
}

impl<'a> Measured<'a> {
    fn new(context: &Context<'_>, resident: &'a Resident, blocks: &Blocks) -> Result<Self, Error> {
        let basis = Basis::default();
        let problems = blocks::problems(context, resident, blocks, Overlaps::default(), &basis)?;
        let density = Density { eta: basis.eta as f32, epsilon: basis.epsilon as f32, full: false };
        let options = Options { density: Some(density), ..Options::default() };
        let h = blocks::rows(context, basis.eta);
        let assembly = Assembly::new(context.session.device, resident, &blocks.members, &blocks.starts, &h, options)?;
        Ok(Self { problems, assembly, basis })
    }

    /// Solves all blocks; the host's solvers use all threads if `parallel`, otherwise one.
    fn run(&self, context: &Context<'_>, solver: Solver, parallel: bool) -> Result<(Vec<Solution>, Sample), Error> {
        if solver.eigensolver != Eigensolver::Device {
            let one = |p: &Problem| solve(p, solver, &self.basis);
            return Ok(Sample::host(|| {
                if parallel {
                    self.problems.par_iter().with_max_len(1).map(one).collect()
                } else {
                    self.problems.iter().map(one).collect()
                }
            }));
        }
        let problem = device::Problem { epsilon: self.basis.epsilon as f32, tau: self.basis.tau as f32 };
        let started = Instant::now();
        let mut out = Vec::with_capacity(self.problems.len());
        let timings = self.assembly.solve_each(problem, |_, s| -> Result<(), Error> {
            let widen = |v: &[f32]| v.iter().map(|x| f64::from(*x)).collect();
            out.push(Solution { lambda: widen(&s.lambda), q: widen(s.q), failed: s.failed });
            Ok(())
        })?;
        Ok((out, Sample::of(context.session.device, &timings, &["participation"], started)))
    }

    fn truth(&self) -> Vec<Solution> {
        let exact = Solver { eigensolver: EXACT, library: serving() };
        self.problems.par_iter().with_max_len(1).map(|p| solve(p, exact, &self.basis)).collect()
    }

    /// Each rung's distance from the reference, and its times.
    fn measure(
        &self,
        context: &Context<'_>,
        rungs: &[Rung<Solver>],
        parallel: bool,
        budget: f64,
    ) -> Result<Vec<(Distance, Timed)>, Error> {
        let truth = self.truth();
        let mut distances = Vec::new();
        for rung in rungs {
            distances.push(distance(&self.run(context, rung.value, parallel)?.0, &truth));
        }
        let timed = interleaved(rungs.len(), budget, 3, context.session.watcher, |k, _| {
            self.run(context, rungs[k].value, parallel).map(|(_, sample)| sample)
        })?;
        Ok(distances.into_iter().zip(timed).collect())
    }
}

pub fn measure(context: &Context<'_>, rungs: &[Rung<Solver>], mut axis: AxisRecord) -> Result<AxisRecord, Error> {
    let model = &context.subject.model;
    let resident = Resident::upload(context.session.device, model)?;
    let scene = blocks::sampled(model, Basis::default().partition);
    let measured = Measured::new(context, &resident, &scene)?;
    for (Rung { name, value }, (d, timed)) in
        rungs.iter().zip(measured.measure(context, rungs, true, context.seconds)?)
    {
        let mut rung = axis.rung(name).timed(&timed, 1e3);
        rung.accuracy = Some(d.q);
        rung.exact = value.eigensolver == EXACT && *value.library == *serving();
        rung.figures.insert("lambda_error", d.lambda);
        rung.figures.insert("kept_jaccard", d.jaccard);
        rung.figures.insert("failed_blocks", d.failed as f64);
        axis.rungs.push(rung);
    }
    let sizes: Vec<usize> = scene.iter().map(<[u32]>::len).collect();
    axis.notes.push(format!(
        "{} blocks of {} Gaussians, {} to {} each; the host's rungs run one block a thread, the device's rung is its kernel alone, \
         without assembling N and W.",
        scene.len(),
        scene.members.len(),
        sizes.iter().min().unwrap_or(&0),
        sizes.iter().max().unwrap_or(&0)
    ));
    by_size(context, &resident, rungs, &mut axis)?;
    Ok(axis)
}

/// Times per block of each size on one thread.
fn by_size(
    context: &Context<'_>,
    resident: &Resident,
    rungs: &[Rung<Solver>],
    axis: &mut AxisRecord,
) -> Result<(), Error> {
    let mut table = Table {
        title:
            "By block size, one block at a time on one thread: time in µs, agreement of the kept set with low-rank's"
                .to_owned(),
        columns: vec![
            "rung",
            "members",
            "µs a block",
            "times as fast as dsygvd",
            "error of q",
            "error of λ",
            "Jaccard of the set",
        ],
        rows: Vec::new(),
    };
    for (m, count) in SIZES {
        let blocks = blocks::of_size(&context.subject.model, m, count);
        if blocks.is_empty() {
            continue;
        }
        let measured = Measured::new(context, resident, &blocks)?;
        let rungs: Vec<Rung<Solver>> = rungs
            .iter()
            .filter(|r| m <= device::LARGEST_BLOCK || r.value.eigensolver != Eigensolver::Device)
            .cloned()
            .collect();
        let results = measured.measure(context, &rungs, false, 0.2 * context.seconds)?;
        let time = |t: &Timed| t.device.or(t.wall).map_or(f64::NAN, |s| s.median * 1e6 / blocks.len() as f64);
        let whole = rungs.iter().position(|r| r.value.eigensolver == SLOWEST).map(|k| time(&results[k].1));
        for (Rung { name, .. }, (d, timed)) in rungs.iter().zip(&results) {
            let ratio = whole.map_or_else(|| "–".to_owned(), |w| figure(w / time(timed)));
            let cells = [figure(time(timed)), ratio, figure(d.q), figure(d.lambda), format!("{:.4}", d.jaccard)];
            table.rows.push([name.clone(), m.to_string()].into_iter().chain(cells).collect());
            if let (256, Some(w)) = (m, whole)
                && let Some(rung) = axis.rungs.iter_mut().find(|r| r.name == *name)
            {
                rung.figures.insert("speedup_m256", w / time(timed));
                rung.figures.insert("kept_jaccard_m256", d.jaccard);
            }
        }
    }
    axis.tables.push(table);
    axis.notes.push(format!(
        "The set kept is the first {} % of a block by q, scores rounded to 12 bits as the engine rounds them (blocks that fail in \
         float32 on the device are solved by the host).",
        KAPPA.0
    ));
    Ok(())
}
