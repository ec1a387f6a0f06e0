//! The files of a comparison's or a sweep's figures.

use crate::job::{Error, Output};
use serde::Serialize;
use std::path::Path;

/// The names of the figures in their folder: JSON, CSV and page.
pub struct Figures(pub(super) [&'static str; 3]);

impl Figures {
    /// Writes the figures, each file completely or not at all.
    pub fn write(&self, folder: &Path, record: &impl Serialize, csv: &str, page: &str) -> Result<(), Error> {
        let Self([json_name, csv_name, page_name]) = self;
        Output::json(&folder.join(json_name), json_name, record)?;
        Output::text(&folder.join(csv_name), csv)?;
        Output::text(&folder.join(page_name), page)
    }

    /// Removes the figures of earlier work.
    pub fn remove(&self, folder: &Path) {
        for name in self.0 {
            let _ = std::fs::remove_file(folder.join(name));
        }
    }
}
