//! The whole state of a run on disk: model, moments, growth, responses, exposures, iteration. A file is written completely or
//! not at all.

use super::cloak::Masks;
use super::course::Course;
use super::error::Result;
use super::exposure::{self, Exposure};
use super::options::{Exposures, Options};
use super::trainee::{Tail, Trainee};
use super::trainer::Trainer;
use crate::gaussians::formats::{crc32, write_atomically};
use crate::gaussians::resident::Resident;
use crate::gaussians::{Attributes, Error, Gaussians};
use crate::gpu::{self, Buffer, Device};
use crate::response::{CHANNELS, ResidentResponses};
use crate::scene::Photo;
use safetensors::tensor::{Dtype, SafeTensors, TensorView};
use std::collections::{BTreeMap, HashMap};
use std::path::Path;

/// Everything needed to resume a run.
#[derive(Clone, Debug, PartialEq)]
pub struct Snapshot {
    /// Iterations done.
    pub iteration: u32,
    /// Rows skipped so far because a gradient was not finite.
    pub skipped_rows: u64,
    /// The model.
    pub model: Gaussians,
    /// Number of Gaussians at its end that never change and have no moments.
    pub tail: usize,
    /// Moments of each attribute, first and second interleaved; empty for bands that the model lacks.
    pub moments: Attributes<Vec<f32>>,
    /// [`Trainee::growth`]: two numbers per Gaussian.
    pub growth: Vec<f32>,
    /// Averaged responses, eight per Gaussian, and the iteration that last showed each Gaussian; empty if there are none.
    pub responses: (Vec<f32>, Vec<u32>),
    /// Exposures, twelve numbers per photo, and their moments, first and second interleaved; empty if there are none.
    pub exposures: (Vec<f32>, Vec<f32>),
    /// Scores of learnt masks, and their moments, first and second interleaved; empty if there are none.
    pub masks: (Vec<f32>, Vec<f32>),
    /// Events of the run so far.
    pub course: Course,
    /// Text by name that the caller stores along, such as its configuration.
    pub notes: HashMap<String, String>,
}

impl Trainer {
    /// The state after [`Trainer::iteration`] iterations.
    ///
    /// # Errors
    /// Device errors.
    pub fn snapshot(&self) -> Result<Snapshot> {
        let read = |buffer: &Buffer<[f32; 2]>| buffer.cast::<f32>().read(&self.device);
        let Trainee { moments, growth, .. } = &self.trainee;
        Ok(Snapshot {
            iteration: self.iteration,
            skipped_rows: self.skipped_rows,
            model: self.download()?,
            tail: self.trainee.tail(),
            moments: moments.each_ref().try_map(read)?,
            growth: read(growth)?,
            responses: match &self.responses {
                Some(r) => (r.values.read(&self.device)?, r.seen.read(&self.device)?),
                None => Default::default(),
            },
            exposures: match &self.objective.exposure {
                Some(e) => (e.affine.read(&self.device)?, read(&e.moments)?),
                None => Default::default(),
            },
            masks: match &self.trainee.masks {
                Some(m) => (m.scores.read(&self.device)?, read(&m.moments)?),
                None => Default::default(),
            },
            course: self.course,
            notes: HashMap::new(),
        })
    }

    /// Resumes a run from a snapshot; it ends with the same bits as the uninterrupted run.
    ///
    /// # Errors
    /// Device memory; device errors; no photos; exposures of a different number of photos.
    pub fn resume(
        device: &Device,
        snapshot: &Snapshot,
        photos: Vec<Photo>,
        extent: f64,
        mut options: Options,
    ) -> Result<Self> {
        // They end once.
        options.schedule.learnt_masks.take_if(|_| snapshot.course.masks.is_some());
        let (scores, moments_of_scores) = &snapshot.masks;
        let masks = || Masks::with(device, scores, moments_of_scores);
        let upload =
            |name: &str, values: &[f32]| -> gpu::Result<Buffer<[f32; 2]>> { Ok(device.upload(name, values)?.cast()) };
        let moments = Attributes::NAMES.zip(snapshot.moments.each_ref());
        let trainee = Trainee {
            moments: moments.try_map(|(name, values)| upload(&format!("{name}.moments"), values))?,
            model: Resident::upload(device, &snapshot.model)?,
            growth: upload("growth", &snapshot.growth)?,
            masks: (!scores.is_empty()).then(masks).transpose()?,
            tail: Tail::new(device, snapshot.model.len(), snapshot.tail)?,
        };
        let mut trainer = Self::assemble(device, trainee, photos, extent, options)?;
        let (values, seen) = &snapshot.responses;
        if !seen.is_empty() {
            let (values, seen) = (device.upload("responses", values)?, device.upload("responses' iterations", seen)?);
            trainer.responses = Some(ResidentResponses { values, seen });
        }
        let (affine, moments) = &snapshot.exposures;
        if let (Some(e), Some(Exposures::Learnt(gains))) = (&trainer.objective.exposure, &trainer.options.exposure) {
            let [stored, photos] = [affine.len(), e.affine.len()].map(|numbers| numbers / exposure::SIZE);
            if stored != photos {
                return Err(super::Error::Exposures { stored, photos });
            }
            let pixels = e.image.len();
            trainer.objective.exposure = Some(Exposure::with(device, gains, affine, moments, pixels)?);
        }
        trainer.iteration = snapshot.iteration;
        trainer.skipped_rows = snapshot.skipped_rows;
        trainer.course = snapshot.course;
        Ok(trainer)
    }
}

