//! `qirf-vk compress`: from a model that is there to a smaller one.

use super::budget::{self, Compressing};
use super::config::{Compression, Pruning, Selection};
use super::evaluate::Evaluator;
use super::output::bytes_on_disk;
use super::pairs;
use super::prepare::{Prepared, open};
use super::prune::{Decision, decide};
use super::records::{
    CompressProtocol, CompressRecord, CompressTimes, Memory, ModelFile, StageScores, TruthKind, ViewStages,
};
use super::virtual_views::{self, Around, OwnPictures};
use super::watcher::Watcher;
use crate::error::Error;
use crate::gaussians::resident::Resident;
use crate::gaussians::{Gaussians, formats};
use crate::gpu::Device;
use crate::metrics::{Networks, Scores};
use crate::qirf::select::budget::Keep;
use crate::render::{Settings, Style};
use crate::response::Responses;
use crate::scene::camera::{self, Camera};
use crate::scene::{Photo, PhotoMemory};
use crate::train::loss::Weights;
use crate::train::schedule::Schedule;
use crate::train::{Options, Trainer};
use std::path::Path;
use std::time::Instant;

/// What to do with a model.
#[derive(Clone, Debug, PartialEq)]
pub struct Job {
    /// How Gaussians are chosen.
    pub compression: Compression,
    /// What they are judged by.
    pub sight: Sight,
    /// How it is rendered: as the model was trained.
    pub style: Style,
    /// Iterations of training after the prune.
    pub fine_tune: u32,
    /// Key of all random numbers.
    pub seed: u32,
}

/// What a model is judged by.
#[derive(Clone, Debug, PartialEq)]
pub enum Sight {
    /// A scene's photos.
    Photos(Selection),
    /// Its own pictures, over a background.
    OwnPictures(Around, [f32; 3]),
}

/// A model and where it was read from, in how many seconds.
pub struct Input<'a> {
    /// Where it lies.
    pub path: &'a Path,
    /// The model.
    pub model: Gaussians,
    /// Seconds that reading it took.
    pub read_s: f64,
}

/// Compresses a model and writes it to `output`, whose extension decides the format. Photos take no more than `host_bytes`
/// of the host's memory.
///
/// # Errors
/// Anything from scene to disk; [`Error::Interrupted`], with nothing written.
pub fn compress(
    device: &Device,
    input: Input<'_>,
    job: &Job,
    output: &Path,
    host_bytes: u64,
    watcher: &(dyn Watcher + Sync),
) -> Result<CompressRecord, Error> {
    let begun = Instant::now();
    let Input { path, model, read_s } = input;
    let input = model_file(path, &model);
    let mut time = CompressTimes { read_s, ..CompressTimes::default() };
    let keep = at_least_one(job.compression.keep, model.len());
    let (views, estimated_bytes) = Views::new(device, &model, job, host_bytes, watcher)?;
    time.truth_s = seconds(begun);

    let mut judge = Judge { device, views: &views, watcher, rounds: views.rounds(job), done: 0, seconds: 0.0 };
    let before = if views.truth == TruthKind::Photos { judge.scores(&model)? } else { Vec::new() };
    let responding = Instant::now();
    let responses = responses(device, &model, &views, job, watcher)?;
    time.responses_s = seconds(responding);

    let resident = Resident::upload(device, &model)?;
    let decided = decide(device, (&resident, model), &job.compression, keep, &responses, job.seed)?;
    let Decision { pruned, keep, model } = decided;
    drop((resident, responses));
    time.merge_s = pruned.seconds.merge;
    time.keep_mask_s = pruned.seconds.total - pruned.seconds.merge;
    watcher.unless_stopped()?;
    let kept: Vec<usize> = (0..keep.len()).filter(|i| keep[*i]).collect();
    let mut model = model.select(&kept);
    let after = judge.scores(&model)?;

    let tuning = Instant::now();
    let mut tuned = Vec::new();
    if job.fine_tune > 0 {
        model = fine_tune(device, &model, &views, job, watcher)?;
        time.fine_tune_s = seconds(tuning);
        tuned = judge.scores(&model)?;
    }
    time.evaluate_s = judge.seconds;
    watcher.unless_stopped()?;
    let writing = Instant::now();
    formats::write(output, &model).map_err(Error::writing)?;
    time.write_s = seconds(writing);
    time.total_s = read_s + seconds(begun);

    let test = views.tell([before, after, tuned]);
    Ok(CompressRecord {
        schema: 1,
        version: env!("CARGO_PKG_VERSION"),
        device: device.info().clone(),
        protocol: views.protocol(job),
        input,
        output: model_file(output, &model),
        prune: pruned,
        test: StageScores::mean(&test),
        views: test,
        time,
        memory: Memory { estimated_bytes, peak_bytes: device.memory_used().1, limit_bytes: device.memory_limit() },
    })
}

