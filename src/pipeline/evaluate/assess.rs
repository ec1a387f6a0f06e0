//! Assessment of a model on a scene: scores, frame rate, and the conditions of the measurement.

use super::evaluator::{Evaluator, HeldOut};
use super::exposure_fit;
use crate::error::Error;
use crate::gaussians::Gaussians;
use crate::metrics::Networks;
use crate::pipeline::Session;
use crate::pipeline::config::Selection;
use crate::pipeline::output::bytes_on_disk;
use crate::pipeline::prepare::Prepared;
use crate::pipeline::records::{Counts, Guards, Protocol, RunRecord, Times, TrainScores};
use crate::render::Source;
use crate::scene::camera;
use std::path::Path;

/// Measurements of a model on a scene.
pub struct Assessment {
    /// Scores of the held-out views.
    pub held_out: HeldOut,
    /// Mean PSNR of the held-out views without fitted exposures, in dB; none if exposures are not fitted.
    pub unfitted_psnr: Option<f64>,
    /// Mean PSNR of the training views, in dB; none without any.
    pub train_psnr: Option<f64>,
    /// Pictures per second, rendering alone; none without views.
    pub frames_per_second: Option<f64>,
}

impl Evaluator {
    /// Measures a model on the views of a scene. Writes pictures of held-out views to the folder `renders`, if given;
    /// `follow` receives the number of views done, and may end the work.
    ///
    /// # Errors
    /// Device errors; pictures that cannot be written; errors of `follow`.
    pub fn assess<'m>(
        &mut self,
        model: impl Into<Source<'m>>,
        prepared: &Prepared,
        renders: Option<&Path>,
        networks: &Networks,
        follow: &mut dyn FnMut(usize) -> Result<(), Error>,
    ) -> Result<Assessment, Error> {
        let model = model.into();
        let held_out = self.held_out(model, &prepared.test, renders, networks, follow)?;
        let unfitted_psnr = self.unfitted_psnr(model, prepared.test.iter().map(|(_, view)| view))?;
        let train_psnr = self.psnr(model, prepared.train.iter())?;
        let frames_per_second = self.frames_per_second(model, prepared)?;
        Ok(Assessment { held_out, unfitted_psnr, train_psnr, frames_per_second })
    }
}

impl Assessment {
    /// The record of an evaluation of `model`, read from `file`; fields that training adds are left empty.
    pub fn record(
        self,
        session: &Session<'_>,
        prepared: &Prepared,
        protocol: Protocol,
        model: &Gaussians,
        file: &Path,
    ) -> RunRecord {
        RunRecord {
            schema: 1,
            version: env!("CARGO_PKG_VERSION"),
            device: session.device.tuned(),
            protocol,
            gaussians: Counts { initial: None, dense: None, last: model.len() },
            test: self.held_out.mean(),
            unfitted_psnr: self.unfitted_psnr,
            train: TrainScores { psnr: self.train_psnr },
            frames_per_second: self.frames_per_second,
            model_bytes: bytes_on_disk(file),
            prunes: Vec::new(),
            masks: None,
            curve: Vec::new(),
            time: Times::default(),
            effects: Vec::new(),
            guards: Guards {
                skipped_rows: 0,
                undrawable: model.undrawable(),
                empty_views: self.held_out.empty,
                scene: prepared.scene.skipped.clone(),
            },
            views: self.held_out.views,
            memory: session.memory(0),
        }
    }
}

/// The protocol of an evaluation without training; with `fits_exposure` each photo has its own exposure.
pub fn protocol(selection: &Selection, prepared: &Prepared, networks: &Networks, fits_exposure: bool) -> Protocol {
    Protocol {
        test_split: format!("the data set's own, else every {} by name", selection.eval_every),
        train_views: prepared.train.len(),
        test_views: prepared.test.len(),
        image_size: camera::largest(prepared.views().map(|v| &v.camera)),
        downscaling: "exact area average of the 8-bit photos; distorted photos resampled once to an ideal pinhole",
        background: prepared.background,
        lpips: networks.note().unwrap_or("VGG16, inputs in [0, 1]").to_owned(),
        exposure: if fits_exposure { exposure_fit::PROTOCOL } else { "none: pictures are scored as they are rendered" },
        iterations: None,
        seed: None,
    }
}
