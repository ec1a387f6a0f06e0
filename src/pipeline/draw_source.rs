//! A model of which a job shows pictures: on the device if it fits there, else on the host.

use super::budget;
use crate::gaussians::Gaussians;
use crate::gaussians::resident::Resident;
use crate::job::{Error, Session};
use crate::render::{Source, Style};

/// A model, and its copy on the device if that holds it.
pub struct DrawSource<'a> {
    model: &'a Gaussians,
    resident: Option<Resident>,
}

impl<'a> DrawSource<'a> {
    /// Uploads a model if the device holds it whole; else says that pictures are drawn in parts.
    pub fn new(session: &Session<'_>, model: &'a Gaussians, whole: bool) -> Result<Self, Error> {
        let Session { device, watcher, .. } = *session;
        if whole {
            return Ok(Self { model, resident: Some(Resident::upload(device, model)?) });
        }
        let (n, name) = (model.len(), &device.info().name);
        watcher.note(&format!("{name} cannot hold {n} Gaussians at once: pictures are drawn in parts"));
        Ok(Self { model, resident: None })
    }

    /// Uploads a model as [`Self::new`] does, for pictures of at most this size in a style.
    ///
    /// # Errors
    /// Too little memory for the pictures' own buffers.
    pub fn for_pictures(
        session: &Session<'_>,
        model: &'a Gaussians,
        size: [u32; 2],
        style: Style,
    ) -> Result<Self, Error> {
        Self::new(session, model, budget::for_pictures(session.device, model, size, style)?.whole)
    }

    /// True if the device holds the model whole.
    pub fn is_whole(&self) -> bool {
        self.resident.is_some()
    }

    /// The model where it is.
    pub fn source(&self) -> Source<'_> {
        self.resident.as_ref().map_or(Source::Host(self.model), Source::Device)
    }
}
