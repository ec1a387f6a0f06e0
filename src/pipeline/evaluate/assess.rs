//! Assessment of a model on a scene: scores, frame rate, and the conditions of the measurement.

use super::evaluator::{Evaluator, HeldOut};
use super::exposure_fit::exposure_rule;
use crate::gaussians::Gaussians;
use crate::job::output::bytes_on_disk;
use crate::job::records::{Counts, Guards, Protocol, RunRecord, Times, TrainScores, infinite_for_nulls};
use crate::job::{Error, Selection, Session};
use crate::metrics::Networks;
use crate::pipeline::prepare::Prepared;
use crate::render::Source;
use crate::scene::{Skipped, camera};
use serde::{Deserialize, Serialize};
use std::path::Path;

/// Measurements of a model on views of a scene.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Assessment {
    /// Scores of the held-out views.
    pub held_out: HeldOut,
    /// PSNR of each held-out view without fitted exposures, in dB; of none if exposures are not fitted.
    #[serde(deserialize_with = "infinite_for_nulls")]
    pub unfitted_psnr: Vec<f64>,
    /// PSNR of each training view, in dB.
    #[serde(deserialize_with = "infinite_for_nulls")]
    pub train_psnr: Vec<f64>,
    /// Pictures per second, rendering alone; none if it was not measured.
    #[serde(skip)]
    pub frames_per_second: Option<f64>,
}

/// Mean of the finite values: a picture that equals its photo has an infinite PSNR, and tells nothing of the others. Infinite if no value
/// is finite; none without values.
pub fn mean(values: &[f64]) -> Option<f64> {
    let finite: Vec<f64> = values.iter().copied().filter(|value| value.is_finite()).collect();
    if finite.is_empty() { values.first().copied() } else { Some(finite.iter().sum::<f64>() / finite.len() as f64) }
}

impl Evaluator {
    /// Measures a model on the held-out views of a scene. Writes pictures of held-out views to the folder `renders`, if given;
    /// `follow` receives the number of views done, and may end the work.
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
        Ok(Assessment { held_out, unfitted_psnr, ..Assessment::default() })
    }
}

impl Assessment {
    /// Adds what was measured on more views.
    pub fn extend(&mut self, more: Self) {
        self.held_out.views.extend(more.held_out.views);
        self.held_out.empty += more.held_out.empty;
        self.unfitted_psnr.extend(more.unfitted_psnr);
        self.train_psnr.extend(more.train_psnr);
    }

    /// The record of an evaluation of `model`, read from `file`, on a scene without what was `skipped`; fields that training adds are
    /// left empty.
    pub fn record(
        self,
        session: &Session<'_>,
        skipped: Skipped,
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
            unfitted_psnr: mean(&self.unfitted_psnr),
            train: TrainScores { psnr: mean(&self.train_psnr) },
            frames_per_second: self.frames_per_second,
            model_bytes: bytes_on_disk(file),
            prunes: Vec::new(),
            camera_errors: None,
            floaters: None,
            cut: None,
            curve: Vec::new(),
            time: Times::default(),
            effects: Vec::new(),
            guards: Guards {
                skipped_rows: 0,
                undrawable: model.undrawable(),
                empty_views: self.held_out.empty,
                scene: skipped,
            },
            views: self.held_out.views,
            memory: session.memory(0),
        }
    }
}

/// The protocol of an evaluation of these views without training; with `fits_exposure` each photo has its own exposure.
pub fn protocol(selection: &Selection, views: &Prepared, networks: &Networks, fits_exposure: bool) -> Protocol {
    Protocol {
        train_views: views.train.len(),
        test_views: views.test.len(),
        image_size: camera::largest(views.views().map(|view| &view.camera)),
        background: views.background,
        ..rules(selection.eval_every, networks, fits_exposure)
    }
}

/// The rules of such an evaluation, without its views.
pub fn rules(eval_every: usize, networks: &Networks, fits_exposure: bool) -> Protocol {
    Protocol {
        test_split: format!("the data set's own, else one photo in {eval_every}, by name"),
        downscaling: "exact area average of the 8-bit photos; distorted photos resampled once to an ideal pinhole",
        lpips: networks.note().unwrap_or("VGG16, inputs in [0, 1]").to_owned(),
        exposure: exposure_rule(fits_exposure),
        ..Protocol::default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn infinite_scores_survive_a_file() {
        let some = Assessment { unfitted_psnr: vec![f64::INFINITY], train_psnr: vec![31.5], ..Assessment::default() };
        let text = serde_json::to_string(&some).unwrap();
        let mut back: Assessment = serde_json::from_str(&text).unwrap();
        assert_eq!(back, some);
        back.extend(some);
        assert_eq!((mean(&back.unfitted_psnr), mean(&back.train_psnr)), (Some(f64::INFINITY), Some(31.5)));
        assert_eq!((mean(&[]), mean(&[30.0, f64::INFINITY, 32.0])), (None, Some(31.0)));
    }
}
