//! `qirf-vk sweep`: what accuracy costs in time. Each axis of the engine is climbed rung by rung in one process on one device.

pub mod axis;
mod blocks;
mod epsilon;
mod gradients;
pub mod heavy;
pub mod measure;
mod overlap;
mod pictures;
pub mod results;
mod solver;
pub mod subject;

pub use axis::{Asked, Axis};
pub use results::{AxisRecord, Described, SweepRecord};
pub use subject::Subject;

use crate::error::Error;
use crate::pipeline::Session;
use std::time::Instant;

/// What a light axis is climbed with.
pub struct Context<'a> {
    /// Device, limits and audience.
    pub session: Session<'a>,
    /// What is looked at.
    pub subject: &'a Subject,
    /// Whether its views should show the subject's own pictures.
    pub own_pictures: bool,
    /// Time budget of each axis, in seconds; warm-up and three samples are always taken.
    pub seconds: f64,
}

/// Climbs one light axis.
///
/// # Errors
/// Device memory; device errors; [`Error::Interrupted`].
pub fn light(context: &Context<'_>, asked: &Asked) -> Result<Option<AxisRecord>, Error> {
    let rungs = &asked.rungs;
    let begun = Instant::now();
    let result = match asked.axis {
        Axis::Solver => solver::climb(context, rungs),
        Axis::Overlap => overlap::climb(context, rungs),
        Axis::Epsilon => epsilon::climb(context, rungs),
        Axis::Culling => pictures::cull(context, rungs),
        Axis::Stop => pictures::stop(context, rungs),
        Axis::Storage => pictures::storage(context, rungs),
        Axis::Gradients => gradients::climb(context, rungs),
        Axis::Keep | Axis::Selector | Axis::Iterations | Axis::Effects => return Ok(None),
    };
    let mut axis = result?;
    axis.seconds = begun.elapsed().as_secs_f64();
    context.session.watcher.note(&format!("{}: {:.1} s. {}", asked.axis.name(), axis.seconds, axis.sentence));
    Ok(Some(axis))
}

/// Climbs the heavy axes among those asked for, in the order of [`Axis::ALL`].
///
/// # Errors
/// As runs and comparisons.
pub fn heavy(training: &heavy::Training<'_>, asked: &[Asked]) -> Result<Vec<AxisRecord>, Error> {
    let begun = Instant::now();
    let mut out = Vec::new();
    let forked: Vec<&Asked> = asked.iter().filter(|a| matches!(a.axis, Axis::Keep | Axis::Selector)).collect();
    if !forked.is_empty() {
        out = heavy::forked(training, &forked)?;
        let seconds = begun.elapsed().as_secs_f64() / out.len() as f64;
        for axis in &mut out {
            axis.seconds = seconds;
        }
    }
    for asked in asked {
        let begun = Instant::now();
        let axis = match asked.axis {
            Axis::Iterations => heavy::iterations(training, &asked.rungs)?,
            Axis::Effects => heavy::effects(training, &asked.rungs)?,
            _ => continue,
        };
        out.push(AxisRecord { seconds: begun.elapsed().as_secs_f64(), ..axis });
    }
    Ok(out)
}
