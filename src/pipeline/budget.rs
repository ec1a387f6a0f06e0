//! Checks that a job fits the device, before its work starts: its memory, and the buffers that its kernels can bind.

use super::effects;
use super::evaluate::Evaluator;
use super::pair_capacity;
use super::prepare::{Opened, Prepared};
use super::start::Start;
use super::virtual_views;
use crate::effects::Effect;
use crate::gaussians::Gaussians;
use crate::gaussians::resident::Resident;
use crate::gpu::{Device, LargestBuffer, staging_bytes};
use crate::job::config::PruneRule;
use crate::job::{Error, Relief, RunConfig, Session, host_memory};
use crate::qirf::study::{self, Basis};
use crate::render::{Beside, LEAST_PAIRS, Renderer, Style, Uses, binds, largest};
use crate::response::Wanted;
use crate::scene::{DepthMap, Resize, Scene, camera};
use crate::train::checkpoint::Snapshot;
use crate::train::{PhotoNeeds, Trainer, TrainerNeeds, responses_bytes};
use crate::wording::mebibytes;

/// Assumed growth of a run's number of Gaussians, as far as `--max-gaussians` allows.
const GROWTH: usize = 4;
/// Assumed ratio of a grown block's Gaussians to those that it hands on.
const GROWN: f64 = 1.5;
const MOST_BLOCKS: usize = 1024;
/// Bytes of a pixel on the host: as it was drawn, as colours, and encoded.
const HOST_PIXEL: u64 = 32;

/// What a job needs of a device.
#[derive(Default)]
struct Needed {
    bytes: u64,
    /// The largest buffer, as far as it decides whether the job fits.
    largest: LargestBuffer,
}

impl From<u64> for Needed {
    fn from(bytes: u64) -> Self {
        Self { bytes, ..Self::default() }
    }
}

impl Needed {
    /// True if the device has it.
    fn fits(&self, device: &Device) -> bool {
        self.bytes <= device.memory_limit() && self.largest.bytes <= device.info().max_buffer_bytes
    }
}

/// The needs of a run, as foreseen before its start.
#[derive(Clone, Copy, Debug)]
pub struct Foreseen {
    /// Gaussians that it plans to grow to, or four times its initial ones, or the largest number allowed if that is less.
    pub gaussians: usize,
    /// Bytes of device memory with that many.
    pub bytes: u64,
}

/// The needs of a run that begins now on photos of full size: no photo is loaded. `scene` is the configuration's, of which
/// [`Scene::require_photos`] has left the views.
///
/// # Errors
/// Those of the initial model, and of [`for_run`].
pub fn foreseen(session: &Session<'_>, config: &RunConfig, scene: Scene) -> Result<Foreseen, Error> {
    let opened = Opened::of(&config.selection(), Resize::Full, scene).with_depths(session.watcher);
    let largest = opened.train_pixels().into_iter().max().unwrap_or(0);
    let start = Start::of(config, &opened.scene, largest, session.watcher)?;
    for_run(session, config, &opened, &start)
}

