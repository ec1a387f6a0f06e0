//! `qirf-vk compare`: one model trained to the prune point, and every arm from that one checkpoint with the same seed, loss
//! and iterations.

use super::checkpoint::Checkpoint;
use super::config::{Compression, Pruning, RunConfig};
use super::evaluate::Evaluator;
use super::job::{Job, Stage};
use super::output::Output;
use super::prepare::{Start, open};
use super::records::{ArmRecord, CompareRecord, RunRecord};
use super::watcher::Watcher;
use super::{budget, run};
use crate::error::Error;
use crate::gaussians::formats;
use crate::gaussians::resident::Resident;
use crate::gpu::Device;
use crate::metrics::Networks;
use crate::qirf::select::Selector;
use crate::qirf::select::budget::{Budget, Keep};
use std::path::Path;
use std::time::Instant;

/// Rounds in which the arms' frame rates are taken in turn.
const ROUNDS: usize = 5;

/// One way to go on from the prune point.
#[derive(Clone, Debug, PartialEq)]
pub struct Arm {
    /// Its name, as it was asked for: a folder's name too.
    pub name: String,
    /// How it prunes; the dense arm does not.
    pub compression: Option<Compression>,
}

impl Arm {
    /// Reads `dense`, `default`, `paper`, or a selector's name with any of `:BUDGET`, `+merge`, `-detail` and `@SHARE` after
    /// it. A selector alone divides its count per block and does not merge. `given` is what `default` stands for, and
    /// gives every arm its share, its detail and its blocks.
    ///
    /// # Errors
    /// A sentence that says what is wrong.
    pub fn parse(text: &str, given: &Compression) -> Result<Self, String> {
        let name = text.to_owned();
        let (rest, keep) = match text.split_once('@') {
            None => (text, given.keep),
            Some((rest, share)) => {
                let share = share.parse::<f64>().ok().filter(|s| *s > 0.0 && *s <= 1.0);
                (rest, Keep::Share(share.ok_or_else(|| format!("'{text}': write a share such as 0.2 after @"))?))
            }
        };
        let (rest, without_detail) = rest.strip_suffix("-detail").map_or((rest, false), |rest| (rest, true));
        let (rest, merge) = rest.strip_suffix("+merge").map_or((rest, false), |rest| (rest, true));
        let (selector, budget) = rest.split_once(':').map_or((rest, None), |(s, b)| (s, Some(b)));
        let named = |budget: &str| match budget {
            "per-block" => Ok(Budget::PerBlock),
            "hybrid" => Ok(Budget::Hybrid),
            "global" => Ok(Budget::Global),
            other => Err(format!("'{text}': there is no budget '{other}'; choose per-block, hybrid or global")),
        };
        let mut compression = match selector {
            "dense" => return Ok(Self { name, compression: None }),
            "default" => given.clone(),
            "paper" => Compression::paper(),
            selector => Compression {
                selector: selector.parse::<Selector>().map_err(|e| format!("{e}, or default, paper or dense"))?,
                budget: Budget::PerBlock,
                merge: false,
                ..given.clone()
            },
        };
        if selector != "paper" || keep != given.keep {
            compression.keep = keep;
        }
        if let Some(budget) = budget {
            compression.budget = named(budget)?;
        }
        compression.merge |= merge;
        if without_detail {
            compression.detail = 0.0;
        }
        Ok(Self { name, compression: Some(compression) })
    }

    /// Its folder's name, which every file system allows.
    #[must_use]
    pub fn folder(name: &str) -> String {
        name.replace([':', '@'], "-")
    }

    /// The arm's run: the shared one's, but for how it prunes.
    fn configuration(&self, shared: &RunConfig) -> RunConfig {
        let prune = match (&self.compression, &shared.prune) {
            (Some(compression), Some(pruning)) => Some(Pruning { compression: compression.clone(), ..pruning.clone() }),
            (None, Some(pruning)) => Some(Pruning { at: Vec::new(), ..pruning.clone() }),
            _ => None,
        };
        RunConfig { prune, checkpoint_every: 0, ..shared.clone() }
    }
}

/// Compares `arms` on one scene; everything lies in `folder`. With `resume`, what an earlier comparison of the same
/// options finished there is taken over.
///
/// # Errors
/// Anything from scene to disk; [`Error::Interrupted`].
pub fn compare(
    device: &Device,
    (shared, arms): (&RunConfig, &[Arm]),
    folder: &Path,
    networks: &Networks,
    host_bytes: u64,
    resume: bool,
    watcher: &(dyn Watcher + Sync),
) -> Result<CompareRecord, Error> {
    let begun = Instant::now();
    let output = Output::new(folder)?;
    let opened = open(&shared.selection())?;
    let fork = run::found(&output, resume, watcher)?;
    let of = fork.as_ref().map(|c| c.notes.config.clone());
    let start = match fork {
        Some(c) => Start::Resumed(Box::new(c)),
        None => Start::of(shared, &opened)?,
    };
    let estimated_bytes = budget::for_run(device, shared, &opened, &start)?;
    let means = (host_bytes, &output);
    let (stage, shared) = Stage::load(device, (opened, shared), means, networks, watcher, (begun, estimated_bytes))?;
    let (shared, written) = (&shared, shared.written()?);
    run::same_run(&output, of, &written)?;
    Output::text(&output.config(), &written)?;
    let at = shared.prune.as_ref().and_then(|p| p.iterations(shared.schedule.iterations).first().copied());
    let at = at.unwrap_or(shared.schedule.iterations);
    let fork = {
        let mut job = Job::start(&stage, shared, &output, start)?;
        job.train(at)?;
        job.checkpoint()?
    };
    fork.write(&output.checkpoint())?;

    let mut results = Vec::new();
    for arm in arms {
        watcher.note(&format!("{} ({} of {})", arm.name, results.len() + 1, arms.len()));
        results.push(finish(
            &stage,
            arm,
            shared,
            &fork,
            &output.folder().join("arms").join(Arm::folder(&arm.name)),
            resume,
        )?);
    }
    frame_rates(&stage, shared, &mut results, folder)?;
    Ok(CompareRecord {
        schema: 1,
        version: env!("CARGO_PKG_VERSION"),
        device: device.info().clone(),
        scene: shared.scene.display().to_string(),
        iterations: shared.schedule.iterations,
        prune_point: at,
        gaussians: fork.snapshot.model.len(),
        arms: results,
    })
}

