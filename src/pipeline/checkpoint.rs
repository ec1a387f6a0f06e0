//! A run's checkpoint: the trainer's state with the run's own notes. Notes that cannot be read are an error: without
//! its prunes, a run would prune again.

use crate::job::Error;
use crate::job::records::{CurvePoint, PruneRecord, Trial};
use crate::scene::Names;
use crate::train::checkpoint::{OWN_NOTES, Snapshot};
use serde::de::DeserializeOwned;
use serde::{Deserialize, Serialize};
use serde_json::Value;
use std::collections::{BTreeMap, HashMap, HashSet};
use std::path::Path;

/// The state of a run besides the trainer's.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct RunNotes {
    /// The text of its `config.toml`.
    pub config: String,
    /// Quality against time so far.
    pub curve: Vec<CurvePoint>,
    /// Prunes so far.
    pub prunes: Vec<PruneRecord>,
    /// Seconds of training and pruning so far.
    pub seconds: f64,
    /// Seconds of the whole run so far; 0 in checkpoints of earlier versions.
    pub elapsed: f64,
    /// Largest device memory in use so far, in bytes; 0 in checkpoints of earlier versions.
    pub peak: u64,
    /// Largest estimate of it, in bytes; 0 in checkpoints of earlier versions.
    pub estimated: u64,
    /// Gaussians at the start.
    pub initial: usize,
    /// Names of the training photos; none in checkpoints of earlier versions.
    pub photos: Vec<String>,
    /// Checksum of each photo by name ([`super::prepare::Prepared::contents`]); none in checkpoints of earlier versions.
    pub contents: BTreeMap<String, u32>,
    /// The short training ahead of it, if there was one.
    pub trial: Option<Trial>,
}

impl RunNotes {
    /// Text by name: `config` unchanged, all else as JSON.
    fn to_text(&self) -> serde_json::Result<HashMap<String, String>> {
        let notes = serde_json::to_value(self)?;
        let text = |value: &Value| value.as_str().map_or_else(|| value.to_string(), str::to_owned);
        Ok(notes.as_object().into_iter().flatten().map(|(name, value)| (name.clone(), text(value))).collect())
    }

    /// The difference of the photos, those to train on and the contents of all, from those of the run so far, if there is one: its
    /// state belongs to them.
    pub fn other_photos(&self, names: &[String], contents: &BTreeMap<String, u32>) -> Option<String> {
        if self.photos.is_empty() || self.photos == names {
            let other = |(name, sum): &(&String, &u32)| self.contents.get(*name).is_some_and(|before| before != *sum);
            let mut changed = Names::default();
            contents.iter().filter(other).for_each(|(name, _)| changed.add(name));
            let what = "since then: the photo, its mask, depth map or camera";
            return (changed.count > 0).then(|| format!("{changed} changed {what}"));
        }
        let only = |of: &[String], other: &[String]| {
            let other: HashSet<&String> = other.iter().collect();
            of.iter().find(|name| !other.contains(name)).cloned()
        };
        let (lost, new) = (only(&self.photos, names), only(names, &self.photos));
        let lost = lost.map(|name| format!("; {name} is missing"));
        let new = new.map(|name| format!("; {name} is new"));
        let [lost, new] = [lost, new].map(Option::unwrap_or_default);
        Some(format!("photos to train on were {}, are {}{lost}{new}", self.photos.len(), names.len()))
    }

    /// Reads the notes of a snapshot. The error names the one that is missing, unknown or unreadable.
    fn from_text(notes: &HashMap<String, String>) -> Result<Self, String> {
        fn json<T: DeserializeOwned>(name: &str, text: &str) -> Result<T, String> {
            serde_json::from_str(text).map_err(|e| format!("the note '{name}' cannot be read: {e}"))
        }
        let text = |name: &str| notes.get(name).ok_or_else(|| format!("the note '{name}' is missing"));
        let read = Self {
            config: text("config")?.clone(),
            curve: json("curve", text("curve")?)?,
            prunes: json("prunes", text("prunes")?)?,
            seconds: json("seconds", text("seconds")?)?,
            elapsed: notes.get("elapsed").map_or(Ok(0.0), |text| json("elapsed", text))?,
            peak: notes.get("peak").map_or(Ok(0), |text| json("peak", text))?,
            estimated: notes.get("estimated").map_or(Ok(0), |text| json("estimated", text))?,
            initial: json("initial", text("initial")?)?,
            photos: notes.get("photos").map_or(Ok(Vec::new()), |text| json("photos", text))?,
            contents: notes.get("contents").map_or(Ok(BTreeMap::new()), |text| json("contents", text))?,
            trial: notes.get("trial").map_or(Ok(None), |text| json("trial", text))?,
        };
        let known = Self::default().to_text().unwrap_or_default();
        match notes.keys().find(|name| !known.contains_key(*name) && !OWN_NOTES.contains(&name.as_str())) {
            Some(name) => Err(format!("the note '{name}' is unknown")),
            None => Ok(read),
        }
    }
}

/// A run's whole state, in memory or in its folder.
#[derive(Clone, Debug)]
pub struct Checkpoint {
    /// The trainer's state; its notes are [`Checkpoint::notes`] as text.
    pub snapshot: Snapshot,
    /// The run's own notes.
    pub notes: RunNotes,
}