/// The needs of a run with this start.
///
/// # Errors
/// [`Error::Memory`] if the device allows less; [`Error::Buffer`] if its kernels cannot bind the run's largest buffer; those of
/// [`Session::method`].
pub fn for_run(session: &Session<'_>, config: &RunConfig, opened: &Opened, start: &Start) -> Result<Foreseen, Error> {
    let (device, method) = (session.device, session.method(config)?);
    let schedule = &config.schedule;
    let from = if let Start::Resumed(checkpoint) = start { checkpoint.snapshot.iteration + 1 } else { 1 };
    let grows = (from..=schedule.iterations).any(|i| schedule.densifies(i));
    // Points are thinned to the limit, a model is not; an interrupted run has noted its initial number.
    let first = match start {
        Start::Model(model) => model.len(),
        Start::Points(n) | Start::Random(n) => (*n).min(config.max_gaussians),
        Start::Resumed(checkpoint) => checkpoint.notes.initial,
    };
    let pixels = opened.train_pixels();
    let planned = schedule.growth.and_then(|plan| plan.for_photos(&pixels, schedule.iterations).gaussians);
    let most_grown = planned.map_or(first.saturating_mul(GROWTH), |n| n.max(first));
    let grown = if grows { most_grown.min(config.max_gaussians) } else { first };
    let size = opened.size();
    let fixed = TrainerNeeds {
        size,
        photos: pixels.iter().map(|pixels| 4 * pixels).collect(),
        degree: config.sh_degree.max(start.degree()),
        // Which effects the scene calls for is not known yet.
        exposure: config.effects.allow(Effect::Exposure),
        poses: config.effects.allow(Effect::Poses),
        depths: if config.effects.allow(Effect::Depth) { opened.depth_bytes() } else { 0 },
        masked: opened.scene.has_masks(),
        method,
        style: effects::style(|effect| config.effects.allow(effect)),
        halves: schedule.halves(1),
        grows,
        ..TrainerNeeds::default()
    };
    let needed = |gaussians| of_run(device, config, &fixed, gaussians, 0);
    let now = if matches!(start, Start::Resumed(_)) { start.len() } else { first };
    // What a resumed run has pruned does not grow again.
    let expected = if matches!(start, Start::Resumed(_)) && !grows { now } else { grown.max(now) };
    let fitting = largest(expected.max(config.max_gaussians), |n| needed(n).fits(device));
    if fitting < config.max_gaussians {
        tracing::info!("there is room for about {fitting} Gaussians");
    }
    let relief = match (start, fitting) {
        (Start::Resumed(_), _) => Relief::OtherDevice,
        (_, 0) => Relief::None,
        (Start::Model(_), most) if most < now => Relief::SmallerModel,
        (_, most) => {
            let fits = |degree: &usize| {
                let fixed = TrainerNeeds { degree: *degree, ..fixed.clone() };
                of_run(device, config, &fixed, expected, 0).fits(device)
            };
            let degree = (start.degree()..fixed.degree).rev().find(fits);
            Relief::Gaussians { most, degree: degree.and_then(|degree| u8::try_from(degree).ok()) }
        }
    };
    // Where not even one Gaussian fits, a buffer for pictures is too large.
    let Needed { bytes, largest } = needed(expected);
    let largest = if fitting == 0 { needed(1).largest } else { largest };
    let bytes = check(device, "the run", expected, size, Needed { bytes, largest }, relief)?;
    Ok(Foreseen { gaussians: expected, bytes })
}

/// Bytes of device memory that the run of a block will need, which begins with or continues from `snapshot`.
///
/// # Errors
/// [`Error::Memory`] if the device allows less; [`Error::Buffer`] if its kernels cannot bind the block's largest buffer.
pub fn for_block(device: &Device, config: &RunConfig, prepared: &Prepared, snapshot: &Snapshot) -> Result<u64, Error> {
    let (schedule, tail) = (&config.schedule, snapshot.tail);
    let grows = (snapshot.iteration + 1..=schedule.iterations).any(|i| schedule.densifies(i));
    let now = snapshot.model.len() - tail;
    let planned = schedule.growth.and_then(|plan| plan.gaussians).unwrap_or(now.saturating_mul(GROWTH));
    let gaussians = if grows { planned.min(config.max_gaussians).max(now) } else { now };
    let degree = config.sh_degree.max(snapshot.model.degree());
    let fixed = TrainerNeeds { degree, grows, ..of_block(config, prepared) };
    let needed = of_run(device, config, &fixed, gaussians, tail);
    check(device, "the block", gaussians + tail, fixed.size, needed, Relief::MoreBlocks)
}

/// The least number of blocks of which each fits the device, on photos of at most `size` and `pixels` in all, for a scene with
/// this many initial Gaussians. What a block sees of the others is taken to be twice what it trains.
///
/// # Errors
/// [`Error::Memory`] or [`Error::Buffer`] if even small blocks do not fit.
pub fn blocks(device: &Device, config: &RunConfig, prepared: &Prepared, initial: usize) -> Result<usize, Error> {
    let planned = config.schedule.growth.and_then(|plan| plan.gaussians).unwrap_or(initial.saturating_mul(GROWTH));
    let whole = planned.min(config.max_gaussians).max(initial);
    let fixed = of_block(config, prepared);
    let needed = |blocks: usize| {
        let gaussians = (whole as f64 / blocks as f64 * if blocks > 1 { GROWN } else { 1.0 }).ceil() as usize;
        let tail = (2 * gaussians).min(whole.saturating_sub(gaussians));
        let Needed { bytes, .. } = of_run(device, config, &fixed, gaussians, tail);
        // A block has parts of photos, of a size that is not known yet.
        let parts = TrainerNeeds { size: [1, 1], ..fixed.clone() };
        Needed { bytes, ..of_run(device, config, &parts, gaussians, tail) }
    };
    let fits = (1..=MOST_BLOCKS).find(|blocks| needed(*blocks).fits(device));
    match fits {
        Some(blocks) => Ok(blocks),
        None => check(device, "the smallest block", whole / MOST_BLOCKS, fixed.size, needed(MOST_BLOCKS), Relief::None)
            .map(|_| 1),
    }
}

