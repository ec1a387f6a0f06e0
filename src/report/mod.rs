//! Floor 8: pages for people. Each is one file that loads nothing: style, script, pictures and plots lie within it.
//!
//! [`page`] (shell, tables), [`plot`] and [`compare`] are what pages are made of. `maud` escapes every text that comes in.

mod arms;
pub mod compare;
pub mod format;
pub mod page;
pub mod picture;
pub mod plot;
mod run;
mod sweep;

use crate::error::Error;
use crate::pipeline::Output;
use crate::pipeline::records::{CompareRecord, RunRecord};
use crate::pipeline::sweep::SweepRecord;
use std::path::Path;

/// Writes `report.html` of a run into its folder, from its results and from the pictures and `config.toml` there; what
/// is absent is left out.
///
/// # Errors
/// [`Error::Write`].
pub fn write(results: &RunRecord, output: &Output) -> Result<(), Error> {
    Output::text(&output.report(), &of_run(results, output))
}

/// Writes `compare.html` of a comparison into its folder.
///
/// # Errors
/// [`Error::Write`].
pub fn write_comparison(compared: &CompareRecord, folder: &Path) -> Result<(), Error> {
    Output::text(&folder.join("compare.html"), &arms::page(compared, folder))
}

/// Writes `sweep.html` of a sweep into its folder.
///
/// # Errors
/// [`Error::Write`].
pub fn write_sweep(swept: &SweepRecord, folder: &Path) -> Result<(), Error> {
    Output::text(&folder.join("sweep.html"), &sweep::page(swept))
}

/// The page of a run.
pub fn of_run(results: &RunRecord, output: &Output) -> String {
    let config = std::fs::read_to_string(output.config()).unwrap_or_default();
    run::page(results, &run::stacks(results, &output.renders()), &config)
}
