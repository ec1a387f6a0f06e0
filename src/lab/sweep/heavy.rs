//! The axes whose rungs are trainings: kept shares and selectors from one checkpoint, lengths and effects as separate
//! runs.

use super::asked::Asked;
use super::axis::Measure;
use super::records::{AxisRecord, RungRecord};
use super::rung::{Rung, Switch, UNCHANGED, share};
use super::timing::{Spread, Timed};
use crate::effects::{Choice, Decision, Effect, Trigger};
use crate::job::config::{PruneRule, Pruning};
use crate::job::records::RunRecord;
use crate::job::{Error, Output, Preset, RunConfig, Session};
use crate::lab::compare::{Arm, ArmRecord, compare};
use crate::pipeline::run::run;
use crate::qirf::select::budget::Keep;
use std::path::Path;
use std::time::Instant;

/// Parameters of the trainings of heavy axes.
pub struct Training<'a> {
    /// Device, limits and watcher.
    pub session: Session<'a>,
    /// The folder of the sweep.
    pub folder: &'a Path,
    /// The run's configuration, without pruning.
    pub config: &'a RunConfig,
    /// Preset of its schedule at any length.
    pub preset: Preset,
    /// Time and rule of its prunes.
    pub pruning: &'a Pruning,
}

fn once(seconds: Option<f64>) -> Timed {
    Timed { device: None, wall: seconds.and_then(|s| Spread::of(vec![s])) }
}

/// The arm that keeps a share.
pub(super) fn keeping(name: &str, given: Keep) -> String {
    match share(name) {
        Some(1.0) => "dense".to_owned(),
        Some(share) if given == Keep::Share(share) => "default".to_owned(),
        _ => format!("default@{name}"),
    }
}

/// Seconds of an arm's prunes.
pub(super) fn pruning(arm: &ArmRecord) -> f64 {
    arm.prunes.iter().map(|p| p.seconds.total).sum()
}

/// Measures the requested axes of prunes from one checkpoint at the prune point; measures nothing if there are none.
/// Rungs of the same meaning share an arm.
pub fn forked(training: &Training<'_>, asked: &[Asked]) -> Result<Vec<AxisRecord>, Error> {
    let begun = Instant::now();
    let given = &training.pruning.compression;
    let fork = |asked: &Asked| match asked.axis.measure {
        Measure::Forked { arm, time } => Some((asked.axis, asked.values(|name| Some(arm(name, given.keep))), time)),
        _ => None,
    };
    let forks: Vec<_> = asked.iter().filter_map(fork).collect();
    if forks.is_empty() {
        return Ok(Vec::new());
    }
    let mut arms: Vec<Arm> = Vec::new();
    for Rung { value: name, .. } in forks.iter().flat_map(|(_, rungs, _)| rungs) {
        if arms.iter().all(|arm| arm.name != *name) {
            arms.push(Arm::parse(name, training.pruning).map_err(Error::Usage)?);
        }
    }
    let pruning = Pruning { compression: PruneRule::default(), ..training.pruning.clone() };
    let shared = training.config.clone().pruned(pruning);
    let compared = compare(&training.session, &shared, &arms, &training.folder.join("fork"), None)?;
    let seconds = begun.elapsed().as_secs_f64() / forks.len() as f64;
    let mut out = Vec::new();
    for (axis, rungs, time) in forks {
        let mut axis = AxisRecord { seconds, ..AxisRecord::new(axis) };
        for Rung { name, value } in rungs {
            let found = compared.arms.iter().find(|arm| arm.name == value);
            axis.rungs.extend(found.map(|arm| of_arm(axis.rung(&name).timed(&once(time(arm)), 1.0), arm)));
        }
        axis.notes.push(format!(
            "All rungs continue from one checkpoint, {} Gaussians after iteration {} of {}, with the same seed and loss. Frame rates \
             are taken in turn; training is not repeated.",
            compared.gaussians, compared.prune_point, compared.iterations
        ));
        if compared.arms.iter().all(|arm| arm.psnr.is_none()) {
            axis.notes.push("No view is held out, so quality was not measured.".to_owned());
        }
        out.push(axis.judged());
    }
    Ok(out)
}