fn model_file(path: &Path, model: &Gaussians) -> ModelFile {
    ModelFile { path: path.to_owned(), bytes: bytes_on_disk(path), gaussians: model.len(), sh_degree: model.degree() }
}

fn seconds(since: Instant) -> f64 {
    since.elapsed().as_secs_f64()
}

/// A share of few Gaussians rounds to none, which is no model.
fn at_least_one(keep: Keep, gaussians: usize) -> Keep {
    match keep {
        Keep::Share(share) if share * (gaussians as f64) < 1.0 => Keep::Count(1),
        keep => keep,
    }
}

/// Gaussians that are kept at most.
fn most_kept(keep: Keep, gaussians: usize) -> usize {
    match keep {
        Keep::Share(share) => (share * gaussians as f64).ceil() as usize,
        Keep::Count(count) => count.min(gaussians),
        Keep::Paper { .. } => gaussians,
    }
}

/// What a model is judged by, ready.
struct Views {
    truth: TruthKind,
    /// Views of responses and fine-tuning; without photos they have pixels only where there is fine-tuning.
    train: Vec<Photo>,
    test: Vec<(String, Photo)>,
    /// Of positions' learning rate.
    extent: f64,
    settings: Settings,
}

impl Views {
    /// Views of a model, and the bytes of device memory that the job will need.
    fn new(
        device: &Device,
        model: &Gaussians,
        job: &Job,
        host_bytes: u64,
        watcher: &(dyn Watcher + Sync),
    ) -> Result<(Self, u64), Error> {
        match &job.sight {
            Sight::Photos(selection) => Self::of_photos(device, model, selection, job, host_bytes, watcher),
            Sight::OwnPictures(around, background) => Self::of_itself(device, model, around, *background, job, watcher),
        }
    }

    fn of_photos(
        device: &Device,
        model: &Gaussians,
        selection: &Selection,
        job: &Job,
        host_bytes: u64,
        watcher: &(dyn Watcher + Sync),
    ) -> Result<(Self, u64), Error> {
        let opened = open(selection)?;
        let demand = Compressing {
            size: opened.size(),
            own_pictures: false,
            photos: opened.train_pixels().iter().map(|pixels| 4 * pixels).collect(),
            masked: opened.scene.has_masks(),
            style: job.style,
            trained: model.len(),
        };
        let estimated = budget::for_compress(device, model, demand)?;
        let memory = PhotoMemory { bytes: host_bytes, folder: &std::env::temp_dir() };
        let prepared = opened.load_to_train(memory, watcher)?;
        let settings = job.style.over(prepared.background);
        let Prepared { train, test, extent, .. } = prepared;
        Ok((Self { truth: TruthKind::Photos, train, test, extent, settings }, estimated))
    }

    fn of_itself(
        device: &Device,
        model: &Gaussians,
        around: &Around,
        background: [f32; 3],
        job: &Job,
        watcher: &dyn Watcher,
    ) -> Result<(Self, u64), Error> {
        let size = [around.size.0, around.size.1];
        let trained = if job.fine_tune > 0 { most_kept(job.compression.keep, model.len()) } else { 0 };
        let photos = vec![4 * u64::from(size[0]) * u64::from(size[1]); around.views as usize];
        let demand = Compressing { size, own_pictures: true, photos, masked: false, style: job.style, trained };
        let estimated = budget::for_compress(device, model, demand)?;
        let (style, with_pixels) = ((background, job.style), job.fine_tune > 0);
        let own = OwnPictures::new(device, model, around, style, with_pixels, watcher)?;
        let OwnPictures { train, test, settings } = own;
        let extent = camera::extent(train.iter().map(|v| &v.camera));
        Ok((Self { truth: TruthKind::OwnPictures, train, test, extent, settings }, estimated))
    }

    /// How often the held-out views are scored.
    fn rounds(&self, job: &Job) -> usize {
        1 + usize::from(self.truth == TruthKind::Photos) + usize::from(job.fine_tune > 0)
    }

