//! HTML reports. Each page is one self-contained file with its style, script, pictures and plots.
//!
//! Pages are built from [`page`] (shell, tables), [`plot`] and [`slider`]. `maud` escapes every text.

mod compression;
pub mod format;
pub mod page;
pub mod picture;
pub mod plot;
mod run;
pub mod slider;

use crate::pipeline::Error;
use crate::pipeline::Output;
pub use run::cut;

use crate::pipeline::records::{CompressRecord, RunRecord};

/// Writes `report.html` of a run into its folder, from its results and the folder's pictures and `config.toml`; missing
/// ones are left out.
///
/// # Errors
/// [`Error::Write`].
pub fn write(results: &RunRecord, output: &Output) -> Result<(), Error> {
    Output::text(&output.report(), &of_run(results, output))
}

/// The page of a compression.
pub fn of_compression(record: &CompressRecord) -> String {
    compression::page(record)
}

/// The page of a run.
pub fn of_run(results: &RunRecord, output: &Output) -> String {
    let config = std::fs::read_to_string(output.config()).unwrap_or_default();
    run::page(results, &run::stacks(results, &output.renders()), &config)
}