/// Bytes of the depth maps that are trained on.
fn depth_bytes(config: &RunConfig, prepared: &Prepared) -> u64 {
    let maps = prepared.train.iter().filter_map(|photo| photo.depth.as_ref());
    if config.depth_loss { maps.map(DepthMap::bytes).sum() } else { 0 }
}

/// Memory needs of a block that grows, without those that its numbers of Gaussians decide.
fn of_block(config: &RunConfig, prepared: &Prepared) -> TrainerNeeds {
    TrainerNeeds {
        size: camera::largest(prepared.train.iter().map(|photo| &photo.camera)),
        photos: prepared.train.iter().map(|photo| 4 * photo.camera.pixels()).collect(),
        degree: config.sh_degree,
        exposure: config.exposure,
        poses: config.poses,
        depths: depth_bytes(config, prepared),
        masked: prepared.scene.has_masks(),
        style: config.style,
        halves: config.schedule.halves(1),
        grows: true,
        ..TrainerNeeds::default()
    }
}

/// The needs of a run with these numbers of Gaussians, trained and seen.
fn of_run(device: &Device, config: &RunConfig, fixed: &TrainerNeeds, gaussians: usize, tail: usize) -> Needed {
    let needs = TrainerNeeds {
        gaussians,
        tail,
        pairs: pair_capacity::estimate(device, gaussians + tail, fixed.size),
        pruning: config.prune.as_ref().map_or(0, |p| studied(gaussians, &p.compression)),
        evaluation: Evaluator::bytes(device, gaussians + tail, fixed.size, fixed.style),
        ..fixed.clone()
    };
    let bytes = Trainer::bytes(device, &needs);
    // Renderers begin with these lists, and grow only where pictures need it.
    let needs = TrainerNeeds { pairs: pair_capacity::initial(device, gaussians + tail), ..needs };
    Needed { bytes, largest: Trainer::largest_buffer(device, &needs) }
}

/// Location of a job's model.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Place {
    /// True if the device holds all of it; else it stays on the host, and the device gets what each picture shows.
    pub whole: bool,
    /// Bytes of device memory that the job is expected to need.
    pub bytes: u64,
}

/// A job that shows a model in pictures.
struct Job {
    what: &'static str,
    gaussians: usize,
    degree: usize,
    size: [u32; 2],
    uses: Uses,
    beside: Beside,
    /// Bytes that it needs with the whole model on the device.
    needed: u64,
    relief: Relief,
}

impl Job {
    /// The whole model if it fits; else parts, if there is room for one.
    fn place(&self, device: &Device) -> Result<Place, Error> {
        let &Self { what, gaussians, degree, size, uses, beside, needed, relief } = self;
        check_picture(size)?;
        let limit = device.memory_limit();
        let whole = needed <= limit && binds(device, gaussians, degree, size, uses, beside);
        let tile = [device.tuning().tile; 2];
        let least = Resident::bytes(1, degree) + beside.each + Renderer::bytes(device, 1, tile, LEAST_PAIRS, uses);
        if !whole && least > limit {
            check(device, what, gaussians, size, needed, relief)?;
        }
        Ok(Place { whole, bytes: needed.min(limit) })
    }
}

/// Refuses pictures that the host cannot hold: parts help the device alone.
fn check_picture([width, height]: [u32; 2]) -> Result<(), Error> {
    let needed = HOST_PIXEL * u64::from(width) * u64::from(height);
    match host_memory::physical() {
        Some(there) if needed > there => Err(Error::Picture { width, height, needed, there }),
        _ => Ok(()),
    }
}

/// Location of a model while pictures of at most `size` are drawn.
///
/// # Errors
/// [`Error::Memory`] if the device has no room for the smallest part.
pub fn for_pictures(device: &Device, model: &Gaussians, size: [u32; 2], style: Style) -> Result<Place, Error> {
    let (gaussians, degree) = (model.len(), model.degree());
    let resident = Resident::bytes(gaussians, degree);
    let needed = resident + staging_bytes(resident) + Evaluator::bytes(device, gaussians, size, style);
    let uses = Uses { style, ..Uses::default() };
    let (what, beside, relief) = ("drawing", Beside::default(), Relief::None);
    Job { what, gaussians, degree, size, uses, beside, needed, relief }.place(device)
}