/// The entry of the file's header that holds all notes as JSON.
const NOTES: &str = "notes";
/// The note that holds the events of the run as JSON, if there were any.
const COURSE: &str = "course";
/// The note that holds the number of Gaussians that never change, if there are any.
const TAIL: &str = "tail";
/// The note that holds the checksum of everything else.
const CHECKSUM: &str = "crc32";

/// CRC-32 of tensors and notes with their names, in the names' order.
fn checksum<'a>(tensors: impl Iterator<Item = (&'a str, &'a [u8])>, notes: &'a HashMap<String, String>) -> u32 {
    let notes = notes.iter().filter(|(key, _)| *key != CHECKSUM).map(|(key, text)| (key.as_str(), text.as_bytes()));
    let mut parts: Vec<(&str, &[u8])> = tensors.chain(notes).collect();
    parts.sort_unstable();
    crc32(parts.into_iter().flat_map(|(name, bytes)| [name.as_bytes(), bytes]))
}

impl Snapshot {
    /// Writes the snapshot: to a temporary file, flushed to disk, then renamed.
    ///
    /// # Errors
    /// [`Error::Io`] with the path.
    pub fn write(&self, path: &Path) -> std::result::Result<(), Error> {
        let bytes = self.bytes()?;
        write_atomically(path, |out| out.write_all(&bytes))
    }

