//! The axis of regularisation: epsilon on the metric's diagonal, or a dilation of every Gaussian.

use super::blocks::{self, jaccard};
use super::records::AxisRecord;
use super::rung::Rung;
use super::subject::Context;
use super::timing::{Sample, interleaved};
use crate::gaussians::resident::Resident;
use crate::job::Error;
use crate::qirf::assemble::symmetric;
use crate::qirf::overlap::Metric as Overlaps;
use crate::qirf::participation::Gram;
use crate::qirf::partition::Blocks;
use crate::qirf::select::Selector;
use crate::qirf::select::budget::{Budget, Keep};
use crate::qirf::study::{Basis, Observed, Study, dilation};
use rayon::prelude::*;
use std::time::Instant;

/// Largest number of blocks whose condition number is computed, by an eigendecomposition each.
const CONDITIONED: usize = 60;
/// Share of Gaussians kept.
const KEPT: f64 = 0.28;
/// The most exact rung: the smallest addition to the metric that avoids singularity.
const LEAST: f64 = 1e-6;

fn study(context: &Context<'_>, resident: &Resident, basis: &Basis) -> Result<Study, Error> {
    let subject = context.subject;
    let selectors = [Selector::Gnso];
    let observed = Observed { resident, model: &subject.model, responses: &subject.responses };
    Ok(Study::new(context.session.device, observed, basis, &selectors, 1)?)
}

/// The Gaussians that the paper's rule keeps, by block and without the detail safeguard, which would hide the metric's
/// effect.
fn kept(study: &Study) -> Vec<bool> {
    study.choose(Selector::Gnso, Budget::PerBlock, Keep::Share(KEPT), 0.0).keep
}

/// Median and largest condition number of some blocks' metrics.
fn conditions(context: &Context<'_>, resident: &Resident, basis: &Basis) -> Result<(f64, f64), Error> {
    let model = &context.subject.model;
    let sampled = blocks::sampled(model, basis.partition);
    let some = Blocks::of(sampled.iter().step_by(sampled.len().div_ceil(CONDITIONED).max(1)));
    let metric = Overlaps { dilation: dilation(model, basis.dilate), ..Overlaps::default() };
    let problems = blocks::problems(context, resident, &some, metric, basis)?;
    let condition =
        |p: &blocks::Problem| Gram::new(p.len(), &symmetric(p.len(), &p.overlap), None, basis.epsilon).condition();
    let mut all: Vec<f64> = problems.par_iter().filter_map(condition).collect();
    all.sort_by(f64::total_cmp);
    Ok((all.get(all.len() / 2).copied().unwrap_or(1.0), all.last().copied().unwrap_or(1.0)))
}

pub fn measure(context: &Context<'_>, rungs: &[Rung<Basis>], mut axis: AxisRecord) -> Result<AxisRecord, Error> {
    let resident = Resident::upload(context.session.device, &context.subject.model)?;
    let truth = kept(&study(context, &resident, &Basis { epsilon: LEAST, ..Basis::default() })?);
    for Rung { name, value: basis } in rungs {
        let (middle, most) = conditions(context, &resident, basis)?;
        let mut rung = axis.rung(name);
        let same = jaccard(&kept(&study(context, &resident, basis)?), &truth);
        rung.accuracy = Some(1.0 - same);
        rung.exact = basis.dilate == 0.0 && basis.epsilon == LEAST;
        rung.figures.insert("kept_jaccard", same);
        rung.figures.insert("condition", middle);
        rung.figures.insert("largest_condition", most);
        axis.rungs.push(rung);
    }
    // The arithmetic does not depend on epsilon: times of their own would differ by the machine's noise alone.
    let timed = interleaved(rungs.len().min(1), 0.5 * context.seconds, 5, context.session.watcher, |k, _| {
        let started = Instant::now();
        let wall = study(context, &resident, &rungs[k].value)?.seconds.wall;
        Ok(Sample { device: None, wall: wall.min(started.elapsed().as_secs_f64()) })
    })?;
    axis.rungs = axis.rungs.into_iter().map(|rung| timed.iter().fold(rung, |rung, t| rung.timed(t, 1e3))).collect();
    axis.notes.push(format!(
        "The paper's selector keeps {KEPT} of every block. The time was measured once, for the first rung, since the arithmetic does not \
         depend on epsilon. A larger epsilon gives a better conditioned metric (the plot's abscissa; the median of up to {CONDITIONED} blocks), which float32 solvers need. Rungs t=... widen every Gaussian by that many median scales: another metric, which sees \
         redundancy that the eye sees, not a worse approximation of this one."
    ));
    Ok(axis)
}