impl Checkpoint {
    /// Joins a snapshot with the run's notes.
    pub fn new(mut snapshot: Snapshot, notes: RunNotes) -> Result<Self, Error> {
        snapshot.notes.extend(notes.to_text().map_err(|e| Error::encoding("the checkpoint's notes", e))?);
        Ok(Self { snapshot, notes })
    }

    /// Reads a checkpoint.
    ///
    /// # Errors
    /// A damaged file; [`Error::Checkpoint`] for one of another version.
    pub fn read(path: &Path) -> Result<Self, Error> {
        let snapshot = Snapshot::read(path)?;
        let notes =
            RunNotes::from_text(&snapshot.notes).map_err(|what| Error::Checkpoint { path: path.to_owned(), what })?;
        Ok(Self { snapshot, notes })
    }

    /// Writes the checkpoint whole or not at all.
    pub fn write(&self, path: &Path) -> Result<(), Error> {
        self.snapshot.write(path).map_err(Error::writing)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The notes as written by commit e8c9f27.
    fn text() -> HashMap<String, String> {
        let prune = r#"[{"iteration":52,"selector":"css","before":900,"after":655,"detail":45,"blocks":20,"voxel":0.25,
            "occupancy":[1,2],"kept_shares":[0,0,0,0,0,0,0,0,0,3],"spectrum":[1.0,0.0,0.0,0.0,0.0,0.0,0.0,0.0],
            "modes":[3,0,0,0,0,0,0,0],"guards":{"canonical_blocks":0,"unseen_blocks":1,"repaired_values":0},
            "merged":{"accepted":2,"refused":1},"frames_per_second_before":120.5,"seconds":{"responses":0.1,
            "partition":0.1,"assemble":0.1,"solve":0.1,"assemble_and_solve":0.1,"select":0.1,"merge":0.1,"total":0.7}}]"#;
        [
            ("config", "seed = 1\n"),
            ("curve", r#"[{"iteration":15,"seconds":0.25,"psnr":null,"gaussians":900}]"#),
            ("prunes", prune),
            ("seconds", "3"),
            ("initial", "900"),
            ("iteration", "60"),
            ("skipped_rows", "0"),
            ("crc32", "12345"),
        ]
        .map(|(name, text)| (name.to_owned(), text.to_owned()))
        .into()
    }

    #[test]
    fn notes_of_the_old_form_are_read_and_written_notes_come_back() {
        let notes = RunNotes::from_text(&text()).unwrap();
        assert_eq!((notes.initial, notes.seconds, notes.prunes[0].after), (900, 3.0, 655));
        assert_eq!(notes.curve[0].psnr, f64::INFINITY, "JSON has no infinity");
        assert_eq!(RunNotes::from_text(&notes.to_text().unwrap()), Ok(notes));
    }

    #[test]
    fn other_photos_are_named() {
        let names = |list: &[&str]| list.iter().map(|name| (*name).to_owned()).collect::<Vec<String>>();
        let notes = RunNotes { photos: names(&["a", "b"]), ..RunNotes::default() };
        let sums = |a: u32, b: u32| BTreeMap::from([("a".to_owned(), a), ("b".to_owned(), b)]);
        let told = |list: &[&str]| notes.other_photos(&names(list), &sums(1, 2)).unwrap_or_default();
        assert_eq!(told(&["a", "b"]), "");
        assert_eq!(told(&["a"]), "photos to train on were 2, are 1; b is missing");
        assert_eq!(told(&["a", "c"]), "photos to train on were 2, are 2; b is missing; c is new");
        assert_eq!(RunNotes::default().other_photos(&names(&["a"]), &sums(1, 2)), None, "an earlier version's");
        let notes = RunNotes { contents: sums(1, 2), ..notes };
        assert_eq!(notes.other_photos(&notes.photos, &sums(1, 2)), None);
        assert!(notes.other_photos(&notes.photos, &sums(1, 3)).unwrap().starts_with("b changed since"));
    }

    #[test]
    fn notes_of_another_version_are_refused_by_name() {
        let with = |name: &str, new: Option<&str>| {
            let mut notes = text();
            notes.remove(name);
            notes.extend(new.map(|new| (name.to_owned(), new.to_owned())));
            RunNotes::from_text(&notes).expect_err("must be refused")
        };
        for name in ["config", "curve", "prunes", "seconds", "initial"] {
            assert!(with(name, None).contains(&format!("'{name}' is missing")));
        }
        for (name, wrong) in [("curve", ""), ("prunes", "{}"), ("seconds", "long"), ("initial", "-1")] {
            assert!(with(name, Some(wrong)).contains(&format!("'{name}' cannot be read")), "{name}");
        }
        // A prune with one figure more or fewer is from another version.
        assert!(with("prunes", Some(&text()["prunes"].replace("\"detail\":45,", ""))).contains("'prunes' cannot"));
        let more = text()["prunes"].replace("\"detail\":45,", "\"detail\":45,\"new\":1,");
        assert!(with("prunes", Some(&more)).contains("'prunes' cannot be read"));
        assert!(with("merged", Some("[]")).contains("'merged' is unknown"));
    }
}
