//! `--diagnostics`: writes a file with block, score and fate of each Gaussian of a prune.

use super::check_file;
use super::console::Console;
use super::remedy::quoted;
use crate::extension::folder_of;
use crate::gaussians::Gaussians;
use crate::gaussians::formats::{self, RenderMode};
use crate::job::Error;
use crate::job::diagnostics::Diagnostics;
use crate::job::output::same_place;
use std::path::{Path, PathBuf};

/// The file's extension: no model has it, so that none is overwritten.
const EXTENSION: &str = "safetensors";

/// Reads the value of `--diagnostics`.
pub(super) fn file(text: &str) -> Result<PathBuf, String> {
    let path = PathBuf::from(text);
    match path.extension() {
        Some(extension) if extension == EXTENSION => Ok(path),
        _ => Err(format!("the name of such a file ends in .{EXTENSION}")),
    }
}

/// Whether two paths have the same name in the same folder, whether or not a file is there.
pub(super) fn same_file(a: &Path, b: &Path) -> bool {
    a.file_name() == b.file_name() && same_place(folder_of(a), folder_of(b))
}

/// Writes a prune's diagnostics.
pub(super) struct Recorder {
    file: PathBuf,
    /// Path for the model before the prune, if it is not a file yet.
    model: Option<PathBuf>,
}

impl Recorder {
    pub fn of_file(file: &Path) -> Self {
        Self { file: file.to_owned(), model: None }
    }

    /// A recorder for a run, which writes the model before the prune beside `file`, too. Neither file may replace one
    /// of `taken`. The folder `made` need not exist yet.
    ///
    /// # Errors
    /// [`Error::Usage`]; [`Error::Write`] if there is no such folder.
    pub fn of_run(file: &Path, taken: &[&Path], made: &Path) -> Result<Self, Error> {
        let model = file.with_extension("ply");
        for path in [file, &model] {
            if path.is_dir() || taken.iter().any(|other| same_place(path, other) || same_file(path, other)) {
                return Err(Error::Usage(format!(
                    "{} is already used for another output; name another file",
                    path.display()
                )));
            }
        }
        let folder = folder_of(file);
        if folder.components().ne(made.components()) {
            std::fs::metadata(folder).map_err(|source| Error::Write { path: file.to_owned(), source })?;
        }
        if folder.is_dir() {
            [file, &model].into_iter().try_for_each(check_file)?;
        }
        Ok(Self { file: file.to_owned(), model: Some(model) })
    }

    /// Writes the file, and the model.
    pub fn write(
        &self,
        before: &Gaussians,
        mode: RenderMode,
        diagnostics: &Diagnostics,
        console: &Console,
    ) -> Result<(), Error> {
        let Some(model) = &self.model else { return diagnostics.write(&self.file, before) };
        formats::write(model, before, mode).map_err(Error::writing)?;
        // As `view` will read it.
        diagnostics.write(&self.file, &formats::read(model)?.gaussians)?;
        let [model, file] = [model, &self.file].map(|path| quoted(path));
        console.note(format_args!("to see the prune: qirf-vk view {model} --diagnostics {file}"));
        Ok(())
    }
}
