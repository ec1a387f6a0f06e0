//! Responses to each Gaussian, from a pass over all photos or averaged over iterations.

use super::device_photos::DevicePhotos;
use super::error::Result;
use super::exposure::Exposure;
use super::loss::Loss;
use super::mask::Mask;
use super::objective::{Current, Objective};
use super::options::Options;
use super::trainer::Trainer;
use crate::gpu::{self, Buffer, Device};
use crate::render::{Renderer, Source, Style, TrainingRenderer, Uses};
use crate::response::{self, Gather, Responses, Term, Views, Wanted, full_pass};
use crate::scene::{Photo, camera};
use std::ops::Range;

/// Errors of a pass: those of its caller, into which a device's and training's go.
pub trait PassError: From<gpu::Error> + From<super::Error> {}

impl<E: From<gpu::Error> + From<super::Error>> PassError for E {}

/// Photos, and the objective that compares pictures with them.
struct Compared<'a> {
    photos: &'a [Photo],
    device_photos: &'a mut DevicePhotos,
    objective: &'a Objective,
}

/// A pass over the photos with these numbers.
fn pass<E: PassError>(
    renderer: &mut TrainingRenderer,
    model: Source<'_>,
    Compared { photos, device_photos, objective }: &mut Compared<'_>,
    (wanted, numbers): (Wanted, Range<usize>),
    (follow, of): (impl FnMut(usize) -> Result<(), E>, Option<usize>),
) -> Result<Responses, E> {
    let first = numbers.start;
    let cameras: Vec<_> = photos[numbers].iter().map(|p| p.camera.clone()).collect();
    let views = Views { cameras: &cameras, follow, of };
    full_pass(renderer, model, views, &objective.loss.gradient, wanted, |recording, v, image, term| -> Result<(), E> {
        let number = first + v;
        let pixels = device_photos.get(recording, photos, number, (number + 1) % photos.len())?;
        let current = Current::new(number, pixels, &cameras[v]);
        if term == Term::Squares {
            objective.record_squares(recording, image, current);
        } else {
            let seen = objective.record(recording, image, current, false, None);
            objective.record_residual(recording, seen, current);
        }
        Ok(())
    })
}

/// A pass over each photo alone, whose results go to `each` with its number.
fn by_photo<E: PassError>(
    renderer: &mut TrainingRenderer,
    model: Source<'_>,
    compared: &mut Compared<'_>,
    wanted: Wanted,
    mut each: impl FnMut(usize, Responses) -> Result<(), E>,
) -> Result<(), E> {
    (0..compared.photos.len()).try_for_each(|number| {
        let one = (wanted, number..number + 1);
        each(number, pass(renderer, model, compared, one, (|_| Ok::<_, E>(()), None))?)
    })
}

/// Responses and scores, as `wanted`, of `photos` to a model that is not in training, on the device or on the host. Of
/// the options, image formation, exposures, the loss's weights and the capacity in pairs matter. With `of`, the photos
/// are a chunk of that many, as in [`Views::of`].
pub fn responses<E: PassError>(
    device: &Device,
    model: Source<'_>,
    photos: &[Photo],
    options: &Options,
    wanted: Wanted,
    (follow, of): (impl FnMut(usize) -> Result<(), E>, Option<usize>),
) -> Result<Responses, E> {
    let size = camera::largest(photos.iter().map(|p| &p.camera));
    let mut renderer = response::renderer(device, options.settings, model, size, options.pairs, wanted)?;
    if !wanted.gradients() {
        let cameras: Vec<_> = photos.iter().map(|p| p.camera.clone()).collect();
        let unread = device.buffer("image gradient", 1)?;
        let views = Views { cameras: &cameras, follow, of };
        return full_pass(&mut renderer, model, views, &unread, wanted, |_, _, _, _| Ok(()));
    }
    let (device_photos, objective) =
        (&mut DevicePhotos::new(device, photos)?, &Objective::new(device, photos, size, options)?);
    let mut compared = Compared { photos, device_photos, objective };
    pass(&mut renderer, model, &mut compared, (wanted, 0..photos.len()), (follow, of))
}

/// Like [`responses`], but passes the results of each photo alone, with its number, to `each`.
pub fn responses_by_photo<E: PassError>(
    device: &Device,
    model: Source<'_>,
    photos: &[Photo],
    (options, wanted): (&Options, Wanted),
    each: impl FnMut(usize, Responses) -> Result<(), E>,
) -> Result<(), E> {
    let size = camera::largest(photos.iter().map(|p| &p.camera));
    let mut renderer = response::renderer(device, options.settings, model, size, options.pairs, wanted)?;
    let (device_photos, objective) =
        (&mut DevicePhotos::new(device, photos)?, &Objective::new(device, photos, size, options)?);
    by_photo(&mut renderer, model, &mut Compared { photos, device_photos, objective }, wanted, each)
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
    /// True if each photo has an exposure of its own.
    pub exposure: bool,
}

/// Bytes of device memory that [`responses`] takes besides the model and the results ([`Wanted::bytes`]).
pub fn bytes(
    device: &Device,
    gaussians: usize,
    pairs: u32,
    photos: PhotoNeeds<'_>,
    (style, wanted): (Style, Wanted),
) -> u64 {
    let PhotoNeeds { size, bytes, masked, exposure } = photos;
    let renderer =
        Renderer::bytes(device, gaussians, size, pairs, Uses { purpose: wanted.purpose(), responses: true, style });
    if !wanted.gradients() {
        return renderer + Buffer::<[f32; 4]>::bytes_of(1);
    }
    let pixels = size[0] as usize * size[1] as usize;
    let compared = device.bytes_of(|counts| {
        masked.then(|| Mask::new(counts, pixels, [0.0; 3])).transpose()?;
        exposure.then(|| Exposure::new(counts, &[], bytes.len(), pixels)).transpose()?;
        Loss::new(counts, size[0], size[1])
    });
    renderer + DevicePhotos::bytes(bytes, device.memory_limit()) + compared
}

impl Trainer {
    /// The trainer's renderer, model and photos for a pass.
    fn for_pass(&mut self) -> (&mut TrainingRenderer, Source<'_>, Compared<'_>) {
        let (model, photos) = (Source::Device(&self.training.model), &self.photos);
        let compared = Compared { photos, device_photos: &mut self.device_photos, objective: &self.objective };
        (&mut self.renderer, model, compared)
    }

    /// Responses and scores, as `wanted`, by a pass over all photos. Neither model nor moments change.
    pub fn responses(&mut self, wanted: Wanted) -> Result<Responses> {
        let (renderer, model, mut compared) = self.for_pass();
        let all = 0..compared.photos.len();
        pass(renderer, model, &mut compared, (wanted, all), (|_| Ok(()), None))
    }

    /// Like [`Trainer::responses`], but passes the results of each photo alone, with its number, to `each`.
    pub fn responses_by_photo<E: PassError>(
        &mut self,
        wanted: Wanted,
        each: impl FnMut(usize, Responses) -> Result<(), E>,
    ) -> Result<(), E> {
        let (renderer, model, mut compared) = self.for_pass();
        by_photo(renderer, model, &mut compared, wanted, each)
    }

    /// Responses averaged over [`super::Options::averaged`], decayed to the last iteration done; `None` before those
    /// iterations.
    pub fn averages(&self) -> Result<Option<Responses>> {
        let gather = Gather::Average { iteration: self.iteration };
        let Some(responses) = &self.responses else { return Ok(None) };
        Ok(Some(Responses { channels: responses.read(&self.device, gather)?, ..Responses::default() }))
    }
}
