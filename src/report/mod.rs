//! HTML reports. Each page is one self-contained file with its style, script, pictures and plots.
//!
//! Pages are built from [`page`] (shell, tables), [`plot`] and [`slider`]. `maud` escapes every text.

pub mod compression;
pub mod curve;
pub mod format;
pub mod page;
pub mod picture;
pub mod plot;
mod run;
pub mod slider;

use crate::job::{Error, Output};
pub use run::cut;

use crate::job::records::RunRecord;

/// Writes `report.html` of a run into its folder, from its results and the folder's pictures and `config.toml`; missing
/// ones are left out. `viewer` is a page that draws the model.
pub fn write(results: &RunRecord, output: &Output, viewer: Option<&str>) -> Result<(), Error> {
    Output::text(&output.report(), &of_run(results, output, viewer))
}

/// The page of a run; `viewer` is a page within it that draws the model.
pub fn of_run(results: &RunRecord, output: &Output, viewer: Option<&str>) -> String {
    let config = std::fs::read_to_string(output.config()).unwrap_or_default();
    let name = output.folder().file_name().unwrap_or_default().to_string_lossy();
    run::page((results, &*name), &run::stacks(results, &output.renders()), &config, viewer)
}
