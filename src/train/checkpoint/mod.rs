//! The complete state of a run: model, moments, growth, responses, exposures, iteration.

use super::error::Result;
use super::exposure::{self, Exposure};
use super::mean::Mean;
use super::options::{Exposures, Options};
use super::poses;
use super::state::TrainState;
use super::trainer::Trainer;
use super::training_model::{Array, Tail, TrainingModel};
use crate::gaussians::resident::Resident;
use crate::gaussians::{Attributes, Gaussians};
use crate::gpu::{self, Buffer, Device};
use crate::response::ResidentResponses;
use crate::scene::Photo;
use std::collections::{BTreeMap, HashMap};

mod file;

pub use file::OWN_NOTES;

/// Everything needed to resume a run.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Snapshot {
    /// Iterations done.
    pub iteration: u32,
    /// Rows skipped so far because a gradient was not finite.
    pub skipped_rows: u64,
    /// The model.
    pub model: Gaussians,
    /// Number of Gaussians at the model's end that never change and have no moments.
    pub tail: usize,
    /// Moments of each attribute, first and second interleaved; empty for bands that the model lacks.
    pub moments: Attributes<Vec<f32>>,
    /// [`TrainingModel::growth`]: two numbers per Gaussian.
    pub growth: Vec<f32>,
    /// Averaged responses, eight per Gaussian, and the iteration that last showed each Gaussian; empty if there are none.
    pub responses: (Vec<f32>, Vec<u32>),
    /// Exposures, twelve numbers per photo, and their moments, first and second interleaved; empty if there are none.
    pub exposures: (Vec<f32>, Vec<f32>),
    /// Corrections of the cameras, [`poses::STORED`] numbers per photo; empty if there are none.
    pub poses: Vec<f32>,
    /// A method's arrays by name; see [`super::ArrayKind`].
    pub arrays: BTreeMap<String, Vec<f32>>,
    /// The mean of iterates, while one is taken.
    pub mean: Option<Mean>,
    /// Events of the run so far.
    pub state: TrainState,
    /// Text by name that the caller stores along, such as its configuration.
    pub notes: HashMap<String, String>,
}

impl Trainer {
    /// The state after [`Trainer::iteration`] iterations.
    pub fn snapshot(&self) -> Result<Snapshot> {
        let read = |buffer: &Buffer<[f32; 2]>| buffer.cast::<f32>().read(&self.device);
        let TrainingModel { moments, growth, .. } = &self.training;
        Ok(Snapshot {
            iteration: self.iteration,
            skipped_rows: self.skipped_rows,
            model: self.download()?,
            tail: self.training.tail(),
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
            poses: match &self.poses {
                Some(poses) => poses.stored(&self.device)?,
                None => Vec::new(),
            },
            arrays: {
                let read = |array: &Array| Ok((array.kind.name.to_owned(), array.values.read(&self.device)?));
                self.training.arrays.iter().map(read).collect::<Result<_>>()?
            },
            mean: self.training.mean.clone(),
            state: self.state,
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
        // A method that has ended is not attached again.
        options.method.take_if(|_| snapshot.state.cut.is_some());
        let kinds = options.method.as_ref().map(|method| method.arrays()).unwrap_or_default();
        let trained = snapshot.model.len() - snapshot.tail;
        let mut arrays = Vec::new();
        for kind in kinds {
            let values = snapshot.arrays.get(kind.name).filter(|values| values.len() == kind.width * trained);
            let method = options.method.as_ref().map_or("", |method| method.name());
            arrays.push(Array::with(device, *kind, values.ok_or(super::Error::Method { method })?)?);
        }
        let upload =
            |name: &str, values: &[f32]| -> gpu::Result<Buffer<[f32; 2]>> { Ok(device.upload(name, values)?.cast()) };
        let moments = Attributes::NAMES.zip(snapshot.moments.each_ref());
        let training = TrainingModel {
            moments: moments.try_map(|(name, values)| upload(&format!("{name}.moments"), values))?,
            model: Resident::upload(device, &snapshot.model)?,
            growth: upload("growth", &snapshot.growth)?,
            arrays,
            mean: snapshot.mean.clone(),
            tail: Tail::new(device, snapshot.model.len(), snapshot.tail)?,
        };
        let mut trainer = Self::assemble(device, training, photos, extent, options)?;
        let (values, seen) = &snapshot.responses;
        if !seen.is_empty() {
            let (values, seen) = (device.upload("responses", values)?, device.upload("responses' iterations", seen)?);
            trainer.responses = Some(ResidentResponses { values, seen });
        }
        let (affine, moments) = &snapshot.exposures;
        if let (Some(e), Some(Exposures::Learnt(gains))) = (&trainer.objective.exposure, &trainer.options.exposure) {
            let [stored, photos] = [affine.len(), e.affine.len()].map(|numbers| numbers / exposure::SIZE);
            if stored != photos {
                return Err(super::Error::OtherPhotos { what: "exposures", stored, photos });
            }
            let pixels = e.image.len();
            trainer.objective.exposure = Some(Exposure::with(device, gains, affine, moments, pixels)?);
        }
        if let Some(poses) = &mut trainer.poses {
            let [stored, photos] = [snapshot.poses.len() / poses::STORED, trainer.photos.len()];
            if stored != photos {
                return Err(super::Error::OtherPhotos { what: "camera corrections", stored, photos });
            }
            poses.restore(device, &mut trainer.photos, &snapshot.poses)?;
        }
        trainer.iteration = snapshot.iteration;
        trainer.skipped_rows = snapshot.skipped_rows;
        trainer.state = snapshot.state;
        Ok(trainer)
    }
}
