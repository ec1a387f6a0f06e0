//! Checks of outputs before any work: a run's files stay whole.

use crate::extension::has_extension;
use crate::gaussians::formats;
use crate::job::Error;
use crate::job::earlier::spare_model;
use crate::job::output::run_of_pictures;
use std::path::Path;

/// Refuses a file, or standard output, where a folder for results is wanted.
pub(super) fn check_folder(output: &Path) -> Result<(), Error> {
    if output == Path::new("-") {
        return Err(Error::Usage("-: results are files in a folder, not standard output; name a folder".to_owned()));
    }
    if output.exists() && !output.is_dir() {
        return Err(Error::Usage(format!("{} is a file; name a folder", output.display())));
    }
    Ok(())
}

/// Refuses a folder of results that is a run's, or its folder of pictures.
pub(super) fn check_no_run(output: &Path) -> Result<(), Error> {
    let own = Some(output).filter(|folder| folder.join("config.toml").is_file());
    match run_of_pictures(output).or(own) {
        Some(run) => Err(holds_run(run)),
        None => check_folder(output),
    }
}

/// An error for a folder with a run, whose figures would be overwritten.
pub(super) fn holds_run(output: &Path) -> Error {
    Error::Usage(format!("-o {} holds a run and its figures; name another folder", output.display()))
}

/// Refuses the name of a file that is no model's, and the model of a run, which its figures describe.
pub(super) fn check_model(output: &Path) -> Result<(), Error> {
    spare_model(output)?;
    if formats::is_levels(output) || has_extension(output, &["html"]) {
        let what = "pages and levels of detail are written by `qirf-vk convert`; write a model, and convert that";
        return Err(Error::Usage(format!("{}: {what}", output.display())));
    }
    formats::check_output(output).map_err(Error::writing)
}
