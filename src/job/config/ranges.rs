//! Ranges of the numbers in a `config.toml`: the same as on the command line, and finite. A file that was edited or
//! damaged is refused with the name of the field, before any work.

use super::pruning::{PruneRule, Pruning};
use super::run::RunConfig;
use crate::gaussians::MAX_SH_DEGREE;
use crate::qirf::participation::Eigensolver;
use crate::qirf::partition::Partition;
use crate::qirf::select::budget::Keep;
use crate::qirf::study::{Basis, Overlap};
use crate::render::Style;
use crate::scene::Resize;
use crate::train::schedule::Schedule;
use std::fmt::{Display, LowerExp};
use std::ops::RangeInclusive;

/// Longest run.
pub const MOST_ITERATIONS: u32 = 1_000_000;
/// Largest number of Gaussians: they are counted in 32 bits, and moments of SH bands have 42 numbers each.
pub const MOST_GAUSSIANS: usize = 100_000_000;
/// Members of the largest block: its matrix is square.
const BLOCK: RangeInclusive<usize> = 16..=8000;
/// Learning rates, weights, gradients and scales.
const POSITIVE: RangeInclusive<f64> = 1e-30..=1e6;
/// Steps from one held-out photo to the next.
const EVERY: RangeInclusive<usize> = 0..=1_000_000;
/// Degrees from straight down to the horizon.
const POLE: RangeInclusive<f64> = 0.0..=90.0;
/// Shares.
pub const SHARE: RangeInclusive<f64> = 0.0..=1.0;
/// Numbers of 0 or more.
pub const WEIGHT: RangeInclusive<f64> = 0.0..=1e6;

/// Refuses a value outside its range, and NaN.
pub fn within<T: Copy + PartialOrd + Display + LowerExp>(
    field: &str,
    value: T,
    range: &RangeInclusive<T>,
) -> Result<(), String> {
    if range.contains(&value) {
        return Ok(());
    }
    let shown = |number: &T| {
        let digits = number.to_string();
        if digits.len() > 10 { format!("{number:e}") } else { digits }
    };
    Err(format!("{field} = {}: write a number from {} to {}", shown(&value), shown(range.start()), shown(range.end())))
}

/// Checks that a solver takes the overlaps.
pub fn overlap(basis: &Basis) -> Result<(), String> {
    if (basis.solver, basis.overlap) == (Eigensolver::Device, Overlap::Raw) {
        return Err("prune.compression.basis.overlap = \"raw\": the solver \"device\" takes normalised overlaps alone; write another \
                    solver, such as \"low-rank\""
            .to_owned());
    }
    Ok(())
}

/// Checks every number of a configuration.
pub fn check(config: &RunConfig) -> Result<(), String> {
    if let Some(text) = &config.resolution {
        text.parse::<Resize>().map_err(|what| format!("resolution: {what}"))?;
    }
    within("pole_mask", config.pole_mask, &POLE)?;
    within("eval_every", config.eval_every, &EVERY)?;
    within("sh_degree", config.sh_degree, &(0..=MAX_SH_DEGREE))?;
    within("max_gaussians", config.max_gaussians, &(1..=MOST_GAUSSIANS))?;
    if let Some(count) = config.init_count {
        within("init_count", count, &(1..=MOST_GAUSSIANS))?;
    }
    for channel in config.background.into_iter().flatten() {
        within("background", f64::from(channel), &SHARE)?;
    }
    if let Some(dilation) = config.style.dilation
        && !Style::DILATIONS.contains(&dilation)
    {
        let [narrow, wide] = Style::DILATIONS;
        return Err(format!("dilation = {dilation}: write {narrow} or {wide}"));
    }
    schedule(&config.schedule)?;
    config.prune.as_ref().map_or(Ok(()), pruning)
}