/// Device memory of the study of `gaussians` Gaussians that a prune needs, and of the pass before it; in bytes.
fn studied(gaussians: usize, compression: &PruneRule) -> u64 {
    study::bytes(gaussians, compression.selector.reads(), &compression.basis)
}

/// Parameters of a compression's memory besides the model.
#[derive(Clone, Debug, Default)]
pub struct CompressNeeds {
    /// Width and height that every picture fits in.
    pub size: [u32; 2],
    /// True if the model's own pictures replace photos.
    pub own_pictures: bool,
    /// Bytes of each training photo.
    pub photos: Vec<u64>,
    /// True if the photos have masks.
    pub masked: bool,
    /// True if each photo has an exposure of its own.
    pub exposure: bool,
    /// The data that the pass over the views gathers.
    pub wanted: Wanted,
    /// Blocks and their solver.
    pub basis: Basis,
    /// Style of rendering.
    pub style: Style,
    /// Largest number of Gaussians that are fine-tuned.
    pub trained: usize,
}

impl CompressNeeds {
    /// The data of a pass over a scene's photos that gathers nothing yet.
    pub fn of_photos(opened: &Opened) -> Self {
        let photos = opened.train_pixels().iter().map(|pixels| 4 * pixels).collect();
        Self { size: opened.size(), photos, masked: opened.scene.has_masks(), ..Self::default() }
    }
}

/// Location of the model in a compression: on the device if it fits there in all stages except fine-tuning.
///
/// # Errors
/// The errors of [`for_run`]: blocks that are solved, and Gaussians that are fine-tuned, must be on the device at once.
pub fn for_compress(device: &Device, model: &Gaussians, needs: CompressNeeds) -> Result<Place, Error> {
    let CompressNeeds { size, own_pictures, photos, masked, exposure, wanted, basis, style, trained } = needs;
    let (gaussians, degree) = (model.len(), model.degree());
    let staged = |bytes: u64| bytes + staging_bytes(bytes);
    let resident = staged(Resident::bytes(gaussians, degree));
    let pairs = pair_capacity::estimate(device, gaussians, size);
    let evaluates = resident + Evaluator::bytes(device, gaussians, size, style);
    let passes = if own_pictures {
        virtual_views::bytes(device, gaussians, size, pairs, style, wanted)
    } else {
        let photos = PhotoNeeds { size, bytes: &photos, masked, exposure };
        responses_bytes(device, gaussians, pairs, photos, (style, wanted))
    };
    let solves = wanted.channels;
    let studied = if solves { study::bytes(gaussians, wanted, &basis) } else { 0 };
    let whole = evaluates.max(resident + studied).max(resident + passes + wanted.bytes(gaussians));
    let uses = Uses { purpose: wanted.purpose(), responses: true, style };
    let relief = if own_pictures { Relief::SmallerPictures } else { Relief::None };
    let (what, beside) = ("the compression", wanted.beside(0));
    let place = Job { what, gaussians, degree, size, uses, beside, needed: whole, relief }.place(device)?;

    let trainer = TrainerNeeds {
        gaussians: trained,
        pairs: pair_capacity::estimate(device, trained, size),
        size,
        photos,
        depths: 0,
        degree,
        exposure,
        masked,
        style: Style { antialias: true, ..style },
        ..TrainerNeeds::default()
    };
    let trains = if trained > 0 { Trainer::bytes(device, &trainer) } else { 0 };
    let shapes = staged(Resident::bytes(gaussians, 0));
    let studies = if solves && !place.whole { shapes + studied } else { 0 };
    let bytes = check(device, what, gaussians, size, place.bytes.max(trains).max(studies), relief)?;
    Ok(Place { bytes, ..place })
}

fn check(
    device: &Device,
    what: &'static str,
    gaussians: usize,
    [width, height]: [u32; 2],
    needed: impl Into<Needed>,
    relief: Relief,
) -> Result<u64, Error> {
    let Needed { bytes: needed, largest: LargestBuffer { name, bytes } } = needed.into();
    let (there, binds) = (device.memory_limit(), device.info().max_buffer_bytes);
    let device = device.info().name.clone();
    if needed > there {
        return Err(Error::Memory { what, gaussians, width, height, needed, there, device, relief });
    }
    if bytes > binds {
        let (needed, there) = (bytes, binds);
        return Err(Error::Buffer { what, name, gaussians, width, height, needed, there, device, relief });
    }
    tracing::info!("{what} needs about {} of device memory, of {}", mebibytes(needed), mebibytes(there));
    Ok(needed)
}
