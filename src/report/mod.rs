//! Floor 8: HTML reports. Each page is one self-contained file with its style, script, pictures and plots.
//!
//! Pages are built from [`page`] (shell, tables), [`plot`] and [`compare`]. `maud` escapes every text.

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

/// Writes `report.html` of a run into its folder, from its results and the folder's pictures and `config.toml`; missing
/// ones are left out.
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
