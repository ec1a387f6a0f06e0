//! The file of a snapshot: safetensors, with all notes as JSON in one header entry, and a checksum of everything. A
//! file is written completely or not at all.

use super::Snapshot;
use crate::gaussians::formats::{crc32, write_atomically};
use crate::gaussians::{Attributes, Error, Gaussians};
use crate::response::CHANNELS;
use crate::train::exposure;
use crate::train::mean::Mean;
use crate::train::poses;
use crate::train::state::TrainState;
use safetensors::SafeTensorError;
use safetensors::tensor::{Dtype, SafeTensors, TensorView};
use std::collections::{BTreeMap, HashMap};
use std::fs::File;
use std::io::Read;
use std::path::Path;

/// Largest header in bytes that safetensors accepts.
const LONGEST_HEADER: u64 = 100_000_000;
/// The header entry that holds all notes as JSON.
const NOTES: &str = "notes";
/// The note with the number of iterations done.
const ITERATION: &str = "iteration";
/// The note with the number of rows skipped because their gradients were not finite.
const SKIPPED_ROWS: &str = "skipped_rows";
/// The note with the events of the run as JSON, if there were any.
const COURSE: &str = "course";
/// Prefix of the names of a method's arrays.
const METHOD: &str = "method.";
/// The note with the number of Gaussians that never change, if there are any.
const TAIL: &str = "tail";
/// The note with the number of iterates in the mean, if one is taken.
const ITERATES: &str = "iterates";
/// The note with the checksum of everything else.
const CHECKSUM: &str = "crc32";

/// Names of the notes that a [`Snapshot`] writes and reads itself; a caller's notes need other names.
pub const OWN_NOTES: [&str; 6] = [ITERATION, SKIPPED_ROWS, COURSE, TAIL, ITERATES, CHECKSUM];

/// CRC-32 of tensors and notes with their names, ordered by name.
fn checksum<'a>(tensors: impl Iterator<Item = (&'a str, &'a [u8])>, notes: &'a HashMap<String, String>) -> u32 {
    let notes = notes.iter().filter(|(key, _)| *key != CHECKSUM).map(|(key, text)| (key.as_str(), text.as_bytes()));
    let mut parts: Vec<(&str, &[u8])> = tensors.chain(notes).collect();
    parts.sort_unstable();
    crc32(parts.into_iter().flat_map(|(name, bytes)| [name.as_bytes(), bytes]))
}

impl Snapshot {
    /// Writes the snapshot to a temporary file, flushes it to disk, and renames it.
    pub fn write(&self, path: &Path) -> Result<(), Error> {
        let bytes = self.bytes()?;
        write_atomically(path, |out| out.write_all(&bytes))
    }

    /// The bytes of the snapshot's file: the same for equal snapshots.
    ///
    /// # Errors
    /// [`Error::Inconsistent`] for contents that the format cannot hold.
    pub fn bytes(&self) -> Result<Vec<u8>, Error> {
        let mut tensors = Vec::new();
        let mut add = |name: String, data: &[f32]| {
            let bytes = bytemuck::cast_slice::<f32, u8>(data).to_vec();
            tensors.push((name, data.len(), bytes));
        };
        let all = Attributes::NAMES.zip(self.model.attributes().zip(self.moments.each_ref()));
        for (name, (parameters, moments)) in all.up_to(self.model.degree()) {
            add(name.to_owned(), parameters);
            add(format!("{name}.moments"), moments);
        }
        add("growth".to_owned(), &self.growth);
        if !self.responses.1.is_empty() {
            add("responses".to_owned(), &self.responses.0);
            // Integers, stored as the float with the same bits.
            add("responses.seen".to_owned(), bytemuck::cast_slice(&self.responses.1));
        }
        if !self.exposures.0.is_empty() {
            add("exposures".to_owned(), &self.exposures.0);
            add("exposures.moments".to_owned(), &self.exposures.1);
        }
        if !self.poses.is_empty() {
            add("poses".to_owned(), &self.poses);
        }
        if let Some(Mean { model, .. }) = &self.mean {
            for (name, values) in Attributes::NAMES.zip(model.attributes()).up_to(model.degree()) {
                add(format!("{name}.mean"), values);
            }
        }
        for (name, values) in &self.arrays {
            add(format!("{METHOD}{name}"), values);
        }
        let stored = |what: String| Error::Inconsistent { what: format!("the checkpoint cannot be stored: {what}") };
        let mut notes = self.notes.clone();
        notes.insert(ITERATION.into(), self.iteration.to_string());
        notes.insert(SKIPPED_ROWS.into(), self.skipped_rows.to_string());
        if self.state != TrainState::default() {
            let state = serde_json::to_string(&self.state);
            notes.insert(COURSE.into(), state.map_err(|e| stored(e.to_string()))?);
        }
        if let Some(Mean { iterates, .. }) = &self.mean {
            notes.insert(ITERATES.into(), iterates.to_string());
        }
        if self.tail > 0 {
            notes.insert(TAIL.into(), self.tail.to_string());
        }
        let sum = checksum(tensors.iter().map(|(name, _, bytes)| (name.as_str(), bytes.as_slice())), &notes);
        notes.insert(CHECKSUM.into(), sum.to_string());
        let views: Result<Vec<_>, _> = tensors
            .iter()
            .map(|(name, len, bytes)| TensorView::new(Dtype::F32, vec![*len], bytes).map(|view| (name.clone(), view)))
            .collect();
        // Sorted, because a map's order changes from run to run.
        let ordered: BTreeMap<String, String> = notes.into_iter().collect();
        let ordered = serde_json::to_string(&ordered).map_err(|e| stored(e.to_string()))?;
        let notes = [(NOTES.to_owned(), ordered)].into();
        views.and_then(|views| safetensors::serialize(views, Some(notes))).map_err(|e| stored(e.to_string()))
    }