fn of_arm(mut rung: RungRecord, arm: &ArmRecord) -> RungRecord {
    rung.accuracy = arm.psnr;
    rung.figures.insert("ssim", arm.ssim.unwrap_or(f64::NAN));
    rung.figures.insert("lpips_vgg", arm.lpips_vgg.unwrap_or(f64::NAN));
    rung.figures.insert("psnr_pruned", arm.psnr_pruned.unwrap_or(f64::NAN));
    rung.figures.insert("gaussians", arm.gaussians as f64);
    rung.figures.insert("ply_bytes", arm.ply_bytes as f64);
    rung.figures.insert("train_s", arm.seconds);
    rung.figures.insert("prune_s", pruning(arm));
    rung.figures.insert("frame_ms", arm.fps.map_or(f64::NAN, |f| 1e3 / f));
    rung.figures.retain(|_, v| v.is_finite());
    rung
}

fn whole(training: &Training<'_>, config: &RunConfig, name: &str) -> Result<RunRecord, Error> {
    training.session.watcher.unless_stopped()?;
    training.session.watcher.note(name);
    let output = Output::new(&training.folder.join("runs").join(name.replace(['/', '='], "-")))?;
    run(&training.session, config, &output, false)
}

fn of_run(rung: RungRecord, results: &RunRecord, time: f64) -> RungRecord {
    let mut rung = rung.timed(&once(Some(time)), 1.0);
    let test = results.test.as_ref();
    rung.accuracy = test.and_then(|t| t.psnr);
    rung.figures.insert("ssim", test.and_then(|t| t.ssim).unwrap_or(f64::NAN));
    rung.figures.insert("lpips_vgg", test.and_then(|t| t.lpips_vgg).unwrap_or(f64::NAN));
    rung.figures.insert("gaussians", results.gaussians.last as f64);
    rung.figures.insert("train_s", results.time.train_s);
    rung.figures.insert("frame_ms", results.frames_per_second.map_or(f64::NAN, |f| 1e3 / f));
    rung.figures.retain(|_, v| v.is_finite());
    rung
}

/// Measures the axis of lengths: schedules scale as a whole, so that each rung is a separate run.
pub fn iterations(training: &Training<'_>, rungs: &[Rung<f64>], mut axis: AxisRecord) -> Result<AxisRecord, Error> {
    let longest = training.config.schedule.iterations;
    for Rung { name, value: share } in rungs {
        let length = ((share * f64::from(longest)).round() as u32).max(1);
        let schedule = training.preset.schedule(Some(length));
        let config = RunConfig { checkpoint_every: 0, schedule, ..training.config.clone() };
        let config = config.pruned(training.pruning.clone());
        let results = whole(training, &config, &format!("iterations-{name}"))?;
        let mut rung = of_run(axis.rung(name), &results, results.time.train_s);
        rung.figures.insert("iterations", f64::from(config.schedule.iterations));
        axis.rungs.push(rung);
    }
    axis.notes.push(format!(
        "Milestones of the schedule, the prune among them, scale with its length; the whole is {longest} iterations. Milestones part at \
         once, so that no two rungs share a checkpoint; each is trained once."
    ));
    Ok(axis)
}

/// The effect of a decision and the opposite choice; `None` if that would enable an effect that the photos do not
/// support.
fn switched(decision: &Decision) -> Option<(Effect, Choice)> {
    match (decision.name.trigger(), decision.on) {
        (Trigger::Always, _) | (Trigger::Photos | Trigger::Request, false) => None,
        (_, true) => Some((decision.name, Choice::Off)),
        (Trigger::Measure, false) => Some((decision.name, Choice::On)),
    }
}

/// Measures the axis of effects: switches each effect to the opposite of the run's choice, if possible.
pub fn effects(training: &Training<'_>, rungs: &[Rung<Switch>], mut axis: AxisRecord) -> Result<AxisRecord, Error> {
    let mut base = training.config.clone().pruned(training.pruning.clone());
    base.checkpoint_every = 0;
    let per_iteration = |r: &RunRecord| r.time.train_s / f64::from(base.schedule.iterations.max(1)) * 1e3;
    let results = whole(training, &base, "effects-default")?;
    let others: Vec<(Effect, Choice)> = if rungs.is_empty() {
        results.effects.iter().filter_map(switched).collect()
    } else {
        rungs.iter().filter_map(|rung| rung.value).collect()
    };
    axis.rungs.push(of_run(axis.rung(UNCHANGED), &results, per_iteration(&results)));
    for (effect, choice) in others {
        let mut config = base.clone();
        config.effects.set(effect, choice);
        let name = format!("{}={}", effect.name(), choice.name());
        let results = whole(training, &config, &format!("effects-{name}"))?;
        axis.rungs.push(of_run(axis.rung(&name), &results, per_iteration(&results)));
    }
    axis.notes.push(format!(
        "Each rung is a run of {} iterations with one effect switched differently from `default`, trained once.",
        base.schedule.iterations
    ));
    Ok(axis)
}
