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
use slider::Stack;

/// The pictures of a run's page, from those in its folder; missing ones are left out. They take most of the page's time.
pub fn pictures(results: &RunRecord, output: &Output) -> Vec<Stack> {
    run::stacks(results, &output.renders())
}

/// Writes `report.html` of a run into its folder, from its results, the page's pictures and the folder's `config.toml`, if that
/// is there. `viewer` is a page that draws the model.
pub fn write(results: &RunRecord, pictures: &[Stack], output: &Output, viewer: Option<&str>) -> Result<(), Error> {
    Output::text(&output.report(), &with_pictures(results, pictures, output, viewer))
}

/// The page of a run; `viewer` is a page within it that draws the model.
pub fn of_run(results: &RunRecord, output: &Output, viewer: Option<&str>) -> String {
    with_pictures(results, &pictures(results, output), output, viewer)
}

fn with_pictures(results: &RunRecord, pictures: &[Stack], output: &Output, viewer: Option<&str>) -> String {
    let config = std::fs::read_to_string(output.config()).unwrap_or_default();
    let name = output.folder().file_name().unwrap_or_default().to_string_lossy();
    run::page((results, &*name), pictures, &config, viewer)
}
