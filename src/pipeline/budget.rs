//! Checks that a job fits the device's memory, before its work starts.

use super::config::{Init, RunConfig};
use super::effects;
use super::evaluate::Evaluator;
use super::pairs;
use super::prepare::Opened;
use super::start::Start;
use super::virtual_views;
use crate::effects::Effect;
use crate::error::{Error, Relief};
use crate::gaussians::Gaussians;
use crate::gaussians::resident::Resident;
use crate::gpu::{Device, staging_bytes};
use crate::qirf::study;
use crate::render::Style;
use crate::response::Wanted;
use crate::train::{Trainer, TrainerNeeds};

/// Assumed growth of a run's number of Gaussians, as far as `--max-gaussians` allows.
const GROWTH: usize = 4;

/// Bytes of device memory that a run will need: with the Gaussians that it plans to grow to, or four times its initial
/// ones, or with the largest number allowed if that is less.
///
/// # Errors
/// [`Error::Memory`] if the device allows less.
pub fn for_run(device: &Device, config: &RunConfig, opened: &Opened, start: &Start) -> Result<u64, Error> {
    let schedule = &config.schedule;
    let grows = (1..=schedule.iterations).any(|i| schedule.densifies(i));
    // Points are thinned to the limit, a model is not; an interrupted run has noted its initial number.
    let first = match start {
        Start::Model(model) => model.len(),
        Start::Points(n) | Start::Random(n) => (*n).min(config.max_gaussians),
        Start::Resumed(checkpoint) => checkpoint.notes.initial,
    };
    let pixels = opened.train_pixels().iter().sum();
    let planned = schedule.growth.and_then(|plan| plan.for_photos(pixels, schedule.iterations).gaussians);
    let most_grown = planned.map_or(first.saturating_mul(GROWTH), |n| n.max(first));
    let grown = if grows { most_grown.min(config.max_gaussians) } else { first };
    let size = opened.size();
    let photos: Vec<u64> = opened.train_pixels().iter().map(|pixels| 4 * pixels).collect();
    let degree = config.sh_degree.max(start.degree());
    let needed = |gaussians: usize| {
        let photos = photos.clone();
        // Which effects the scene calls for is not known yet.
        let exposure = config.effects.allow(Effect::Exposure);
        let masked = opened.scene.has_masks();
        let pairs = pairs::room(gaussians);
        let wanted = config.prune.as_ref().map(|p| p.compression.selector.reads());
        let pruning = wanted.map_or(0, |wanted| study::bytes(gaussians, wanted));
        let (style, halves) = (effects::style(|effect| config.effects.allow(effect)), schedule.halves(1));
        let trainer =
            TrainerNeeds { gaussians, pairs, size, photos, degree, exposure, masked, style, halves, grows, pruning };
        Trainer::bytes(device, &trainer) + Evaluator::bytes(device, gaussians, size, style)
    };
    let now = if matches!(start, Start::Resumed(_)) { start.len() } else { first };
    let expected = grown.max(now);
    let fitting = most(expected.max(config.max_gaussians), |n| needed(n) <= device.memory_limit());
    if fitting < config.max_gaussians {
        tracing::info!("there is room for about {fitting} Gaussians");
    }
    let relief = match fitting {
        0 => Relief::None,
        n if n < now && matches!(config.init, Init::Model(_)) => Relief::SmallerModel,
        n => Relief::Gaussians(n),
    };
    check(device, "the run", expected, size, needed(expected), relief)
}

/// Bytes of device memory that an evaluation will need.
///
/// # Errors
/// As [`for_run`].
pub fn for_eval(device: &Device, opened: &Opened, model: &Gaussians, style: Style) -> Result<u64, Error> {
    let (size, gaussians) = (opened.size(), model.len());
    let resident = Resident::bytes(gaussians, model.degree());
    let needed = resident + staging_bytes(resident) + Evaluator::bytes(device, gaussians, size, style);
    check(device, "the evaluation", gaussians, size, needed, Relief::None)
}

/// Parameters of a compression's memory besides the model.
#[derive(Clone, Debug)]
pub struct CompressNeeds {
    /// Width and height that every picture fits in.
    pub size: [u32; 2],
    /// True if the model's own pictures replace photos.
    pub own_pictures: bool,
    /// Bytes of each training photo.
    pub photos: Vec<u64>,
    /// True if the photos have masks.
    pub masked: bool,
    /// What the pass over the views gathers.
    pub wanted: Wanted,
    /// Style of rendering.
    pub style: Style,
    /// Largest number of Gaussians in a trainer, for responses or for fine-tuning.
    pub trained: usize,
}

/// Bytes of device memory that a compression will need: the largest need of its stages.
///
/// # Errors
/// As [`for_run`].
pub fn for_compress(device: &Device, model: &Gaussians, needs: CompressNeeds) -> Result<u64, Error> {
    let CompressNeeds { size, own_pictures, photos, masked, wanted, style, trained } = needs;
    let (gaussians, degree) = (model.len(), model.degree());
    let resident = Resident::bytes(gaussians, degree);
    let resident = resident + staging_bytes(resident);
    let pairs = pairs::most(device, gaussians);
    let evaluates = resident + Evaluator::bytes(device, gaussians, size, style);
    let studies = resident + study::bytes(gaussians, wanted);
    let responds = resident + virtual_views::bytes(device, gaussians, size, pairs, style) + wanted.bytes(gaussians);
    let trainer = TrainerNeeds {
        gaussians: trained,
        pairs: pairs::most(device, trained),
        size,
        photos,
        degree,
        exposure: false,
        masked,
        style: Style { antialias: true, ..style },
        halves: false,
        grows: false,
        pruning: study::bytes(trained, wanted),
    };
    let trains = if trained > 0 { Trainer::bytes(device, &trainer) + wanted.bytes(trained) } else { 0 };
    let needed = evaluates.max(studies).max(trains).max(if own_pictures { responds } else { 0 });
    let relief = if own_pictures { Relief::SmallerPictures } else { Relief::None };
    check(device, "the compression", gaussians, size, needed, relief)
}

/// The largest number up to `limit` that fits, if every smaller one does; 0 for none.
fn most(limit: usize, fits: impl Fn(usize) -> bool) -> usize {
    let (mut low, mut high) = (0, limit);
    while low < high {
        let middle = low + (high - low).div_ceil(2);
        if fits(middle) {
            low = middle;
        } else {
            high = middle - 1;
        }
    }
    low
}

fn check(
    device: &Device,
    what: &'static str,
    gaussians: usize,
    [width, height]: [u32; 2],
    needed: u64,
    relief: Relief,
) -> Result<u64, Error> {
    let there = device.memory_limit();
    if needed <= there {
        tracing::info!("{what} needs about {needed} bytes of device memory, of {there}");
        return Ok(needed);
    }
    let device = device.info().name.clone();
    Err(Error::Memory { what, gaussians, width, height, needed, there, device, relief })
}

#[cfg(test)]
mod tests {
    use super::most;

    #[test]
    fn the_largest_that_fits() {
        for right in 0..=20 {
            assert_eq!(most(20, |n| n <= right), right);
        }
        assert_eq!((most(0, |_| true), most(0, |_| false)), (0, 0));
    }
}
