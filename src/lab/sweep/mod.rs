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

use crate::job::Error;
use crate::lab::figures::Figures;
use axis::Measure;
use std::path::Path;
use std::time::Instant;

/// Writes the figures of a sweep into its folder: `sweep.json`, `sweep.csv` and `sweep.html`.
pub fn write(swept: &SweepRecord, folder: &Path) -> Result<(), Error> {
    FIGURES.write(folder, swept, &swept.csv(), &page::page(swept))
}

/// The figures of a sweep.
const FIGURES: Figures = Figures(["sweep.json", "sweep.csv", "sweep.html"]);

/// Measures one light axis; returns `None` for a heavy one.
pub fn light(context: &Context<'_>, asked: &Asked) -> Result<Option<AxisRecord>, Error> {
    let Measure::Light(measure) = asked.axis.measure else { return Ok(None) };
    let measured = timed(asked.axis, |axis| measure(context, asked, axis))?;
    context.session.watcher.note(&format!("{}: {:.1} s. {}", asked.axis.name, measured.seconds, measured.sentence));
    Ok(Some(measured))
}

/// Measures the requested heavy axes: first those that share a checkpoint. `done` gets each as soon as it is measured.
pub fn heavy(
    training: &heavy::Training<'_>,
    asked: &[Asked],
    mut done: impl FnMut(AxisRecord) -> Result<(), Error>,
) -> Result<(), Error> {
    heavy::forked(training, asked)?.into_iter().try_for_each(&mut done)?;
    for asked in asked {
        if let Measure::Run(measure) = asked.axis.measure {
            done(timed(asked.axis, |axis| measure(training, asked, axis))?)?;
        }
    }
    Ok(())
}

/// The record of an axis that `by` fills in, judged, with the seconds that this took.
fn timed(axis: &'static Axis, by: impl FnOnce(AxisRecord) -> Result<AxisRecord, Error>) -> Result<AxisRecord, Error> {
    let begun = Instant::now();
    let measured = by(AxisRecord::new(axis))?.judged();
    Ok(AxisRecord { seconds: begun.elapsed().as_secs_f64(), ..measured })
}