    /// A note of the snapshot in a file, from its header alone; `None` if it cannot be read. Its checksum is not compared.
    pub fn note(path: &Path, name: &str) -> Option<String> {
        let mut file = File::open(path).ok()?;
        let (mut length, mut header) = ([0; 8], Vec::new());
        file.read_exact(&mut length).ok()?;
        file.take(u64::from_le_bytes(length).min(LONGEST_HEADER)).read_to_end(&mut header).ok()?;
        let header: serde_json::Value = serde_json::from_slice(&header).ok()?;
        let entries = header.get("__metadata__")?;
        match entries.get(NOTES) {
            Some(text) => serde_json::from_str::<HashMap<String, String>>(text.as_str()?).ok()?.remove(name),
            None => Some(entries.get(name)?.as_str()?.to_owned()),
        }
    }

    /// Reads a snapshot.
    ///
    /// # Errors
    /// [`Error::Io`]; [`Error::Malformed`] if the file is not a complete checkpoint.
    pub fn read(path: &Path) -> Result<Self, Error> {
        let bytes = std::fs::read(path).map_err(|source| Error::Io { path: path.into(), source })?;
        let stored = Stored::new(path, &bytes)?;
        let bands = Attributes::NAMES.sh.into_iter().take_while(|name| stored.has(name)).count();
        let n = stored.floats("opacity_logits")?.len();
        let tail = if stored.notes.contains_key(TAIL) { stored.number(TAIL)? as usize } else { 0 };
        let trained = n.checked_sub(tail);
        let trained = trained.ok_or_else(|| stored.bad(TAIL, &format!("it is longer than {n} Gaussians")))?;
        let all = Attributes::NAMES.zip(Attributes::widths(bands.max(1) - 1));
        let each = |suffix: &str, times: usize| {
            all.try_map(|(name, width)| match width {
                0 => Ok(Vec::new()),
                _ => stored.rows(&format!("{name}{suffix}"), times, width),
            })
        };
        let mean = if stored.notes.contains_key(ITERATES) {
            let model = Gaussians::of_attributes(each(".mean", n)?, bands);
            Some(Mean { model, iterates: stored.number(ITERATES)? as u32 })
        } else {
            None
        };
        let responses = if stored.has("responses") {
            let seen = stored.rows("responses.seen", n, 1)?;
            (stored.rows("responses", n, CHANNELS)?, seen.into_iter().map(f32::to_bits).collect())
        } else {
            Default::default()
        };
        let exposures = if stored.has("exposures") {
            (stored.floats("exposures")?, stored.floats("exposures.moments")?)
        } else {
            Default::default()
        };
        if exposures.0.len() % exposure::SIZE != 0 || exposures.1.len() != 2 * exposures.0.len() {
            return Err(stored.bad("exposures", "their lengths do not agree"));
        }
        let poses = if stored.has("poses") { stored.floats("poses")? } else { Vec::new() };
        if poses.len() % poses::STORED != 0 {
            return Err(stored.bad("poses", &format!("a photo has {} numbers", poses::STORED)));
        }
        let arrays = stored.arrays(trained)?;
        let state = match stored.notes.get(COURSE) {
            Some(text) => serde_json::from_str(text).map_err(|e| stored.bad(COURSE, &e.to_string()))?,
            None => TrainState::default(),
        };
        stored.check()?;
        Ok(Self {
            iteration: stored.number(ITERATION)? as u32,
            skipped_rows: stored.number(SKIPPED_ROWS)?,
            model: Gaussians::of_attributes(each("", n)?, bands),
            moments: each(".moments", 2 * trained)?,
            growth: stored.rows("growth", n, 2)?,
            tail,
            responses,
            exposures,
            poses,
            arrays,
            mean,
            state,
            notes: stored.notes,
        })
    }
}

