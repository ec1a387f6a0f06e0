//! `qirf-vk sweep`: the cost of accuracy in time. Each axis of the engine is measured rung by rung in one process on
//! one device.

pub mod axis;
mod blocks;
mod epsilon;
mod gradients;
pub mod heavy;
mod overlap;
mod page;
mod pictures;
pub mod records;
pub mod rung;
mod solver;
pub mod subject;
pub mod timing;

pub use axis::{Asked, Axis};
pub use records::{AxisRecord, Described, SweepRecord};
pub use subject::Subject;

use crate::job::{Error, Output, Session};
use std::path::Path;
use std::time::Instant;

/// Writes `sweep.html` of a sweep into its folder.
pub fn write_page(swept: &SweepRecord, folder: &Path) -> Result<(), Error> {
    Output::text(&folder.join("sweep.html"), &page::page(swept))
}

/// Input of a light axis.
pub struct Context<'a> {
    /// Device, limits and watcher.
    pub session: Session<'a>,
    /// The subject.
    pub subject: &'a Subject,
    /// True if the ground truth of its views is the subject's own pictures.
    pub own_pictures: bool,
    /// Time budget of each axis, in seconds; warm-up and three samples are always measured.
    pub seconds: f64,
}

/// Measures one light axis; returns `None` for a heavy one.
pub fn light(context: &Context<'_>, asked: &Asked) -> Result<Option<AxisRecord>, Error> {
    let Some(measure) = asked.axis.measure() else { return Ok(None) };
    let begun = Instant::now();
    let mut axis = measure(context, &asked.rungs)?;
    axis.seconds = begun.elapsed().as_secs_f64();
    context.session.watcher.note(&format!("{}: {:.1} s. {}", axis.axis.name(), axis.seconds, axis.sentence));
    Ok(Some(axis))
}

/// Measures the requested heavy axes: first those that share a checkpoint.
pub fn heavy(training: &heavy::Training<'_>, asked: &[Asked]) -> Result<Vec<AxisRecord>, Error> {
    let begun = Instant::now();
    let mut out = heavy::forked(training, asked)?;
    let seconds = begun.elapsed().as_secs_f64() / out.len().max(1) as f64;
    for axis in &mut out {
        axis.seconds = seconds;
    }
    for asked in asked {
        let begun = Instant::now();
        let axis = match asked.axis {
            Axis::Iterations => heavy::iterations(training, &asked.values(rung::fraction))?,
            Axis::Effects => heavy::effects(training, &asked.values(|name| rung::switch(name).ok()))?,
            _ => continue,
        };
        out.push(AxisRecord { seconds: begun.elapsed().as_secs_f64(), ..axis });
    }
    Ok(out)
}