fn schedule(s: &Schedule) -> Result<(), String> {
    within("schedule.iterations", s.iterations, &(1..=MOST_ITERATIONS))?;
    for (field, value) in [
        ("position_rate", s.position_rate),
        ("position_rate_end", s.position_rate_end),
        ("densify_gradient", s.densify_gradient),
        ("clone_scale", s.clone_scale),
        ("prune_scale", s.prune_scale),
        ("forgetting", s.forgetting),
    ] {
        within(&format!("schedule.{field}"), value, &POSITIVE)?;
    }
    for (field, value) in [
        ("dc_rate", s.dc_rate),
        ("rest_rate", s.rest_rate),
        ("opacity_rate", s.opacity_rate),
        ("scale_rate", s.scale_rate),
        ("rotation_rate", s.rotation_rate),
    ] {
        within(&format!("schedule.{field}"), value, &WEIGHT)?;
    }
    // Beyond 1 means never.
    for (field, value) in [
        ("densify_from", s.densify_from),
        ("densify_until", s.densify_until),
        ("prune_opacity", s.prune_opacity),
        ("prune_scale_from", s.prune_scale_from),
        ("degree_every", s.degree_every),
        ("half_until", s.half_until),
        ("mean_from", s.mean_from),
    ] {
        within(&format!("schedule.{field}"), value, &(0.0..=1000.0))?;
    }
    if let Some(g) = &s.growth {
        let gaussians = g.gaussians.unwrap_or(MOST_GAUSSIANS);
        within("schedule.growth.gaussians", gaussians, &(1..=MOST_GAUSSIANS))?;
        within("schedule.growth.least", g.least.unwrap_or_default(), &(0..=MOST_GAUSSIANS))?;
        within("schedule.growth.steps", g.steps, &(1..=MOST_ITERATIONS))?;
    }
    Ok(())
}

fn pruning(p: &Pruning) -> Result<(), String> {
    // Dense arms of a comparison prune never, and change their loss.
    if p.at.is_empty() && p.l2_from.is_none() {
        return Err("prune.at = []: write a share of the run, or leave out the table [prune]".to_owned());
    }
    let mut before = 0.0;
    for &at in &p.at {
        within("prune.at (rising shares of the run)", at, &(before..=1.0))?;
        before = at;
    }
    within("prune.average_from", p.average_from, &SHARE)?;
    within("prune.l2", p.l2, &WEIGHT)?;
    if let Some(from) = p.l2_from {
        within("prune.l2_from", from, &SHARE)?;
    }
    if let Some(a) = &p.attrition {
        let begins = p.at.first().copied().unwrap_or_default();
        within("prune.attrition.until (it begins at prune.at)", a.until, &(begins..=1.0))?;
        within("prune.attrition.opacity_rate", a.opacity_rate, &POSITIVE)?;
        within("prune.attrition.faint", a.faint, &SHARE)?;
    }
    compression(&p.compression)
}

