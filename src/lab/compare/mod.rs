//! `qirf-vk compare`: one model trained to the prune point, and every arm continued from that checkpoint with the same
//! seed, loss and iterations.

mod arm;
mod page;
mod paired;
mod records;

pub use arm::{Arm, Grown, help as arms_help};
pub use paired::Paired;
pub use records::{ArmRecord, CompareRecord};

use crate::gaussians::formats::{self, crc32};
use crate::gaussians::resident::Resident;
use crate::job::records::RunRecord;
use crate::job::sealed::{open, seal};
use crate::job::{Error, Output, RunConfig, Session};
use crate::lab::figures::Figures;
use crate::pipeline::active_run::{ActiveRun, tell_of_checkpoint};
use crate::pipeline::checkpoint::Checkpoint;
use crate::pipeline::evaluate::Evaluator;
use crate::pipeline::prepare::{Prepared, crc32_of_file};
use crate::pipeline::setup::{Setup, tuned};
use crate::pipeline::start::Start;
use crate::scene::median;
use serde_json::json;
use std::path::{Path, PathBuf};

/// Writes the figures of a comparison into its folder: `compare.json`, `compare.csv` and `compare.html`.
pub fn write(compared: &CompareRecord, folder: &Path) -> Result<(), Error> {
    FIGURES.write(folder, compared, &compared.csv(), &page::page(compared, folder))
}

/// The figures of a finished comparison.
const FIGURES: Figures = Figures(["compare.json", "compare.csv", "compare.html"]);

/// Number of rounds in which the arms' frame rates are measured in turn.
const ROUNDS: usize = 5;

/// The configuration and the folder of each part of a comparison: `folder` itself without a number of seeds; otherwise
/// one subfolder per seed, from the configuration's own seed on.
pub fn of_seeds(shared: &RunConfig, seeds: Option<u32>, folder: &Path) -> Vec<(RunConfig, PathBuf)> {
    let of_seed = |k: u32| {
        let seed = shared.seed.wrapping_add(k);
        (RunConfig { seed, ..shared.clone() }, folder.join(CompareRecord::folder_of(seed)))
    };
    seeds.map_or_else(|| vec![(shared.clone(), folder.to_owned())], |n| (0..n).map(of_seed).collect())
}

/// Compares `arms` on one scene with `seeds` seeds (at least one), from the configuration's own on, each in a folder of
/// its own inside `folder`.
pub fn compare_seeds(
    session: &Session<'_>,
    shared: &RunConfig,
    arms: &[Arm],
    seeds: u32,
    folder: &Path,
    resume: bool,
) -> Result<CompareRecord, Error> {
    let parts = of_seeds(shared, Some(seeds.max(1)), folder);
    let of_part = |k: usize| {
        session.watcher.note(&format!("seed {} ({} of {seeds})", parts[k].0.seed, k + 1));
        part(session, arms, (&parts, k), (folder, Some(resume)))
    };
    let first = of_part(0)?;
    Ok(first.mean(&(1..parts.len()).map(of_part).collect::<Result<Vec<_>, _>>()?))
}

/// Compares `arms` on one scene with one seed; all results go to `folder`. With `resume`, finished parts of an earlier comparison
/// with the same options are reused, and interrupted ones continued; `None` if none may continue this one later either.
pub fn compare(
    session: &Session<'_>,
    shared: &RunConfig,
    arms: &[Arm],
    folder: &Path,
    resume: Option<bool>,
) -> Result<CompareRecord, Error> {
    part(session, arms, (&of_seeds(shared, None, folder), 0), (folder, resume))
}

