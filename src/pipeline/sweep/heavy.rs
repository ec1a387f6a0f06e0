//! The axes whose rungs are trainings: kept shares and selectors from one checkpoint, lengths and effects as runs of their own.

use super::axis::{Asked, Axis, fraction};
use super::measure::{Spread, Timed};
use super::results::{AxisRecord, Better, Rung};
use crate::effects::{Choice, Effect, Overrides};
use crate::error::Error;
use crate::pipeline::arm::Arm;
use crate::pipeline::compare::compare;
use crate::pipeline::config::{Compression, Pruning};
use crate::pipeline::records::{ArmRecord, RunRecord};
use crate::pipeline::run::run;
use crate::pipeline::{Output, Preset, RunConfig, Session};
use crate::qirf::select::budget::Keep;
use std::path::Path;

/// Where and how heavy axes train.
pub struct Training<'a> {
    /// Device, limits and audience.
    pub session: Session<'a>,
    /// The folder of the sweep.
    pub folder: &'a Path,
    /// The whole run.
    pub config: &'a RunConfig,
    /// What its schedule is of, at any length.
    pub preset: Preset,
    /// When and how it prunes.
    pub pruning: &'a Pruning,
}

fn once(seconds: Option<f64>) -> Timed {
    Timed { device: None, wall: seconds.and_then(|s| Spread::of(vec![s])) }
}

/// The arm that a rung of keep or selector is: one for both where they mean the same.
fn arm(axis: Axis, rung: &str, given: Keep) -> String {
    match (axis, rung.parse()) {
        (Axis::Keep, Ok(1.0)) => "dense".to_owned(),
        (Axis::Keep, Ok(share)) if given == Keep::Share(share) => "default".to_owned(),
        (Axis::Keep, _) => format!("default@{rung}"),
        _ => rung.to_owned(),
    }
}

/// Climbs keep and selector, one or both, from one checkpoint at the prune point.
///
/// # Errors
/// As a comparison's.
pub fn forked(training: &Training<'_>, asked: &[&Asked]) -> Result<Vec<AxisRecord>, Error> {
    let given = &training.pruning.compression;
    let mut arms: Vec<Arm> = Vec::new();
    for asked in asked {
        for rung in &asked.rungs {
            let arm = Arm::parse(&arm(asked.axis, rung, given.keep), given).map_err(Error::Usage)?;
            if arms.iter().all(|a| a.name != arm.name) {
                arms.push(arm);
            }
        }
    }
    let shared =
        training.config.clone().pruned(Pruning { compression: Compression::default(), ..training.pruning.clone() });
    let compared = compare(&training.session, &shared, &arms, &training.folder.join("fork"), false)?;
    let common = format!(
        "All rungs go on from one checkpoint, {} Gaussians after iteration {} of {}, with the same seed and loss. Frame rates are taken in \
         turn; training is not repeated.",
        compared.gaussians, compared.prune_point, compared.iterations
    );
    let of = |asked: &&Asked| {
        let mut axis = match asked.axis {
            Axis::Keep => AxisRecord::new(
                Axis::Keep,
                "Share of the Gaussians that is kept",
                ["PSNR / dB", "held-out photos", "ms a frame"],
            ),
            _ => AxisRecord::new(
                Axis::Selector,
                "What a prune ranks by",
                ["PSNR / dB", "held-out photos, at equal count", "s to select and prune"],
            ),
        };
        axis.better = Better::Higher;
        for rung in &asked.rungs {
            let name = arm(asked.axis, rung, given.keep);
            let Some(found) = compared.arms.iter().find(|a| a.name == name) else { continue };
            axis.rungs.push(of_arm(asked.axis, rung, found));
        }
        axis.notes.push(common.clone());
        if compared.arms.iter().all(|a| a.psnr.is_none()) {
            axis.notes.push("No view is held out, so quality was not measured.".to_owned());
        }
        axis.judged([
            "these rungs differ in what they keep, not in what they do.",
            "the held-out views cannot tell these rungs apart.",
        ])
    };
    Ok(asked.iter().map(of).collect())
}

fn of_arm(axis: Axis, name: &str, arm: &ArmRecord) -> Rung {
    let pruning: f64 = arm.prunes.iter().map(|p| p.seconds.total).sum();
    let rung = Rung::new(axis, name);
    let mut rung = match axis {
        Axis::Keep => rung.timed(&once(arm.fps.map(|f| 1.0 / f)), 1e3),
        _ => rung.timed(&once((!arm.prunes.is_empty()).then_some(pruning)), 1.0),
    };
    rung.accuracy = arm.psnr;
    rung.figures.insert("ssim", arm.ssim.unwrap_or(f64::NAN));
    rung.figures.insert("lpips_vgg", arm.lpips_vgg.unwrap_or(f64::NAN));
    rung.figures.insert("psnr_pruned", arm.psnr_pruned.unwrap_or(f64::NAN));
    rung.figures.insert("gaussians", arm.gaussians as f64);
    rung.figures.insert("ply_bytes", arm.ply_bytes as f64);
    rung.figures.insert("train_s", arm.seconds);
    rung.figures.insert("prune_s", pruning);
    rung.figures.insert("frame_ms", arm.fps.map_or(f64::NAN, |f| 1e3 / f));
    rung.figures.retain(|_, v| v.is_finite());
    rung
}