/// Checks the numbers of a choice of Gaussians, and that its solver knows its overlaps. Errors name fields of `config.toml`.
fn compression(c: &PruneRule) -> Result<(), String> {
    match c.keep {
        Keep::Paper { kappa } => within("prune.compression.keep.paper.kappa", kappa, &SHARE)?,
        Keep::Share(share) => within("prune.compression.keep.share", share, &(1e-9..=1.0))?,
        Keep::Count(count) => within("prune.compression.keep.count", count, &(1..=MOST_GAUSSIANS))?,
    }
    within("prune.compression.detail", c.detail, &SHARE)?;
    let b = &c.basis;
    for (field, value, range) in
        [("dilate", b.dilate, &WEIGHT), ("epsilon", b.epsilon, &WEIGHT), ("tau", b.tau, &SHARE), ("eta", b.eta, &SHARE)]
    {
        within(&format!("prune.compression.basis.{field}"), value, range)?;
    }
    overlap(b)?;
    let field = "prune.compression.basis.partition";
    match b.partition {
        Partition::Paper { voxel, cap } => {
            within(&format!("{field}.paper.voxel"), voxel, &POSITIVE)?;
            within(&format!("{field}.paper.cap"), cap, &BLOCK)
        }
        Partition::Adaptive { mean, least, most } => {
            within(&format!("{field}.adaptive.mean"), mean, &(1..=MOST_GAUSSIANS))?;
            within(&format!("{field}.adaptive.most"), most, &BLOCK)?;
            within(&format!("{field}.adaptive.least (at most mean and most)"), least, &(0..=mean.min(most)))
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::job::config::Preset;

    #[test]
    fn every_preset_passes() {
        for preset in [Preset::Paper, Preset::Standard, Preset::Quick] {
            let run = RunConfig::sample(preset).pruned(preset.pruning());
            assert_eq!(check(&run), Ok(()));
            let gradual = Pruning::gradual();
            assert_eq!(check(&run.pruned(gradual)), Ok(()));
        }
        let dense = Pruning { at: Vec::new(), l2_from: Some(0.5), attrition: None, ..Pruning::default() };
        let arm = RunConfig { prune: Some(dense), ..RunConfig::sample(Preset::Standard) };
        assert_eq!(check(&arm), Ok(()));
        // The usual multiple of this number is beyond the largest one.
        let many = PruneRule { keep: Keep::Count(30_000_000), ..PruneRule::default() };
        let run = RunConfig::sample(Preset::Standard).pruned(Pruning { compression: many, ..Pruning::default() });
        assert_eq!(check(&run), Ok(()));
    }

    #[test]
    fn what_no_run_can_mean_is_refused_by_field() {
        let with = |f: &dyn Fn(&mut RunConfig)| {
            let mut config = RunConfig::sample(Preset::Standard).pruned(Pruning::default());
            f(&mut config);
            check(&config).expect_err("must be refused")
        };
        let pruned = |f: fn(&mut Pruning)| with(&|c| c.prune.iter_mut().for_each(f));
        // The iteration at this share, plus 1, would exceed 32 bits.
        assert!(pruned(|p| p.average_from = 1e9).starts_with("prune.average_from = 1000000000:"));
        assert!(pruned(|p| p.at = Vec::new()).starts_with("prune.at = []: write a share of the run"));
        assert!(pruned(|p| p.at = vec![0.4, 0.2]).contains("from 0.4 to 1"));
        assert!(pruned(|p| p.at = vec![f64::NAN]).contains("prune.at"));
        assert!(pruned(|p| p.compression.keep = Keep::Share(0.0)).contains("keep.share"));
        assert!(pruned(|p| p.compression.basis.tau = f64::INFINITY).contains("tau = inf"));
        assert!(pruned(|p| p.compression.basis.eta = 1.5).contains("basis.eta = 1.5: write a number from 0 to 1"));
        assert!(pruned(|p| p.compression.basis.eta = -0.1).contains("basis.eta = -0.1"));
        let raw =
            pruned(|p| (p.compression.basis.solver, p.compression.basis.overlap) = (Eigensolver::Device, Overlap::Raw));
        assert!(raw.contains("overlap = \"raw\"") && raw.contains("low-rank"), "{raw}");
        for (mean, least, most, says) in [(48, 8, 1_000_000, "8000"), (4, 8, 128, "0 to 4"), (48, 20, 16, "0 to 16")] {
            let partition = Partition::Adaptive { mean, least, most };
            let refused = with(&|c| c.prune.iter_mut().for_each(|p| p.compression.basis.partition = partition));
            assert!(refused.ends_with(says), "{refused}");
        }
        let until = pruned(|p| p.attrition.iter_mut().for_each(|a| a.until = 0.4));
        assert!(until.starts_with("prune.attrition.until") && until.ends_with("= 0.4: write a number from 0.5 to 1"));
        assert!(with(&|c| c.schedule.iterations = 0).contains("schedule.iterations = 0: write a number from 1"));
        assert!(with(&|c| c.schedule.position_rate = -1.0).contains("position_rate = -1"));
        assert!(with(&|c| c.max_gaussians = usize::MAX).contains("max_gaussians"));
        assert!(with(&|c| c.eval_every = usize::MAX).ends_with(": write a number from 0 to 1000000"));
        for angle in [-30.0, 180.0, 1e30, f64::NAN] {
            assert!(with(&|c| c.pole_mask = angle).contains("write a number from 0 to 90"));
        }
        assert!(with(&|c| c.resolution = Some("abc".into())).starts_with("resolution: 'abc' is neither a width"));
        assert!(with(&|c| c.sh_degree = 4).contains("from 0 to 3"));
        assert!(with(&|c| c.background = Some([0.0, f32::NAN, 0.0])).contains("background = NaN"));
    }
}
