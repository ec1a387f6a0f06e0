//! `qirf-vk sweep`: the cost of accuracy in time. Each axis of the engine is measured rung by rung in one process on
//! one device.

pub mod asked;
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

pub use asked::Asked;
pub use axis::Axis;
pub use records::{AxisRecord, Described, SweepRecord};
pub use subject::{Context, Subject};

use crate::job::{Error, Output};
use rung::{Formula, Regularisation, Solver, culling, fraction, stop, sums, switch};
use std::path::Path;
use std::time::Instant;

/// Writes `sweep.html` of a sweep into its folder.
pub fn write_page(swept: &SweepRecord, folder: &Path) -> Result<(), Error> {
    Output::text(&folder.join("sweep.html"), &page::page(swept))
}

/// Measures one light axis; returns `None` for a heavy one.
pub fn light(context: &Context<'_>, asked: &Asked) -> Result<Option<AxisRecord>, Error> {
    let begun = Instant::now();
    let mut axis = match asked.axis {
        Axis::Solver => solver::measure(context, &asked.values(Solver::of)),
        Axis::Overlap => overlap::measure(context, &asked.values(Formula::of)),
        Axis::Epsilon => epsilon::measure(context, &asked.values(Regularisation::of)),
        Axis::Culling => pictures::culling(context, &asked.values(culling)),
        Axis::Stop => pictures::stop(context, &asked.values(stop)),
        Axis::Gradients => gradients::measure(context, &asked.values(sums)),
        Axis::Keep | Axis::Selector | Axis::Iterations | Axis::Effects => return Ok(None),
    }?;
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
            Axis::Iterations => heavy::iterations(training, &asked.values(fraction))?,
            Axis::Effects => heavy::effects(training, &asked.values(|name| switch(name).ok()))?,
            _ => continue,
        };
        out.push(AxisRecord { seconds: begun.elapsed().as_secs_f64(), ..axis });
    }
    Ok(out)
}
