//! Responses of photos to each Gaussian: from a pass over all photos, or averaged over iterations.

use super::device_photos::DevicePhotos;
use super::error::Result;
use super::loss::Loss;
use super::mask::Mask;
use super::objective::{Current, Objective};
use super::options::Options;
use super::trainer::Trainer;
use crate::gpu::{self, Buffer, Device};
use crate::render::{Renderer, Source, Style, Uses};
use crate::response::{self, Gather, Responses, Term, Views, Wanted, full_pass};
use crate::scene::{Photo, camera};

/// Photos, and what compares pictures with them.
struct Compared<'a> {
    photos: &'a [Photo],
    device_photos: &'a mut DevicePhotos,
    objective: &'a Objective,
}

/// The pass over all photos.
fn pass<E>(
    renderer: &mut Renderer,
    model: Source<'_>,
    Compared { photos, device_photos, objective }: Compared<'_>,
    wanted: Wanted,
    (follow, of): (impl FnMut(usize) -> Result<(), E>, Option<usize>),
) -> Result<Responses, E>
where
    E: From<gpu::Error> + From<super::Error>,
{
    let cameras: Vec<_> = photos.iter().map(|p| p.camera.clone()).collect();
    let views = Views { cameras: &cameras, follow, of };
    full_pass(renderer, model, views, &objective.loss.gradient, wanted, |recording, v, image, term| -> Result<(), E> {
        let pixels = device_photos.get(recording, photos, v, (v + 1) % cameras.len())?;
        let current = Current::new(v, pixels, &cameras[v]);
        if term == Term::Squares {
            objective.record_squares(recording, image, current);
        } else {
            let seen = objective.record(recording, image, current, false, None);
            objective.record_residual(recording, seen, current);
        }
        Ok(())
    })
}

/// Responses and scores, as `wanted`, of `photos` to a model that is not in training, wherever it is. Of the options, image
/// formation, exposures, the loss's weights and the capacity in pairs matter. With `of`, the photos are a chunk of so
/// many, as [`Views::of`].
///
/// # Errors
/// Device memory; device errors; photos that cannot be read; errors of `follow`.
pub fn responses<E>(
    device: &Device,
    model: Source<'_>,
    photos: &[Photo],
    options: &Options,
    wanted: Wanted,
    (follow, of): (impl FnMut(usize) -> Result<(), E>, Option<usize>),
) -> Result<Responses, E>
where
    E: From<gpu::Error> + From<super::Error>,
{
    let size = camera::largest(photos.iter().map(|p| &p.camera));
    let mut renderer = response::renderer(device, options.settings, model, (size, options.pairs), wanted)?;
    if !wanted.gradients() {
        let cameras: Vec<_> = photos.iter().map(|p| p.camera.clone()).collect();
        let unread = device.buffer("image gradient", 1)?;
        let views = Views { cameras: &cameras, follow, of };
        return full_pass(&mut renderer, model, views, &unread, wanted, |_, _, _, _| Ok(()));
    }
    let mut device_photos = DevicePhotos::new(device, photos)?;
    let objective = Objective::new(device, photos, size, options)?;
    let compared = Compared { photos, device_photos: &mut device_photos, objective: &objective };
    pass(&mut renderer, model, compared, wanted, (follow, of))
}

/// The photos of [`responses`], for an estimate of its memory.
#[derive(Clone, Copy, Debug)]
pub struct PhotoNeeds<'a> {
    /// Largest width and height of a photo.
    pub size: [u32; 2],
    /// Bytes of each photo.
    pub bytes: &'a [u64],
    /// True if photos have masks.
    pub masked: bool,
}

/// Bytes of device memory that [`responses`] takes besides the model and the results ([`Wanted::bytes`]).
pub fn bytes(
    device: &Device,
    gaussians: usize,
    pairs: u32,
    photos: PhotoNeeds<'_>,
    (style, wanted): (Style, Wanted),
) -> u64 {
    let PhotoNeeds { size, bytes, masked } = photos;
    let renderer =
        Renderer::bytes(device, gaussians, size, pairs, Uses { purpose: wanted.purpose(), responses: true, style });
    if !wanted.gradients() {
        return renderer + Buffer::<[f32; 4]>::bytes_of(1);
    }
    let pixels = size[0] as usize * size[1] as usize;
    let masks = if masked { Mask::bytes(pixels) } else { 0 };
    renderer + DevicePhotos::bytes(bytes, device.memory_limit()) + Loss::bytes(device, size[0], size[1]) + masks
}

impl Trainer {
    /// Responses and scores, as `wanted`, by a pass over all photos. Neither model nor moments change.
    ///
    /// # Errors
    /// Device memory; device errors; photos that cannot be read.
    pub fn responses(&mut self, wanted: Wanted) -> Result<Responses> {
        self.responses_with(wanted, |_| Ok(()))
    }

    /// As [`Trainer::responses`]; `follow` receives the number of photos done, and may end the pass by an error.
    ///
    /// # Errors
    /// As [`Trainer::responses`]; errors of `follow`.
    pub fn responses_with<E>(
        &mut self,
        wanted: Wanted,
        follow: impl FnMut(usize) -> Result<(), E>,
    ) -> Result<Responses, E>
    where
        E: From<gpu::Error> + From<super::Error>,
    {
        let (model, photos) = (Source::Device(&self.training.model), &self.photos);
        let compared = Compared { photos, device_photos: &mut self.device_photos, objective: &self.objective };
        pass(&mut self.renderer, model, compared, wanted, (follow, None))
    }

    /// Responses averaged over [`super::Options::averaged`], decayed to the last iteration done; none before those iterations.
    ///
    /// # Errors
    /// Device errors.
    pub fn averages(&self) -> Result<Option<Responses>> {
        let gather = Gather::Average { iteration: self.iteration };
        let Some(responses) = &self.responses else { return Ok(None) };
        Ok(Some(Responses { channels: responses.read(&self.device, gather)?, ..Responses::default() }))
    }
}