/// A file that is being read.
struct Stored<'a> {
    path: &'a Path,
    file: SafeTensors<'a>,
    notes: HashMap<String, String>,
}

impl<'a> Stored<'a> {
    fn new(path: &'a Path, bytes: &'a [u8]) -> Result<Self, Error> {
        let bad = |e: SafeTensorError| damaged(path, "header", &e.to_string());
        let (_, header) = SafeTensors::read_metadata(bytes).map_err(bad)?;
        let mut notes = header.metadata().clone().unwrap_or_default();
        // Older checkpoints have separate entries.
        if let Some(text) = notes.remove(NOTES) {
            notes = serde_json::from_str(&text).map_err(|e| damaged(path, NOTES, &e.to_string()))?;
        }
        Ok(Self { path, file: SafeTensors::deserialize(bytes).map_err(bad)?, notes })
    }

    fn bad(&self, record: &str, what: &str) -> Error {
        damaged(self.path, record, what)
    }

    fn has(&self, tensor: &str) -> bool {
        self.file.tensor(tensor).is_ok()
    }

    fn number(&self, note: &str) -> Result<u64, Error> {
        let number = self.notes.get(note).and_then(|text| text.parse().ok());
        number.ok_or_else(|| self.bad(note, "it is missing or no number"))
    }

    fn floats(&self, name: &str) -> Result<Vec<f32>, Error> {
        let tensor = self.file.tensor(name).map_err(|e| self.bad(name, &e.to_string()))?;
        if tensor.dtype() != Dtype::F32 {
            return Err(self.bad(name, "it is not of 32-bit floats"));
        }
        Ok(tensor.data().chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect())
    }

    /// A tensor of this many rows of this width.
    fn rows(&self, name: &str, rows: usize, width: usize) -> Result<Vec<f32>, Error> {
        match self.floats(name)? {
            values if values.len() == rows * width => Ok(values),
            _ => Err(self.bad(name, &format!("its length is not that of {rows} rows of {width}"))),
        }
    }

    /// The arrays of a method, each of whole rows for `n` Gaussians.
    fn arrays(&self, n: usize) -> Result<BTreeMap<String, Vec<f32>>, Error> {
        let mut arrays = BTreeMap::new();
        for tensor in self.file.names() {
            let Some(name) = tensor.strip_prefix(METHOD) else { continue };
            let values = self.floats(tensor)?;
            if values.is_empty() != (n == 0) || values.len().checked_rem(n).unwrap_or(0) != 0 {
                return Err(self.bad(tensor, &format!("its length is not that of {n} rows")));
            }
            arrays.insert(name.to_owned(), values);
        }
        Ok(arrays)
    }

    /// Refuses a file whose checksum does not match: a run resumed from a flipped bit would silently end with a
    /// different model.
    fn check(&self) -> Result<(), Error> {
        let all = self.file.tensors();
        let sum = checksum(all.iter().map(|(name, t)| (name.as_str(), t.data())), &self.notes);
        if self.number(CHECKSUM)? != u64::from(sum) {
            return Err(self.bad(CHECKSUM, "it is not that of the content: the file is damaged"));
        }
        Ok(())
    }
}

fn damaged(path: &Path, record: &str, what: &str) -> Error {
    Error::Malformed {
        path: path.into(),
        record: record.into(),
        what: format!("{what}; delete the checkpoint to start afresh"),
    }
}