    /// The bytes of the snapshot's file: the same for equal snapshots.
    ///
    /// # Errors
    /// [`Error::Inconsistent`] for contents that the format cannot hold.
    pub fn bytes(&self) -> std::result::Result<Vec<u8>, Error> {
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
            // Integers, whose bits are stored as those of floats.
            add("responses.seen".to_owned(), bytemuck::cast_slice(&self.responses.1));
        }
        if !self.exposures.0.is_empty() {
            add("exposures".to_owned(), &self.exposures.0);
            add("exposures.moments".to_owned(), &self.exposures.1);
        }
        if !self.masks.0.is_empty() {
            add("masks".to_owned(), &self.masks.0);
            add("masks.moments".to_owned(), &self.masks.1);
        }
        let stored = |what: String| Error::Inconsistent { what: format!("the checkpoint cannot be stored: {what}") };
        let mut notes = self.notes.clone();
        notes.insert("iteration".into(), self.iteration.to_string());
        notes.insert("skipped_rows".into(), self.skipped_rows.to_string());
        if self.course != Course::default() {
            let course = serde_json::to_string(&self.course);
            notes.insert(COURSE.into(), course.map_err(|e| stored(e.to_string()))?);
        }
        if self.tail > 0 {
            notes.insert(TAIL.into(), self.tail.to_string());
        }
        let sum = checksum(tensors.iter().map(|(name, _, bytes)| (name.as_str(), bytes.as_slice())), &notes);
        notes.insert(CHECKSUM.into(), sum.to_string());
        let views: std::result::Result<Vec<_>, _> = tensors
            .iter()
            .map(|(name, len, bytes)| TensorView::new(Dtype::F32, vec![*len], bytes).map(|view| (name.clone(), view)))
            .collect();
        // One after the other: a map's order changes from run to run.
        let ordered: BTreeMap<String, String> = notes.into_iter().collect();
        let ordered = serde_json::to_string(&ordered).map_err(|e| stored(e.to_string()))?;
        let notes = [(NOTES.to_owned(), ordered)].into();
        views.and_then(|views| safetensors::serialize(views, Some(notes))).map_err(|e| stored(e.to_string()))
    }

    /// Reads a snapshot.
    ///
    /// # Errors
    /// [`Error::Io`]; [`Error::Malformed`] if the file is not a complete checkpoint.
    pub fn read(path: &Path) -> std::result::Result<Self, Error> {
        let bytes = std::fs::read(path).map_err(|source| Error::Io { path: path.into(), source })?;
        let bad = |record: &str, what: String| Error::Malformed {
            path: path.into(),
            record: record.into(),
            what: format!("{what}; delete the checkpoint to start afresh"),
        };
        let file = SafeTensors::deserialize(&bytes).map_err(|e| bad("header", e.to_string()))?;
        let (_, header) = SafeTensors::read_metadata(&bytes).map_err(|e| bad("header", e.to_string()))?;
        let mut notes = header.metadata().clone().unwrap_or_default();
        // Older checkpoints have them one by one.
        if let Some(text) = notes.remove(NOTES) {
            notes = serde_json::from_str(&text).map_err(|e| bad(NOTES, e.to_string()))?;
        }
        let number = |key: &str| -> std::result::Result<u64, Error> {
            notes.get(key).and_then(|v| v.parse().ok()).ok_or_else(|| bad(key, "it is missing or no number".into()))
        };
        let floats = |key: &str| -> std::result::Result<Vec<f32>, Error> {
            let tensor = file.tensor(key).map_err(|e| bad(key, e.to_string()))?;
            if tensor.dtype() != Dtype::F32 {
                return Err(bad(key, "it is not of 32-bit floats".into()));
            }
            Ok(tensor.data().chunks_exact(4).map(|b| f32::from_le_bytes([b[0], b[1], b[2], b[3]])).collect())
        };
        let bands = Attributes::NAMES.sh.into_iter().take_while(|name| file.tensor(name).is_ok()).count();
        let n = floats("opacity_logits")?.len();
        let numbers = |name: &str, len: usize| match floats(name)? {
            values if values.len() == len => Ok(values),
            _ => Err(bad(name, format!("its length is not that of {n} Gaussians"))),
        };
        let all = Attributes::NAMES.zip(Attributes::widths(bands.max(1) - 1));
        let tail = if notes.contains_key(TAIL) { number(TAIL)? as usize } else { 0 };
        let trained = n.checked_sub(tail).ok_or_else(|| bad(TAIL, format!("it is longer than {n} Gaussians")))?;
        let each = |suffix: &str, times: usize| {
            all.try_map(|(name, width)| match width {
                0 => Ok(Vec::new()),
                _ => numbers(&format!("{name}{suffix}"), times * width),
            })
        };
        let (model, moments) = (Gaussians::of_attributes(each("", n)?, bands), each(".moments", 2 * trained)?);
        let growth = numbers("growth", 2 * n)?;
        let responses = match file.tensor("responses") {
            Ok(_) => {
                (floats("responses")?, floats("responses.seen")?.iter().map(|v| v.to_bits()).collect::<Vec<u32>>())
            }
            Err(_) => Default::default(),
        };
        if !responses.0.is_empty() && (responses.0.len() != CHANNELS * n || responses.1.len() != n) {
            return Err(bad("responses", format!("its length is not that of {n} Gaussians")));
        }
        let exposures = match file.tensor("exposures") {
            Ok(_) => (floats("exposures")?, floats("exposures.moments")?),
            Err(_) => Default::default(),
        };
        if exposures.0.len() % exposure::SIZE != 0 || exposures.1.len() != 2 * exposures.0.len() {
            return Err(bad("exposures", "their lengths do not agree".into()));
        }
        let masks = match file.tensor("masks") {
            Ok(_) => (numbers("masks", trained)?, numbers("masks.moments", 2 * trained)?),
            Err(_) => Default::default(),
        };
        let course = match notes.get(COURSE) {
            Some(text) => serde_json::from_str(text).map_err(|e| bad(COURSE, e.to_string()))?,
            None => Course::default(),
        };
        let (iteration, skipped_rows) = (number("iteration")? as u32, number("skipped_rows")?);
        // A run resumed from a flipped bit would end with a different model, and nobody would know.
        let all = file.tensors();
        if number(CHECKSUM)? != u64::from(checksum(all.iter().map(|(name, t)| (name.as_str(), t.data())), &notes)) {
            return Err(bad(CHECKSUM, "it is not that of the content: the file is damaged".into()));
        }
        Ok(Self { iteration, skipped_rows, model, tail, moments, growth, responses, exposures, masks, course, notes })
    }
}
