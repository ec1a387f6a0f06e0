//! How runs draw and score their models, which these remember.

use crate::errors::wrong;
use crate::model::Model;
use crate::watch::log;
use engine::job::Error;
use engine::job::earlier;
use engine::render::Style;
use pyo3::prelude::*;
use std::path::Path;

/// How a model's run draws and scores it.
#[derive(Clone, Copy, Debug, Default, PartialEq, FromPyObject, IntoPyObject)]
#[pyo3(from_item_all)]
pub struct OfRun {
    dilation: Option<f32>,
    depth_order: bool,
    exposure: bool,
    /// The background that its configuration names.
    pub(crate) background: Option<[f32; 3]>,
    /// The background of its figures.
    scored_on: Option<[f32; 3]>,
}

impl OfRun {
    /// The settings in the config.toml beside a model, and the background in the figures there; none without that file.
    pub(crate) fn beside(model: &Path) -> Result<Self, Error> {
        let Some(run) = earlier::of_model(model)? else { return Ok(Self::default()) };
        Ok(Self {
            dilation: run.style.dilation,
            depth_order: run.style.depth_order,
            exposure: run.exposure,
            background: run.background,
            scored_on: model.parent().and_then(earlier::scored_on),
        })
    }
}

impl Model {
    /// The style that its tag asks for, with these options instead.
    pub(crate) fn style(
        &self,
        antialias: Option<bool>,
        dilation: Option<f32>,
        depth_order: Option<bool>,
    ) -> PyResult<Style> {
        if let Some(dilation) = dilation.filter(|d| !(0.0..=100.0).contains(d)) {
            return Err(wrong(format!("dilation={dilation}: give 0 to 100 square pixels")));
        }
        let usual = Style::of(self.mode);
        let depth_order = depth_order.unwrap_or_default();
        Ok(Style { antialias: antialias.unwrap_or(usual.antialias), dilation, depth_order })
    }

    /// As [`Self::style`], with the style of its run where an option is not given; the log tells what is taken from it.
    pub(crate) fn style_of_run(
        &self,
        py: Python<'_>,
        antialias: Option<bool>,
        dilation: Option<f32>,
        depth_order: Option<bool>,
    ) -> PyResult<Style> {
        let taken = self.run.dilation.filter(|_| dilation.is_none());
        let orders = self.run.depth_order && depth_order.is_none();
        let style = self.style(antialias, dilation.or(taken), depth_order.or(Some(orders)))?;
        let dilation = taken.map(|dilation| format!("dilation={dilation}"));
        let order = orders.then(|| "depth_order=True".to_owned());
        let told: Vec<String> = dilation.into_iter().chain(order).collect();
        if !told.is_empty() {
            log(py, "info", &format!("drawn with {}, as in the model's run", told.join(", ")))?;
        }
        Ok(style)
    }

    /// The background of its pictures: that of its run, of which the log tells, else black.
    pub(crate) fn background(&self, py: Python<'_>) -> PyResult<[f32; 3]> {
        let own @ [red, green, blue] = self.run.background.or(self.run.scored_on).unwrap_or_default();
        if own.iter().any(|c| *c > 0.0) {
            log(py, "info", &format!("drawn on background=({red:.3}, {green:.3}, {blue:.3}), as in the model's run"))?;
        }
        Ok(own)
    }

    /// True if photos get exposures of their own: as given, else as in its run, of which the log tells.
    pub(crate) fn exposure(&self, py: Python<'_>, given: Option<bool>) -> PyResult<bool> {
        if given.is_none() && self.run.exposure {
            log(py, "info", "an exposure is fitted to each photo, as in the model's run")?;
        }
        Ok(given.unwrap_or(self.run.exposure))
    }
}