/// One whole run.
fn whole(training: &Training<'_>, config: &RunConfig, name: &str) -> Result<RunRecord, Error> {
    training.session.watcher.unless_stopped()?;
    training.session.watcher.note(name);
    let output = Output::new(&training.folder.join("runs").join(name.replace(['/', '='], "-")))?;
    run(&training.session, config, &output, false)
}

fn of_run(axis: Axis, name: &str, results: &RunRecord, seconds: f64) -> Rung {
    let mut rung = Rung::new(axis, name).timed(&once(Some(seconds)), 1.0);
    let test = results.test.as_ref();
    rung.accuracy = test.and_then(|t| t.psnr);
    rung.figures.insert("ssim", test.map_or(f64::NAN, |t| t.ssim));
    rung.figures.insert("lpips_vgg", test.and_then(|t| t.lpips_vgg).unwrap_or(f64::NAN));
    rung.figures.insert("gaussians", results.gaussians.last as f64);
    rung.figures.insert("train_s", results.time.train_s);
    rung.figures.insert("frame_ms", results.frames_per_second.map_or(f64::NAN, |f| 1e3 / f));
    rung.figures.retain(|_, v| v.is_finite());
    rung
}

/// Climbs the axis of lengths: schedules scale as a whole, so that each rung is a run of its own.
///
/// # Errors
/// As a run's.
pub fn iterations(training: &Training<'_>, rungs: &[String]) -> Result<AxisRecord, Error> {
    let mut axis =
        AxisRecord::new(Axis::Iterations, "Length of the run", ["PSNR / dB", "held-out photos", "s of training"]);
    axis.better = Better::Higher;
    let longest = training.config.schedule.iterations;
    for name in rungs {
        let length = ((fraction(name).unwrap_or(1.0) * f64::from(longest)).round() as u32).max(1);
        let schedule = training.preset.schedule(Some(length));
        let config = RunConfig { checkpoint_every: 0, schedule, ..training.config.clone() };
        let config = config.pruned(training.pruning.clone());
        let results = whole(training, &config, &format!("iterations-{name}"))?;
        let mut rung = of_run(Axis::Iterations, name, &results, results.time.train_s);
        rung.figures.insert("iterations", f64::from(config.schedule.iterations));
        axis.rungs.push(rung);
    }
    axis.notes.push(format!(
        "Milestones of the schedule, the prune among them, scale with its length; the whole is {longest} iterations. Milestones part at \
         once, so that no two rungs share a checkpoint; each is trained once."
    ));
    Ok(axis.judged(["every rung trained for as long.", "the held-out views cannot tell these lengths apart."]))
}

/// Climbs the axis of effects: each that can be switched the other way than the run has it.
///
/// # Errors
/// As a run's.
pub fn effects(training: &Training<'_>, rungs: &[String]) -> Result<AxisRecord, Error> {
    let mut axis =
        AxisRecord::new(Axis::Effects, "What is simulated", ["PSNR / dB", "held-out photos", "ms an iteration"]);
    axis.better = Better::Higher;
    let mut base = training.config.clone().pruned(training.pruning.clone());
    base.checkpoint_every = 0;
    let per_iteration = |r: &RunRecord| r.time.train_s / f64::from(base.schedule.iterations.max(1)) * 1e3;
    let results = whole(training, &base, "effects-default")?;
    let others: Vec<(Effect, Choice)> = if rungs.is_empty() {
        let switched = |effect: Effect| {
            let decision = results.effects.iter().find(|d| d.name == effect)?;
            match (effect, decision.on) {
                (Effect::Cameras, _) => None,
                (_, true) => Some((effect, Choice::Off)),
                // What photos do not have cannot be switched on.
                (Effect::ViewDependence | Effect::Exposure | Effect::Antialias, false) => Some((effect, Choice::On)),
                _ => None,
            }
        };
        Effect::ALL.into_iter().filter_map(switched).collect()
    } else {
        let named = rungs.iter().filter(|r| *r != "default");
        named.map(|r| Overrides::parse(r)).collect::<Result<_, _>>().map_err(Error::Usage)?
    };
    axis.rungs.push(of_run(Axis::Effects, "default", &results, per_iteration(&results)));
    for (effect, choice) in others {
        let mut config = base.clone();
        config.effects.set(effect, choice);
        let state = match choice {
            Choice::On => "on",
            Choice::Off => "off",
            Choice::Auto => "auto",
        };
        let name = format!("{}={state}", effect.name());
        let results = whole(training, &config, &format!("effects-{name}"))?;
        axis.rungs.push(of_run(Axis::Effects, &name, &results, per_iteration(&results)));
    }
    axis.notes.push(format!(
        "Each rung is a run of {} iterations with one effect the other way than `default` has it, trained once.",
        base.schedule.iterations
    ));
    Ok(axis.judged([
        "none of these effects is a large part of an iteration on this scene.",
        "the scene calls for none of these effects.",
    ]))
}