    fn protocol(&self, job: &Job) -> CompressProtocol {
        let views = self.train.iter().chain(self.test.iter().map(|(_, view)| view));
        CompressProtocol {
            truth: self.truth,
            train_views: self.train.len(),
            test_views: self.test.len(),
            image_size: camera::largest(views.map(|v| &v.camera)),
            background: self.settings.background,
            antialias: self.settings.antialias,
            depth_order: self.settings.depth_order,
            fine_tune: job.fine_tune,
            seed: job.seed,
            compression: job.compression.clone(),
        }
    }

    /// The held-out views with their scores before, after the prune and after fine-tuning, each absent or one a view.
    fn tell(&self, stages: [Vec<Scores>; 3]) -> Vec<ViewStages> {
        let [mut before, mut pruned, mut fine_tuned] = stages.map(Vec::into_iter);
        let mut stages = || StageScores { before: before.next(), pruned: pruned.next(), fine_tuned: fine_tuned.next() };
        self.test.iter().map(|(name, _)| ViewStages { name: name.clone(), scores: stages() }).collect()
    }
}

/// Scores models by the held-out views.
struct Judge<'a> {
    device: &'a Device,
    views: &'a Views,
    watcher: &'a dyn Watcher,
    rounds: usize,
    done: usize,
    seconds: f64,
}

impl Judge<'_> {
    fn scores(&mut self, model: &Gaussians) -> Result<Vec<Scores>, Error> {
        let begun = Instant::now();
        let test = &self.views.test;
        let resident = Resident::upload(self.device, model)?;
        let of_test = test.iter().map(|(_, view)| view);
        let mut evaluator = Evaluator::new(self.device, self.views.settings, model.len(), of_test)?;
        let (done, all, watcher) = (self.done, self.rounds * test.len(), self.watcher);
        let held_out = evaluator.held_out(&resident, test, None, &Networks::default(), &mut |now| {
            watcher.evaluating(done + now, all);
            watcher.unless_stopped()
        })?;
        self.done += test.len();
        self.seconds += seconds(begun);
        Ok(held_out.views.into_iter().map(|v| v.scores).collect())
    }
}

/// How strongly the training views depend on each Gaussian.
fn responses(
    device: &Device,
    model: &Gaussians,
    views: &Views,
    job: &Job,
    watcher: &dyn Watcher,
) -> Result<Responses, Error> {
    let follow = |done: usize| {
        watcher.responding(done, views.train.len());
        watcher.unless_stopped()
    };
    let with_scores = job.compression.selector.reads_scores();
    if views.truth == TruthKind::Photos {
        return trainer(device, model, views, job)?.responses_with(with_scores, follow);
    }
    let cameras: Vec<Camera> = views.train.iter().map(|v| v.camera.clone()).collect();
    let resident = Resident::upload(device, model)?;
    let pairs = pairs::few(device, model.len());
    virtual_views::responses(device, &resident, &cameras, views.settings, (pairs, with_scores), follow)
}

fn trainer(device: &Device, model: &Gaussians, views: &Views, job: &Job) -> Result<Trainer, Error> {
    let end = Schedule::default().position_rate_end;
    let options = Options {
        // A model that is there is where training ends: positions move as slowly, and its number is settled.
        schedule: Schedule {
            iterations: job.fine_tune,
            position_rate: end,
            position_rate_end: end,
            densify_until: 0.0,
            ..Schedule::default()
        },
        settings: views.settings,
        seed: job.seed,
        degree: model.degree(),
        most: model.len(),
        exposure: None,
        weights: Weights { l2: Pruning::L2 as f32, ..Weights::default() },
        averaged: 0..0,
        pairs: pairs::few(device, model.len()),
    };
    Ok(Trainer::new(device, model, views.train.clone(), views.extent, options)?)
}

fn fine_tune(
    device: &Device,
    model: &Gaussians,
    views: &Views,
    job: &Job,
    watcher: &dyn Watcher,
) -> Result<Gaussians, Error> {
    let mut trainer = trainer(device, model, views, job)?;
    while trainer.iteration() < job.fine_tune {
        let progress = trainer.advance(job.fine_tune)?;
        watcher.training(&progress, job.fine_tune);
        watcher.unless_stopped()?;
    }
    Ok(trainer.download()?)
}