/// Compares `arms` with one seed: part `k` of a comparison in the folder `whole`. The first part of one that begins anew takes what is
/// left of an earlier one: no part may continue from its checkpoints, and its figures would mark this one as finished.
fn part(
    session: &Session<'_>,
    arms: &[Arm],
    (parts, k): (&[(RunConfig, PathBuf)], usize),
    (whole, resumes): (&Path, Option<bool>),
) -> Result<CompareRecord, Error> {
    let resume = resumes == Some(true);
    let (shared, folder) = &parts[k];
    let output = Output::new(folder)?;
    let device = tuned(session, shared, &output, resume)?;
    let session = &Session { device: &device, ..*session };
    let (setup, start) = Setup::load(session, shared, &output, resume)?;
    if !resume && k == 0 {
        for (_, folder) in parts {
            Output::new(folder)?.complete();
        }
    }
    setup.write_config(&start, &output)?;
    FIGURES.remove(whole);
    let iterations = setup.config.schedule.iterations;
    let prunes = setup.config.prune.as_ref().map(|p| p.iterations(iterations)).unwrap_or_default();
    let prune_point = prunes.first().copied().unwrap_or(iterations);
    let fork = {
        let mut run = ActiveRun::start(&setup, &setup.config, &output, start)?;
        run.train(prune_point)?;
        run.checkpoint()?
    };
    fork.write(&output.checkpoint())?;

    let mut records = Vec::new();
    for arm in arms {
        session.watcher.note(&format!("{} ({} of {})", arm.name, records.len() + 1, arms.len()));
        let finished = finish(&setup, arm, &fork, folder, resume);
        if let Err(error) = &finished
            && resumes.is_some()
            && !arm_output(folder, &arm.name)?.checkpoint().is_file()
        {
            tell_of_checkpoint(session.watcher, error, fork.snapshot.iteration);
        }
        records.push(finished?);
    }
    frame_rates(&setup, &mut records, folder)?;
    Ok(CompareRecord {
        schema: 1,
        version: env!("CARGO_PKG_VERSION"),
        device: session.device.tuned(),
        scene: setup.config.scene.display().to_string(),
        seeds: vec![setup.config.seed],
        iterations,
        prune_point,
        gaussians: fork.snapshot.model.len(),
        arms: records,
    }
    .with_differences())
}

/// The folder of an arm, inside that of the comparison.
fn arm_output(folder: &Path, name: &str) -> Result<Output, Error> {
    Output::new(&folder.join("arms").join(Arm::folder(name)))
}

/// Takes one arm to its end, from the fork or from the beginning; or from its own checkpoint, if an earlier comparison was interrupted
/// there; or reuses its result.
///
/// `arm.json` names the fork while the arm is trained, then also has the result.
fn finish(setup: &Setup<'_>, arm: &Arm, fork: &Checkpoint, folder: &Path, resume: bool) -> Result<ArmRecord, Error> {
    let output = arm_output(folder, &arm.name)?;
    let gaussians = fork.snapshot.model.len();
    let config = arm.configuration(&setup.config, gaussians);
    let (config_text, file) = (config.written_in(output.folder())?, output.folder().join("arm.json"));
    let from = crc32(fork.snapshot.model.bytes());
    // An arm whose record is unreadable, or of another fork, is trained again.
    let read = if resume { std::fs::read(&file).ok().and_then(|bytes| open(&bytes).ok()) } else { None };
    let read = read.filter(|read| read["fork_crc32"] == from);
    if let Some(read) = &read
        && std::fs::read_to_string(output.config()).is_ok_and(|text| text == config_text)
        && crc32_of_file(&output.model()).is_ok_and(|model| read["model_crc32"] == model)
        && let Ok(record) = serde_json::from_value(read["record"].clone())
    {
        output.complete();
        return Ok(record);
    }
    let begun = |psnr_pruned: Option<f64>| {
        Output::json(&file, "arm.json", &seal(json!({ "fork_crc32": from, "psnr_pruned": psnr_pruned })))
    };
    let own = read.as_ref().and_then(|_| Checkpoint::read(&output.checkpoint()).ok());
    let own = own.filter(|own| own.notes.config == config_text);
    let past = own.as_ref().is_some_and(|own| own.snapshot.iteration > fork.snapshot.iteration);
    let mut psnr_pruned = read.filter(|_| past).and_then(|read| read["psnr_pruned"].as_f64());
    let start = if let Some(own) = own {
        setup.session.watcher.note(&format!("{} resumes after iteration {}", arm.name, own.snapshot.iteration));
        Start::Resumed(Box::new(own))
    } else {
        // From here on, the folder may hold files of two arms.
        output.complete();
        begun(None)?;
        beginning(setup, arm, &config, fork)?
    };
    let mut run = ActiveRun::start(setup, &config, &output, start)?;
    run.train(fork.snapshot.iteration)?;
    if !past && arm.compression.is_some() && arm.twice.is_none() {
        run.prune_now()?;
        if run.pruned() {
            psnr_pruned = run.psnr()?;
            begun(psnr_pruned)?;
        }
    }
    run.train(config.schedule.iterations)?;
    let record = arm_record(&arm.name, gaussians, psnr_pruned, run.finish()?);
    Output::text(&output.config(), &config_text)?;
    let model = crc32_of_file(&output.model())?;
    Output::json(&file, "arm.json", &seal(json!({ "fork_crc32": from, "model_crc32": model, "record": record })))?;
    output.complete();
    Ok(record)
}

