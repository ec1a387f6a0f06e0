//! The folder of a posed scene: its contents and their origin.

use super::{Backend, Matching, Options, Posed};
use crate::job::{Error, Output};
use serde::{Deserialize, Serialize};
use std::fs;
use std::io;
use std::path::{Component, Path, PathBuf};

/// The file that marks the folder as written by this program, and records the work done.
const RECORD: &str = "pose.json";
const MADE_BY: &str = "qirf-vk pose";

/// The key that identifies a set of photos: while it is the same, the poses stay valid.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Key {
    /// Name, size and time of the last change of every file.
    pub files: Vec<(String, u64, u64)>,
    /// Largest number of frames, of a video.
    pub frames: Option<usize>,
    /// COLMAP's configuration of rigs, or `panoramas`, if there is one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub rig: Option<String>,
}

#[derive(Clone, Debug, Default, Serialize, Deserialize)]
struct Record {
    made_by: String,
    key: Key,
    backend: Backend,
    matching: Matching,
    /// Photos in the folder of images; none before all are there.
    photos: Vec<String>,
    /// Finished steps of the features in the database.
    features: usize,
    /// Kind of pairs that the database holds completely.
    matched: Option<Matching>,
    posed: Option<Posed>,
}

/// The folder of a posed scene.
pub(super) struct Folder {
    root: PathBuf,
    record: Record,
    /// Photos of an earlier job, to be removed with its poses.
    stale: Option<Vec<String>>,
}

impl Folder {
    /// Reads the folder without changes.
    pub fn open(root: &Path, key: Key, options: &Options) -> Result<Self, Error> {
        let (backend, matching) = (options.backend, options.matching);
        let fresh = Record { made_by: MADE_BY.to_owned(), key, backend, matching, ..Record::default() };
        let folder = |record, stale| Self { root: root.to_owned(), record, stale };
        let path = root.join(RECORD);
        let text = match fs::read(&path) {
            Ok(text) => text,
            Err(e) if matches!(e.kind(), io::ErrorKind::NotFound | io::ErrorKind::NotADirectory) => {
                let empty = fs::read_dir(root).map_or(!root.exists(), |mut entries| entries.next().is_none());
                return if empty { Ok(folder(fresh, None)) } else { Err(Error::NotOurs(root.to_owned())) };
            }
            Err(source) => return Err(Error::Read { path, source }),
        };
        let earlier = serde_json::from_slice::<Record>(&text).ok().filter(|r| r.made_by == MADE_BY);
        // Photos of an earlier job are removed: none may lie elsewhere.
        let within = |name: &String| Path::new(name).components().all(|c| matches!(c, Component::Normal(_)));
        let earlier = earlier.filter(|r| r.photos.iter().all(|name| !name.is_empty() && within(name)));
        let Some(earlier) = earlier else { return Err(Error::NotOurs(root.to_owned())) };
        let there = |name: &String| root.join("images").join(name).is_file();
        if earlier.key != fresh.key || earlier.backend != backend || !earlier.photos.iter().all(there) {
            return Ok(folder(fresh, Some(earlier.photos)));
        }
        let whole = root.join("sparse/0").is_dir() && earlier.matching == matching;
        let posed = earlier.posed.clone().filter(|_| whole);
        Ok(folder(Record { matching, posed, ..earlier }, None))
    }

    /// The result, if it is there already.
    pub fn finished(&self) -> Option<Posed> {
        self.record.posed.clone()
    }

    /// Makes the folder; removes what an earlier job on other photos left in it.
    pub fn begin(&mut self) -> Result<(), Error> {
        if let Some(photos) = self.stale.take() {
            for name in photos {
                remove(&self.images(), Path::new(&name));
                remove(&self.masks(), &Path::new(&name).with_extension("png"));
            }
            for made in [self.root.join("sparse"), self.work()] {
                let _ = fs::remove_dir_all(made);
            }
        }
        for path in [self.images(), self.models()] {
            fs::create_dir_all(&path).map_err(|source| Error::Write { path, source })?;
        }
        self.write()
    }

    /// Notes that all photos are in the folder of images.
    pub fn placed(&mut self, names: Vec<String>) -> Result<(), Error> {
        self.record.photos = names;
        self.write()
    }

    /// Names of the photos.
    pub fn photos(&self) -> &[String] {
        &self.record.photos
    }

    /// Number of finished steps of the features.
    pub fn features(&self) -> usize {
        self.record.features
    }

    /// Notes that one more step of the features is finished.
    pub fn featured(&mut self) -> Result<(), Error> {
        self.record.features += 1;
        self.write()
    }

    /// True if the database holds all matches of this kind.
    pub fn has_matches(&self, matching: Matching) -> bool {
        self.record.matched == Some(matching)
    }

    /// Notes that the database holds all matches of this kind.
    pub fn matched(&mut self, matching: Matching) -> Result<(), Error> {
        self.record.matched = Some(matching);
        self.write()
    }

    /// Records the result, and removes the database, which is large.
    pub fn finish(mut self, posed: &Posed) -> Result<(), Error> {
        self.record = Record { posed: Some(posed.clone()), features: 0, matched: None, ..self.record };
        self.write()?;
        for ending in ["", "-wal", "-shm"] {
            let _ = fs::remove_file(format!("{}{ending}", self.database().display()));
        }
        Ok(())
    }

    fn write(&self) -> Result<(), Error> {
        Output::json(&self.root.join(RECORD), RECORD, &self.record)
    }

    /// The photos.
    pub fn images(&self) -> PathBuf {
        self.root.join("images")
    }

    /// Their masks.
    pub fn masks(&self) -> PathBuf {
        self.root.join("masks")
    }

    /// The poses of the scene.
    pub fn poses(&self) -> PathBuf {
        self.root.join("sparse/0")
    }

    /// Files of the program that estimates poses.
    pub fn work(&self) -> PathBuf {
        self.root.join("pose")
    }

    /// Folders of all parts, as the program writes them.
    pub fn models(&self) -> PathBuf {
        self.work().join("models")
    }

    /// COLMAP's database.
    pub fn database(&self) -> PathBuf {
        self.work().join("database.db")
    }

    /// The output of the programs.
    pub fn log(&self) -> PathBuf {
        self.work().join("log.txt")
    }
}

/// Removes a file within a folder, and the subfolders that it leaves empty. Files outside, to which a link may lead, are not
/// removed.
fn remove(folder: &Path, name: &Path) {
    let path = folder.join(name);
    let real = |path: Option<&Path>| path.and_then(|p| fs::canonicalize(p).ok());
    if !real(path.parent()).zip(real(Some(folder))).is_some_and(|(at, folder)| at.starts_with(folder)) {
        return;
    }
    let _ = fs::remove_file(&path);
    for sub in name.ancestors().skip(1).filter(|sub| !sub.as_os_str().is_empty()) {
        let _ = fs::remove_dir(folder.join(sub));
    }
}
