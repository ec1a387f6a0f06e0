//! How an evaluation's figures come about, in words.

use super::exposure_fit;
use crate::metrics::Networks;
use crate::pipeline::config::Selection;
use crate::pipeline::prepare::Prepared;
use crate::pipeline::records::Protocol;
use crate::scene::camera;

/// The protocol of an evaluation without training.
pub fn protocol(selection: &Selection, prepared: &Prepared, networks: &Networks) -> Protocol {
    Protocol {
        test_split: format!("the data set's own, else every {} by name", selection.eval_every),
        train_views: prepared.train.len(),
        test_views: prepared.test.len(),
        image_size: camera::largest(prepared.views().map(|v| &v.camera)),
        downscaling: "exact area average of the 8-bit photos; distorted photos resampled once to an ideal pinhole",
        background: prepared.background,
        lpips: networks.note().unwrap_or("VGG16, inputs in [0, 1]").to_owned(),
        exposure: exposure_note(false),
        iterations: None,
        seed: None,
    }
}

/// How pictures are scored where each photo has an exposure of its own, and where none has.
pub fn exposure_note(own: bool) -> &'static str {
    if own { exposure_fit::PROTOCOL } else { "none: pictures are scored as they are rendered" }
}