/// The state that an arm begins with: the fork, or the beginning of the run.
fn beginning(setup: &Setup<'_>, arm: &Arm, config: &RunConfig, fork: &Checkpoint) -> Result<Start, Error> {
    if arm.grown == Grown::Together {
        return Ok(Start::Resumed(Box::new(fork.clone())));
    }
    let Prepared { scene, train, .. } = &setup.prepared;
    let pixels = train.iter().map(|p| p.camera.pixels()).max().unwrap_or(0);
    Start::of(config, scene, pixels, setup.session.watcher)
}

fn arm_record(name: &str, before: usize, psnr_pruned: Option<f64>, run: RunRecord) -> ArmRecord {
    let test = run.test.as_ref();
    ArmRecord {
        name: name.to_owned(),
        psnr: test.and_then(|t| t.psnr),
        ssim: test.and_then(|t| t.ssim),
        lpips_vgg: test.and_then(|t| t.lpips_vgg),
        gaussians: run.gaussians.last,
        removed: 1.0 - run.gaussians.last as f64 / before.max(1) as f64,
        ply_bytes: run.model_bytes,
        fps: run.frames_per_second,
        seconds: run.time.train_s,
        psnr_pruned,
        prunes: run.prunes,
        cut: run.cut,
        views: run.views,
        ..ArmRecord::default()
    }
}

/// Measures all arms' frame rates in turn, so that other work on the machine affects all of them alike.
fn frame_rates(setup: &Setup<'_>, arms: &mut [ArmRecord], folder: &Path) -> Result<(), Error> {
    let Setup { session, config, prepared, .. } = setup;
    let settings = prepared.settings(config.style);
    let most = arms.iter().map(|a| a.gaussians).max().unwrap_or(0);
    let mut evaluator = Evaluator::new(session.device, settings, most, prepared.views())?;
    evaluator.compare_as(config.exposure);
    let model = |arm: &ArmRecord| arm_output(folder, &arm.name).map(|output| output.model());
    let files: Vec<_> = arms.iter().map(model).collect::<Result<_, _>>()?;
    let mut rates: Vec<Vec<f64>> = vec![Vec::new(); arms.len()];
    for _ in 0..ROUNDS {
        for (file, rates) in files.iter().zip(&mut rates) {
            let model = Resident::upload(session.device, &formats::read(file)?.gaussians)?;
            rates.extend(evaluator.frames_per_second(&model, prepared)?);
        }
    }
    for (arm, mut rates) in arms.iter_mut().zip(rates) {
        arm.fps = median(&mut rates);
    }
    Ok(())
}
