//! Paths of a job's files, and the lock of their folder.

use crate::extension::folder_of;
use crate::gaussians::formats;
use crate::job::{Error, Init};
use crate::lock::{Attempt, attempt};
use serde::Serialize;
use std::fs::File;
use std::path::{Path, PathBuf};

/// A folder of results.
pub struct Output {
    folder: PathBuf,
    /// Held until the end; the system releases it however the process ends.
    _lock: Option<File>,
}

/// Paths in the folder.
macro_rules! paths {
    ($($(#[$doc:meta])* $name:ident: $file:literal,)*) => {
        impl Output {
            $($(#[$doc])* pub fn $name(&self) -> PathBuf {
                self.folder.join($file)
            })*
        }
    };
}

paths! {
    /// The checkpoint.
    checkpoint: "checkpoint.safetensors",
    /// The configuration.
    config: "config.toml",
    /// The trained model.
    model: "model.ply",
    /// The model packed into a wanted size.
    packed: "model.sog",
    /// The figures.
    metrics: "metrics.json",
    /// The log of a run in progress.
    log: "log.jsonl",
    /// The report.
    report: "report.html",
    /// The folder of pictures.
    renders: "renders",
    /// The scene of a run on photos without poses.
    scene: "scene",
}

impl Output {
    /// Opens a folder, created if absent, for this process alone. Where another process has it, nothing in it is touched.
    ///
    /// # Errors
    /// [`Error::Busy`] if another process has it, as far as the file system knows locks; [`Error::Write`].
    pub fn claim(folder: &Path) -> Result<Self, Error> {
        create(folder)?;
        let lock = match lockable(folder).and_then(|file| Ok((attempt(&file)?, file))) {
            Ok((Attempt::Busy, _)) => return Err(Error::Busy(folder.to_owned())),
            Ok((Attempt::Locked, file)) => Some(file),
            Ok((Attempt::WithoutLocks, _)) | Err(_) => None,
        };
        Ok(Self { _lock: lock, ..Self::new(folder)? })
    }

    /// Opens the folder of a run that begins with `init`, as [`Output::claim`] does, where no other results are lost.
    ///
    /// # Errors
    /// The errors of [`check_run_folder`] and of [`Output::claim`]; [`Error::Usage`] for a model that is neither a run's nor `init`.
    pub fn for_run(folder: &Path, init: &Init) -> Result<Self, Error> {
        check_run_folder(folder)?;
        let output = Self::claim(folder)?;
        let model = output.model();
        let begins = matches!(init, Init::Model(initial) if formats::refuse_overwrite(initial, &model).is_err());
        if model.exists() && !output.config().exists() && !begins {
            return Err(Error::Usage(format!(
                "{} does not belong to a run and would be overwritten; name another folder",
                model.display()
            )));
        }
        Ok(output)
    }

    /// Opens a folder, created if absent. Temporary files that a killed program left there are removed.
    pub fn new(folder: &Path) -> Result<Self, Error> {
        create(folder)?;
        let output = Self { folder: folder.to_owned(), _lock: None };
        let files =
            [output.checkpoint(), output.config(), output.model(), output.packed(), output.metrics(), output.report()];
        files.iter().chain([&output.log()]).for_each(|file| formats::remove_leftovers(file));
        Ok(output)
    }

    /// The folder itself.
    pub fn folder(&self) -> &Path {
        &self.folder
    }

    /// Ends a run whose results are all written: its checkpoint, if there is one, is no longer needed.
    pub fn complete(&self) {
        let _ = std::fs::remove_file(self.checkpoint());
    }

    /// Writes `document` as JSON, whole or not at all; `what` names it in errors.
    pub fn json(path: &Path, what: &'static str, document: &impl Serialize) -> Result<(), Error> {
        Self::text(path, &serde_json::to_string_pretty(document).map_err(|e| Error::encoding(what, e))?)
    }

    /// Writes a text file whole or not at all.
    pub fn text(path: &Path, text: &str) -> Result<(), Error> {
        formats::write_atomically(path, |out| out.write_all(text.as_bytes())).map_err(Error::writing)
    }
}

/// Refuses a folder where a file is to be written, and a file that cannot be written there.
///
/// # Errors
/// [`Error::Usage`] for a folder; [`Error::Write`] for the system's reason.
pub fn check_file(file: &Path) -> Result<(), Error> {
    if file.is_dir() {
        return Err(Error::Usage(format!("{} is a folder; name a file", file.display())));
    }
    formats::check_place(file).map_err(Error::writing)
}

/// Makes the folder of a file, and checks the file as [`check_file`] does.
///
/// # Errors
/// Those of [`check_file`]; [`Error::Write`] for a folder that cannot be made.
pub fn make_place(file: &Path) -> Result<(), Error> {
    create(folder_of(file))?;
    check_file(file)
}

/// Refuses the folder of a comparison, and another run's folder of pictures, for a run.
///
/// # Errors
/// [`Error::Usage`].
pub fn check_run_folder(folder: &Path) -> Result<(), Error> {
    let holds = if ["compare.json", "arms"].iter().any(|part| folder.join(part).exists()) {
        "a comparison and its figures"
    } else if run_of_pictures(folder).is_some() {
        "the pictures of another run"
    } else {
        return Ok(());
    };
    Err(Error::Usage(format!("{} holds {holds}; name another folder", folder.display())))
}

/// The run whose pictures are in `folder`, if there is one.
pub fn run_of_pictures(folder: &Path) -> Option<&Path> {
    let inner = folder.ends_with("renders/photos") || folder.ends_with("renders/dense");
    let renders = if inner { folder.parent()? } else { folder };
    renders.parent().filter(|run| renders.ends_with("renders") && run.join("config.toml").is_file())
}

fn create(folder: &Path) -> Result<(), Error> {
    std::fs::create_dir_all(folder).map_err(|source| Error::Write { path: folder.to_owned(), source })
}

/// The file whose lock is a folder's: the folder itself, where folders can be opened.
fn lockable(folder: &Path) -> std::io::Result<File> {
    if cfg!(unix) {
        return File::open(folder);
    }
    File::options().write(true).create(true).truncate(false).open(folder.join(".lock"))
}

/// The same path from the root, for work in another folder.
pub fn absolute(path: &Path) -> PathBuf {
    std::path::absolute(path).unwrap_or_else(|_| path.to_owned())
}

/// Returns true if both paths lead to the same place on disk, however they are spelt.
pub fn same_place(a: &Path, b: &Path) -> bool {
    let real = |path: &Path| std::fs::canonicalize(path).ok();
    a == b || real(a).is_some_and(|a| Some(a) == real(b))
}

/// Changes the paths of a scene, a folder or a file, and of its photos and depth maps, where these are not names within it.
pub fn respell(scene: &mut PathBuf, folders: [&mut Option<PathBuf>; 2], spell: impl Fn(&Path) -> PathBuf) {
    *scene = spell(scene);
    for folder in folders.into_iter().flatten().filter(|folder| !within(scene, folder).exists()) {
        *folder = spell(folder);
    }
}

/// The place that a name within a scene, a folder or a file, stands for.
pub fn within(scene: &Path, name: &Path) -> PathBuf {
    if scene.is_file() { scene.with_file_name(name) } else { scene.join(name) }
}

/// Bytes of a model's file, or of all files in its folder; 0 if there is none.
pub fn bytes_on_disk(path: &Path) -> u64 {
    let file = |p: &Path| std::fs::metadata(p).map_or(0, |m| m.len());
    match std::fs::read_dir(path) {
        Ok(entries) => entries.flatten().map(|e| file(&e.path())).sum(),
        Err(_) => file(path),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::time::{Duration, SystemTime};

    #[test]
    fn a_folder_is_for_one_at_a_time() {
        let folder = tempfile::tempdir().unwrap();
        let claimed = Output::claim(folder.path()).unwrap();
        // A killed writer's; no system numbers processes so high.
        let left = folder.path().join(".model.ply.4194305-0.tmp");
        File::create(&left).unwrap().set_modified(SystemTime::now() - Duration::from_secs(7200)).unwrap();
        assert!(matches!(Output::claim(folder.path()), Err(Error::Busy(_))));
        assert!(left.exists(), "it is the other process's to remove");
        assert!(Output::new(folder.path()).is_ok(), "for readers, and parts of the same job");
        drop(claimed);
        assert!(Output::claim(folder.path()).is_ok());
        assert!(!left.exists());
    }

    #[test]
    fn a_run_leaves_other_results_alone() {
        let folder = tempfile::tempdir().unwrap();
        let at = |name: &str| folder.path().join(name);
        let refused = |name: &str, init: &Init| match Output::for_run(&at(name), init) {
            Err(Error::Usage(what)) => what,
            opened => panic!("{name}: {:?}", opened.map(|output| output.folder().to_owned())),
        };
        for name in ["compared/arms", "foreign", "run/renders/photos"] {
            std::fs::create_dir_all(at(name)).unwrap();
        }
        File::create(at("foreign/model.ply")).unwrap();
        File::create(at("run/config.toml")).unwrap();
        assert!(refused("compared", &Init::Points).contains("holds a comparison"));
        assert!(refused("foreign", &Init::Points).contains("model.ply does not belong to a run"));
        for pictures in ["run/renders", "run/renders/photos", "run/renders/dense"] {
            assert!(refused(pictures, &Init::Points).contains("holds the pictures of another run"));
        }
        assert!(!at("run/renders/dense").exists());
        assert!(Output::for_run(&at("foreign"), &Init::Model(at("foreign/model.ply"))).is_ok());
        for name in ["run", "new/renders"] {
            assert!(Output::for_run(&at(name), &Init::Points).is_ok(), "{name}");
        }
    }
}