/// Takes one arm from the fork to its end, or takes over what is there of it.
fn finish(
    stage: &Stage<'_>,
    arm: &Arm,
    shared: &RunConfig,
    fork: &Checkpoint,
    folder: &Path,
    resume: bool,
) -> Result<ArmRecord, Error> {
    let output = Output::new(folder)?;
    let config = arm.configuration(shared);
    let (written, file) = (config.written()?, folder.join("arm.json"));
    let there = || std::fs::read_to_string(output.config()).is_ok_and(|text| text == written);
    if resume && there() {
        let read = std::fs::read_to_string(&file).ok().and_then(|text| serde_json::from_str(&text).ok());
        if let Some(result) = read {
            return Ok(result);
        }
    }
    let mut job = Job::start(stage, &config, &output, Start::Resumed(Box::new(fork.clone())))?;
    let psnr_pruned = if arm.compression.is_some() {
        job.prune_now()?;
        job.psnr()?
    } else {
        // The dense arm goes on with the same loss.
        job.fine_tune();
        None
    };
    job.train(config.schedule.iterations)?;
    let result = arm_record(&arm.name, fork.snapshot.model.len(), psnr_pruned, job.finish()?);
    let text = serde_json::to_string(&result).map_err(|e| Error::encoding("arm.json", e))?;
    Output::text(&file, &text)?;
    Output::text(&output.config(), &written)?;
    Ok(result)
}

fn arm_record(name: &str, before: usize, psnr_pruned: Option<f64>, run: RunRecord) -> ArmRecord {
    let test = run.test.as_ref();
    ArmRecord {
        name: name.to_owned(),
        psnr: test.and_then(|t| t.psnr),
        ssim: test.map(|t| t.ssim),
        lpips_vgg: test.and_then(|t| t.lpips_vgg),
        gaussians: run.gaussians.last,
        removed: 1.0 - run.gaussians.last as f64 / before.max(1) as f64,
        ply_bytes: run.model_bytes,
        fps: run.frames_per_second,
        seconds: run.time.train_s,
        psnr_pruned,
        prunes: run.prunes,
        views: run.views,
    }
}

/// Times all arms' models in turn, so that whatever else the machine does falls on all of them.
fn frame_rates(stage: &Stage<'_>, shared: &RunConfig, arms: &mut [ArmRecord], folder: &Path) -> Result<(), Error> {
    let settings = shared.style().over(stage.prepared.background);
    let most = arms.iter().map(|a| a.gaussians).max().unwrap_or(0);
    let mut evaluator = Evaluator::new(stage.device, settings, most, stage.prepared.views())?;
    evaluator.compare_as(shared.exposure);
    let model = |arm: &ArmRecord| Output::new(&folder.join("arms").join(Arm::folder(&arm.name))).map(|o| o.model());
    let files: Vec<_> = arms.iter().map(model).collect::<Result<_, _>>()?;
    let mut rates: Vec<Vec<f64>> = vec![Vec::new(); arms.len()];
    for _ in 0..ROUNDS {
        for (file, rates) in files.iter().zip(&mut rates) {
            let model = Resident::upload(stage.device, &formats::read(file)?.gaussians)?;
            rates.extend(evaluator.frames_per_second(&model, &stage.prepared)?);
        }
    }
    for (arm, mut rates) in arms.iter_mut().zip(rates) {
        rates.sort_by(f64::total_cmp);
        arm.fps = rates.get(rates.len() / 2).copied();
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn arms_by_name() {
        let given = Compression { merge: true, ..Compression::default() };
        let arm = |text: &str| Arm::parse(text, &given).unwrap().compression;
        assert_eq!(arm("dense"), None);
        assert_eq!(arm("default"), Some(given.clone()));
        let css = arm("css").unwrap();
        assert_eq!((css.selector, css.budget, css.merge), (Selector::Css, Budget::PerBlock, false));
        let all = arm("gnso:global+merge-detail@0.1").unwrap();
        assert_eq!((all.budget, all.merge, all.detail, all.keep), (Budget::Global, true, 0.0, Keep::Share(0.1)));
        assert_eq!(arm("paper").unwrap().keep, Keep::Paper { kappa: 0.22 });
        for wrong in ["", "nothing", "css:half", "css@2", "css@", "../up"] {
            assert!(Arm::parse(wrong, &given).is_err(), "{wrong}");
        }
    }
}
