//! The whole state of a run: model, moments, growth, responses, exposures, iteration.

use super::cloak::Masks;
use super::course::Course;
use super::error::Result;
use super::exposure::{self, Exposure};
use super::mean::Mean;
use super::options::{Exposures, Options};
use super::trainee::{Tail, Trainee};
use super::trainer::Trainer;
use crate::gaussians::resident::Resident;
use crate::gaussians::{Attributes, Gaussians};
use crate::gpu::{self, Buffer, Device};
use crate::response::ResidentResponses;
use crate::scene::Photo;
use std::collections::HashMap;

mod file;

pub use file::OWN_NOTES;

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
    /// The mean of iterates, while one is taken.
    pub mean: Option<Mean>,
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
            mean: self.trainee.mean.clone(),
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
            mean: snapshot.mean.clone(),
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
